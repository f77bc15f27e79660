r"""The error of a calibration that was made at each frequency for itself: the table ``calibration.csv`` of a dataset.

A rig turns a load z into :math:`h = (a z + b)/(c z + 1)`, and recordings were corrected with a, b and c that runs with
known loads have determined at each frequency (:mod:`bayes_impedance.intake.two_port`). Errors
:math:`\delta v_f = (\delta a, \delta b, \delta c)_f` are independent from frequency to frequency, circular, of
covariance :math:`\Sigma_f` in each of real and imaginary part, and **the same in all recordings**. To first order they
change a corrected load by

.. math:: g\,\delta v, \qquad g = \frac{(-z,\, -1,\, z h)}{a - c h}.

``dataset.toml`` names the table by ``map`` in its table ``[calibration]``.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import FloatArray, numbers, parse_csv

MAP_FILE = "calibration.csv"
_PAIRS = ((0, 1, "ab"), (0, 2, "ac"), (1, 2, "bc"))
_VALUES = tuple(f"{x}_{part}" for x in "abc" for part in ("re", "im"))
_SPREADS = (*(f"var_{x}" for x in "abc"), *(f"cov_{xy}_{part}" for *_, xy in _PAIRS for part in ("re", "im")))
_SAME_FREQUENCY = 0.05
"""Largest relative distance of a recording's frequency from that of the map. By choice: the import has corrected each
frequency with the map of its own, which nominal and actual frequencies of instruments hardly miss by so much."""
_ROUNDING = 1e-9
"""Negative part of a covariance, over its size, that is rounding."""

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationMap:
    """What recordings were corrected with, at each frequency.

    Attributes
    ----------
    frequency_hz : ndarray of float, shape (F,)
    a, b, c : ndarray of complex, shape (F,)
        Without unit, in the dataset's unit, and in its reciprocal.
    covariance : ndarray of complex, shape (F, 3, 3), or None
        Of (a, b, c), of each of real and imaginary part; None if it is not known.
    in_noise : bool
        Whether the recordings' ``noise_sd`` holds the error already.
    """

    frequency_hz: FloatArray
    a: ComplexArray
    b: ComplexArray
    c: ComplexArray
    covariance: ComplexArray | None
    in_noise: bool = False

    def csv(self) -> bytes:
        """The table as a file."""
        header = ["frequency_hz", *_VALUES, *(_SPREADS if self.covariance is not None else ())]
        rows: list[list[object]] = [[*header]]
        for i, frequency in enumerate(self.frequency_hz):
            row = [float(frequency)]
            for value in (self.a[i], self.b[i], self.c[i]):
                row += [float(value.real), float(value.imag)]
            if self.covariance is not None:
                row += [float(self.covariance[i, k, k].real) for k in range(3)]
                for k, m, _ in _PAIRS:
                    row += [float(self.covariance[i, k, m].real), float(self.covariance[i, k, m].imag)]
            rows.append([repr(value) for value in row])
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        return text.getvalue().encode()

    def changes(self, frequency_hz: FloatArray, z: ComplexArray) -> tuple[npt.NDArray[np.int64], ComplexArray]:
        """How corrected loads follow the errors of the map.

        Parameters
        ----------
        frequency_hz : ndarray of float, shape (L,)
        z : ndarray of complex, shape (..., L)

        Returns
        -------
        index : ndarray of int, shape (L,)
            Of the map's frequencies.
        gradient : ndarray of complex, shape (..., L, 3)
            By (a, b, c) there.

        Raises
        ------
        InputError
            If the map has no such frequency.
        """
        log, wanted = np.log(self.frequency_hz), np.log(frequency_hz)
        right = np.clip(np.searchsorted(log, wanted), 1, log.size - 1)
        index = np.where(wanted - log[right - 1] < log[right] - wanted, right - 1, right)
        away = np.abs(log[index] - wanted)
        if away.max() > _SAME_FREQUENCY:
            raise InputError(
                f"the calibration's map has no frequency near {frequency_hz[int(np.argmax(away))]:g} Hz, at which "
                "there are recordings; import them again, or take the calibration as exact (--exact-calibration)"
            )
        a, b, c = self.a[index], self.b[index], self.c[index]
        h = (a * z + b) / (c * z + 1)
        return index, np.stack([-z, -np.ones_like(z), z * h], axis=-1) / (a - c * h)[..., None]

    def variance(self, frequency_hz: FloatArray, z: ComplexArray) -> FloatArray:
        """Variance of each of real and imaginary part of corrected loads (..., L) from the map's errors."""
        assert self.covariance is not None  # what is carried on has one
        index, gradient = self.changes(frequency_hz, z)
        return np.asarray(np.einsum("...fi,fij,...fj->...f", gradient, self.covariance[index], gradient.conj()).real)


def parse_map(data: bytes, file: str) -> CalibrationMap:
    """Read the table.

    Raises
    ------
    InputError
        If a column is missing, a number is none, frequencies do not ascend, or variances cannot be.
    """
    again = "import the recordings again"
    table = parse_csv(data, file, ("frequency_hz", *_VALUES, *_SPREADS))
    missing = [name for name in ("frequency_hz", *_VALUES, *_SPREADS) if name not in table.columns]
    if missing:
        raise InputError(f'{file}, row 1: column "{missing[0]}" is missing; {again}')
    column = {name: numbers(table, name) for name in ("frequency_hz", *_VALUES, *_SPREADS)}
    for name, values in column.items():
        if not np.all(np.isfinite(values)):
            raise InputError(f"{file}, row {table.row[int(np.argmin(np.isfinite(values)))]}: {name} is empty; {again}")
    frequency = column["frequency_hz"]
    if frequency.size < 2 or not (frequency[0] > 0 and np.all(np.diff(frequency) > 0)):
        raise InputError(f"{file}: frequencies must be above zero and ascend, at least two of them; {again}")
    a, b, c = (column[f"{x}_re"] + 1j * column[f"{x}_im"] for x in "abc")
    covariance = np.zeros((frequency.size, 3, 3), dtype=complex)
    for k, x in enumerate("abc"):
        covariance[:, k, k] = column[f"var_{x}"]
    for k, m, xy in _PAIRS:
        covariance[:, k, m] = column[f"cov_{xy}_re"] + 1j * column[f"cov_{xy}_im"]
        covariance[:, m, k] = covariance[:, k, m].conj()
    size = np.sqrt(np.abs(np.diagonal(covariance, axis1=1, axis2=2)))
    size[size == 0] = 1.0
    least = np.linalg.eigvalsh(covariance / (size[:, :, None] * size[:, None, :])).min(axis=1)
    if least.min() < -_ROUNDING:
        row = table.row[int(np.argmin(least))]
        raise InputError(f"{file}, row {row}: variances and covariances are no positive semidefinite matrix; {again}")
    return CalibrationMap(frequency_hz=frequency, a=a, b=b, c=c, covariance=covariance)
