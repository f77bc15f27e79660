"""The layout of a result's groups in the netCDF file, which ArviZ's functions work on as they are.

In memory every variable has a place for every element, NaN for those that the recordings do not determine. In the file
the posterior holds only what has been sampled and may be read:

* the axis ``element`` of ``posterior`` and ``prior`` has the determined elements only;
* ``correlation`` is one number for each pair of elements: the diagonal is constant, and densities, R-hat and
  autocorrelations of constants are not defined;
* dispersions and differences of groups have the axis ``varying_element``, without parameters that are the same for
  everybody, if there are any.
* ``person_log_elements`` has its axes in the order of the other variables, element first: ArviZ 1 labels the entries of
  a summary in the order in which a group's axes appear.

Reading the file restores the complete arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

Groups = dict[str, dict[str, np.ndarray]]

LAYOUT_ATTRIBUTE, LAYOUT = "layout", 2
"""Attribute of the file, and its value for this layout; files of earlier versions hold the complete arrays."""

_BY_ELEMENT = ("mu", "central", "person_log_elements", "slope", "dispersion_between_persons",
               "dispersion_between_repetitions", "group_difference")  # fmt: skip
_OF_VARYING = ("dispersion", "group_difference")
"""Beginnings of the names of variables that parameters which are the same for everybody do not have."""
_AXIS = {"slope": -2}
"""Position of the axis element where it is not the last."""
_ALSO_BY_ELEMENT = ("posterior", "prior")


def for_file(
    groups: Mapping[str, Mapping[str, np.ndarray]], coords: Mapping[str, Any]
) -> tuple[Groups, dict[str, Any]]:
    """Groups and coordinates as they are written; the arguments are not changed."""
    written = {name: dict(variables) for name, variables in groups.items()}
    labels = dict(coords)
    elements = list(coords["element"])
    known = np.asarray(groups["constant_data"]["identified"], dtype=bool)
    if not known.any():  # nothing may be read, and axes of no length are no help
        known = np.ones(len(elements), dtype=bool)
    kept = np.flatnonzero(known)
    posterior = groups["posterior"]
    same = np.zeros(len(elements), dtype=bool)
    if "dispersion_between_persons" in posterior:
        same = np.all(posterior["dispersion_between_persons"] == 0, axis=(0, 1))
    varying = np.flatnonzero(known & ~same)
    narrowed = 0 < varying.size < kept.size
    pairs = [(i, j) for j in varying.tolist() for i in varying.tolist() if i < j]
    for group in _ALSO_BY_ELEMENT:
        if group not in groups:
            continue
        for name, values in groups[group].items():
            if name == "correlation":
                own = values[..., [j for _, j in pairs], [i for i, _ in pairs]]
                del written[group][name]
                if pairs and np.any(own != 0):  # a diagonal covariance has constant zeros
                    written[group]["correlation"] = own
            elif name.startswith(_OF_VARYING) and narrowed:
                written[group][name] = values[..., varying]
            elif name in _BY_ELEMENT and kept.size < len(elements):
                written[group][name] = np.take(values, kept, axis=_AXIS.get(name, -1))
        if kept.size < len(elements):
            labels[f"{group}/element"] = [elements[i] for i in kept]
    if "person_log_elements" in posterior:
        written["posterior"]["person_log_elements"] = np.swapaxes(written["posterior"]["person_log_elements"], -1, -2)
    if narrowed:
        labels["varying_element"] = [elements[i] for i in varying]
    if pairs:
        labels["pair"] = [f"{elements[i]}, {elements[j]}" for i, j in pairs]
    return written, labels


def file_dims(written: Mapping[str, Mapping[str, np.ndarray]], dims: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Axes of the written variables, given those of the complete ones."""
    posterior = written["posterior"]
    found = {name: axes for name, axes in dims.items() if any(name in group for group in written.values())}
    found["correlation"], found["person_log_elements"] = ["pair"], ["element", "subject"]
    size = posterior["mu"].shape[-1]
    for name in [n for n in posterior if n.startswith(_OF_VARYING)]:
        if posterior[name].shape[-1] < size:
            found[name] = ["varying_element"]
    return found


def from_file(groups: Groups, coords: dict[str, Any]) -> tuple[Groups, dict[str, Any]]:
    """Complete arrays of what was read from a file."""
    elements = list(coords["element"])
    labels = {k: v for k, v in coords.items() if k not in ("pair", "varying_element") and "/" not in k}
    restored = {name: dict(variables) for name, variables in groups.items()}
    own = restored["posterior"]
    if "person_log_elements" in own:
        groups = groups | {"posterior": own | {"person_log_elements": np.swapaxes(own["person_log_elements"], -1, -2)}}
        restored["posterior"] = dict(groups["posterior"])
    for group in _ALSO_BY_ELEMENT:
        if group not in groups:
            continue
        known = list(coords.get(f"{group}/element", elements))
        columns = [elements.index(e) for e in known]
        varying = [elements.index(e) for e in coords.get("varying_element", known)]
        seen = [i for i in columns if groups["constant_data"]["identified"][i]]
        for name, values in groups[group].items():
            if name == "correlation":
                restored[group][name] = _matrices(values, list(coords["pair"]), elements, seen)
            elif name.startswith(_OF_VARYING) and "varying_element" in coords:
                restored[group][name] = _whole(values, varying, len(elements), -1)
                restored[group][name][..., [i for i in columns if i not in varying]] = 0.0
            elif name in _BY_ELEMENT and len(known) < len(elements):
                restored[group][name] = _whole(values, columns, len(elements), _AXIS.get(name, -1))
        if "dispersion_between_persons" in groups[group] and "correlation" not in groups[group]:
            shape = (*groups[group]["dispersion_between_persons"].shape[:2], 0)
            restored[group]["correlation"] = _matrices(np.zeros(shape), [], elements, seen)
    labels["element_2"] = elements
    return restored, labels


def _whole(values: np.ndarray, columns: list[int], size: int, axis: int) -> np.ndarray:
    shape = list(values.shape)
    shape[axis] = size
    result = np.full(shape, np.nan)
    np.moveaxis(result, axis, -1)[..., columns] = np.moveaxis(values, axis, -1)
    return result


def _matrices(values: np.ndarray, pairs: list[str], elements: list[str], known: list[int]) -> np.ndarray:
    """Correlation matrices (C, S, P, P) of pairs (C, S, K); NaN for elements that are not determined."""
    p = len(elements)
    result = np.zeros((*values.shape[:2], p, p))
    result[..., np.arange(p), np.arange(p)] = 1.0
    for k, pair in enumerate(pairs):
        a, b = (elements.index(name) for name in pair.split(", "))
        result[..., a, b] = result[..., b, a] = values[..., k]
    lost = np.setdiff1d(np.arange(p), known)
    result[..., lost, :] = result[..., :, lost] = np.nan
    return result
