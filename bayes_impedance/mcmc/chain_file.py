"""One ensemble's chain in a file that emcee's `HDFBackend` reads, complete whenever the process is killed.

An HDF5 file that is extended in place cannot be opened after a kill at the wrong moment, and cannot be extended while
somebody reads it. So a chain is written whole to a temporary name, and the name is changed. Beside emcee's group
``mcmc`` there is one, ``burn_in``, with what the burn-in has found.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import replacing

_BURN_IN, _ADAPTED = "burn_in", ("mean", "covariance", "coordinates")


def write_chain(file: Path, backend: Any, adapted: dict[str, Any]) -> None:
    """Write the chain of an ensemble, complete or not at all.

    Parameters
    ----------
    file : Path
        What is there is replaced.
    backend : emcee.backends.Backend
        Chain in memory of S steps, W walkers, D dimensions; S may be zero.
    adapted : dict
        What the burn-in has found: mean (D,), covariance (D, D), coordinates (W, D), random_state.
    """
    import emcee

    with replacing(file) as temporary:
        kept = emcee.backends.HDFBackend(temporary)
        kept.reset(*backend.shape)
        kept.grow(backend.iteration, None)
        with kept.open("a") as opened:
            group = opened[kept.name]
            if backend.iteration:
                group["chain"][...], group["log_prob"][...] = backend.chain, backend.log_prob
                group["accepted"][...] = backend.accepted
                _put_random_state(group, backend.random_state)
            group.attrs["iteration"] = backend.iteration
            group = opened.create_group(_BURN_IN)
            for name in _ADAPTED:
                group[name] = adapted[name]
            _put_random_state(group, adapted["random_state"])


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
        What the burn-in had found. None if there is no file or it is damaged: an ensemble that is sampled anew is the
        same, so that this is not worth a message.

    Raises
    ------
    InputError
        If the file is of other walkers or dimensions.
    """
    import emcee

    if not file.exists():
        return None
    kept = emcee.backends.HDFBackend(file, read_only=True)
    try:
        with kept.open() as opened:
            group, burn_in = opened[kept.name], opened[_BURN_IN]
            shape = group.attrs["nwalkers"], group.attrs["ndim"]
            adapted = {name: burn_in[name][...] for name in _ADAPTED} | {"random_state": _random_state(burn_in)}
            chain, log_probability = group["chain"][...], group["log_prob"][...]
            accepted = group["accepted"][...]
            random_state = _random_state(group) if len(chain) else None
    except (OSError, KeyError, RuntimeError):
        return None
    if shape != backend.shape:
        raise InputError(
            f"{file}: is of another fit ({shape[1]} parameters, not {backend.shape[1]}); name another folder"
        )
    backend.grow(len(chain), None)
    backend.chain[...], backend.log_prob[...], backend.accepted = chain, log_probability, accepted
    backend.iteration, backend.random_state = len(chain), random_state
    return adapted


def _put_random_state(group: Any, state: Any) -> None:
    """As emcee does it."""
    for i, value in enumerate(state):
        group.attrs[f"random_state_{i}"] = value


def _random_state(group: Any) -> Any:
    kind, keys, position, has_normal, normal = (group.attrs[f"random_state_{i}"] for i in range(5))
    return str(kind), keys, int(position), int(has_normal), float(normal)
