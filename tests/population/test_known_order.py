"""Central values whose order is known: drawn, sampled and begun in this order, or refused in a sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import SHORT
from scipy.stats import kstest, norm

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.coordinates_gradient import pulled_back
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior, read_prior
from bayes_impedance.population.likelihood_gradient import ParameterGradient
from bayes_impedance.population.order import Order, arranged
from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.prior_draws import draw_prior
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import make_result

TWO_BRANCHES = VirtualPopulation(
    network="(n1-r1)|(n2-r2)",
    central={"n1": 1e-4, "r1": 2.0, "n2": 1e-3, "r2": 20.0},
    between_persons={"n1": 0.2, "r1": 0.2, "n2": 0.2, "r2": 0.2},
)
"""Two branches that can be exchanged, well apart: relaxation times of 0.2 and 20 ms."""
TWO_SPRINGS = VirtualPopulation(
    network="n1-(m1|r1|n2)",
    central={"n1": 1e-4, "m1": 1e-3, "r1": 1.0, "n2": 1e-3},
    between_persons={"n1": 0.2, "m1": 0.2, "r1": 0.2, "n2": 0.2},
)
"""Two compliances that cannot be exchanged, n1 below n2."""
THREE = Order(chains=((2, 0, 3),), names=(("c", "a", "d"),))


@pytest.fixture(scope="module")
def branches() -> Recordings:
    return simulate_recordings(TWO_BRANCHES, 8, 1, np.geomspace(5, 5000, 16), seed=4).recordings


def ordered(*lists: tuple[str, ...], **elements: ElementPrior) -> FitSettings:
    return replace(SHORT, prior=GivenPrior(order=lists, elements=elements))


def coordinates(order: Order, free: tuple[int, ...] = (0, 1, 2, 3)) -> Coordinates:
    prior = Prior(centre=np.array([0.3, -1.0, 0.1, 2.0]), centre_sd=np.array([1.0, 3.0, 0.5, 2.0]), order=order)
    return Coordinates(
        prior=prior,
        correlated=False,
        repetitions=False,
        n_covariates=0,
        free=free,
        held_mu=np.zeros(4),
        held_dispersion=np.ones(4),
    )


# -------------------------------------------------------------------- coordinates


def test_every_vector_is_in_order_and_packs_again() -> None:
    c = coordinates(THREE)
    vector = np.random.default_rng(1).normal(0, 2, (200, c.n_dimensions))
    p = c.unpack(vector)
    assert np.all(THREE.obeyed(p.mu))
    assert np.all((p.mu[:, 2] < p.mu[:, 0]) & (p.mu[:, 0] < p.mu[:, 3]))
    packed = np.array([c.pack(p.mu[w], p.covariance[w], p.between_repetitions[w], p.slopes[w]) for w in range(200)])
    vector[:, c.even] = np.abs(vector[:, c.even])
    np.testing.assert_allclose(packed, vector, atol=1e-9)
    np.testing.assert_array_equal(c.even[:4], [True, False, False, True])


def test_the_density_is_the_normal_one_where_the_order_holds() -> None:
    with_order, without = coordinates(THREE), coordinates(Order())
    vector = np.random.default_rng(2).normal(0, 1, (50, with_order.n_dimensions))
    p = with_order.unpack(vector)
    same = np.array([without.pack(p.mu[w], p.covariance[w], p.between_repetitions[w], p.slopes[w]) for w in range(50)])
    np.testing.assert_allclose(with_order.log_prior(vector), without.log_prior(same), rtol=1e-10)


def test_its_gradient_is_that_of_its_values() -> None:
    c = coordinates(THREE)
    slope = np.array([0.7, -0.4, 1.1, 0.2])  # of a log likelihood that is linear in the centres
    vector = np.random.default_rng(3).normal(0, 1, (5, c.n_dimensions))
    p = c.unpack(vector)
    zero = np.zeros((5, 4))
    own = ParameterGradient(
        mu=np.tile(slope, (5, 1)),
        covariance=np.zeros((5, 4, 4)),
        between_repetitions=zero,
        slopes=np.zeros((5, 4, 0)),
        shared=np.zeros((5, 0)),
        tail=np.zeros(5),
        share=np.zeros(5),
        separation=zero,
    )
    gradient = pulled_back(c, vector, p, own)

    def density(x: np.ndarray) -> np.ndarray:
        return c.unpack(x).mu @ slope + c.log_prior(x)

    for k in range(c.n_dimensions):
        step = 1e-6 * np.eye(c.n_dimensions)[k]
        np.testing.assert_allclose((density(vector + step) - density(vector - step)) / 2e-6, gradient[:, k], atol=1e-6)


def test_what_is_not_sampled_takes_no_part() -> None:
    c = coordinates(THREE, free=(1, 2, 3))
    assert c.centres.order.names == (("c", "d"),)
    assert not coordinates(THREE, free=(1, 3)).centres.order


# -------------------------------------------------------------------- the prior alone


def test_draws_of_the_prior_are_those_of_order_statistics() -> None:
    """Of two values with one normal prior the lower is the lower of two, and of three the middle is the median."""
    prior = Prior(centre=np.full(3, 1.0), centre_sd=2.0, order=Order(chains=((1, 0),), names=(("b", "a"),)))
    drawn = draw_prior(prior, 4000, 1).mu
    assert np.all(drawn[:, 1] < drawn[:, 0])
    assert kstest(drawn[:, 1], lambda x: 1 - norm.sf(x, 1, 2) ** 2).pvalue > 1e-3
    assert kstest(drawn[:, 0], lambda x: norm.cdf(x, 1, 2) ** 2).pvalue > 1e-3
    assert kstest(drawn[:, 2], norm(1, 2).cdf).pvalue > 1e-3


def test_a_sample_of_the_prior_obeys_it(branches: Recordings) -> None:
    lists = (("n2", "n1"), ("r1", "r2"))
    table = sample_prior(branches, settings=ordered(*lists), n=500, seed=2).to_dataframe()
    assert (table["n2"] < table["n1"]).all()
    assert (table["r1"] < table["r2"]).all()
    assert (table["n2_person"] > table["n1_person"]).any()  # nothing is said of a single person
    one = replace(branches, subjects=branches.subjects[:1])
    assert (sample_prior(one, settings=ordered(*lists), n=500).to_dataframe().eval("n2 < n1")).all()


# -------------------------------------------------------------------- fits


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("order", [("n1", "n2"), ("n2", "n1")])
def test_equal_branches_end_in_the_order_that_was_given(
    branches: Recordings, order: tuple[str, str], seed: int
) -> None:
    """Without it seeds 1 and 2 end in mirror images."""
    fit = fit_population(branches, settings=ordered(order), seed=seed)
    value = dict(zip(fit.kernel.elements, np.exp(np.median(fit.parameters.mu, axis=0)), strict=True))
    low, high = order
    assert value[low] == pytest.approx(1e-4, rel=0.4)
    assert value[high] == pytest.approx(1e-3, rel=0.4)
    assert value[f"r{low[1]}"] == pytest.approx(2.0, rel=0.4)
    assert value[f"r{high[1]}"] == pytest.approx(20.0, rel=0.4)
    position = fit.kernel.elements.index
    assert np.all(fit.parameters.mu[:, position(low)] < fit.parameters.mu[:, position(high)])
    assert fit.identified.all()
    # Everybody's elements have changed places too, and the noise is that of the network.
    assert np.all(np.median(fit.person_draws[..., position(low)], axis=(0, 1)) < np.log(3e-4))
    assert np.all(fit.noise_scale < 3)


def test_the_order_changes_nothing_but_the_names(branches: Recordings) -> None:
    one, other = (fit_population(branches, settings=ordered(o), seed=1) for o in (("n1", "n2"), ("n2", "n1")))
    rows = [one.kernel.elements.index(name) for name in ("n2", "r2", "n1", "r1")]
    mean, sd = one.parameters.mu.mean(axis=0), one.parameters.mu.std(axis=0)
    np.testing.assert_array_less(np.abs(mean[rows] - other.parameters.mu.mean(axis=0)), 0.4 * sd[rows])
    np.testing.assert_allclose(sd[rows], other.parameters.mu.std(axis=0), rtol=0.4)


@pytest.mark.parametrize("order", [("r1", "r2"), ("r2", "r1")])
def test_one_persons_own_values_are_in_order(branches: Recordings, order: tuple[str, str]) -> None:
    fit = fit_population(replace(branches, subjects=branches.subjects[:1]), settings=ordered(order), seed=1)
    low, high = (fit.kernel.elements.index(name) for name in order)
    assert np.all(fit.parameters.mu[:, low] < fit.parameters.mu[:, high])
    assert fit.noise_scale[0] < 2


def test_an_order_that_the_recordings_contradict_is_refused(tmp_path: Path) -> None:
    springs = simulate_recordings(TWO_SPRINGS, 8, 1, np.geomspace(5, 5000, 16), seed=4).recordings
    fit_population(springs, settings=ordered(("n1", "n2")), seed=1)
    file = tmp_path / "prior.toml"
    file.write_text('order = [["n2", "n1"]]\n', encoding="utf-8")
    with pytest.raises(
        InputError, match=r"prior\.toml: the recordings contradict the order n2 below n1.*take them out"
    ):
        fit_population(springs, settings=replace(SHORT, prior=read_prior(file)), seed=1)


@pytest.mark.long
def test_the_posterior_is_that_without_the_order_cut_off() -> None:
    """Two compliances that cannot be exchanged and are equal: the order cuts off about half of the posterior."""
    population = replace(TWO_SPRINGS, central={"n1": 3e-4, "m1": 1e-3, "r1": 1.0, "n2": 3e-4})
    springs = simulate_recordings(population, 8, 1, np.geomspace(5, 5000, 16), seed=10).recordings
    # With SHORT the ratio of two standard deviations has an error of 0.13, with these draws and steps one of 0.05.
    precise = replace(SHORT, draws=512, sampler=replace(SHORT.sampler, effective=1600.0, longest=2400))
    free = fit_population(springs, settings=precise, seed=1)
    for order in (("n1", "n2"), ("n2", "n1")):
        fit = fit_population(springs, settings=replace(precise, prior=GivenPrior(order=(order,), elements={})), seed=1)
        low, high = (fit.kernel.elements.index(name) for name in order)
        assert np.all(fit.parameters.mu[:, low] < fit.parameters.mu[:, high])
        assert not fit.diagnostics.problems
        kept = free.parameters.mu[free.parameters.mu[:, low] < free.parameters.mu[:, high]]
        assert 0.4 < len(kept) / len(free.parameters.mu) < 0.6
        for of in (low, high):
            sd = kept[:, of].std()
            assert fit.parameters.mu[:, of].mean() == pytest.approx(kept[:, of].mean(), abs=0.25 * sd)
            assert fit.parameters.mu[:, of].std() == pytest.approx(sd, rel=0.2)
        apart, expected = fit.parameters.mu[:, high] - fit.parameters.mu[:, low], kept[:, high] - kept[:, low]
        np.testing.assert_allclose(
            np.quantile(apart, [0.1, 0.5, 0.9]), np.quantile(expected, [0.1, 0.5, 0.9]), atol=0.06
        )


def test_the_summary_names_the_order(branches: Recordings) -> None:
    fit = fit_population(branches, settings=ordered(("n1", "n2")), seed=1)
    result = make_result(fit, predict(fit, n_draws=20, n_replicates=4), {})
    assert result.summary["prior"]["order"] == [["n1", "n2"]]
    drawn = result.groups["prior"]["mu"][0]
    assert np.all(drawn[:, fit.kernel.elements.index("n1")] < drawn[:, fit.kernel.elements.index("n2")])


# -------------------------------------------------------------------- arrangements and starts


def test_the_arrangement_with_the_smallest_violation_is_found() -> None:
    kernel = Kernel(parse("(n1-r1)|(n2-r2)|(n3-r3)"))
    position = kernel.elements.index
    chain = tuple(position(name) for name in ("n3", "n1", "n2"))
    order = Order(chains=(chain,), names=(("n3", "n1", "n2"),))
    centres = np.arange(6.0)
    rows = arranged(order, kernel, centres, np.ones(6))
    assert order.obeyed(centres[rows])
    np.testing.assert_array_equal(rows[[position("r3"), position("r1"), position("r2")]] - rows[list(chain)], [1, 1, 1])
    contrary = Order(chains=(*order.chains, (position("r2"), position("r1"))), names=(*order.names, ("r2", "r1")))
    assert contrary.violation(centres[arranged(contrary, kernel, centres, np.ones(6))], np.ones(6)) > 0


def test_the_nearest_start_is_in_order_and_what_obeys_stays() -> None:
    order = Order(chains=((0, 1, 2),), names=(("a", "b", "c"),))
    kept = np.array([0.0, 1.0, 2.0, -7.0])
    np.testing.assert_allclose(order.nearest(kept, np.ones(4)), kept)
    moved = order.nearest(np.array([1.0, 0.0, 2.0, -7.0]), np.array([1.0, 0.1, 1.0, 1.0]))
    assert order.obeyed(moved)
    assert abs(moved[1]) < 0.1  # the one that is known well hardly moves
    assert moved[2:].tolist() == [2.0, -7.0]


# -------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('order = "n1"', "must be lists of two or more"),
        ('order = ["n1", "n2"]', 'order has "n1" in it, but must be lists'),
        ('order = [["n1"]]', "must be lists of two or more"),
        ("order = [[1, 2]]", "must be text"),
        ('order = [["n1", "n2"], ["n2", "n3"]]', '"n2" twice; write what belongs together as one list'),
    ],
)
def test_a_list_that_is_none_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "prior.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_prior(file)
    assert str(file) in str(refused.value)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("network", "text", "message"),
    [
        ("(n1-r1)|(n2-r2)", 'order = [["n1", "n7"]]', '"n7" is not an element of the fitted network'),
        ("(n1-r1)|(n2-r2)", 'order = [["n1", "r1"]]', "n1 is a compliance and r1 a damper"),
        ("(n1*-r1)|(n2-r2)", 'order = [["n2", "n1"]]', "n1 is the same for all"),
        (
            "(n1-r1)|(n2-r2)",
            'order = [["n1", "n2"]]\n[elements]\nn1 = {centre = 1.0, scale = 0.1}\nn2 = {centre = 0.1, scale = 0.1}\n',
            "exchange the names in the list",
        ),
    ],
)
def test_an_order_that_cannot_be_is_refused(
    branches: Recordings, tmp_path: Path, network: str, text: str, message: str
) -> None:
    file = tmp_path / "prior.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        fit_population(branches, network, settings=replace(SHORT, prior=read_prior(file)))
    assert str(refused.value).startswith(f"{file}: ")
    assert message in str(refused.value)


def test_an_order_is_kept_as_text_and_for_a_smaller_network() -> None:
    given = GivenPrior(order=[["n1", "n2", "n3"], ["r1", "r2"]])
    assert GivenPrior.of_text(given.text()) == given
    assert given.only(["n1", "n3", "r1"]).order == (("n1", "n3"),)
    assert "order" not in GivenPrior(slope=1.0).text()
