r"""Mapping a rational impedance onto a network, the step that section 4.2 of the paper could not complete.

There are two separate questions.

**Is the function exactly some network of this form?** The coefficient equations
(:mod:`~bayes_impedance.classical.coefficients`) are solved for real elements. A rational function from a fit
does not meet them in general: eq. 4 has ten coefficients for eight elements, and a pole at exactly 0.
All solutions found are reported, with the signs of their elements.

**Which elements are nearest?** Over the band, in relative or whitened complex error,

.. math:: \min_\theta\ \frac1F\sum_k \frac{|Z(j\omega_k;\theta) - \hat z(j\omega_k)|^2}{\sigma_k^2},
          \qquad \operatorname{cov}\hat\theta = s^2\,(J^TJ)^{-1},

from many starts. The root of the minimum is the distance of the function from the network's set.

If the noise of the fitted recordings is known, s = 1: the network's curves are a subset of the rational functions, and
fitting the larger set first is, to first order, least squares on the recordings themselves. If the difference is larger
than the C - P additional coefficients of the larger set can explain, s grows with it. Without a known noise the
difference itself, :math:`s^2 = \chi^2/(2F - P)`, is the only measure of scatter, and the intervals only say how
precisely the elements are determined **if the network is accepted**. An element whose logarithm has a standard error
above :data:`~bayes_impedance.population.em.DETERMINED_SD` is not determined by the curve in this band, and gets no
number.

At the nearest elements the relative sensitivities :math:`G_{kp} = \partial\ln c_k/\partial\ln x_p` say which
coefficients determine which element. Their pseudo-inverse is the first-order answer to "what does the element become
when a coefficient changes by one per cent", and the norm of its rows the factor by which independent relative errors of
the coefficients (those of rounding, say) are amplified.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.classical.coefficients import (
    CoefficientEquations,
    ExactSolution,
    exact_solutions,
    log_sensitivity,
)
from bayes_impedance.classical.elementwise import RUNAWAY, Curve
from bayes_impedance.classical.levenberg_marquardt import START_SPREAD
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.em import DETERMINED_SD
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.starting_fits import search_modes
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.atomic_files import finite_or_none
from bayes_impedance.units import NORMAL_Q95

if TYPE_CHECKING:
    import pandas as pd

_HELD_BY = 4
"""Number of coefficients reported for each element, those with the largest sensitivities. By choice."""

_RANDOM_STARTS = 3072
"""Random starts of the search: the best network of one published curve is reached by one start in 200."""

_THINNED_POINTS, _KEPT = 64, 6
"""Frequencies used in the search from all starts, and number of distinct end points refined on all frequencies. By
choice: more cost time."""

_PROVISIONAL_NOISE = 0.05
"""Relative noise assumed in the search if none is known: about the distance of published curves from the network (4 to
5 %). The standard errors then come from the difference itself."""


@dataclass(frozen=True, kw_only=True, repr=False)
class MappedElement(Brief):
    """One element of the nearest network.

    Attributes
    ----------
    unit : str
    value, q05, q95 : float or None
        Best value and 90 % interval; None where the curve does not determine the element in this band.
    standard_error : float
        Of its natural logarithm.
    held_by : tuple of (str, float)
        The coefficients it depends on most, and its relative sensitivity to each.
    amplification : float
        Relative error of the element per unit of independent relative errors of all coefficients.
    """

    unit: str
    value: float | None
    q05: float | None
    q95: float | None
    standard_error: float
    held_by: tuple[tuple[str, float], ...]
    amplification: float


@dataclass(frozen=True, kw_only=True, repr=False)
class NetworkMapping(Brief):
    """The result of mapping a rational impedance onto a network.

    Attributes
    ----------
    network : str
    n_coefficients, n_elements : int
        Number of free coefficients of the network's form (without one common factor), and number of elements.
    obstacles : tuple of str
        Coefficients that are zero in the network but not in the function, or the reverse: no exact mapping exists.
    exact : tuple of ExactSolution
        All real solutions of the coefficient equations that were found.
    elements : dict of str to MappedElement
        The nearest network with positive elements.
    log_elements : ndarray, shape (P,)
        Log elements of the nearest network, including undetermined ones, for evaluating its curve.
    distance : float
        Root mean square over frequency of the relative complex difference to the nearest network.
    worst_hz, worst_relative : float
        Where the relative difference is largest, and how large.
    whitened_distance : float or None
        Root mean square in units of the given noise: far below 1 if the noise explains the difference.
    condition : float
        Ratio of the largest to the smallest singular value of G.
    coefficient_ratios : dict of str to float
        Each coefficient of the function over that of the nearest network, both with the common factor that brings the
        geometric mean of these ratios to one.
    """

    network: str
    n_coefficients: int
    n_elements: int
    obstacles: tuple[str, ...]
    exact: tuple[ExactSolution, ...]
    elements: dict[str, MappedElement]
    log_elements: np.ndarray
    distance: float
    worst_hz: float
    worst_relative: float
    whitened_distance: float | None
    condition: float
    coefficient_ratios: dict[str, float]

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each element of the nearest network."""
        import pandas as pd

        return pd.DataFrame([{"element": name, **asdict(own)} for name, own in self.elements.items()]).set_index(
            "element"
        )

    def summary(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "network": self.network,
            "coefficients": self.n_coefficients,
            "obstacles": list(self.obstacles),
            "exact_solutions": [s.values for s in self.exact],
            "distance": self.distance,
            "worst": {"frequency_hz": self.worst_hz, "relative": self.worst_relative},
            "condition": finite_or_none(self.condition),
            "elements": {
                name: {
                    "unit": e.unit,
                    "identified": e.value is not None,
                    "value": e.value,
                    "q05": e.q05,
                    "q95": e.q95,
                    "standard_error_log": finite_or_none(e.standard_error),
                    "amplification": finite_or_none(e.amplification),
                    "held_by": dict(e.held_by),
                }
                for name, e in self.elements.items()
            },
            "coefficient_ratios": {k: finite_or_none(v) for k, v in self.coefficient_ratios.items()},
        }


