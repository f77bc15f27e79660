"""The error that a calibration has left in all recordings of a dataset: the table ``[calibration]`` of dataset.toml.

Of a calibration at each frequency the table only names the file that holds it (:mod:`.calibration_map`). Else it is
described by a rig around whatever network is fitted, with parameters that are the same for everybody, and what
the calibration says of them: means, standard deviations and correlations, those of a gain on its logarithm.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import FloatArray
from bayes_impedance.runtime.user_table import UserTable, number_in

TABLE = "calibration"
"""Key of the table."""
PLACE = "NETWORK"
"""Where the network stands in that of the rig."""
MAP = "map"
"""Key of the name of the file with the error of each frequency."""
_KEYS = ("network", "parameters", "mean", "sd", "correlation", "share")


@dataclass(frozen=True, eq=False, kw_only=True)
class CommonError:
    """What a calibration leaves uncertain, the same in all recordings.

    Attributes
    ----------
    network : str
        Notation of the rig, with ``NETWORK`` for what is fitted.
    parameters : tuple of str
        Names of its S parameters.
    mean : ndarray of float, shape (S,)
        Most probable values in the dataset's units.
    sd : ndarray of float, shape (S,)
        Standard deviations: of the logarithm of a gain, and of other parameters in the dataset's units.
    correlation : ndarray of float, shape (S, S)
    share : float
        Part of the variance of the calibration's error that this describes.
    """

    network: str
    parameters: tuple[str, ...]
    mean: FloatArray
    sd: FloatArray
    correlation: FloatArray
    share: float

    def around(self, network: str) -> str:
        """A network within the rig."""
        return self.network.replace(PLACE, network)

    def toml(self) -> str:
        """The table as it stands in dataset.toml."""
        lists = {
            "parameters": list(self.parameters),
            "mean": self.mean.tolist(),
            "sd": self.sd.tolist(),
            "correlation": self.correlation.tolist(),
            "share": self.share,
        }
        return "\n".join(
            [
                f"[{TABLE}]",
                "# What the calibration leaves uncertain, the same in all recordings. Fits estimate it.",
                "# Standard deviations and correlations of a gain are those of its logarithm.",
                f"network = {json.dumps(self.network)}",
                *(f"{key} = {json.dumps(value)}" for key, value in lists.items()),
            ]
        )


def map_table(file: str) -> str:
    """The table as it stands in dataset.toml where a file beside it holds the error of each frequency."""
    return "\n".join(
        [
            f"[{TABLE}]",
            "# What the calibration leaves uncertain at each frequency, the same in all recordings, is in this file.",
            "# Fits carry it on.",
            f"{MAP} = {json.dumps(file)}",
        ]
    )


def map_file_of(value: object, where: Callable[[str], str]) -> str:
    """Name of the file that the table of a file names; empty if it describes a rig.

    Raises
    ------
    InputError
        If the name is none of a file in the dataset's folder, or other keys stand beside it.
    """
    if not isinstance(value, Mapping) or MAP not in value:
        return ""
    name = UserTable(value, where, (MAP,)).text(MAP)
    if name in ("", ".", "..") or "/" in name or "\\" in name:
        raise InputError(f"{where(MAP)}: {MAP} must be the name of a file in the dataset's folder, as calibration.csv")
    return name


def common_error_of(value: object, where: Callable[[str], str]) -> CommonError:
    """The table of a file.

    Parameters
    ----------
    value : object
    where : callable
        File and line of a key.

    Raises
    ------
    InputError
        If anything of it cannot be used.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where(TABLE)}: {TABLE} must be a table [{TABLE}]; see the one that 'import' writes")
    network = UserTable(value, where, _KEYS).text("network")
    names = value.get("parameters")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"{where('parameters')}: parameters must be a list of names; import the recordings again")
    if network.count(PLACE) != 1:
        raise InputError(
            f"{where('network')}: the rig's network must contain {PLACE} once; import the recordings again"
        )
    n = len(names)
    mean, sd, correlation = (
        _numbers(value, key, shape, where) for key, shape in (("mean", (n,)), ("sd", (n,)), ("correlation", (n, n)))
    )
    right = np.allclose(correlation, correlation.T) and np.allclose(np.diag(correlation), 1.0)
    if not (np.all(sd > 0) and right and np.linalg.eigvalsh(correlation).min() > 0):
        raise InputError(
            f"{where('correlation')}: standard deviations must be above zero, and the correlations a positive definite "
            "matrix; import the recordings again"
        )
    share = number_in(value.get("share", 1.0), f"{where('share')}: share", at_least=0.0, at_most=1.0)
    return CommonError(network=network, parameters=tuple(names), mean=mean, sd=sd, correlation=correlation, share=share)


def _numbers(table: Mapping[str, object], key: str, shape: tuple[int, ...], where: Callable[[str], str]) -> FloatArray:
    try:
        found = np.array(table.get(key), dtype=float)
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if found.shape != shape or not np.all(np.isfinite(found)):
        count = " by ".join(map(str, shape))
        raise InputError(f"{where(key)}: {key} must be {count} finite numbers; import the recordings again")
    return found
