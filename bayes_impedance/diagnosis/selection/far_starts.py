r"""Refits that begin far from the network, for recordings that it does not describe at all.

The scan of the candidates (:mod:`.score_scan`) is a derivative at the network's best fit with the effect at zero. It
says what a *small* effect would do. A low-pass in the middle of the band, or a lag of a quarter of a period, changes
the recordings by more than their magnitude: a mass then looks like a negative resistance, the best fit of the network
is no description of it at all, and the derivative there says nothing about the right effect.

If the network is that far off, delays and filters, effects with one coefficient x, are therefore also fitted from many
random starts, as a network is (:mod:`bayes_impedance.population.starting_fits`): the elements of a typical person
together with x, at sizes of either sign from the smallest that the band shows to the largest. Everybody begins at the
best of these. The same is done where the network has driven elements away from everybody's values, or to where nobody's
recordings feel them (:func:`~bayes_impedance.diagnosis.fit.lost_elements.lost_elements`): there the derivative had the
wrong sign for a high-pass, and refits from the network ended 900 nats behind the truth. There everything else that the
rig may add is searched as well, with shapes anywhere in their grids: a residual mass was not even among the candidates
of the scan, and a semi-inductance only after a resonator had been found in its place and the network beside that one
was right. A branch of a damper and a spring became the rig's damper, the spring rigid in everybody, and a relaxation
took the branch's place: a damper of the rig was no candidate where the network had one. Whether such a thing is the
rig's or the body's is not known before it is found, and one that differs between people is not found as the same for
all: a mass of 6 mg at the port, different in each person, was missed where the network's own mass of 6 g had taken its
place, and something unknown was named.

A network may also have absorbed a delay or a filter with its elements in place. Behind a low-pass a mass has a
resistance that grows with the square of the frequency; so has a mass in series with a large damper, and the damper of
such a branch became 1700 times as large. There the low-pass's derivative is nearly one of the elements', the scan
says nothing or something random of it, and a resonator was named, 137 nats behind it. So delays and filters that the
elements hide (:func:`absorbed`) are begun from afar wherever something is missing.

Elements that were driven away do not return when the right effect is there. So beside an explanation that is about to
be compared, and where one of several is left out, the network is searched in the same way, with the effects near their
values (:func:`network_from_afar`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.cold_start import driven_away, population_around
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.absolute_fit import GROSS_ERROR
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.trial import poolings_for
from bayes_impedance.network.elements import KINDS, band_scale
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.starting_fits import PROVISIONAL_NOISE, search_modes, thinned_points

_SIZES = 8
"""Sizes of the coefficient of each sign. By choice: over three decades a factor of 2.7, which a search bridges."""

_SMALLEST, _LARGEST = 0.1, 3.0
"""Smallest size in units of the coefficient's scale, at which an effect changes one end of the band by its magnitude;
and the largest, in units of what changes the other end. By choice: a smaller effect is seen by the scan."""

_WHOLE_LOAD = 1.0
"""Largest size of a mass, spring or damper of the rig, in units of the coefficient's scale. By choice: it is no larger
than the whole load, beyond which it fits anything."""

_STARTS = 48
"""Random starts of the elements for each size: with two signs 768 in all, as many as for the network."""

_START_SPREAD = 2.5
"""Standard deviation of the starts' log elements: that of the network's own search."""

_ELEMENT_SD = 3.0
"""Prior standard deviation of a log element: that of the network's own fit."""

_KNOWN_SD = 0.3
"""Standard deviation of what was added, beside which the network is searched: of a coefficient as a share of it, of a
shape in its logarithm. By choice: beside another addition it was off by a tenth."""

_HIDDEN = 0.05
"""Fraction of a derivative that the elements leave, below which its score is not believed. By choice: of delays and
filters it was 0.1 to 1 in 48 populations of ``analyses/other_worlds`` with something missing, where refits from the
scan reached what those from afar did unless elements were lost; in the one that was missed it was 0.001, and in ten
made like it 0.001 to 0.002, where refits from the scan gained nothing of 2600 to 2900."""

