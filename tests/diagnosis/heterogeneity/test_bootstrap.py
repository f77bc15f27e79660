"""Parametric bootstrap: replicates are estimated again and have the right covariance; tails of known distributions."""

from __future__ import annotations

import numpy as np
from populations_of_likelihoods import covariance, informations, observed, population
from scipy.stats import chi2

from bayes_impedance.diagnosis.heterogeneity.bootstrap import replicates, tail_probability
from bayes_impedance.diagnosis.heterogeneity.reml import centred_fit


def test_replicates_are_estimated_again():
    # With perfect recordings the new covariance is that of the replicate, whose white pulls have unit covariance again.
    rng = np.random.default_rng(18)
    _, fit = centred_fit(observed(rng, population(rng, 60, covariance(3)), informations(rng, 60, 3, sd=1e-4)))
    for batch in replicates(fit, 7, 4, 1):
        assert batch.pull.shape[0] in (3, 4)
        unit = np.swapaxes(batch.pull, 1, 2) @ batch.pull / 59
        assert np.abs(unit - np.eye(3)).max() < 0.05  # the prior's two persons in sixty
        assert np.abs(batch.pull.mean(axis=1)).max() < 1e-4
        spread = np.array([np.diag(f @ f.T) for f in batch.factor]) / np.diag(fit.covariance)
        assert 0.05 < np.std(np.log(spread)) < 0.5  # sqrt(2 / 59) = 0.18 expected
    again = [b.pull for b in replicates(fit, 7, 4, 1)]
    np.testing.assert_array_equal(again[-1], batch.pull)


def test_pulls_of_replicates_have_their_weights_as_covariance(monkeypatch):
    # Before the population is estimated again, and but for its mean.
    monkeypatch.setattr("bayes_impedance.diagnosis.heterogeneity.bootstrap._STEPS", 0)
    rng = np.random.default_rng(19)
    _, fit = centred_fit(observed(rng, population(rng, 25, covariance(2)), informations(rng, 25, 2, 0.3, unseen=1)))
    own_pulls, own_weights = [], []
    for b in replicates(fit, 1000, 250, 3):  # in the elements themselves
        inverse = np.linalg.inv(b.factor)
        own_pulls.append(b.pull @ inverse)
        own_weights.append(np.swapaxes(inverse, 1, 2)[:, None] @ b.weight @ inverse[:, None])
    pulls, weights = np.concatenate(own_pulls), np.concatenate(own_weights)
    y, root = weights[0], np.linalg.inv(fit.factor)
    np.testing.assert_allclose(y, root.T @ fit.weight @ root, atol=1e-9)
    expected = np.sum(y - y @ fit.variance @ y, axis=0)
    # 12 000 pulls of the first element, which every other person does not see, have a variance known to 1.3 %.
    np.testing.assert_allclose(np.einsum("rnp,rnp->p", pulls, pulls) / 1000, np.diag(expected), rtol=0.055)
    assert np.abs(pulls[:, ::2, 0]).max() < 1e-6  # others are of order one


def test_tail_probability_of_known_tails():
    null = chi2.isf((np.arange(400) + 0.5) / 400, 2)
    for p in (0.5, 0.2, 0.03, 0.005, 1e-5):
        said = tail_probability(float(chi2.isf(p, 2)), null)
        assert p / 1.2 < said < (1.1 * p + 0.003 if p >= 0.1 else 2 * p**0.8)
    assert tail_probability(-1.0, null) == 1.0
