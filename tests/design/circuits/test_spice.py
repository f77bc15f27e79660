"""Circuits: operations as elements, ladders, and ngspice against the package's own arithmetic."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import networks_with_elements, repeatable

from bayes_impedance.classical import check_passivity
from bayes_impedance.design.circuits import spice
from bayes_impedance.design.circuits.ladders import FILTERS, built, power_law
from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.operations import Operation
from bayes_impedance.population.fingertip import FINGERTIP

BAND = (5.0, 5000.0)
FREQUENCY = np.geomspace(*BAND, 120)
PAPER = parse(PAPER_NETWORK)
LOGS = {e: float(np.log(FINGERTIP.central[e])) for e in PAPER.elements}

needs_ngspice = pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")

# Name, constants and parameters u, as the catalogue uses them.
EXACT = (
    ("add", (1e-4, 1.0), (1.0,)),
    ("add", (1e-4, 1.0), (-1.0,)),
    ("add", (1.0, 0.0), (0.5,)),
    ("add", (100.0, -1.0), (2.0,)),
    ("relaxation", (1.0, 0.0, 1.0), (1.0, -5.0)),
    ("resonator", (1.0, 0.0, 1.0), (-6.0, 6.0, -2.0)),
    ("bypass", (1.0, 300.0), (2.0, 1.5)),
    ("series_compliance", (1e-6,), (1.0,)),
    ("series_layer", (1e-6,), (1.0, -8.0)),
)
RATIONAL = (
    *EXACT,
    ("highpass", (10.0,), (3.0,)),
    ("highpass", (10.0,), (-3.0,)),
    ("lowpass", (1e-5,), (3.0,)),
    ("lowpass", (1e-5,), (-3.0,)),
)


def operation(name, constants, u, path=()):
    names = tuple(f"u{i}" for i in range(len(u)))
    return Operation(name, path, names, constants), dict(zip(names, u, strict=True))


def by_kernel(network, operations, parameters, frequency):
    kernel = Kernel(network, operations)
    return kernel.impedance([parameters[name] for name in kernel.elements], frequency)


def ngspice(deck: str, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) and voltages (F, N) that a deck writes to out.txt."""
    (folder / "deck.cir").write_text(deck, encoding="utf-8")
    done = subprocess.run(["ngspice", "-b", "deck.cir"], cwd=folder, capture_output=True, text=True, check=False)
    assert (folder / "out.txt").is_file(), done.stdout + done.stderr
    table = np.loadtxt(folder / "out.txt", ndmin=2)
    (folder / "out.txt").unlink()
    return table[:, 0], table[:, 1::2] + 1j * table[:, 2::2]


def simulated(network, values, analogy, folder, *, filters=(), parameters=None):
    """Frequencies and impedance of a sub-circuit."""
    circuit = spice.subcircuit("one", network, values, analogy, filters=filters, parameters=parameters)
    drive = ["* V/I of one sub-circuit", spice.OPTIONS, circuit, "I1 0 port AC 1", "X1 port 0 one", ".control"]
    drive += ["set numdgt=15", "set wr_singlescale", f"ac dec 20 {BAND[0]:.17g} {BAND[1]:.17g}"]
    drive += ["wrdata out.txt v(port)", "quit", ".endc", ".end"]
    frequency, voltage = ngspice("\n".join(drive) + "\n", folder)
    return frequency, voltage[:, 0] if analogy == "fv" else 1 / voltage[:, 0]


# -------------------------------------------------------------------- operations as elements


@pytest.mark.parametrize("form", EXACT, ids=lambda f: f"{f[0]} {f[2][0]:+g}")
@pytest.mark.parametrize("place", PAPER.places(), ids=lambda p: p.name)
def test_operations_are_elements_at_every_place(form, place) -> None:
    added, u = operation(*form, path=place.path)
    result = built(PAPER, [added], LOGS | u)
    assert result.error == 0
    z = result.network.impedance(2j * np.pi * FREQUENCY, result.values)
    np.testing.assert_allclose(z, by_kernel(PAPER, [added], LOGS | u, FREQUENCY), rtol=1e-12)


def test_several_operations_keep_their_places_and_order() -> None:
    first, u = operation("series_compliance", (1e-6,), (1.0,))
    parameters, operations = dict(LOGS), []
    for i, (form, path) in enumerate(((EXACT[4], (1,)), (EXACT[5], (0,)), (EXACT[7], ()), (EXACT[6], ()))):
        one, own = operation(*form, path=path)
        names = tuple(f"{name}_{i}" for name in one.parameters)
        operations.append(Operation(one.name, path, names, one.constants))
        parameters |= dict(zip(names, own.values(), strict=True))
    result = built(PAPER, operations, parameters)
    z = result.network.impedance(2j * np.pi * FREQUENCY, result.values)
    np.testing.assert_allclose(z, by_kernel(PAPER, operations, parameters, FREQUENCY), rtol=1e-12)
    with pytest.raises(InputError, match="has no value"):
        built(PAPER, [first], LOGS)
    assert u