_ENDS = 3
"""Best end points of the search from which all people are refitted. By choice: a search is of thinned recordings."""


def wholly_off(fit: Refit) -> bool:
    """Whether the model is too far from the recordings for its derivatives to show what is missing.

    The criterion is the median person's relative error, above
    :data:`~bayes_impedance.diagnosis.residuals.absolute_fit.GROSS_ERROR`.
    """
    errors, row = [], 0
    for d in fit.data:
        z = d.z[:, 0] + 1j * d.z[:, 1]
        model = fit.model.kernel.impedance(np.ascontiguousarray(fit.u[row : row + len(z)]), d.omega / (2 * np.pi))
        errors.append(float(np.sqrt(np.mean(np.abs(model - z) ** 2 / np.abs(z) ** 2))))
        row += len(z)
    return bool(np.median(errors) > GROSS_ERROR)


def at_the_port(fit: Refit, effects: Sequence[Effect]) -> list[Candidate]:
    """Effects at the port that the rig may have and the model does not, with shapes in the middle of their grids.

    Those of the body that are the same law are among them, such as a mass that differs between people.

    Of a network that does not describe the recordings at all only delays and filters: with more subtracted than the
    whole load, masses, springs and dampers fit recordings of anything, even complex conjugates.
    """
    any_kind = not wholly_off(fit)
    taken = {addition.key for addition in fit.model.additions}
    of_the_rig = {effect.form for effect in effects if effect.side == "rig" and effect.operation}
    return [
        Candidate(effect, place.name, {c.name: _middle(c.values(fit.model.scales)) for c in effect.coefficients[1:]})
        for effect in effects
        if effect.form in of_the_rig
        if any_kind or _in_the_channels(effect)
        for place in effect.sites(fit.model.network)
        if not place.path and (effect.id, effect.form, place.name) not in taken
    ]


def absorbed(candidates: Sequence[Candidate], screening: Screening) -> list[Candidate]:
    """Those delays and filters of whose derivative at the network its elements leave nearly nothing.

    What the elements absorb at all of their values as well, a gain, gains nothing from afar either. A mass, spring or
    damper is not begun: mostly the network has the same element at the port.
    """
    of_the_scan = zip(screening.candidates, screening.visible, strict=True)
    hidden = {(c.effect, c.place) for c, visible in of_the_scan if visible < _HIDDEN}
    return [c for c in candidates if _in_the_channels(c.effect) and (c.effect, c.place) in hidden]


