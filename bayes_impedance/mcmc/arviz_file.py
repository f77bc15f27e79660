"""Everything that is asked of ArviZ, in one place, for its 0.x and 1.x versions.

ArviZ 1.x needs Python 3.12 and this package supports 3.11, so both generations stay. They differ in the container
(InferenceData or DataTree), in the shape of ``from_dict`` and in where the statistics live. No other module, test,
analysis or benchmark asks which one is installed: what is read back of a file are plain arrays (:func:`load_groups`),
and what others do with the container is what both have in common (``data["posterior"]``, ``summary``).

ArviZ takes seconds to import, so it is imported inside the functions.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.runtime.atomic_files import replacing


def _modern() -> bool:
    return int(version("arviz").split(".")[0]) >= 1


def _statistics() -> Any:
    """ArviZ's statistics on plain arrays."""
    if _modern():
        from arviz_stats.base import array_stats

        return array_stats
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0.23 announces 1.x at import
        import arviz
    return arviz


def rhat(chains: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat of chains (C, S, D) for each of D quantities; infinite where it is undefined."""
    statistics = _statistics()
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # constant chains
        if _modern():
            values = statistics.rhat(chains, chain_axis=0, draw_axis=1)
        else:
            values = np.array([statistics.rhat(chains[:, :, d]) for d in range(chains.shape[2])])
    return np.asarray(np.where(np.isfinite(values), values, np.inf), dtype=float)


def pareto_k(log_weights: np.ndarray) -> np.ndarray:
    """Pareto shape of the largest importance weights, for log weights (..., K): shape (...)."""
    statistics = _statistics()
    flat = log_weights.reshape(-1, log_weights.shape[-1]).astype(float)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if _modern():
            # 1.x takes log likelihoods and changes their sign; 0.x takes log weights.
            k = np.array([statistics.psislw(-row, axis=-1)[1] for row in flat])
        else:
            k = np.array([statistics.psislw(row)[1] for row in flat])
    return np.asarray(k, dtype=float).reshape(log_weights.shape[:-1])


def save(
    file: Path,
    groups: Mapping[str, Mapping[str, np.ndarray]],
    dims: Mapping[str, list[str]],
    coords: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> None:
    """Write groups of arrays as an ArviZ netCDF file that is complete or absent.

    Parameters
    ----------
    file : Path
    groups : mapping
        Group name to variables. Variables of ``posterior``, ``posterior_predictive``, ``sample_stats`` and
        ``log_likelihood`` start with the axes chain and draw.
    dims : mapping
        Variable to names of its further axes.
    coords : mapping
        Axis to labels.
    attributes : mapping
        Written on the file and on every group.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz
    with replacing(file) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if _modern():
            data = arviz.from_dict(
                {name: dict(variables) for name, variables in groups.items()}, dims=dict(dims), coords=dict(coords)
            )
            data.attrs.update(attributes)
            for name in groups:
                data[name].attrs.update(attributes)
            for node in data.subtree:
                node.attrs.pop("created_at", None)  # equal runs give equal files
            data.to_netcdf(temporary, engine="h5netcdf")
        else:
            arguments: dict[str, Any] = {name: dict(variables) for name, variables in groups.items()}
            data = arviz.from_dict(**arguments, dims=dict(dims), coords=dict(coords), attrs=dict(attributes))
            for name in groups:
                data[name].attrs.update(attributes)
            for name in groups:
                data[name].attrs.pop("created_at", None)  # equal runs give equal files
            data.attrs.pop("created_at", None)
            data.to_netcdf(str(temporary), engine="h5netcdf", compress=True)


def load_groups(file: Path) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, Any], dict[str, Any]]:
    """Read groups, labels of the axes, and attributes back as plain arrays.

    Returns
    -------
    groups, coords, attributes : dict
        As they were given to :func:`save`.
    """
    import h5netcdf

    groups: dict[str, dict[str, np.ndarray]] = {}
    coords: dict[str, Any] = {}
    with h5netcdf.File(file, "r") as data:
        attributes = {name: _plain(value) for name, value in data["posterior"].attrs.items()}
        for group in data.groups:
            groups[group] = {}
            for name, variable in data[group].variables.items():
                values = np.asarray(variable[...])
                if name in data[group].dimensions:
                    coords[name] = [_plain(v) for v in values] if values.dtype.kind in "OSU" else values
                else:
                    groups[group][name] = values
    return groups, coords, attributes


def _plain(value: Any) -> Any:
    """Text as str, numbers as Python's."""
    if isinstance(value, bytes):
        return value.decode()
    return value.item() if isinstance(value, np.generic) else value
