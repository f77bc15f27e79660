"""Order selection: the true order is found, noise does not add to it, and nothing is tested on what was fitted."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.classical import order
from bayes_impedance.classical.order import OrderSelection, select_order
from bayes_impedance.classical.pole_residue import PoleResidue
from bayes_impedance.errors import InputError

FREQUENCY = np.geomspace(5, 5000, 61)
S = 2j * np.pi * FREQUENCY
UPPER = 2 * np.pi * np.array([30 * (-0.4 + 0.9j), 600 * (-0.4 + 0.9j)])
RESIDUES = np.array([150 + 40j, 2500 - 400j])
THREE = PoleResidue([-2 * np.pi * 900, UPPER[0], UPPER[0].conj()], [9000, RESIDUES[0], RESIDUES[0].conj()], 3.0)
FOUR = PoleResidue(np.append(UPPER, UPPER.conj()), np.append(RESIDUES, RESIDUES.conj()), 3.0)
SPRING = PoleResidue(np.append(UPPER[:1], [UPPER[0].conj(), 0.0]), [*RESIDUES[:1], RESIDUES[0].conj(), 900.0], 3.0)


def noisy(z, relative, seed, n=None):
    """Curves with noise relative to their magnitude."""
    rng = np.random.default_rng(seed)
    shape = z.shape if n is None else (n, z.size)
    return z * (1 + relative * (rng.normal(size=shape) + 1j * rng.normal(size=shape)))


@pytest.mark.long
@pytest.mark.parametrize("n", [None, 12])
@pytest.mark.parametrize(
    ("truth", "poles", "terms"), [(THREE, 3, {}), (FOUR, 4, {}), (SPRING, 3, {"pole_at_zero": True})]
)
def test_finds_the_true_order(truth, poles, terms, n):
    chosen = [select_order(FREQUENCY, noisy(truth(S), 0.02, seed, n), range(1, 6), **terms).chosen for seed in range(3)]
    assert np.median(chosen) == poles
    assert max(chosen) <= poles + 1


@pytest.mark.long
@pytest.mark.parametrize("n", [None, 8])
def test_does_not_run_away_with_noise(n):
    chosen = [select_order(FREQUENCY, noisy(np.full(61, 5.0), 0.1, seed, n), range(5)).chosen for seed in range(3)]
    assert np.median(chosen) == 0
    assert max(chosen) <= 2


def test_persons_who_differ_do_not_add_poles():
    rng = np.random.default_rng(8)
    scale = np.exp(0.3 * rng.normal(size=(12, 1)))
    result = select_order(FREQUENCY, noisy(THREE(S), 0.02, 8, 12) * scale, range(1, 6))
    assert result.chosen == 3


def test_choice_is_the_smallest_within_one_standard_error():
    result = select_order(FREQUENCY, noisy(FOUR(S), 0.02, 1, 10), [6, 1, 2, 4, 4, 5])
    assert result.orders == (1, 2, 4, 5, 6)
    assert result.by_fold.shape == (5, 5)
    best = result.orders.index(result.best)
    for i, n in enumerate(result.orders):
        difference = [mine - least for mine, least in zip(result.by_fold[i], result.by_fold[best], strict=True)]
        mean = sum(difference) / 5
        standard_error = (sum((d - mean) ** 2 for d in difference) / 4 * (1 / 5 + 1 / 4)) ** 0.5
        assert result.error[i] == pytest.approx(sum(result.by_fold[i]) / 5, rel=1e-12)
        assert result.standard_error[i] == pytest.approx(standard_error, abs=1e-15)
        assert (mean > standard_error) == (n < result.chosen) or n > result.chosen
    assert result.standard_error[best] == 0
    assert result.error[0] > 3 * result.error[best]


def recorded(monkeypatch):
    """Everything that is fitted from now on."""
    fitted = []
    original = order.vector_fit

    def record(frequency_hz, z, n_poles, **options):
        fitted.append((frequency_hz, z))
        return original(frequency_hz, z, n_poles, **options)

    monkeypatch.setattr(order, "vector_fit", record)
    return fitted


def test_blocks_of_one_curve_are_short_held_out_once_and_never_at_the_ends(monkeypatch):
    fitted = recorded(monkeypatch)
    frequency = np.geomspace(5, 5000, 420)
    select_order(frequency, THREE(2j * np.pi * frequency), [2])
    held_out = np.array([~np.isin(frequency, training) for training, _ in fitted])
    assert held_out.shape == (5, 420)
    assert np.all(held_out.sum(axis=0)[10:-10] == 1)
    assert not np.any(held_out[:, :10])
    assert not np.any(held_out[:, -10:])
    for fold in held_out:
        lengths = np.diff(np.flatnonzero(np.diff(fold.astype(int))))[::2]
        assert lengths.tolist() == [10] * 8


def test_folds_of_curves_are_trained_on_the_mean_of_the_others(monkeypatch):
    fitted = recorded(monkeypatch)
    z = noisy(THREE(S), 0.1, 3, 3)
    result = select_order(FREQUENCY, z, [3])
    assert result.by_fold.shape == (1, 3)
    pairs = {frozenset((0, 1)): (z[0] + z[1]) / 2, frozenset((0, 2)): (z[0] + z[2]) / 2, frozenset((1, 2)): None}
    pairs[frozenset((1, 2))] = (z[1] + z[2]) / 2
    for mean in pairs.values():
        assert sum(np.allclose(mean, training, rtol=1e-12) for _, training in fitted) == 1


def test_missing_data_are_left_out_and_nothing_is_extrapolated(monkeypatch):
    z = noisy(THREE(S), 0.02, 4, 6)
    z[0, 45:] = np.nan
    z[1:, 53:] = np.nan
    z[2, :10] = np.nan
    full = select_order(FREQUENCY, z, [3])
    assert np.all(np.isfinite(full.by_fold))
    assert full.error[0] < 0.04
    alone = noisy(THREE(S), 0.02, 4, 2)
    alone[0, 30:] = np.nan
    fitted = recorded(monkeypatch)
    result = select_order(FREQUENCY, alone, [3])
    assert sorted(training.size for training, _ in fitted) == [30, 61]
    assert np.all(result.by_fold < 0.06)  # beyond 30 points the model of the short curve would be far off
    with_nothing = np.vstack([z, np.full((1, 61), np.nan)])
    np.testing.assert_array_equal(select_order(FREQUENCY, with_nothing, [3]).by_fold, full.by_fold)


def test_one_curve_in_either_shape_is_the_same():
    z = noisy(THREE(S), 0.02, 5)
    z[30] = np.nan
    flat, row = select_order(FREQUENCY, z, [2, 3]), select_order(FREQUENCY, z[None], [2, 3])
    np.testing.assert_array_equal(flat.by_fold, row.by_fold)


def test_same_seed_same_result():
    z = noisy(THREE(S), 0.1, 6, 11)
    one, two, other = (select_order(FREQUENCY, z, [3], seed=seed) for seed in (1, 1, 2))
    assert isinstance(one, OrderSelection)
    np.testing.assert_array_equal(one.by_fold, two.by_fold)
    assert not np.array_equal(one.by_fold, other.by_fold)


@pytest.mark.parametrize(
    ("frequency", "curves", "options", "message"),
    [
        (FREQUENCY, THREE(S)[:-1], {}, r"give \(N, F\) or \(F,\)"),
        (FREQUENCY, np.zeros((2, 2, 61)), {}, r"give \(N, F\) or \(F,\)"),
        (FREQUENCY, np.append(THREE(S)[1:], np.inf), {}, "mark missing data by NaN"),
        (FREQUENCY, np.append(THREE(S)[1:], 0), {}, "mark missing data by NaN"),
        (np.append(FREQUENCY[1:], np.nan), THREE(S), {}, "frequency_hz is not finite"),
        (FREQUENCY[::-1], THREE(S), {}, "does not ascend"),
        (FREQUENCY, np.full((3, 61), np.nan), {}, "no data at all"),
        (FREQUENCY, THREE(S), {"folds": 1}, "give 2 or more"),
        (FREQUENCY, THREE(S), {"orders": []}, "at least one number of poles"),
        (FREQUENCY, THREE(S), {"orders": [-1]}, "n_poles is -1"),
        (FREQUENCY[:12], THREE(S)[:12], {"orders": range(1, 15)}, "10 poles cannot be determined from the 10 freq"),
        (FREQUENCY[:6], THREE(S)[:6], {"orders": [1]}, "6 frequencies are too few for 5 folds: give 7"),
        (
            FREQUENCY,
            np.array([np.where(FREQUENCY < 100, THREE(S), np.nan), np.where(FREQUENCY < 100, np.nan, THREE(S))]),
            {"orders": [1]},
            "no frequency in the band of the others",
        ),
    ],
)
def test_unusable_input_is_refused_with_a_remedy(frequency, curves, options, message):
    with pytest.raises(InputError, match=message):
        select_order(frequency, curves, **options)