def _middle(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def _in_the_channels(effect: Effect) -> bool:
    return effect.traits.connection == "replaces" and not effect.traits.passive


def refits_from_afar(refitter: Refitter, fit: Refit, candidate: Candidate, seed: int, rounds: int) -> list[Refit]:
    """Refits of everybody with an effect, from the best end points of the search.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without the effect.
    candidate : Candidate
        Of :func:`at_the_port`.
    seed : int
        For the random starts.
    rounds : int
        Of each refit.
    """
    effect, pooling = candidate.effect, poolings_for(candidate.effect, len(refitter.data))[0]
    model = extended(fit.model, candidate, pooling, 1.0)
    u, population = extended_start(fit, model)
    typical = _typical_person(fit, u.shape[1])
    shapes = dict(zip(model.columns(len(model.additions) - 1)[1:], effect.coefficients[1:], strict=True))
    refits = []
    for end in _search(model, u, typical, effect, seed):
        found = {c.name: float(c.value(end[column], model.scales)) for column, c in shapes.items()}
        # The prior of shapes is around those found, within their grids.
        model = extended(fit.model, replace(candidate, shape=found), pooling, 1.0)
        around = population
        if not refitter.one_person:
            around = population_around(population, end[: model.n_elements])
            around = replace(around, mu=end[~model.shared])
        refits.append(refitter.fit(model, np.tile(end, (len(u), 1)), around, rounds))
    return refits


def network_from_afar(refitter: Refitter, fit: Refit, seed: int, rounds: int) -> Refit:
    """The fit, or a better one of the same model whose network is searched anew beside what was added.

    It is searched if the fit has driven elements away from everybody's values.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Of a model whose additions are near their right values, and whose network may not be.
    seed : int
        For the random starts.
    rounds : int
        Of each refit.
    """
    model = fit.model
    if refitter.one_person or not model.additions or not driven_away(fit).any():
        return fit
    centre, sd = _expected(model, fit.u)
    sd[model.n_elements :] = _KNOWN_SD * np.maximum(
        [abs(centre[c]) if p.is_coefficient else 1.0 for c, p in enumerate(model.parameters, model.n_elements)], 1e-9
    )
    spread = np.where(sd == _ELEMENT_SD, _START_SPREAD, 0.0)
    starts = centre + spread * np.random.default_rng(seed).normal(size=(_SIZES * _STARTS, centre.size))
    typical = _typical_person(fit, centre.size)
    ends = search_modes(model.kernel, typical, starts, Prior(centre=centre, centre_sd=sd), _ENDS)
    for end in ends:
        begin = fit.u.copy()
        begin[:, : model.n_elements] = end[: model.n_elements]
        around = population_around(fit.population, end[: model.n_elements])
        found = refitter.fit(model, begin, around, rounds)
        fit = found if found.evidence.sum() > fit.evidence.sum() else fit
    return fit


def _typical_person(fit: Refit, n_parameters: int) -> Likelihood:
    """Mean recording, at few frequencies and with provisional noise, of the person of median magnitude.

    `n_parameters` is the number of a model's parameters.
    """
    size = [float(np.mean(np.log(np.hypot(d.z[:, 0], d.z[:, 1])))) for d in fit.data]
    d = fit.data[int(np.argsort(size)[len(size) // 2])]
    points = thinned_points(d.omega.size)
    z = (d.z[:, 0] + 1j * d.z[:, 1]).mean(axis=0)[None, points]
    deviations = np.zeros((1, n_parameters))
    return Likelihood.make(d.omega[points] / (2 * np.pi), z, PROVISIONAL_NOISE * np.abs(z), deviations)


def _expected(model: Model, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and standard deviation of the parameters: elements as in a first fit, others at the median of u (M, P)."""
    centre, sd = np.median(u, axis=0), np.ones(u.shape[1])
    for k, name in enumerate(model.network.elements):
        if name[:1] in KINDS:
            centre[k] = band_scale(name, model.scales.z_middle, model.scales.middle / (2 * np.pi))
            sd[k] = _ELEMENT_SD
    sd[model.n_elements :] = [p.prior_sd for p in model.parameters]
    return centre, sd


def _search(model: Model, u: np.ndarray, typical: Likelihood, effect: Effect, seed: int) -> np.ndarray:
    """Best end points of searches from random elements, all sizes and shapes of the last addition; shape (_ENDS, P)."""
    scales = model.scales
    centre, sd = _expected(model, u)
    coefficient, *shapes = model.columns(len(model.additions) - 1)
    largest = _LARGEST * scales.high / scales.low if _in_the_channels(effect) else _WHOLE_LOAD
    sizes = np.geomspace(_SMALLEST, largest, _SIZES)
    if effect.signed:
        sizes = np.concatenate([sizes, -sizes])
    spread = np.where(sd == _ELEMENT_SD, _START_SPREAD, 0.0)
    rng = np.random.default_rng(seed)
    starts = centre + spread * rng.normal(size=(sizes.size, _STARTS, centre.size))
    starts[..., coefficient] = sizes[:, None]
    for column, shape in zip(shapes, effect.coefficients[1:], strict=True):
        grid = np.array([shape.unbounded(value, scales) for value in shape.values(scales)])
        starts[..., column] = rng.choice(grid, size=starts.shape[:2])
        centre[column], sd[column] = grid.mean(), shape.prior_sd + np.ptp(grid)  # all of the grid is as likely
    centre[coefficient], sd[coefficient] = 0.0, sizes.max()  # all of these sizes are as likely
    prior = Prior(centre=centre, centre_sd=sd)
    return search_modes(model.kernel, typical, starts.reshape(-1, centre.size), prior, _ENDS)