@pytest.mark.parametrize("beta", [0.02, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_power_law_is_a_passive_ladder_of_the_stated_accuracy(beta: float, accuracy: float) -> None:
    network, values = power_law(3.0, beta, BAND, accuracy)
    assert all(v > 0 for v in values.values())
    s = 2j * np.pi * FREQUENCY
    z = network.impedance(s, values)
    assert np.max(np.abs(z / (3.0 * s**-beta) - 1)) < accuracy
    far = realise(network, values)(2j * np.pi * np.geomspace(1e-6, 1e9, 60))[0]
    assert np.all(far.real > 0)


def test_ladders_in_a_network_state_their_error() -> None:
    for form, path, accuracy in (
        (("beside_power", (1.0, 500.0, 0.0), (1.0, 0.3)), (1,), 1e-4),
        (("power", (1.0, 500.0, 0.0), (0.1,)), (0, 0), 1e-4),
        (("line", (1e-3, 0.0, 0.0), (1.0,)), (0,), 1e-4),
    ):
        added, u = operation(*form, path=path)
        result = built(PAPER, [added], LOGS | u, accuracy=accuracy)
        z = result.network.impedance(2j * np.pi * FREQUENCY, result.values)
        error = np.max(np.abs(z / by_kernel(PAPER, [added], LOGS | u, FREQUENCY) - 1))
        assert 0 < error < accuracy
        assert error == pytest.approx(result.error, rel=0.05)
        assert all(v > 0 for v in result.values.values())


def test_a_small_ladder_is_positive_real_over_the_whole_axis() -> None:
    network, values = power_law(3.0, 0.4, (50.0, 500.0), 0.2)
    assert check_passivity(network.transfer_function(values)).positive_real


def test_what_is_no_network_is_refused() -> None:
    for form, message in (
        (("delay", (1e-6,), (1.0,)), "cannot be realised"),
        (("hysteresis", (1.0,), (0.1,)), "cannot be realised"),
        (("power", (1.0, 500.0, 0.0), (0.1,)), "place of a spring"),
        (("line", (1e-3, 0.0, 0.0), (-1.0,)), "negative mass"),
    ):
        added, u = operation(*form)
        with pytest.raises(InputError, match=message):
            built(PAPER, [added], LOGS | u)
    added, u = operation("power", (1.0, 500.0, 0.0), (-0.1,), path=(0, 0))
    with pytest.raises(InputError, match="is not passive"):
        built(PAPER, [added], LOGS | u)
    added, u = operation("lowpass", (1e-5,), (3.0,), path=(0,))
    with pytest.raises(InputError, match="only at the port"):
        built(PAPER, [added], LOGS | u)


# -------------------------------------------------------------------- circuits


def test_masses_end_at_ground_in_the_drawing_that_looks_like_the_mechanics() -> None:
    text = spice.subcircuit("finger", PAPER, FINGERTIP.central, "fc")
    masses = [line.split() for line in text.splitlines() if line.startswith("C_m")]
    assert len(masses) == 2
    assert {line[2] for line in masses} == {"q"}
    with pytest.raises(InputError, match="analogy is "):
        spice.subcircuit("finger", PAPER, FINGERTIP.central, "mobility")
    with pytest.raises(InputError, match="has no value"):
        spice.subcircuit("finger", PAPER, {"n3": 1.0}, "fv")


def test_names_that_differ_in_case_stay_apart() -> None:
    text = spice.subcircuit("two", parse("rA|ra|ra_|r"), {"rA": 1.0, "ra": 2.0, "ra_": 3.0, "r": 4.0}, "fv")
    names = [part.split("=")[0] for part in text.splitlines()[0].split("params:")[1].split()]
    assert len({name.lower() for name in names}) == 4


@st.composite
def circuits(draw):
    """A network whose elements matter in the band, and a rational effect somewhere or none."""
    network, theta = draw(networks_with_elements(8))
    # One decade around the value whose impedance is 1 in the middle of the band; circuit simulators add admittances,
    # and lose what is a billion times smaller than its neighbour.
    scale = np.array([np.log(kind_of(e).value_at(1.0, np.sqrt(BAND[0] * BAND[1]))) for e in network.elements])
    parameters = dict(zip(network.elements, scale + theta, strict=True))
    operations = []
    if draw(st.booleans()):
        name, constants, u = draw(st.sampled_from(RATIONAL))
        path = () if name in FILTERS else draw(st.sampled_from([p.path for p in network.places()]))
        # Coefficients about as large as an impedance of 1, whatever the catalogue's unit.
        sizes = {"add": {1.0: 1e-3, 0.0: 1.0, -1.0: 1e3}.get(constants[1] if len(constants) > 1 else 0.0)}
        first = sizes.get(name) or {"series_compliance": 1e-3, "series_layer": 1e-3, "bypass": 1.0}.get(
            name, constants[0]
        )
        u = (abs(u[0]), *u[1:]) if name == "add" else u
        u = (-7.0, *u[1:]) if name == "resonator" else u
        added, own = operation(name, (first, *constants[1:]), u, path)
        parameters |= own
        operations.append(added)
    return network, operations, parameters


@needs_ngspice
@settings(repeatable, max_examples=40)
@given(drawn=circuits())
def test_ngspice_reproduces_magnitude_and_phase(drawn, tmp_path_factory: pytest.TempPathFactory) -> None:
    network, operations, parameters = drawn
    folder = tmp_path_factory.mktemp("spice")
    result = built(network, operations, parameters)
    for analogy in spice.ANALOGIES:
        frequency, z = simulated(
            result.network, result.values, analogy, folder, filters=result.filters, parameters=parameters
        )
        assert (frequency[0], frequency[-1]) == pytest.approx(BAND, rel=1e-3)
        wanted = by_kernel(network, operations, parameters, frequency)
        np.testing.assert_allclose(np.abs(z), np.abs(wanted), rtol=1e-8)
        np.testing.assert_allclose(np.angle(z / wanted), 0.0, atol=1e-8)


@needs_ngspice
@pytest.mark.parametrize("form", RATIONAL, ids=lambda f: f"{f[0]} {f[2][0]:+g}")
def test_ngspice_reproduces_the_catalogue_on_a_fingertip(form, tmp_path: Path) -> None:
    added, u = operation(*form)
    result = built(PAPER, [added], LOGS | u)
    for analogy in spice.ANALOGIES:
        frequency, z = simulated(
            result.network, result.values, analogy, tmp_path, filters=result.filters, parameters=LOGS | u
        )
        np.testing.assert_allclose(z, by_kernel(PAPER, [added], LOGS | u, frequency), rtol=1e-10)


@needs_ngspice
def test_ngspice_runs_every_user_and_draws_its_own(tmp_path: Path) -> None:
    network = parse("(n1|r1)-m1")
    mu = np.log([1e-3, 2.0, 1e-3])
    factor = np.array([[0.3, 0, 0], [-0.24, 0.18, 0], [0, 0, 0.2]])  # correlation of n1 and r1: -0.8
    population = UserPopulation(
        network=network,
        unit="N s/m",
        mu=np.tile(mu, (4, 1)),
        factor=np.tile(factor, (4, 1, 1)),
        between_repetitions=np.zeros((4, 3)),
    )
    users = population.draw(6, seed=3)
    (tmp_path / "users.lib").write_text(spice.library(users), encoding="utf-8")
    frequency, z = ngspice(spice.sweep(users, "users.lib", BAND, "out.txt", points=5), tmp_path)
    np.testing.assert_allclose(z.T, users.impedance(frequency), rtol=1e-10)

    # Without a seed ngspice draws by the clock. With 900 users 0.02 is 4.7 standard errors of the largest variance.
    number = 900
    lines = ["* Monte Carlo", f"{spice.OPTIONS} seed=3", spice.monte_carlo(population)]
    for i in range(number):
        lines += [f"I{i} 0 z{i} AC 1", f"X{i} z{i} 0 any_user_fv"]
    shown = " ".join(f"v(z{i})" for i in range(number))
    lines += [".control", "set numdgt=15", "set wr_singlescale", "ac lin 3 5 500", f"wrdata out.txt {shown}", "quit"]
    frequency, z = ngspice("\n".join([*lines, ".endc", ".end"]) + "\n", tmp_path)
    # From 1/z = 1/(s m) + s n/(1 + s n r) at two frequencies: n r and n, whose logarithms correlate as drawn.
    kernel_users = Users(network, "N s/m", tuple(map(str, range(number))), _solved(frequency[:2], z[:2].T))
    drawn = np.cov(kernel_users.u.T)
    np.testing.assert_allclose(drawn, factor @ factor.T, atol=0.02)
    np.testing.assert_allclose(kernel_users.u.mean(axis=0), mu, atol=0.06)


def _solved(frequency: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Log elements of (n1|r1)-m1 from z at two frequencies: the real part of 1/z has only n and r."""
    s = 2 * np.pi * frequency
    real = (1 / z).real
    # Re = s^2 n^2 r/(1 + s^2 n^2 r^2): 1/Re = 1/(s^2 n^2 r) + r is linear in 1/s^2.
    slope = (1 / real[:, 0] - 1 / real[:, 1]) / (1 / s[0] ** 2 - 1 / s[1] ** 2)
    r = 1 / real[:, 1] - slope / s[1] ** 2
    n = 1 / np.sqrt(slope * r)
    rest = (1 / z[:, 0]).imag - (1j * s[0] * n / (1 + 1j * s[0] * n * r)).imag
    return np.log(np.stack([n, r, -1 / (s[0] * rest)], axis=1))
