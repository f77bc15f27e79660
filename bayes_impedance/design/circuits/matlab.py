"""Users as a MATLAB file: elements, impedances, and state spaces with names of inputs, outputs and users.

In MATLAB, with the Control System Toolbox::

    load users.mat
    k = 1;
    finger = ss(A(:,:,k), B(:,:,k), C(:,:,k), D(:,:,k), 'InputName', input_name, 'OutputName', output_name, ...
                'Name', users{k});

SciPy and Octave read it, too.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_impedance.design.circuits.equivalent import Equivalent
from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.circuits.transfer_functions import matrices, signal_names
from bayes_impedance.design.users import Users

_HEADER = b"MATLAB 5.0 MAT-file, written by bayes_impedance"
_TEXT_BYTES = 116
"""Bytes of text at the beginning of a MAT-file of version 5, by its specification."""


def variables(users: Users, frequency_hz: np.ndarray, made: Equivalent | None = None) -> dict[str, Any]:
    """What the file holds.

    Parameters
    ----------
    users : Users
        N users.
    frequency_hz : ndarray, shape (F,)
    made : Equivalent, optional
        The same users as masses, compliances and dampers; without it there are no state spaces.

    Returns
    -------
    dict
        ``users`` (N,), ``elements`` and ``units`` (P,) as cells of text, ``values`` (N, P), ``frequency_hz`` (F,),
        ``z`` (N, F) complex, ``network``, ``unit``; and ``A`` (n, n, N), ``B`` (n, 1, N), ``C`` (1, n, N), ``D``
        (1, 1, N), ``input_name``, ``output_name`` of the state spaces.
    """
    content: dict[str, Any] = {
        "users": _cells(users.names),
        "elements": _cells(users.elements),
        "units": _cells([users.units[e] for e in users.elements]),
        "values": np.stack([users.values[e] for e in users.elements], axis=1),
        "frequency_hz": np.asarray(frequency_hz, dtype=float),
        "z": users.impedance(frequency_hz),
        "network": str(users.network),
        "unit": users.unit,
    }
    if made is not None:
        impedance = realise(made.users.network, made.users.values)
        is_mobility = impedance.high >= 0
        a, b, c, d = matrices(impedance.reciprocal() if is_mobility else impedance)
        number = len(users)
        content |= {
            "A": np.moveaxis(np.broadcast_to(a, (number, *a.shape[1:])), 0, -1),
            "B": np.broadcast_to(b, (number, b.shape[1])).T[:, None, :],
            "C": np.broadcast_to(c, (number, c.shape[1])).T[None, :, :],
            "D": np.broadcast_to(d, (number,))[None, None, :],
        }
        content["input_name"], content["output_name"] = signal_names(users.unit, mobility=is_mobility)
    return content


def mat_bytes(content: Mapping[str, Any]) -> bytes:
    """A MAT-file of version 5; equal content gives equal bytes, since the time of writing is left out."""
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, dict(content), do_compression=True, oned_as="column")
    return _HEADER.ljust(_TEXT_BYTES) + stream.getvalue()[_TEXT_BYTES:]


def with_warnings(file: bytes, warnings: list[str]) -> bytes:
    """The same file with a variable ``warnings``."""
    from scipy.io import loadmat

    content = {k: v for k, v in loadmat(io.BytesIO(file)).items() if not k.startswith("__")}
    return mat_bytes({"warnings": _cells(warnings)} | content)


def _cells(texts: Any) -> np.ndarray:
    cells = np.empty(len(texts), dtype=object)
    cells[:] = list(texts)
    return cells
