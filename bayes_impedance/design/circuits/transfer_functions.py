r"""Users as transfer functions and in state space, for other programs.

Eq. 1 and appendix A of the paper write an impedance as a ratio of polynomials in s with descending powers,

.. math:: z(s) = \frac{b_N s^N + \dots + b_0}{a_M s^M + \dots + a_0}, \qquad a_M = 1 .

The same function is also given by poles, zeros and gain, and in state space. Poles and zeros are eigenvalues of state
matrices and more accurate than the roots of these polynomials. The impedance of a network with a mass at its port grows
with s, so that it has no state space with the usual four matrices; the mobility v/F always has one unless a spring
stands alone at the port. Hence the file states which of the two is given: the mobility, or the impedance if the
mobility grows with s.

python-control is an optional dependency (the extra `design`); only :func:`to_control` and :func:`read_control` need it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.design.circuits.equivalent import Equivalent, equivalent
from bayes_impedance.design.circuits.state_space import Realisation, realise, zeros_and_poles
from bayes_impedance.design.users import Users
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.units import ELECTRICAL_UNIT, ratio_of

SCHEMA = 1
"""Version of the layout of ``transfer.json``."""

_HIGHEST_DEGREE = 30
"""Highest degree of a ladder's polynomials that are written as coefficients: up to 26 was tried, and is passive after
coefficients have been rounded to doubles."""

FORMS = ("transfer", "zeros_poles", "state_space")
"""Forms that :func:`to_control` can make."""


def signal_names(unit: str, *, mobility: bool) -> tuple[str, str]:
    """Names of input and output of a mobility or an impedance, with units."""
    force, velocity = ("force_n", "velocity_m_per_s") if unit == "N s/m" else ("across", "through")
    if unit == "ohm":
        force, velocity = "voltage_v", "current_a"
    return (force, velocity) if mobility else (velocity, force)


def transfer_function(network: Network, values: Mapping[str, float], *, mobility: bool = False) -> TransferFunction:
    """Coefficients as in appendix A, leading one of the denominator 1.

    Parameters
    ----------
    network : Network
    values : mapping of str to float
        Of the elements in their units.
    mobility : bool
        1/z in place of z.
    """
    z = network.transfer_function(values)
    return _trimmed(z.reciprocal() if mobility else z).normalised()


def matrices(proper: Realisation) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices A, B, C, D of a one-port that does not grow with s: shapes (U, n, n), (U, n), (U, n), (U,)."""
    a, b, c = proper.a, proper.b, proper.c
    if proper.low < 0:
        root = np.sqrt(proper.k)[:, None]
        a = np.pad(a, ((0, 0), (1, 0), (1, 0)))
        b, c = np.concatenate([root, b], axis=1), np.concatenate([root, c], axis=1)
    return a, b, c, proper.d


def described(users: Users, made: Equivalent | None = None) -> dict[str, Any]:
    """All users' transfer functions, ready for JSON; complex numbers are pairs [re, im].

    Parameters
    ----------
    users : Users
    made : Equivalent, optional
        The same users as masses, compliances and dampers, if it is known already. If they are not exactly the users,
        the coefficients are left out where doubles cannot hold those of a passive function: the polynomials of a ladder
        have high degrees, its poles and states lose nothing.
    """
    made = equivalent(users) if made is None else made
    plain = made.users
    impedance = realise(plain.network, plain.values)
    zeros, poles, gain = zeros_and_poles(impedance)
    is_mobility = impedance.high >= 0
    parts = matrices(impedance.reciprocal() if is_mobility else impedance)
    with_coefficients = not made.replaced or impedance.order <= _HIGHEST_DEGREE
    entries = []
    for i, name in enumerate(users.names):
        entry: dict[str, Any] = {"name": name}
        if with_coefficients:
            z = transfer_function(plain.network, plain.of(i))
            entry |= {"numerator": [float(c) for c in z.numerator], "denominator": [float(c) for c in z.denominator]}
        entry |= {
            "zeros": [[float(x.real), float(x.imag)] for x in zeros[i]],
            "poles": [[float(x.real), float(x.imag)] for x in poles[i]],
            "gain": float(gain[i]),
        }
        a, b, c, d = (part[i].tolist() for part in parts)
        entry["state_space"] = {"A": a, "B": [[x] for x in b], "C": [c], "D": [[d]]}
        entries.append(entry)
    table: dict[str, Any] = {
        "schema": SCHEMA,
        "network": str(users.network),
        "unit": users.unit,
        "quantity": "z = F/v, coefficients and state space in descending powers of s, s in rad/s",
        "state_space_of": "mobility v/F" if is_mobility else "impedance F/v",
    }
    if plain is not users:
        table["equivalent_network"] = str(plain.network)
        table["relative_error"] = made.error
        table["band_hz"] = users.band_hz
    return table | {"users": entries}


def tabulated(users: Users, frequency_hz: np.ndarray, why: str) -> dict[str, Any]:
    """Impedances over frequency, ready for JSON, of users who have no finite state space.

    Parameters
    ----------
    users : Users
    frequency_hz : ndarray, shape (F,)
    why : str
        Why they have none.
    """
    z = users.impedance(frequency_hz)
    return {
        "schema": SCHEMA,
        "network": str(users.network),
        "unit": users.unit,
        "quantity": "z = F/v at frequencies",
        "why_no_state_space": why,
        "frequency_hz": frequency_hz.tolist(),
        "users": [
            {"name": name, "re": own.real.tolist(), "im": own.imag.tolist()}
            for name, own in zip(users.names, z, strict=True)
        ],
    }


