r"""Expected separation of two explanations by further measurements, from a linearised fit of virtual recordings.

The winner is assumed to be true. It predicts the recordings of several further experiments: on a wider band, with a
contactor that is heavier by a known mass, under another preload, at another position of the finger. The alias is then
fitted to these predictions. With all quantities divided by the noise,

.. math:: Q_i = \min \sum_j \left|r_{ij} - J_{ij}\,\delta\theta_{ij} - G_{ij}\,\delta y_i\right|^2
          + (c_i - \mu)^T T^{-1} (c_i - \mu),

where r is the difference of the two impedances in person i's recording j, J the derivative by the elements, which are
free in every recording, and G that by the alias's additions y = (phi, c): shared parameters are one column for
all people; varying coefficients are each person's own around a common mean, the same in all recordings of a person. A
few Gauss-Newton steps first make r so small that this linearisation holds. The remaining r is what the experiment would
reveal. As in :mod:`bayes_impedance.person.likelihood` a misfit may also be attributed to noise, so for N complex
numbers it costs :math:`(\alpha + N) \ln(1 + \tfrac12 Q_i/(\alpha + N))`, which is Q/2 if it is small.

A varying coefficient makes the prediction uncertain, with covariance :math:`S = 1 + GTG^T`. With D the
information of a person's recordings about c,

.. math:: o_i = \ln|1 + D_iT| - \operatorname{tr} D_iT(1 + D_iT)^{-1}

and the expected difference (the Kullback-Leibler divergence of the two predictions, for the present people) is

.. math:: \sum_i \tfrac12 (Q_i + o_i)_\text{alias} - \tfrac12 (Q_i + o_i)_\text{winner} .

The noise of a new recording relative to its magnitude is that of the present one at the same frequency; beyond the band
it is that at the edge. A recording on a wider band replaces the present one. All other experiments are additional, so a
repetition of the present recordings would have a gain of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.next_experiment.virtual_recordings import Port, Recording, present_recordings
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import MASS, kind_of
from bayes_impedance.person.likelihood import SCALE_SHAPE
from bayes_impedance.population.natural_scales import LOG_SD
from bayes_impedance.units import ELECTRICAL_UNIT, hertz, number_with_unit, significant

WIDER = 3.0
"""Factor by which a band is extended: half a decade. By choice: many analysers can do that."""

ENOUGH = 5.0
"""Difference in natural logarithms from which two explanations count as separated: odds of 150 to one."""

_MASSES = (0.3, 1.0, 3.0)
"""Known masses, in units of the mass whose impedance equals that of the finger at the upper end of the band. By choice:
half a decade to either side."""

_STIFFER = {"m": 0.0, "n": -np.log(1.5), "r": np.log(1.3)}
"""Change of log elements under about three times the preload: stiffness and damping grow as its power 0.35 or less."""

_OTHER_STATE = {
    False: "another preload (elements 1.5 times stiffer)",
    True: "another state of charge (capacitances 1.5 times smaller, resistances 1.3 times larger)",
}
_OTHER_PLACE = {False: "a new finger position", True: "another temperature (elements 30 % different)"}
"""Words for these two, by whether the recordings are electrical."""

_OTHER_POSITION_SD = 0.3
"""Standard deviation by which log elements differ at another position of the finger: about that between
people."""

_POSITION_SEED = 20
"""Fixed seed, so that proposals do not depend on previous draws; its value is arbitrary."""

_STEPS, _LONGEST_STEP = 8, 1.0
"""Largest number of Gauss-Newton steps, and largest change of any parameter in one. By choice: few suffice, because
they start at fits of similar recordings."""

_NEGLIGIBLE = 0.01
"""Lower bound, in natural logarithms, of the separations of which ratios are formed. By choice."""


@dataclass(frozen=True)
class Proposal:
    """A further measurement, and its expected separation.

    Attributes
    ----------
    measurement : str
        What to measure, as part of a sentence.
    kind : str
        ``none`` (the present experiment), ``wider_high``, ``wider_low``, ``contactor_mass``, ``preload`` or
        ``position``.
    elpd : float
        Expected difference of the log likelihoods of the two explanations if the winner is true, in natural
        logarithms, for all people and recordings.
    gain : float
        Ratio to the present experiment.
    """

    measurement: str
    kind: str
    elpd: float
    gain: float


def separation(winner: Refit, alias: Refit, people: int = 8) -> tuple[Proposal, ...]:
    """Expected separation of two explanations in the present experiment and in others.

    Parameters
    ----------
    winner, alias : Refit
        Two models, fitted to the same recordings.
    people : int
        Number of representative people; they are evenly spread in how far their recordings separate the two.

    Returns
    -------
    tuple of Proposal
        Best first.

    Raises
    ------
    InputError
        If the two were fitted to different recordings, or `people` is below one.
    """
    if len(winner.data) != len(alias.data) or len(winner.u) != len(alias.u):
        raise InputError(
            f"the two explanations were fitted to {len(winner.u)} and {len(alias.u)} recordings: fit both to the same"
        )
    if people < 1:
        raise InputError(f"{people} people cannot represent a population: use at least one")
    present, share = _representatives(winner, alias, people)
    plans = _plans(winner, present)
    values = [_expected(winner, alias, recordings, share) for _, _, recordings in plans]
    now = max(values[0], _NEGLIGIBLE)
    proposals = [
        Proposal(measurement, kind, value, max(value, _NEGLIGIBLE) / now)
        for (kind, measurement, _), value in zip(plans, values, strict=True)
    ]
    return tuple(sorted(proposals, key=lambda p: -p.elpd))


def best_sentence(proposals: Sequence[Proposal]) -> str:
    """Name the best further measurement and its expected separation.

    A measurement is named only if it separates the two and gains more than a repetition of the present recordings.
    """
    now = next((p.elpd for p in proposals if p.kind == "none"), 0.0)
    for p in sorted(proposals, key=lambda p: -p.elpd):
        added = p.kind not in ("wider_high", "wider_low")
        if p.kind != "none" and p.elpd > ENOUGH and p.elpd > now * (2.0 if added else 1.0):
            return (
                f"{p.measurement}: expected to raise the difference of the log likelihoods from {_two_digits(now)} to "
                f"{_two_digits(p.elpd)}"
            )
    return "none of the measurements considered"


def _representatives(winner: Refit, alias: Refit, people: int) -> tuple[list[Recording], float]:
    """Present recordings of the representative people, and the number of people each of them represents."""
    everybody = present_recordings(winner)
    if people >= len(everybody):
        return everybody, 1.0
    port = Port(winner.model, 0.0)
    truth = [port.impedance(winner.u[r.row], r.frequency_hz) for r in everybody]
    follower = _Follower(alias, everybody, truth, 1.0)
    apart = follower.through_noise(follower.step(follower.start).misfit)
    middles = ((np.arange(people) + 0.5) * apart.size / people).astype(int)
    chosen = np.argsort(apart, kind="stable")[middles]
    # Weighted by each person's present separation where it exceeds noise, else by number.
    share = float(np.sum(apart + 1) / np.sum(apart[chosen] + 1))
    return [replace(everybody[i], person=k) for k, i in enumerate(chosen.tolist())], share


def _plans(fit: Refit, present: list[Recording]) -> list[tuple[str, str, list[Recording]]]:
    """Kind, name and recordings of each experiment, the present one first."""
    scales, elements = fit.model.scales, fit.model.network.elements
    electrical = scales.unit == ELECTRICAL_UNIT
    stiffer = np.array([_STIFFER[kind_of(e).letter] for e in elements])
    rng = np.random.default_rng(_POSITION_SEED)
    moved = [rng.normal(0, _OTHER_POSITION_SD, stiffer.size) for _ in present]
    low, high = scales.low / (2 * np.pi) / WIDER, scales.high / (2 * np.pi) * WIDER
    plans = [
        ("none", "the present experiment", present),
        ("wider_high", f"the band extended to {hertz(high, digits=2)}", [r.wider(1.0, WIDER) for r in present]),
        ("wider_low", f"the band extended down to {hertz(low, digits=2)}", [r.wider(WIDER, 1.0) for r in present]),
    ]
    for part in _MASSES:
        mass = part * scales.z_high / scales.high
        heavier = [replace(r, mass=mass) for r in present]
        plans.append(("contactor_mass", _heavier(mass, scales.unit), [*present, *heavier]))
    pressed = [replace(r, change=stiffer) for r in present]
    placed = [replace(r, change=change) for r, change in zip(present, moved, strict=True)]
    return [
        *plans,
        ("preload", _OTHER_STATE[electrical], [*present, *pressed]),
        ("position", _OTHER_PLACE[electrical], [*present, *placed]),
    ]


# ------------------------------------------------------------------------------------------- what a model can follow


def _expected(winner: Refit, alias: Refit, recordings: Sequence[Recording], share: float) -> float:
    """Expected difference of the log likelihoods in an experiment; each representative counts as `share` people."""
    ports = {mass: Port(winner.model, mass) for mass in {r.mass for r in recordings}}
    truth = [ports[r.mass].impedance(_parameters(winner, r), r.frequency_hz) for r in recordings]
    behind = _Follower(alias, recordings, truth, share).cost() - _Follower(winner, recordings, truth, share).cost()
    return share * max(behind, 0.0)


def _parameters(fit: Refit, recording: Recording) -> np.ndarray:
    u = np.array(fit.u[recording.row])
    u[: fit.model.n_elements] += recording.change
    return u


@dataclass(frozen=True)
class _State:
    """Parameters during the fit: elements (R, E), additions of each person (n, A) and means (V,)."""

    elements: np.ndarray
    own: np.ndarray
    mean: np.ndarray

    def moved(self, step: _State, part: float) -> _State:
        """State after a fraction of a step, each change being limited."""
        pairs = ((self.elements, step.elements), (self.own, step.own), (self.mean, step.mean))
        return _State(*(now + np.clip(part * by, -_LONGEST_STEP, _LONGEST_STEP) for now, by in pairs))


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step of all parameters.

    Attributes
    ----------
    change : _State
    objective : float
        After the step, in the linear approximation.
    misfit : ndarray, shape (n,)
        Part of each person: |r|^2, and the prior of the person's coefficients around the means.
    information : ndarray, shape (n, A, A)
        D of each person.
    """

    change: _State
    objective: float
    misfit: np.ndarray
    information: np.ndarray


