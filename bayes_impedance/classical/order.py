r"""Order selection by cross-validation: how many poles of a rational function the recordings support.

The training error falls with every pole that is added. The error on held-out data stops falling where poles begin to
fit the noise, or differences peculiar to the subjects in the training data. For order n and fold k, with
:math:`m_{n,k}` fitted to everything but the fold,

.. math:: E_{n,k} = \sqrt{\operatorname{mean}_f \bigl|m_{n,k}(f) - z_k(f)\bigr|^2 / |z_k(f)|^2} .

**Several curves** (persons, or repetitions of one): whole curves are held out. The model is fitted to the complex mean
of the others, and :math:`z_k` is the complex mean of the fold. This estimates the prediction error for new persons,
including noise and the variation between persons.

**One curve**: frequencies are held out. Single points would test little: a resonance covers many points, an analysis
window correlates the noise of neighbours, and a held-out point lies between two that were fitted. Long stretches would
be too hard: a resonance inside one is missing from the training data. The band is therefore cut into short contiguous
blocks, eight in each fold, with neighbouring blocks in different folds. The first and the last block are in no fold, so
that the model never extrapolates.

**Choice.** The order with the smallest error may be best by chance only. A smaller order is taken to be as good if its
mean excess error, the mean over folds of :math:`D_{n,k} = E_{n,k} - E_{\text{best},k}`, is within one standard error.
It is the standard error of the difference, because a fold that is hard for one order is hard for all, and this cancels.
The smallest such order is chosen, as in the one-standard-error rule [1]_. Any two of K folds share most of their
training data, so that the differences are correlated and the variance of their mean is larger than for K independent
values. It is corrected by the ratio of held-out to training data [2]_,

.. math:: \operatorname{se}^2 = \Bigl(\frac1K + \frac1{K-1}\Bigr)\,\frac1{K-1}\sum_k (D_{n,k} - \bar D_n)^2 .

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and regression trees", 1984; T. Hastie,
   R. Tibshirani, J. Friedman, "The elements of statistical learning", 2nd edition, section 7.10.
.. [2] C. Nadeau, Y. Bengio, "Inference for the generalization error", Machine Learning 52(3), 2003.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.classical.vector_fitting import number_of_unknowns, vector_fit
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError

_BLOCKS_PER_FOLD = 8
"""Blocks of neighbouring frequencies in each fold. By choice: fewer, wider blocks make the held-out data less
predictable from their neighbours; more, narrower blocks cover the band more evenly."""
_RELOCATIONS = 20
"""Most pole relocations in each fit. By choice: superfluous poles never converge, so that more only cost time; the
nonlinear refinement afterwards brings the other poles to convergence."""


@dataclass(frozen=True, eq=False, repr=False)
class OrderSelection(Brief):
    """Held-out error over the number of poles.

    Attributes
    ----------
    orders : tuple of int, length P
        Numbers of poles, ascending.
    error : ndarray, shape (P,)
        Relative error on held-out data: mean over folds of the root mean square over frequency.
    standard_error : ndarray, shape (P,)
        Standard error of the mean difference from the best order, corrected for shared training data; 0 for the best.
    chosen : int
        The smallest order whose error exceeds the best by no more than its standard error.
    by_fold : ndarray, shape (P, folds)
        Error of each order in each fold; `error` is its mean over folds.
    """

    orders: tuple[int, ...]
    error: np.ndarray
    standard_error: np.ndarray
    chosen: int
    by_fold: np.ndarray

    @property
    def best(self) -> int:
        """The order with the smallest held-out error."""
        return self.orders[int(np.argmin(self.error))]


def select_order(
    frequency_hz: npt.ArrayLike,
    curves: npt.ArrayLike,
    orders: Iterable[int] = range(1, 11),
    *,
    pole_at_zero: bool = False,
    constant: bool = True,
    linear: bool = False,
    folds: int = 5,
    seed: int = 0,
) -> OrderSelection:
    """Choose the number of poles by held-out error.

    Parameters
    ----------
    frequency_hz : array_like, shape (F,)
        Frequencies in Hz, ascending.
    curves : array_like, complex, shape (N, F) or (F,)
        Impedances of persons or repetitions, NaN where data are missing; with one curve, frequencies are held out.
    orders : iterable of int
        Numbers of poles, including the one at 0.
    pole_at_zero, constant, linear : bool
        As for :func:`~bayes_impedance.classical.vector_fitting.vector_fit`, which is given weights 1/abs(z).
    folds : int
        Number of folds; reduced to the number of curves if there are fewer.
    seed : int
        Seed of the random division of curves into folds. Frequencies are not divided at random.

    Returns
    -------
    OrderSelection

    Raises
    ------
    InputError
        If shapes differ, values are infinite or 0, frequencies do not ascend, there are fewer than two folds or no
        orders, the training data of a fold cannot support an order, or a fold shares no frequencies with the rest.
    """
    frequency, z = np.asarray(frequency_hz, dtype=float), np.atleast_2d(np.asarray(curves, dtype=complex))
    candidates = tuple(sorted({int(order) for order in orders}))
    if frequency.ndim != 1 or z.ndim != 2 or z.shape[1] != frequency.size:
        raise InputError(
            f"curves have shape {z.shape} and frequency_hz {frequency.shape}: give (N, F) or (F,), and (F,)"
        )
    if np.any(np.isinf(z) | (z == 0)) or not np.all(np.isfinite(frequency)):
        raise InputError(
            "curves hold infinite values or 0, or frequency_hz is not finite: mark missing data by NaN in curves"
        )
    if folds < 2:
        raise InputError(f"folds is {folds}: give 2 or more")
    if not candidates:
        raise InputError("orders is empty: give at least one number of poles")
    z = z[np.any(np.isfinite(z), axis=1)]
    if z.shape[0] == 0:
        raise InputError("curves hold no data at all: give at least one curve that is not NaN everywhere")
    divided = list(_by_frequency(z[0], folds) if z.shape[0] == 1 else _by_curve(z, folds, seed))
    terms = {"pole_at_zero": pole_at_zero, "constant": constant, "linear": linear}
    fewest = min(int(np.sum(np.isfinite(training))) for training, _ in divided)
    unsupported = [n for n in candidates if number_of_unknowns(n, **terms) > 2 * fewest]
    if unsupported:
        raise InputError(
            f"{unsupported[0]} poles cannot be determined from the {fewest} frequencies left when a fold is held out: "
            "ask for smaller orders only, or give more data"
        )
    by_fold = np.array(
        [[_held_out_error(frequency, training, test, n, terms) for training, test in divided] for n in candidates]
    )
    error = by_fold.mean(axis=1)
    difference = by_fold - by_fold[np.argmin(error)]
    standard_error = difference.std(axis=1, ddof=1) * np.sqrt(1 / len(divided) + 1 / (len(divided) - 1))
    chosen = candidates[int(np.argmax(difference.mean(axis=1) <= standard_error))]
    return OrderSelection(candidates, error, standard_error, chosen, by_fold)


def _held_out_error(
    frequency: np.ndarray, training: np.ndarray, test: np.ndarray, n_poles: int, terms: dict[str, bool]
) -> float:
    """Relative error on the test data, within the training data's band, of the model fitted to the training data."""
    known = np.isfinite(training)
    model = vector_fit(frequency[known], training[known], n_poles, max_iterations=_RELOCATIONS, **terms).model
    low, high = frequency[known][[0, -1]]
    tested = np.isfinite(test) & (frequency >= low) & (frequency <= high)
    if not np.any(tested):
        raise InputError(
            "a fold of curves has no frequency in the band of the others: leave out curves that stand alone"
        )
    deviation = model(2j * np.pi * frequency[tested]) - test[tested]
    return float(np.sqrt(np.mean(np.abs(deviation / test[tested]) ** 2)))


