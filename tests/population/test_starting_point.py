"""Where coordinates of dispersions bend."""

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.starting_point import bend_of


def prior() -> Prior:
    n = len(Kernel(parse("r1|n1")).elements)
    return Prior(centre=np.zeros(n), centre_sd=3.0, dispersion_sd=1.0, slope_sd=1.0, concentration=2.0)


def test_a_dispersion_that_may_be_negligible_is_on_the_linear_part() -> None:
    own, estimate = prior(), np.array([0.06, 0.06])
    span = DispersionRange(estimate, np.array([5e-4, 0.03]), np.array([0.2, 0.1]), estimate)
    np.testing.assert_allclose(bend_of(estimate, own), 0.02)
    np.testing.assert_allclose(bend_of(estimate, own, span), [0.2, 0.02])
    coordinates = Coordinates(
        prior=own,
        correlated=False,
        repetitions=True,
        n_covariates=0,
        free=(0, 1),
        held_mu=np.zeros(2),
        held_dispersion=np.ones(2),
        bend_repetitions=bend_of(estimate, own, span),
    )
    vectors = [
        coordinates.pack(np.zeros(2), np.eye(2), np.full(2, rho), np.zeros((2, 0)))[4:] for rho in (0.03, 0.06, 0.12)
    ]
    linear, logarithmic = np.diff(vectors, axis=0).T
    assert linear[1] / linear[0] > 1.8  # of a line 2
    assert logarithmic[1] / logarithmic[0] < 1.2  # of a logarithm 1
