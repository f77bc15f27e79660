"""Draws under other dispersions between repetitions, against an integration in which nothing is factored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from drawn_posteriors import posterior_of
from scipy.optimize import least_squares

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population import moved_dispersions
from bayes_impedance.population import posterior as posteriors
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.sharded import Kept

SPAN = DispersionRange(np.array([0.1, 0.02]), np.array([0.01, 0.005]), np.array([0.4, 0.1]), np.array([0.3, 0.01]))
NETWORK = parse("(n3|r3)-(m2|r1|n1)")
VALUES = {"n3": 1e-4, "r3": 30.0, "m2": 1e-3, "r1": 2.0, "n1": 1e-3}
SPREAD, CHANGE = 0.15, {"n3": 0.12, "r3": 0.1, "m2": 0.1, "r1": 0.03, "n1": 0.1}
PEOPLE, REPETITIONS, NOISE = 8, 2, 0.01
DRAWS = 6000


def test_terms_vanish_in_the_middle_and_stay_at_the_ends():
    assert np.array_equal(SPAN.terms(SPAN.middle[None]), np.zeros((1, 4)))
    assert np.array_equal(SPAN.terms(2 * SPAN.highest[None]), SPAN.terms(SPAN.highest[None]))
    assert np.array_equal(SPAN.terms(np.zeros((1, 2))), SPAN.terms(SPAN.lowest[None]))
    assert np.abs(SPAN.nodes[:, [0, -1]].T - [SPAN.lowest, SPAN.highest]).max() < 1e-12


def test_the_range_reaches_as_far_as_likely_dispersions() -> None:
    """Elsewhere it stays, and so does the middle, at which draws are made."""
    inside = np.tile(SPAN.middle, (100, 1))
    assert not SPAN.beyond(inside).any()
    assert SPAN.reaching(inside, (0, 1)) is SPAN
    low, high = inside.copy(), inside.copy()
    low[:50, 0], high[:20, 1] = 0.005, 0.15
    np.testing.assert_allclose(SPAN.beyond(low), [[0.5, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(SPAN.beyond(high), [[0.0, 0.0], [0.0, 0.2]])
    further = SPAN.reaching(low, (0, 1))
    assert not further.beyond(np.tile((1e-6, 0.02), (3, 1))).any()  # all that is negligible is the same
    assert further.lowest[1] == SPAN.lowest[1]
    # Half as far again from the middle as the farthest: 0.02 + 1.5 * 0.13.
    np.testing.assert_allclose(SPAN.reaching(high, (0, 1)).highest, [0.4, 0.215])
    np.testing.assert_allclose(SPAN.reaching(np.full((9, 2), 1.0), (1,)).highest, [0.4, 1.49])  # the first is held
    np.testing.assert_array_equal(further.middle, SPAN.middle)


def test_slopes_of_terms():
    rng = np.random.default_rng(0)
    rho = rng.uniform(1.2 * SPAN.lowest, 0.8 * SPAN.highest, (20, 2))
    weights = rng.normal(size=(20, 4))
    step = 1e-7 * np.eye(2)
    for p in range(2):
        expected = np.sum(weights * (SPAN.terms(rho + step[p]) - SPAN.terms(rho - step[p])), axis=1) / 2e-7
        assert np.abs(SPAN.slopes(rho, weights)[:, p] - expected).max() < 1e-6 * np.abs(expected).max()
    assert not SPAN.slopes(2 * SPAN.highest[None], weights[:1]).any()


def recordings(people: int = PEOPLE, changes: Mapping[str, float] | None = None, relative: float = NOISE) -> Recordings:
    """People of whom one recording determines n3 weakly, and whose repetitions differ much unless said otherwise."""
    kernel, rng = Kernel(NETWORK), np.random.default_rng(3)
    centre = np.log([VALUES[name] for name in kernel.elements])
    change = np.array([(changes or CHANGE)[name] for name in kernel.elements])
    frequency = np.geomspace(5, 1000, 40)
    subjects = []
    for i in range(people):
        own = centre + SPREAD * rng.normal(size=centre.size) + change * rng.normal(size=(REPETITIONS, centre.size))
        z = kernel.impedance(own, frequency)
        noise = rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)
        names = tuple(str(j + 1) for j in range(REPETITIONS))
        sd = relative * np.abs(z)
        subjects.append(Subject(name=f"s{i}", repetitions=names, frequency_hz=frequency, z=z + sd * noise, noise_sd=sd))
    return Recordings(
        subjects=tuple(subjects), title=None, unit="N s/m", network=str(NETWORK), source=None, licence=None
    )


def integrated(kernel: Kernel, subject: Subject, sets: PopulationParameters, k: int) -> float:
    """Log likelihood of a person's recordings under set k, up to a constant of the person.

    All repetitions' log elements are integrated together by importance sampling from a t around their joint mode: no
    Laplace's method, no contrasts, no reference population.
    """
    rng, p, nu = np.random.default_rng(7), sets.mu.shape[1], 8
    own = np.diag(sets.between_repetitions[k] ** 2)
    factor = np.linalg.cholesky(
        np.kron(np.ones((REPETITIONS, REPETITIONS)), sets.covariance[k]) + np.kron(np.eye(REPETITIONS), own)
    )

    def z_of(u: np.ndarray) -> np.ndarray:
        theta = sets.mu[k] + (u @ factor.T).reshape(-1, REPETITIONS, p)
        return kernel.impedance(theta.reshape(-1, p), subject.frequency_hz).reshape(len(u), *subject.z.shape)

    def residuals(u: np.ndarray) -> np.ndarray:
        r = ((z_of(u[None])[0] - subject.z) / subject.noise_sd).ravel()
        return np.concatenate([r.real, r.imag, u])

    mode = least_squares(residuals, np.zeros(factor.shape[0]))
    centre, curvature = mode.x, np.linalg.inv(mode.jac.T @ mode.jac)
    covariance, value = curvature, 0.0
    for _ in range(3):
        spread = np.linalg.cholesky(covariance)
        x = rng.normal(size=(DRAWS, centre.size)) / np.sqrt(rng.chisquare(nu, (DRAWS, 1)) / nu)
        u = centre + x @ spread.T
        chi = np.sum(np.abs((z_of(u) - subject.z) / subject.noise_sd) ** 2, axis=(1, 2))
        log_density = -(2 + subject.z.size) * np.log(2 + 0.5 * chi) - 0.5 * np.sum(u**2, axis=1)
        log_density += 0.5 * (nu + centre.size) * np.log1p(np.sum(x**2, axis=1) / nu) + np.log(np.diag(spread)).sum()
        value = np.logaddexp.reduce(log_density)
        weight = np.exp(log_density - value)
        centre = weight @ u
        covariance = (u - centre).T @ ((u - centre) * weight[:, None]) + 0.02 * curvature
    return float(value)


@pytest.mark.parametrize("moves", [False, True])
def test_the_likelihood_does_not_depend_on_where_the_range_was_at_first(
    moves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does if the range does not move: beyond its end contrasts at the modes go on alone, and make a false peak."""
    given, p = recordings(), Kernel(NETWORK).elements.index("n3")
    # With 256 draws their error alone is 0.1 to 0.7 here.
    wide, first_range = posterior_of(given, monkeypatch, draws=1024), moved_dispersions.range_of

    def narrow(fits: Kept, prior: Prior, rho: np.ndarray) -> DispersionRange:
        own = first_range(fits, prior, rho)
        assert own is not None
        middle, highest = own.middle.copy(), own.highest.copy()
        middle[p], highest[p] = 0.023, 0.035
        return replace(own, middle=middle, highest=highest)

    monkeypatch.setattr(posteriors, "range_of", narrow)
    if not moves:
        monkeypatch.setattr(DispersionRange, "reaching", lambda self, *_: self)
    other = posterior_of(given, monkeypatch, draws=1024)
    sets = wide.coordinates.unpack(np.tile(wide.mode, (8, 1)))
    sets.between_repetitions[:, p] = np.linspace(0.02, 0.15, 8)
    change = other.marginal(sets) - wide.marginal(sets)
    assert (np.ptp(change) < 0.5) == moves, change
    if not moves:
        assert np.ptp(change) > 1