class _Follower:
    """A fitted model that is refitted to virtual recordings.

    Parameters
    ----------
    fit : Refit
    recordings : sequence of Recording
        R of them, of n people.
    truth : sequence of ndarray, complex, shape (F,)
    share : float
        Number of people that each of them represents: the priors of the additions count only once.
    """

    def __init__(self, fit: Refit, recordings: Sequence[Recording], truth: Sequence[np.ndarray], share: float) -> None:
        self.recordings, self.truth, e = recordings, truth, fit.model.n_elements
        ports = {mass: Port(fit.model, mass) for mass in {r.mass for r in recordings}}
        self.ports = [ports[r.mass] for r in recordings]
        self.sd = [r.relative_sd * np.abs(z) for r, z in zip(recordings, truth, strict=True)]
        self.owner = np.array([r.person for r in recordings])
        self.n = int(self.owner.max()) + 1
        self.shared, self.varying = np.flatnonzero(fit.model.shared[e:]), np.flatnonzero(~fit.model.shared[e:])
        self.tau = np.sqrt(np.diag(fit.population.covariance)[e:])
        # Priors keep elements and additions bounded that no recording determines.
        prior_sd = np.array([p.prior_sd for p in fit.model.parameters])[np.r_[self.shared, self.varying]]
        self.prior = 1 / (share * prior_sd**2)
        u = np.array([_parameters(fit, r) for r in recordings])
        first = [int(np.argmax(self.owner == i)) for i in range(self.n)]
        self.start = _State(u[:, :e], u[first, e:], fit.population.mu[e:])

    def cost(self) -> float:
        """(Q + o)/2, where Q allows for the unknown scale of the noise."""
        state, objective = self.start, self._objective(self.start)
        if objective == 0.0 and not self.varying.size:  # the winner fits itself exactly, without uncertainty
            return 0.0
        step = self.step(state)
        for _ in range(_STEPS):
            if objective - step.objective < 1e-3 * max(objective, 1.0):
                break
            trials = (state.moved(step.change, part) for part in (1.0, 0.3, 0.1, 0.03, 0.01))
            better = next(((t, value) for t in trials if (value := self._objective(t)) < objective), None)
            if better is None:
                break
            state, objective = better
            step = self.step(state)
        information = step.information[:, self.varying][:, :, self.varying] * self.tau**2
        inside = np.eye(self.varying.size) + information
        uncertain = np.linalg.slogdet(inside)[1] - np.trace(np.linalg.solve(inside, information), axis1=1, axis2=2)
        return float(np.sum(self.through_noise(step.misfit) + 0.5 * uncertain))

    def through_noise(self, misfit: np.ndarray) -> np.ndarray:
        """Difference of log likelihoods of each person for a misfit, with unknown noise scale, shape (n,)."""
        points = [r.copies * r.frequency_hz.size for r in self.recordings]
        shape = SCALE_SHAPE + np.bincount(self.owner, points, minlength=self.n)
        return np.asarray(shape * np.log1p(0.5 * misfit / shape))

    def step(self, state: _State) -> _Step:
        """Eliminate the elements of every recording, then solve for the additions of all people together."""
        n_elements, a = state.elements.shape[1], state.own.shape[1]
        s, v = self.shared.size, self.varying.size
        where = np.empty((self.n, a), dtype=int)  # unknowns: shared ones, means, each person's own
        where[:, self.shared] = np.arange(s)
        where[:, self.varying] = s + v + np.arange(self.n * v).reshape(self.n, v)
        misfit, pull, information = np.zeros(self.n), np.zeros((self.n, a)), np.zeros((self.n, a, a))
        responses = []
        for k, i in enumerate(self.owner):
            z, dz = self.ports[k].derivative(self._at(state, k), self.recordings[k].frequency_hz)
            away = (self.start.elements[k] - state.elements[k]) / LOG_SD
            white = np.r_[_stacked((self.truth[k] - z) / self.sd[k]), away]
            columns = np.r_[_stacked(dz / self.sd[k]).T, np.eye(n_elements, n_elements + a) / LOG_SD]
            q, triangle = np.linalg.qr(columns[:, :n_elements])
            seen = np.c_[white, columns[:, n_elements:]]
            inside = q.T @ seen
            left = seen - q @ inside
            responses.append(solve_triangular(triangle, inside))
            products = left.T @ left
            misfit[i] += products[0, 0]
            pull[i] += products[0, 1:]
            information[i] += products[1:, 1:]
        precision, right = self._prior(state)
        for i in range(self.n):
            precision[np.ix_(where[i], where[i])] += information[i]
            np.add.at(right, where[i], pull[i])
        solution = np.linalg.solve(precision, right)
        own, mean = solution[where], solution[s : s + v]
        elements = [r[:, 0] - r[:, 1:] @ own[i] for r, i in zip(responses, self.owner, strict=True)]
        change = _State(np.array(elements), own, mean)
        misfit += np.einsum("na,nab,nb->n", own, information, own) - 2 * np.sum(own * pull, axis=1)
        after = _State(state.elements, state.own + own, state.mean + mean)
        misfit = np.maximum(misfit, 0.0) + self._apart(after)
        return _Step(change, float(misfit.sum()) + self._moved(after), misfit, information)

    def _objective(self, state: _State) -> float:
        total = float(self._apart(state).sum()) + self._moved(state)
        total += float(np.sum((state.elements - self.start.elements) ** 2)) / LOG_SD**2
        for k, (r, port) in enumerate(zip(self.recordings, self.ports, strict=True)):
            z = port.impedance(self._at(state, k), r.frequency_hz)
            total += float(np.sum(np.abs((self.truth[k] - z) / self.sd[k]) ** 2))
        return total if np.isfinite(total) else np.inf

    def _at(self, state: _State, k: int) -> np.ndarray:
        return np.concatenate([state.elements[k], state.own[self.owner[k]]])

    def _apart(self, state: _State) -> np.ndarray:
        """Prior term of each person's coefficients, squared distance to the means over the variance, shape (n,)."""
        return np.asarray(np.sum(((state.own[:, self.varying] - state.mean) / self.tau) ** 2, axis=1))

    def _common(self, state: _State) -> np.ndarray:
        return np.concatenate([state.own[0, self.shared], state.mean])

    def _moved(self, state: _State) -> float:
        return float(np.sum(self.prior * (self._common(state) - self._common(self.start)) ** 2))

    def _prior(self, state: _State) -> tuple[np.ndarray, np.ndarray]:
        """Precision and linear term of the priors of means, shared parameters and each person's coefficients."""
        c, v, n = self.prior.size, self.varying.size, self.n
        precision, right = np.zeros((c + n * v,) * 2), np.zeros(c + n * v)
        precision[range(c), range(c)] = self.prior
        right[:c] = self.prior * (self._common(self.start) - self._common(state))
        tie = np.c_[np.zeros((n * v, c - v)), np.tile(-np.eye(v), (n, 1)), np.eye(n * v)]
        tie /= np.tile(self.tau, n)[:, None]
        apart = ((state.own[:, self.varying] - state.mean) / self.tau).ravel()
        return precision + tie.T @ tie, right - tie.T @ apart


# ------------------------------------------------------------------------------------------- words


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag], axis=-1)


def _heavier(mass: float, impedance_unit: str) -> str:
    unit = MASS.unit(impedance_unit)
    size = number_with_unit(mass, unit, digits=2)
    if unit == "H":
        return f"an inductance of {size} in series"
    return f"a second contactor that is {size} heavier" if unit == "kg" else f"a contactor with {size} more inertia"


def _two_digits(value: float) -> str:
    """The value rounded to two significant digits, as text."""
    return significant(float(f"{value:.2g}"), 2)
