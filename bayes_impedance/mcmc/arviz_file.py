"""All uses of ArviZ, for its versions 0.x and 1.x.

ArviZ 1.x needs Python 3.12 and this package supports 3.11, so both generations are supported. They differ in the
container (InferenceData or DataTree) and in the shape of ``from_dict``. No other module, test, analysis or benchmark
depends on the installed version: files are read back as plain arrays (:func:`load_groups`), and only features common to
both containers are used elsewhere (``data["posterior"]``, ``summary``).

ArviZ takes seconds and a hundred megabytes to import, so it is imported where networks are compared alone; a fit takes
its two numbers from :mod:`bayes_impedance.mcmc.convergence`.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_bytes

_SEAL = "content_sha256"
"""Attribute with a digest of the content, by which a damaged file is detected."""
_SAMPLED = frozenset(
    {"posterior", "posterior_predictive", "sample_stats", "log_likelihood", "prior", "prior_predictive"}
)
"""Groups of draws."""
_COUNTED = ("chain", "draw")
"""Axes without labels of their own."""
_AT_ONCE = 1_000_000
"""Numbers of an array that enter the digest at once, 8 MB. By choice: memory."""
_NETCDF_ATTRIBUTES = frozenset({"_NCProperties", "_nc3_strict", "_Netcdf4Dimid", "_Netcdf4Coordinates"})
"""Attributes that netCDF adds to HDF5 for internal use."""


def _modern() -> bool:
    return int(version("arviz").split(".")[0]) >= 1


def leave_one_out(
    posterior: Mapping[str, np.ndarray], log_likelihood: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Leave-one-out cross-validation by Pareto smoothed importance sampling, as ``arviz.loo`` computes it.

    Parameters
    ----------
    posterior : mapping
        Variables with axes chain and draw first: their efficiency sets the length of the smoothed tail.
    log_likelihood : ndarray, shape (C, S, N)
        Of each of N observations.

    Returns
    -------
    elpd, pareto_k : ndarray, shape (N,)
        Log predictive density of each observation given the others, and the Pareto tail index of its weights.
    p_loo : float
        Effective number of parameters.
    """
    groups: dict[str, Any] = {"posterior": dict(posterior), "log_likelihood": {"observation": log_likelihood}}
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # large values of k are for the caller to report
        import arviz

        former = logging.root.manager.disable
        logging.disable(logging.WARNING)  # elements that are not determined are NaN, and it would say so each time
        try:
            untyped: Any = arviz
            data = untyped.from_dict(groups) if _modern() else untyped.from_dict(**groups)
            found = untyped.loo(data, pointwise=True)
        finally:
            logging.disable(former)
    each, p_loo = (found.elpd_i, found.p) if _modern() else (found.loo_i, found.p_loo)
    return np.asarray(each, dtype=float), np.asarray(found.pareto_k, dtype=float), float(p_loo)