@pytest.mark.long
@pytest.mark.parametrize("factored", [False, True])
def test_likelihood_equals_that_with_everything_integrated_together(factored, monkeypatch):
    """And does not if the contrasts are taken at the modes alone: the draws' responses are needed."""
    given = recordings()
    posterior = posterior_of(given, monkeypatch)
    if factored:
        for part in posterior.marginal._kept.parts:
            for _, _, features in part.marginal.blocks:
                features[-2 * len(VALUES) :] = 0.0
    rng = np.random.default_rng(5)
    factor = np.linalg.cholesky(posterior.normal_covariance)
    u = posterior.mode + rng.normal(size=(10, posterior.mode.size)) @ factor.T
    sets = posterior.coordinates.unpack(u)
    # Dispersions between repetitions by up to a factor of four either way, about those of the recordings.
    kernel = Kernel(NETWORK)
    about = np.array([CHANGE[name] for name in kernel.elements])
    sets = replace(sets, between_repetitions=about * 4.0 ** rng.uniform(-1, 1, sets.mu.shape))
    exact = np.array([sum(integrated(kernel, s, sets, k) for s in given.subjects) for k in range(len(u))])
    off = (posterior.marginal(sets) - exact).std()
    assert (off > 0.5) if factored else (off < 0.25), off


@pytest.mark.long
def test_likelihood_of_a_change_that_may_be_nothing_equals_that_with_everything_integrated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Polynomials that bend at the likely change, not at what one person's recordings resolve, are off by 0.3."""
    given = recordings(people=20, changes=dict.fromkeys(VALUES, 0.08), relative=0.02)
    kernel = Kernel(NETWORK)
    p = kernel.elements.index("n3")
    posterior = posterior_of(given, monkeypatch)
    sets = posterior.coordinates.unpack(np.tile(posterior.mode, (5, 1)))
    sets.between_repetitions[:, p] = [0.002, 0.03, 0.06, 0.09, 0.2]
    exact = np.array([sum(integrated(kernel, s, sets, k) for s in given.subjects) for k in range(5)])
    off = posterior.marginal(sets) - exact
    assert np.ptp(off) < 0.15, off - off[0]
