"""One ensemble's chain in a file that emcee's `HDFBackend` reads, complete whenever the process is killed.

An HDF5 file that is extended in place cannot be opened after a kill at the wrong moment, and cannot be extended while
another process reads it. So the whole chain is written to a temporary file, which is then renamed. Beside emcee's group
``mcmc`` a group ``burn_in`` holds the results of the burn-in and a seal: a digest of all content.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_bytes
from bayes_impedance.runtime.checkpoint import seal_of

_CHAIN, _BURN_IN, _ADAPTED = "mcmc", "burn_in", ("mean", "covariance", "coordinates", "curved", "turned")
_SEAL = "seal"


def write_chain(file: Path, backend: Any, adapted: dict[str, Any]) -> None:
    """Write the chain of an ensemble, complete or not at all.

    Parameters
    ----------
    file : Path
        An existing file is replaced.
    backend : emcee.backends.Backend
        Chain in memory of S steps, W walkers, D dimensions; S may be zero.
    adapted : dict
        Results of the burn-in: mean (D,), covariance (D, D), coordinates (W, D), curved and turned (0 or 1),
        random_state.
    """
    import emcee
    import h5py

    walkers, dimensions = backend.shape
    steps = backend.iteration
    chain = {
        "chain": backend.chain if steps else np.empty((0, walkers, dimensions)),
        "log_prob": backend.log_prob if steps else np.empty((0, walkers)),
        "accepted": backend.accepted if steps else np.zeros(walkers),
    }
    content = (
        io.BytesIO()
    )  # HDF5 ends the process if it cannot write what it holds: a disk that is full must not meet it
    with h5py.File(content, "w") as opened:
        group = opened.create_group(_CHAIN)
        group.attrs.update(
            version=emcee.__version__, nwalkers=walkers, ndim=dimensions, has_blobs=False, iteration=steps
        )
        for name, values in chain.items():
            group.create_dataset(name, data=values, maxshape=None if name == "accepted" else (None, *values.shape[1:]))
        if steps:
            _put_random_state(group, backend.random_state)
        burn_in = opened.create_group(_BURN_IN)
        for name in _ADAPTED:
            burn_in[name] = adapted[name]
        _put_random_state(burn_in, adapted["random_state"])
        burn_in.attrs[_SEAL] = _seal(file, chain, adapted, backend.random_state if steps else None)
    write_bytes(file, content.getvalue())


def read_chain(file: Path, backend: Any) -> dict[str, Any] | None:
    """Fill a backend in memory from a file.

    Parameters
    ----------
    file : Path
    backend : emcee.backends.Backend
        Empty, of W walkers and D dimensions.

    Returns
    -------
    dict or None
        Results of the burn-in. None if there is no file, or it is damaged or of another fit: no message is needed,
        because sampling the ensemble again gives the same chain.

    Raises
    ------
    InputError
        If the file is of other walkers or dimensions.
    """
    import h5py

    if not file.exists():
        return None
    try:
        with h5py.File(io.BytesIO(file.read_bytes()), "r") as opened:
            group, burn_in = opened[_CHAIN], opened[_BURN_IN]
            shape = int(group.attrs["nwalkers"]), int(group.attrs["ndim"])
            adapted = {name: burn_in[name][...] for name in _ADAPTED} | {"random_state": _random_state(burn_in)}
            chain = {name: group[name][...] for name in ("chain", "log_prob", "accepted")}
            random_state = _random_state(group) if len(chain["chain"]) else None
            if str(burn_in.attrs[_SEAL]) != _seal(file, chain, adapted, random_state):
                return None
    except Exception:  # damage raises many types of exception in HDF5
        return None
    if shape != backend.shape:
        raise InputError(
            f"{file}: is the chain of another fit ({shape[1]} parameters, not {backend.shape[1]}); name another folder"
        )
    steps = len(chain["chain"])
    backend.grow(steps, None)
    backend.chain[...], backend.log_prob[...], backend.accepted = chain["chain"], chain["log_prob"], chain["accepted"]
    backend.iteration, backend.random_state = steps, random_state
    return adapted


def _seal(file: Path, chain: dict[str, Any], adapted: dict[str, Any], random_state: Any) -> str:
    """Digest of all that the continuation depends on."""
    states = repr([_as_lists(adapted["random_state"]), _as_lists(random_state)])
    arrays = chain | {name: adapted[name] for name in _ADAPTED}
    return seal_of(file.parent, {name: np.asarray(v, dtype=float) for name, v in arrays.items()} | {"states": states})


def _as_lists(state: Any) -> Any:
    if state is None:
        return None
    kind, keys, position, has_normal, normal = state
    return str(kind), np.asarray(keys).tolist(), int(position), int(has_normal), float(normal)


def _put_random_state(group: Any, state: Any) -> None:
    """Write the random state in emcee's format."""
    for i, value in enumerate(state):
        group.attrs[f"random_state_{i}"] = value


def _random_state(group: Any) -> Any:
    kind, keys, position, has_normal, normal = (group.attrs[f"random_state_{i}"] for i in range(5))
    return str(kind), keys, int(position), int(has_normal), float(normal)