def map_to_network(
    transfer: TransferFunction,
    network: Network,
    frequency_hz: np.ndarray,
    *,
    noise_sd: np.ndarray | None = None,
    unit: str = "N s/m",
    seed: int = 1,
) -> NetworkMapping:
    """Find the elements with which a network is, or comes nearest to, a rational impedance.

    Parameters
    ----------
    transfer : TransferFunction
        Real coefficients; sign convention: a passive load has Re z >= 0.
    network : Network
    frequency_hz : ndarray, shape (F,)
        Frequencies in Hz over the band in which the function was fitted.
    noise_sd : ndarray, shape (F,), optional
        Standard deviation of each of real and imaginary part of the data to which the function was fitted.
    unit : str
        Of the impedance.
    seed : int
        Of the random starts.

    Returns
    -------
    NetworkMapping

    Raises
    ------
    InputError
        If coefficients are complex, or Re z is negative in the whole band: its sign is inverted.
    """
    frequency = np.asarray(frequency_hz, dtype=float)
    if any(np.iscomplexobj(p) and np.any(np.imag(p) != 0) for p in (transfer.numerator, transfer.denominator)):
        raise InputError("the coefficients are complex: drop their imaginary parts or fit with real coefficients")
    target = transfer(2j * np.pi * frequency)
    if np.mean(target.real < 0) > 0.5:
        raise InputError(
            "Re z is negative over most of the band, so the force was counted with the opposite sign; reverse the sign"
        )
    kernel = Kernel(network)
    if 2 * frequency.size <= len(kernel.elements):
        raise InputError(f"{frequency.size} frequencies are too few for {len(kernel.elements)} elements: give more")
    log_elements = _nearest(kernel, frequency, target, noise_sd, seed)
    equations = CoefficientEquations.of(network)
    wanted, surplus = equations.wanted(transfer)
    missing = tuple(f"{n} = 0" for n, w in zip(equations.names, wanted, strict=True) if w == 0)
    value, slope = equations.evaluate(log_elements[None], np.ones((1, log_elements.size)))
    sensitivity = log_sensitivity(value[0], slope[0])
    singular = np.linalg.svd(sensitivity, compute_uv=False)
    model, derivative = kernel.derivative(log_elements, frequency)
    n_surplus = len(equations.names) - 1 - len(equations.elements)
    standard_error = _standard_errors(target, model, derivative, noise_sd, n_surplus)
    relative = np.abs(model / target - 1)
    worst = int(np.argmax(relative))
    return NetworkMapping(
        network=str(network),
        n_coefficients=len(equations.names) - 1,
        n_elements=len(equations.elements),
        obstacles=surplus + missing,
        exact=exact_solutions(equations, transfer, log_elements, seed),
        elements=_described(equations.elements, unit, log_elements, standard_error, equations.names, sensitivity),
        log_elements=log_elements,
        distance=float(np.sqrt(np.mean(relative**2))),
        worst_hz=float(frequency[worst]),
        worst_relative=float(relative[worst]),
        whitened_distance=None
        if noise_sd is None
        else float(np.sqrt(np.mean(np.abs(model - target) ** 2 / noise_sd**2))),
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf,
        coefficient_ratios=_ratios(equations.names, wanted, value[0]),
    )