def written(users: Users, rows: range, made: Equivalent | None = None) -> str:
    """Transfer functions as readable text.

    Parameters
    ----------
    users : Users
    rows : range
        Which of them.
    made : Equivalent, optional
        As for :func:`described`.
    """
    made = equivalent(users) if made is None else made
    plain = made.users
    impedance = realise(plain.network, plain.values)
    zeros, poles, gain = zeros_and_poles(impedance)
    inverse = "admittance I/V" if users.unit == ELECTRICAL_UNIT else "mobility v/F"
    head = f"impedance z(s) = {ratio_of(users.unit)} in {users.unit}, s in rad/s; {inverse} = 1/z"
    blocks = [head, f"network {users.network}"]
    for i in rows:
        lines = [f"{users.names[i]}: {parameters_of(users, i)}"]
        if not made.replaced or impedance.order <= _HIGHEST_DEGREE:
            z = transfer_function(plain.network, plain.of(i))
            lines += [
                f"  numerator    {_polynomial(z.numerator)}",
                f"  denominator  {_polynomial(z.denominator)}",
            ]
        lines += [
            f"  zeros (rad/s)  {_roots(zeros[i])}",
            f"  poles (rad/s)  {_roots(poles[i])}",
            f"  gain           {gain[i]:.8g}",
        ]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def parameters_of(users: Users, row: int) -> str:
    """One user's parameters as text."""
    return ", ".join(f"{e} = {v:.4g} {users.units[e]}".rstrip() for e, v in users.of(row).items())


def to_control(
    network: Network,
    values: Mapping[str, float],
    form: str = "state_space",
    *,
    mobility: bool = True,
    unit: str = "N s/m",
) -> Any:
    """One user as a python-control object.

    Parameters
    ----------
    network : Network
    values : mapping of str to float
        Of the elements in their units.
    form : str
        ``transfer``, ``zeros_poles`` (a TransferFunction, made from zeros and poles) or ``state_space``.
    mobility : bool
        v/F or F/v.
    unit : str
        Of the impedance: it names the signals, such as ``force_n`` and ``velocity_m_per_s``.

    Raises
    ------
    InputError
        If python-control is not installed, or the requested function has no state space.
    """
    control = _control()
    if form not in FORMS:
        raise InputError(f"form is '{form}': choose {', '.join(FORMS)}")
    named = dict(zip(("inputs", "outputs"), signal_names(unit, mobility=mobility), strict=True))
    if form == "transfer":
        function = transfer_function(network, values, mobility=mobility)
        return control.TransferFunction(function.numerator, function.denominator, **named)
    impedance = realise(network, values)
    if form == "zeros_poles":
        zeros, poles, gain = (x[0] for x in zeros_and_poles(impedance))
        return control.zpk(*((poles, zeros, 1 / gain) if mobility else (zeros, poles, gain)), **named)
    wanted = impedance.reciprocal() if mobility else impedance
    if wanted.high > 0:
        raise InputError("this function grows without bound with s and has no state space: ask for its reciprocal")
    a, b, c, d = matrices(wanted)
    return control.StateSpace(a[0], b[0][:, None], c[0][None], [[d[0]]], **named)


def read_control(file: str | os.PathLike[str]) -> dict[str, Any]:
    """Exported transfer functions as python-control objects.

    Parameters
    ----------
    file : path
        ``transfer.json``.

    Returns
    -------
    dict of str to StateSpace
        By the users' names; names of input and output say whether they are of the mobility or of the impedance. Users
        without a finite state space are FrequencyResponseData of the impedance, omega in rad/s.

    Raises
    ------
    InputError
        If the file has another format, or python-control is not installed.
    """
    control = _control()
    file = Path(file)
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        if "frequency_hz" in table:
            omega = 2 * np.pi * np.array(table["frequency_hz"], dtype=float)
            return {
                str(entry["name"]): control.FrequencyResponseData(
                    np.array(entry["re"]) + 1j * np.array(entry["im"]), omega, **_named(table, str(entry["name"]))
                )
                for entry in table["users"]
            }
        return {
            str(entry["name"]): control.StateSpace(
                *(entry["state_space"][key] for key in "ABCD"), **_named(table, str(entry["name"]))
            )
            for entry in table["users"]
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: contains no transfer functions ({error}); give an exported transfer.json") from None


def _named(table: Mapping[str, Any], user: str) -> dict[str, str]:
    """Names of a system and its signals."""
    mobility = str(table.get("state_space_of", "")).startswith("mobility")
    given, answer = signal_names(str(table["unit"]), mobility=mobility)
    return {"name": user, "inputs": given, "outputs": answer}


def _control() -> Any:
    try:
        import control
    except ImportError:
        raise InputError("python-control is not installed: pip install 'bayes_impedance[design]'") from None
    return control


def _trimmed(function: TransferFunction) -> TransferFunction:
    """The function without leading coefficients that are zero because of the network's structure."""

    def cut(polynomial: tuple[Any, ...]) -> tuple[Any, ...]:
        end = max(i for i, c in enumerate(polynomial) if c != 0) + 1
        return polynomial[:end]

    numerator, denominator = function.ascending
    return TransferFunction((cut(numerator), cut(denominator)))


def _polynomial(coefficients: np.ndarray) -> str:
    degree = coefficients.size - 1
    terms = []
    for i, c in enumerate(coefficients):
        power = degree - i
        if c != 0:
            unit = "" if power == 0 else "s" if power == 1 else f"s^{power}"
            terms.append(unit if c == 1 and unit else f"{c:.10g} {unit}".rstrip())
    return " + ".join(terms)


def _roots(roots: np.ndarray) -> str:
    shown = [r for r in roots if r.imag >= 0]
    parts = [f"{r.real:.8g}" if abs(r.imag) <= 1e-12 * abs(r) else f"{r.real:.8g} ± {r.imag:.8g}j" for r in shown]
    return ", ".join(parts) or "none"