def _by_curve(z: np.ndarray, folds: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Training and test data of each fold: mean of the curves outside and inside of it, complex, shape (F,) each."""
    fold = np.random.default_rng(seed).permutation(np.arange(z.shape[0]) % folds)
    for k in range(min(folds, z.shape[0])):
        yield _mean(z[fold != k]), _mean(z[fold == k])


def _by_frequency(z: np.ndarray, folds: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Training and test data of each fold: the curve without its blocks, and these alone; complex, (F,), else NaN."""
    known = np.flatnonzero(np.isfinite(z))
    blocks = np.array_split(known, min(_BLOCKS_PER_FOLD * folds + 2, known.size))[1:-1]
    if len(blocks) < folds:
        raise InputError(
            f"{known.size} frequencies are too few for {folds} folds: give {folds + 2} or ask for fewer folds"
        )
    for k in range(folds):
        held_out = np.isin(np.arange(z.size), np.concatenate(blocks[k::folds]))
        yield np.where(held_out, np.nan, z), np.where(held_out, z, np.nan)


def _mean(z: np.ndarray) -> np.ndarray:
    """Mean over the curves at each frequency, ignoring NaN: (N, F) to (F,); NaN where all curves are."""
    known = np.isfinite(z)
    count = known.sum(axis=0)
    return np.asarray(np.where(count > 0, np.where(known, z, 0).sum(axis=0) / np.maximum(count, 1), np.nan))