def _nearest(
    kernel: Kernel, frequency: np.ndarray, target: np.ndarray, noise_sd: np.ndarray | None, seed: int
) -> np.ndarray:
    """Log elements with the least weighted sum of squares, from the same starts as for a subject's curve."""
    recordings = Recordings(
        title="curve",
        unit="",
        network=None,
        source="",
        licence="",
        subjects=(Subject(name="curve", frequency_hz=frequency, z=target[None], repetitions=("1",)),),
    )
    prior = default_prior(kernel, recordings)
    sd = _PROVISIONAL_NOISE * np.abs(target) if noise_sd is None else noise_sd
    likelihood = Likelihood.make(frequency, target[None], sd[None], np.zeros((1, len(kernel.elements))))
    spread = np.random.default_rng(seed).normal(0, START_SPREAD, (_RANDOM_STARTS, len(kernel.elements)))
    starts = search_modes(kernel, likelihood.thinned(_THINNED_POINTS), prior.centre + spread, prior, _KEPT)
    curve = Curve(kernel, frequency, target, "complex", 1 / sd, prior.centre)
    best = curve.best(starts, 2000)[0]
    return np.asarray(np.clip(best, prior.centre - RUNAWAY, prior.centre + RUNAWAY))


def _standard_errors(
    target: np.ndarray, model: np.ndarray, derivative: np.ndarray, noise_sd: np.ndarray | None, n_surplus: int
) -> np.ndarray:
    """Standard errors of the log elements, (P,); infinite for elements that do not affect the curve."""
    sigma = np.abs(target) if noise_sd is None else noise_sd
    whitened = derivative / sigma
    information = (whitened.real @ whitened.real.T) + (whitened.imag @ whitened.imag.T)
    chi_square = float(np.sum(np.abs((model - target) / sigma) ** 2))
    # A fitted curve is smooth: it differs from the network's by no more degrees of freedom than extra coefficients.
    freedom = max(2 * target.size - len(derivative) if noise_sd is None else n_surplus, 1)
    variance = chi_square / freedom if noise_sd is None else max(chi_square / freedom, 1.0)
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    # Directions that the pseudo-inverse leaves out are undetermined.
    lost = np.diag(np.eye(len(derivative)) - inverse @ information) > 1e-3
    return np.where(lost, np.inf, np.sqrt(variance * np.diag(inverse)))


def _described(
    names: tuple[str, ...],
    unit: str,
    log_elements: np.ndarray,
    standard_error: np.ndarray,
    coefficients: tuple[str, ...],
    sensitivity: np.ndarray,
) -> dict[str, MappedElement]:
    inverse = np.linalg.pinv(sensitivity)
    elements = {}
    for p, name in enumerate(names):
        width = NORMAL_Q95 * standard_error[p]
        known = standard_error[p] < DETERMINED_SD
        limits = np.exp(log_elements[p] + np.array([-width, 0, width])).tolist() if known else (None, None, None)
        low, middle, high = limits
        held_by = tuple((coefficients[k], float(inverse[p, k])) for k in np.argsort(-np.abs(inverse[p]))[:_HELD_BY])
        amplification = float(np.linalg.norm(inverse[p]))
        elements[name] = MappedElement(
            unit=kind_of(name).unit(unit),
            value=middle,
            q05=low,
            q95=high,
            standard_error=float(standard_error[p]),
            held_by=held_by,
            amplification=amplification,
        )
    return elements


def _ratios(names: tuple[str, ...], wanted: np.ndarray, value: np.ndarray) -> dict[str, float]:
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(np.abs(wanted / value))
    log_ratio -= np.mean(log_ratio[np.isfinite(log_ratio)])
    return {n: float(np.exp(r) * np.sign(w)) for n, r, w in zip(names, log_ratio, wanted, strict=True)}