def save(
    file: Path,
    groups: Mapping[str, Mapping[str, np.ndarray]],
    dims: Mapping[str, list[str]],
    coords: Mapping[str, Any],
    attributes: Mapping[str, Any],
    meanings: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Write groups of arrays as an ArviZ netCDF file that is complete or absent.

    Parameters
    ----------
    file : Path
    groups : mapping
        Group name to variables. Those of the groups in :data:`_SAMPLED` start with the axes chain and draw.
    dims : mapping
        Variable to names of its further axes.
    coords : mapping
        Axis to labels; ``group/axis`` to the labels that an axis has in one group only.
    attributes : mapping
        Written to the file and to every group.
    meanings : mapping, optional
        Variable, or ``group/variable``, to its own attributes, such as ``units``.
    """
    meanings = meanings or {}
    content, labels = {}, {}
    for group, variables in groups.items():
        sampled = ("chain", "draw") if group in _SAMPLED else ()
        used: dict[str, Any] = {}
        own: dict[str, _Variable] = {}
        for name, values in variables.items():
            axes = (*sampled, *dims.get(name, ()))
            for axis, size in zip(axes, np.shape(values), strict=True):
                key = f"{group}/{axis}" if f"{group}/{axis}" in coords else axis
                labelled = key in coords and axis not in _COUNTED
                used[axis] = coords[key] if labelled else np.arange(size)
                if labelled:
                    labels[key] = coords[key]
            said = dict(meanings.get(name, {})) | dict(meanings.get(f"{group}/{name}", {}))
            own[name] = _Variable(axes, np.asarray(values), said)
        content[group] = own | {axis: _Variable((axis,), np.asarray(values), {}) for axis, values in used.items()}
    own_attributes = dict(attributes) | {_SEAL: _seal(groups, labels, attributes)}
    write_bytes(file, _as_netcdf(content, own_attributes).getbuffer())


class _Variable(NamedTuple):
    """An array, the names of its axes and what is said of it; one with the name of its only axis labels that."""

    axes: tuple[str, ...]
    values: np.ndarray
    attributes: Mapping[str, str]


def _as_netcdf(content: Mapping[str, Mapping[str, _Variable]], attributes: Mapping[str, Any]) -> io.BytesIO:
    """A netCDF file with a group for each mapping.

    It is made in memory: HDF5 ends the process if it cannot write its buffers, which may happen on a full disk. It is
    made without xarray, whose import takes pandas along, a second and seventy megabytes.
    """
    import h5netcdf
    import h5py

    file = io.BytesIO()
    with h5netcdf.File(file, "w") as opened:
        opened.attrs.update(attributes)
        for name, variables in content.items():
            group = opened.create_group(name)
            group.attrs.update(attributes)  # without ArviZ's time of creation: equal runs give equal files
            group.dimensions = {
                axis: size for v in variables.values() for axis, size in zip(v.axes, v.values.shape, strict=True)
            }
            for key, (axes, values, said) in variables.items():
                if values.dtype.kind in "OSU":
                    group.create_variable(key, axes, h5py.string_dtype(), data=values.astype(object))
                    continue
                if values.dtype.kind == "b":  # netCDF has none; this is how xarray writes them, and reads them again
                    values, said = values.astype(np.int8), {**said, "dtype": "bool"}
                packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if axes else {}
                missing = {"fillvalue": np.nan} if values.dtype.kind == "f" else {}
                group.create_variable(key, axes, values.dtype, data=values, **packed, **missing).attrs.update(said)
    return file


def load_groups(file: Path) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, Any], dict[str, Any]]:
    """Read groups, labels of the axes, and attributes back as plain arrays.

    Returns
    -------
    groups, coords, attributes : dict
        As they were given to :func:`save`.

    Raises
    ------
    InputError
        If the file is damaged, or was not written by :func:`save`.
    """
    import h5py  # h5netcdf raises again when it closes a damaged file

    groups: dict[str, dict[str, np.ndarray]] = {}
    coords: dict[str, Any] = {}
    content = io.BytesIO(file.read_bytes())
    try:
        with h5py.File(content, "r") as data:
            attributes = {
                name: _plain(value) for name, value in data["posterior"].attrs.items() if name not in _NETCDF_ATTRIBUTES
            }
            for group, variables in sorted(data.items()):
                groups[group] = {}
                for name, variable in variables.items():
                    values = np.asarray(variable[...])
                    if variable.is_scale:
                        labels = [_plain(v) for v in values] if values.dtype.kind in "OSU" else values
                        first = coords.setdefault(name, labels)
                        if name not in _COUNTED and not np.array_equal(first, labels):
                            coords[f"{group}/{name}"] = labels
                    else:
                        groups[group][name] = values
            seal = attributes.pop(_SEAL, None)
            whole = seal is not None and seal == _seal(groups, coords, attributes)
    except Exception:  # damage raises many types of exception in netCDF
        whole = False
    if not whole:
        raise InputError(
            f"{file}: is damaged, or of another version of this package; fit the recordings again, or take a copy"
        )
    return groups, coords, attributes


def _seal(
    groups: Mapping[str, Mapping[str, np.ndarray]], coords: Mapping[str, Any], attributes: Mapping[str, Any]
) -> str:
    """Digest of the file's content, independent of the byte widths of its numbers."""
    digest = hashlib.sha256(json.dumps({k: str(v) for k, v in sorted(attributes.items())}).encode())
    arrays = {f"{group} {name}": values for group, own in groups.items() for name, values in own.items()}
    for name in sorted(arrays):
        values = np.asarray(arrays[name])
        digest.update(f"{name} {values.shape}".encode())
        for piece in _pieces(values):
            digest.update(np.asarray(piece, dtype=float).tobytes())
    for name in sorted(coords):
        labels = [_plain(label) for label in np.asarray(coords[name]).tolist()]
        if labels == list(range(len(labels))):  # ArviZ numbers an axis that was given no labels
            continue
        digest.update(json.dumps([name, labels]).encode())
    return digest.hexdigest()


def _pieces(values: np.ndarray) -> Iterator[np.ndarray]:
    """The array's numbers in their order, a few at a time: copies of the draws of many people are large."""
    if values.size <= _AT_ONCE or not values.ndim:
        yield values
    else:
        for row in values:
            yield from _pieces(row)


def _plain(value: Any) -> Any:
    """Text as str, numbers as Python's."""
    if isinstance(value, bytes):
        return value.decode()
    if type(value).__name__ == "Empty":  # HDF5's representation of an empty string
        return ""
    if isinstance(value, np.ndarray) and value.size == 1:
        return _plain(value.reshape(-1)[0])
    return value.item() if isinstance(value, np.generic) else value
