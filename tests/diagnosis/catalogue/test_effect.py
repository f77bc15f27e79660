"""Effects and their catalogue, models with effects added, and how the port feels a change anywhere."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from experiments import Experiment, Serial, entry, toy
from hypothesis import given
from hypothesis import strategies as st
from strategies import network_impedance, networks, networks_with_elements, repeatable

from bayes_impedance.diagnosis.catalogue.effect import (
    ADDING,
    Coefficient,
    Effect,
    Scales,
    direction,
    line_mass,
    register,
    registered,
    shape_grid,
    unregister,
)
from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.model import Addition, Model, build, inner_places, scales_of
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.residuals.sensitivity import INSIDE, local_impedances
from bayes_impedance.diagnosis.selection.compare import finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import try_shortlist
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, Element, Network, Parallel, Place, Series, parse
from bayes_impedance.network.operations import Operation
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.units import unit_of

NETWORK = parse(PAPER_NETWORK)
FREQUENCY = np.geomspace(5, 5000, 31)
OMEGA = 2 * np.pi * FREQUENCY
S = 1j * OMEGA
CENTRE = np.log([6.76e-7, 61.4, 7.9e-4, 1.52, 1.15e-3, 0.0517, 4.73e-3, 3.82])
THETA = CENTRE + 0.3 * np.random.default_rng(1).normal(size=(3, 8))
"""Three recordings."""

_SIZES = np.abs(Kernel(NETWORK).impedance(CENTRE, FREQUENCY))[[0, 15, 30]]
SCALES = Scales(
    low=OMEGA[0], middle=OMEGA[15], high=OMEGA[30], z_low=_SIZES[0], z_middle=_SIZES[1], z_high=_SIZES[2], unit="N s/m"
)

IDS = (
    "rig.mass",
    "rig.damping",
    "rig.stiffness",
    "rig.delay",
    "rig.highpass",
    "rig.lowpass",
    "rig.series_compliance",
    "rig.resonance",
    "rig.mains",
    "body.springpot",
    "body.hysteresis",
    "body.relaxation",
    "body.resonator",
    "body.mass",
    "body.line",
    "body.bypass",
    "body.reflex",
    "body.covariate",
    "body.subgroup",
    "body.drift",
    "body.correlation",
)
"""What a diagnosis may name; these ids are stable."""

NAIL = Effect(
    id="body.nail",
    name="nail",
    side="body",
    pooling="varying",
    branch="m-(n|r)",
    connection="beside",
    places=("port", "groups", "elements"),
    formula="z + 1/(1/(s m) + 1/(r + 1/(s n)))",
    story="The nail rides on its bed. It stays behind at high frequencies.",
    look_for="a bump at the resonance",
    separates="a recording with the nail clamped",
    source="ours",
)
PAD = replace(NAIL, id="body.pad", name="pad", branch="r|m", connection="series", formula="1/(1/z + 1/(r + s m))")
CABLE = replace(NAIL, id="rig.cable", name="cable", side="rig", pooling="shared", branch="n-r", places=("port",))
FOOT = replace(CABLE, id="rig.foot", name="foot", branch="n|r", connection="series")
BRANCHES = (NAIL, PAD, CABLE, FOOT)


@pytest.fixture
def added() -> Iterator[Callable[[Effect], Effect]]:
    """Registers effects for the time of a test."""
    effects: list[Effect] = []

    def add(effect: Effect) -> Effect:
        effects.append(effect)
        return register(effect)

    yield add
    for effect in effects:
        unregister(effect)


def entries() -> list[object]:
    return [*registered(), *STRUCTURES.values()]


def own_name(entry: object) -> str:
    return f"{entry.id} {getattr(entry, 'operation', 'structure')}"  # type: ignore[attr-defined]


# The catalogue


def test_every_row_of_the_table_has_an_entry() -> None:
    assert {effect.id for effect in registered()} | set(STRUCTURES) == set(IDS)
    assert len(IDS) == 21
    assert all(key == entry.id for key, entry in STRUCTURES.items())


@pytest.mark.parametrize("entry", entries(), ids=own_name)
def test_every_entry_tells_its_story(entry: Effect) -> None:
    for text in (entry.name, entry.formula, entry.look_for, entry.separates, entry.source):
        assert text.strip() == text
        assert len(text) > 2
    sentences = re.findall(r"[A-Z][^.!?]*(?:\.\d[^.!?]*)*[.!?](?=\s|$)", entry.story)
    assert len(sentences) == 2, entry.story
    assert " ".join(sentences) == entry.story
    assert entry.side == entry.id.split(".")[0]
    assert entry.pooling in ("shared", "varying", "some")


@pytest.mark.parametrize("effect", registered(), ids=own_name)
def test_every_coefficient_has_a_unit(effect: Effect) -> None:
    dimensionless = {"exponent", "loss_factor", "damping_ratio", "change", "time_law"}
    for coefficient in effect.coefficients:
        assert (unit_of(coefficient.unit, "N s/m") == "") == (coefficient.name in dimensionless)
    names = [coefficient.name for coefficient in effect.coefficients]
    assert len(set(names)) == len(names)
    if effect.branch:  # the same thing as elements
        assert Kernel(parse(effect.branch)).elements


def test_rig_effects_are_shared_at_the_port() -> None:
    for effect in registered():
        if effect.side == "rig":
            assert effect.places == ("port",)
            assert effect.pooling == "shared"
        else:
            assert effect.pooling != "shared"


def test_registering_and_taking_out(added: Callable[[Effect], Effect]) -> None:
    before = registered()
    assert added(NAIL) is NAIL
    assert registered() == (*before, NAIL)
    renamed = added(replace(NAIL, name="finger nail"))
    assert registered() == (*before, renamed)  # the same id and form: replaced
    other = added(replace(NAIL, connection="series"))
    assert registered() == (*before, renamed, other)  # another form under the same id
    unregister(renamed)
    unregister(renamed)
    assert registered() == (*before, other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"side": "left"}, "side is one of"),
        ({"pooling": "sometimes"}, "pooling of"),
        ({"connection": "across"}, "connection of"),
        ({"places": ("elbow",)}, "places are"),
        ({"branch": ""}, "give an operation or a branch"),
        ({"branch": "", "operation": "wobble", "coefficients": (Coefficient("x", "m"),)}, "operation is one of add, "),
        ({"branch": "", "operation": "add"}, "with its coefficients"),
        ({"branch": "m-"}, "ends too early"),
        ({"branch": "k1"}, "no known kind"),
    ],
)
def test_effects_that_make_no_sense_are_refused(change: Mapping[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        replace(NAIL, **change)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


# Coefficients and shapes


@pytest.mark.parametrize("effect", registered(), ids=own_name)
def test_values_and_unbounded_parameters_are_inverse(effect: Effect) -> None:
    for coefficient in effect.coefficients:
        for value in (0.03, 0.4, 0.9):
            u = coefficient.unbounded(value, SCALES)
            assert float(coefficient.value(u, SCALES)) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("unit", ["m", "r", "c", "k", "n", "s", "Hz", ""])
def test_a_linear_coefficient_of_one_changes_the_impedance_by_itself(unit: str) -> None:
    """Where it acts most, the change is as large as what is there."""
    x = float(Coefficient("x", unit).value(1.0, SCALES))
    change = {
        "m": OMEGA[-1] * x / SCALES.z_high,
        "r": x / SCALES.z_middle,
        "c": x / SCALES.z_middle,
        "k": x / OMEGA[0] / SCALES.z_low,
        "n": SCALES.z_high * OMEGA[-1] * x,
        "s": OMEGA[-1] * x,
        "Hz": x / OMEGA[0],
        "": x,
    }
    assert change[unit] == pytest.approx(1.0)


@pytest.mark.parametrize("effect", [*registered(), *BRANCHES], ids=own_name)
def test_shapes_cover_the_band(effect: Effect) -> None:
    shapes = list(shape_grid(effect, SCALES))
    assert shapes
    assert len({tuple(shape.items()) for shape in shapes}) == len(shapes)
    for coefficient in effect.coefficients[1:] if effect.operation not in ("", "bypass") else ():
        values = sorted({shape[coefficient.name] for shape in shapes})
        assert set(coefficient.values(SCALES)) == set(values)
        if isinstance(coefficient.grid, tuple):
            factor = 2 * np.pi if coefficient.unit == "Hz" else 1.0
            assert values == pytest.approx(sorted(factor * g for g in coefficient.grid))
            continue
        angular = sorted(1 / v for v in values) if coefficient.unit == "s" else values
        assert (angular[0], angular[-1]) == pytest.approx((SCALES.low, SCALES.high))
        assert np.diff(np.log10(angular)).max() <= 1.2 / coefficient.grid  # as many per decade as it says
    if not effect.operation:
        meeting = []
        for shape in shapes:
            assert set(shape) == set(parse(effect.branch).elements)
            # Impedances of masses and springs have magnitude one at a common frequency.
            found = [1 / v for e, v in shape.items() if e[0] != "r"]
            if found:
                np.testing.assert_allclose(found, found[0], rtol=1e-9)
                meeting.append(found[0])
        if meeting and len(parse(effect.branch).elements) > 1:
            assert (min(meeting), max(meeting)) == pytest.approx((SCALES.low, SCALES.high))


# Places


def adding() -> list[Effect]:
    return [e for e in registered() if e.operation in ADDING] + [NAIL, CABLE]


def kinds_of_place(effect: Effect, network: Network) -> list[Place]:
    """Places of the kinds that an effect names, without looking for what is the same."""
    result = []
    for place in network.places():
        node = network.at(place)
        if not place.path:
            kind = {"port"}
        elif isinstance(node, Element):
            kind = {"elements", {"n": "springs", "r": "dampers"}.get(node.name[0], "")}
        else:
            kind = {"groups"}
        if kind & set(effect.places):
            result.append(place)
    return result


def changes(network: Network, theta: np.ndarray, places: Sequence[Place], beside: bool) -> list[np.ndarray]:
    """What a damper beside (or in series with) each place does to the port's impedance."""
    frequency = np.geomspace(0.02, 5, 15)
    name = "add" if beside else "series_layer"  # a layer with a time constant of zero is a spring
    u, letters = ([0.7], ("x",)) if beside else ([0.7, -60.0], ("x", "y"))
    plain = Kernel(network).impedance(theta, frequency)
    kernels = (Kernel(network, [Operation(name, place.path, letters, (1.0, 0.0))]) for place in places)
    return [kernel.impedance([*theta, *u], frequency) - plain for kernel in kernels]


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.abs(a - b).max() < 1e-7 * max(np.abs(a).max(), np.abs(b).max()))


@pytest.mark.parametrize("effect", [*registered(), *BRANCHES], ids=own_name)
def test_sites_of_the_fingertip(effect: Effect) -> None:
    sites = effect.sites(NETWORK)
    assert len({place.path for place in sites}) == len(sites)
    assert len({place.name for place in sites}) == len(sites)
    assert set(sites) <= set(kinds_of_place(effect, NETWORK))
    expected = {
        "body.relaxation": ["port", "skin", "tissue", "n2|r2"],  # beside the limb is beside the tissue
        "body.hysteresis": ["n3", "n1", "n2"],
        "body.line": ["skin", "n3", "tissue", "n1", "limb", "n2|r2", "n2"],
        "rig.delay": ["port"],
        "body.nail": ["port", "skin", "tissue", "m1", "n2|r2"],
        "body.pad": ["port", "n3", "r3", "m2", "r1", "n1", "limb", "n2", "r2"],
    }
    if effect.id in expected:
        assert [place.name for place in sites] == expected[effect.id]


def some_elements(network: Network) -> np.ndarray:
    """No two of them alike, so that places are only alike by the network."""
    return np.random.default_rng(5).uniform(-1, 1, len(network.elements))


@repeatable
@given(networks(), st.sampled_from(adding()))
def test_no_two_sites_are_the_same_and_none_is_lost(network: Network, effect: Effect) -> None:
    theta = some_elements(network)
    sites = effect.sites(network)
    assert len({place.path for place in sites}) == len(sites)
    kept = changes(network, theta, sites, True)
    for a, b in combinations(kept, 2):
        assert not same(a, b)
    others = [p for p in kinds_of_place(effect, network) if p not in sites]
    for change in changes(network, theta, others, True):
        assert any(same(change, k) for k in kept)


@repeatable
@given(networks())
def test_no_two_sites_in_series_are_the_same_and_none_is_lost(network: Network) -> None:
    theta = some_elements(network)
    kept = changes(network, theta, PAD.sites(network), False)
    for a, b in combinations(kept, 2):
        assert not same(a, b)
    others = [p for p in kinds_of_place(PAD, network) if p not in PAD.sites(network)]
    for change in changes(network, theta, others, False):
        assert any(same(change, k) for k in kept)


def test_places_are_not_lost_to_a_group_that_is_not_asked_for() -> None:
    only = replace(NAIL, places=("springs",))
    assert {place.name for place in only.sites(NETWORK)} & {"n3", "skin"}
    assert [place.name for place in only.sites(parse("n1|r1"))]


# Directions


def assert_slope(function: Callable[[float], np.ndarray], slope: np.ndarray, relative: np.ndarray) -> None:
    """Derivative at zero from one side, for what is not smooth there (a filter and its inverse).

    The step changes what stands at the place by no more than 1e-3 of it: `relative` is its change per unit. The error
    is that to the third power, and what is lost to rounding.
    """
    h = 1e-3 / np.abs(relative).max()
    f = [function(k * h) for k in range(4)]
    numeric = (-11 * f[0] + 18 * f[1] - 9 * f[2] + 2 * f[3]) / (6 * h)
    error = np.abs(numeric - slope)
    assert np.all(error <= 1e-6 * np.abs(slope) + 1e-14 * np.abs(f[0]) / h)
    # At most places this is not rounding alone.
    assert np.any(1e-14 * np.abs(f[0]) / h < 1e-3 * np.abs(slope))


def assert_direction(effect: Effect, place: str, shape: dict[str, float], before: Sequence[Addition] = ()) -> None:
    starts = [{"time_constant": 0.01, "frequency": 900.0, "damping_ratio": 0.2} for _ in before]
    small = build(NETWORK, before, SCALES, starts)
    u = np.column_stack([THETA, *(np.full(3, p.start + 0.1 * p.is_coefficient) for p in small.parameters)])
    local = local_impedances(small, u, OMEGA)[INSIDE if effect.side == "body" and place == "port" else place]
    change = direction(effect, shape, SCALES, OMEGA, local.z)
    model = build(NETWORK, [*before, Addition(effect=effect, place=place, pooling="shared")], SCALES, [*starts, shape])
    columns = model.columns(len(before))
    own = np.column_stack([THETA, *(np.full(3, p.start + 0.1 * p.is_coefficient) for p in model.parameters)])
    units = [c.scale(SCALES) for c in effect.coefficients]

    def curve(x: float) -> np.ndarray:
        """x in the operation's unit."""
        u = own.copy()
        u[:, columns[0]] = x / units[0]
        if effect.operation == "bypass":
            u[:, columns[1]] = x * shape["ratio"] / units[1]
        return model.kernel.impedance(u, FREQUENCY)

    np.testing.assert_allclose(curve(0.0), small.kernel.impedance(u, FREQUENCY), rtol=1e-12)
    assert_slope(curve, change * local.adjoint, np.abs(change / local.z) + np.abs(change * local.adjoint / curve(0.0)))


@pytest.mark.parametrize("effect", [e for e in registered() if e.operation != "line"], ids=own_name)
def test_directions_are_the_derivatives_of_the_model(effect: Effect) -> None:
    """At every place and with every shape, by differences of the impedance of the model with the effect in it."""
    sites = effect.sites(NETWORK)
    assert sites
    for place in sites:
        for shape in shape_grid(effect, SCALES):
            assert_direction(effect, place.name, shape)


BEFORE = (
    Addition(effect=entry("body.relaxation"), place="tissue", pooling="varying"),
    Addition(effect=entry("body.hysteresis"), place="n1", pooling="varying"),
    Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
)


@pytest.mark.parametrize("effect", [e for e in registered() if e.operation != "line"], ids=own_name)
def test_directions_behind_other_additions(effect: Effect) -> None:
    for place in effect.sites(NETWORK):
        if effect.side == "body" and place.name == "port":
            continue  # see the next test
        if (effect.id, place.name) in [(a.effect.id, a.place) for a in BEFORE]:
            continue
        shapes = list(shape_grid(effect, SCALES))
        for shape in shapes[:: max(1, len(shapes) // 3)]:
            assert_direction(effect, place.name, shape, BEFORE)


def test_a_body_effect_at_the_port_is_behind_the_rig() -> None:
    assert_direction(entry("body.mass"), "port", {}, BEFORE)


def test_a_line_is_screened_by_its_secant() -> None:
    """From zero to the level; to first order in a small mass that is a third of it beside the place."""
    local = local_impedances(build(NETWORK, (), SCALES, ()), THETA, OMEGA)["tissue"]
    for level in (0.3, 3.0):
        mass = level * line_mass(OMEGA, local.z)
        w = S * mass[:, None] / local.z
        expected = (local.z * np.sqrt(w) / np.tanh(np.sqrt(w)) - local.z) / mass[:, None]
        found = direction(entry("body.line"), {"level": level}, SCALES, OMEGA, local.z)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    tiny = direction(entry("body.line"), {"level": 1e-6}, SCALES, OMEGA, local.z)
    np.testing.assert_allclose(tiny, np.broadcast_to(S / 3, tiny.shape), rtol=1e-5)
    assert line_mass(OMEGA, local.z) == pytest.approx(np.abs(local.z[:, -1]) / OMEGA[-1])


@pytest.mark.parametrize("effect", BRANCHES, ids=own_name)
def test_directions_of_branches(effect: Effect) -> None:
    """A branch as a whole made weak: impedances times x beside, mobilities times x in series."""
    plain = build(NETWORK, (), SCALES, ())
    local = local_impedances(plain, THETA, OMEGA)
    for place in effect.sites(NETWORK):
        for shape in list(shape_grid(effect, SCALES))[::5]:
            model = build(NETWORK, [Addition(effect=effect, place=place.name, pooling="shared")], SCALES, [shape])
            names = model.kernel.elements[8:]
            assert [name[0] for name in names] == [e[0] for e in parse(effect.branch).elements]

            def curve(x: float, model: Model = model, shape: dict[str, float] = shape) -> np.ndarray:
                weak = x if effect.connection == "beside" else 1 / x
                values = [v / weak if e[0] == "n" else v * weak for e, v in shape.items()]
                return model.kernel.impedance(np.column_stack([THETA, np.tile(np.log(values), (3, 1))]), FREQUENCY)

            here = local[place.name]
            change = direction(effect, shape, SCALES, OMEGA, here.z)
            plainly = plain.kernel.impedance(THETA, FREQUENCY)
            size = np.abs(change / here.z) + np.abs(change * here.adjoint / plainly)
            assert_slope(lambda x: curve(x) if x else plainly, change * here.adjoint, size)  # noqa: B023


# Adjoints


def probed(model: Model, u: np.ndarray, path: tuple[int, ...]) -> Callable[[float], np.ndarray]:
    """The port's impedance with a damper beside a place, after all that happens there."""
    kernel = model.kernel
    probe = Operation("add", path, ("probe",), (1.0, 0.0))
    rank = [*kernel.network.elements, *(p for o in kernel.operations for p in o.parameters)]
    order = [kernel.elements.index(name) for name in rank]
    with_probe = Kernel(kernel.network, [*kernel.operations, probe])

    def curve(step: float) -> np.ndarray:
        return with_probe.impedance(np.column_stack([u[:, order], np.full(len(u), step)]), FREQUENCY)

    return curve


MODELS: dict[str, Sequence[Addition]] = {
    "nothing": (),
    "operations": (
        *BEFORE,
        Addition(effect=entry("body.line"), place="n2|r2", pooling="varying"),
        Addition(effect=entry("rig.series_compliance"), place="port", pooling="shared"),
        Addition(effect=entry("body.subgroup"), place="port", pooling="varying"),
    ),
    "branches": (
        Addition(effect=NAIL, place="n3", pooling="varying"),
        Addition(effect=PAD, place="limb", pooling="varying"),
        Addition(effect=FOOT, place="port", pooling="shared"),
    ),
    "both": (
        Addition(effect=NAIL, place="tissue", pooling="varying"),
        *BEFORE,
        Addition(effect=PAD, place="r3", pooling="shared"),
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_adjoints_against_differences(name: str) -> None:
    starts = [{"time_constant": 0.01} for _ in MODELS[name]]
    model = build(NETWORK, MODELS[name], SCALES, starts)
    rng = np.random.default_rng(3)
    own = [np.full(3, p.start) + (0.1 if p.is_coefficient else 0.3) * rng.normal(size=3) for p in model.parameters]
    u = np.column_stack([THETA, *own])
    local = local_impedances(model, u, OMEGA)
    assert set(local) == {place.name for place in NETWORK.places()} | {INSIDE}
    del local[INSIDE]
    paths = inner_places(model)
    for place, here in local.items():
        curve = probed(model, u, paths[place])
        assert_slope(curve, here.adjoint, 1 / np.abs(here.z) + np.abs(here.adjoint / curve(0.0)))
    np.testing.assert_allclose(local["port"].z, model.kernel.impedance(u, FREQUENCY), rtol=1e-10)
    np.testing.assert_array_equal(local["port"].adjoint, 1)


@repeatable
@given(networks_with_elements())
def test_local_impedances_of_any_network(drawn: tuple[Network, np.ndarray]) -> None:
    network, theta = drawn
    local = local_impedances(build(network, (), SCALES, ()), theta[None], 2 * np.pi * FREQUENCY)
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    for place in network.places():
        expected = network_impedance(network.at(place), S, values)
        np.testing.assert_allclose(local[place.name].z[0], expected, rtol=1e-9)


# Models


@repeatable
@given(networks_with_elements())
def test_a_model_without_additions_is_the_network(drawn: tuple[Network, np.ndarray]) -> None:
    network, theta = drawn
    model = build(network, (), SCALES, ())
    assert model.kernel.elements == network.elements
    assert model.n_elements == len(network.elements)
    assert (model.parameters, model.notation) == ((), str(network))
    z, dz = model.kernel.derivative(theta, FREQUENCY)
    expected, slope = Kernel(network).derivative(theta, FREQUENCY)
    np.testing.assert_allclose(z, expected, rtol=1e-11)
    np.testing.assert_allclose(dz, slope, rtol=1e-7, atol=1e-11 * np.abs(expected).max())


def test_the_networks_own_labels_are_respected() -> None:
    """Also one that looks like ours."""
    network = parse("place1:(n3|r3)-(m2|r1)")
    theta = np.log([1e-3, 2.0, 1e-4, 3.0])
    model = build(network, [Addition(effect=entry("body.mass"), place="place1", pooling="shared")], SCALES, [{}])
    z = model.kernel.impedance([*theta, 0.5], FREQUENCY)
    mass = 0.5 * SCALES.z_high / SCALES.high
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    np.testing.assert_allclose(z, network_impedance(network, S, values, (0,), lambda z: z + S * mass), rtol=1e-10)


def test_the_networks_elements_come_first_wherever_branches_are() -> None:
    """Two branches in the middle: their elements come after the network's own, in every array."""
    additions = [
        Addition(effect=NAIL, place="n3", pooling="varying"),
        Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
    ]
    model = build(NETWORK, [*additions, Addition(effect=PAD, place="limb", pooling="shared")], SCALES, [{}, {}, {}])
    grown = NETWORK.beside("n3", parse("m3-(n4|r4)")).in_series("limb", parse("r5|m4"))
    assert model.kernel.elements[:8] == NETWORK.elements
    assert set(model.kernel.elements) == {*grown.elements, "rig.delay.delay.1"}
    assert grown.elements[:8] != NETWORK.elements  # so the order had to be changed
    extra = {"m3": 1e-4, "n4": 1e-3, "r4": 0.3, "r5": 20.0, "m4": 1e-2}
    values = dict(zip(NETWORK.elements, np.exp(CENTRE), strict=True)) | extra
    tau = 2e-6
    u = [np.log(values[name]) if name in values else tau * SCALES.high for name in model.kernel.elements]
    z, dz = model.kernel.derivative(u, FREQUENCY)
    theta = np.log([values[name] for name in grown.elements])
    expected, slope = Kernel(grown).derivative(theta, FREQUENCY)
    late = np.exp(-S * tau)
    np.testing.assert_allclose(z, expected * late, rtol=1e-10)
    for i, name in enumerate(model.kernel.elements):
        due = slope[grown.elements.index(name)] * late if name in values else -S / SCALES.high * z
        np.testing.assert_allclose(dz[i], due, rtol=1e-8, atol=1e-12 * np.abs(z).max())
    assert [p.name for p in model.parameters] == list(model.kernel.elements[8:])
    assert [[model.kernel.elements[c] for c in model.columns(i)] for i in range(3)] == [
        ["m3", "n4", "r4"],
        ["rig.delay.delay.1"],
        ["r5", "m4"],
    ]
    assert model.shared.tolist() == [False] * 11 + [True] * 3


def coefficients(model: Model, values: Sequence[Sequence[float]]) -> np.ndarray:
    """Parameters with every addition's own values in their units: log values of the elements of a branch."""
    u = np.append(CENTRE, np.zeros(len(model.parameters)))
    for i, (addition, own) in enumerate(zip(model.additions, values, strict=True)):
        effect = addition.effect
        if effect.operation:
            u[model.columns(i)] = [c.unbounded(v, SCALES) for c, v in zip(effect.coefficients, own, strict=True)]
        else:
            u[model.columns(i)] = np.log(own)
    return u


ELEMENTS = dict(zip(NETWORK.elements, np.exp(CENTRE), strict=True))


def with_additions(*items: tuple[Effect, str, Sequence[float]]) -> tuple[Model, np.ndarray]:
    """A model, and the impedance of the average fingertip with these additions."""
    additions = [Addition(effect=effect, place=place, pooling="shared") for effect, place, _ in items]
    starts = [{c.name: v for c, v in zip(e.coefficients, own, strict=False)} for e, _, own in items]
    model = build(NETWORK, additions, SCALES, starts)
    return model, model.kernel.impedance(coefficients(model, [own for *_, own in items]), FREQUENCY)


def at(place: str, form: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    return network_impedance(NETWORK, S, ELEMENTS, NETWORK.place(place).path, form)


def branch(r: float, n: float) -> np.ndarray:
    """A damper and a spring in series."""
    return r / (1 + S * r * n)


def test_two_effects_at_one_place() -> None:
    m, r, t = 2e-4, 2.0, 3e-3
    relaxation, mass = (entry("body.relaxation"), "tissue", [r, t]), (entry("body.mass"), "tissue", [m])
    expected = at("tissue", lambda z: z + S * m + branch(r, t / r))
    for items in ((relaxation, mass), (mass, relaxation)):
        np.testing.assert_allclose(with_additions(*items)[1], expected, rtol=1e-10)
    # Those that do not commute are applied in their order: the loss of the spring, then the waves in it.
    loss, waves = (entry("body.hysteresis"), "n1", [0.3]), (entry("body.line"), "n1", [1e-3])

    def line(z: np.ndarray) -> np.ndarray:
        x = np.sqrt(S * 1e-3 / z)
        return z * x / np.tanh(x)

    first, then = with_additions(loss, waves)[1], with_additions(waves, loss)[1]
    np.testing.assert_allclose(first, at("n1", lambda z: line(z * (1 + 0.3j))), rtol=1e-10)
    np.testing.assert_allclose(then, at("n1", lambda z: line(z) * (1 + 0.3j)), rtol=1e-10)
    assert np.abs(first / then - 1).max() > 1e-4
    # A branch and an operation at the same place.
    nail, values = (NAIL, "skin", [1e-4, 1e-3, 0.3]), {"m": 1e-4, "n": 1e-3, "r": 0.3}
    beside = parse(NAIL.branch).impedance(S, values)
    found = with_additions(nail, (entry("body.mass"), "skin", [m]))[1]
    np.testing.assert_allclose(found, at("skin", lambda z: z + S * m + beside), rtol=1e-10)


def test_rig_effects_are_outermost() -> None:
    m, tau, n = 2e-4, 3e-6, 1e-8
    delay, mount = (entry("rig.delay"), "port", [tau]), (entry("rig.series_compliance"), "port", [n])
    tissue, layer = (entry("body.mass"), "port", [m]), (entry("body.subgroup"), "port", [1e-6, 1e-3])
    inside = 1 / (1 / (at("port", lambda z: z) + S * m) + S * 1e-6 / (1 + S * 1e-3))
    expected = 1 / (1 / (inside * np.exp(-S * tau)) + S * n)
    for items in (
        (tissue, layer, delay, mount),
        (delay, tissue, layer, mount),
        (delay, mount, tissue, layer),
        (delay, tissue, mount, layer),
    ):
        np.testing.assert_allclose(with_additions(*items)[1], expected, rtol=1e-10)
    # Among themselves they keep their order.
    other = 1 / (1 / inside + S * n) * np.exp(-S * tau)
    np.testing.assert_allclose(with_additions(tissue, mount, layer, delay)[1], other, rtol=1e-10)
    assert np.abs(other / expected - 1).max() > 1e-6
    # A branch of the rig is outside of a branch of the body, whichever came first.
    foot, nail = (FOOT, "port", [1e-8, 50.0]), (NAIL, "port", [1e-4, 1e-3, 0.3])
    beside = parse(NAIL.branch).impedance(S, {"m": 1e-4, "n": 1e-3, "r": 0.3})
    z = 1 / (1 / at("port", lambda z: z + beside) + 1 / (50.0 + 1 / (S * 1e-8)))
    np.testing.assert_allclose(with_additions(foot, nail)[1], z, rtol=1e-10)
    np.testing.assert_allclose(with_additions(nail, foot)[1], z, rtol=1e-10)


def test_pooling_says_what_is_shared() -> None:
    shape = {"frequency": 900.0, "damping_ratio": 0.2, "ratio": 100.0}
    for pooling, expected in (("shared", [True] * 3), ("varying", [False, True, True]), ("free", [False] * 3)):
        model = build(
            NETWORK,
            [Addition(effect=entry("body.resonator"), place="skin", pooling=pooling, dispersion=0.5)],
            SCALES,
            [shape],
        )
        assert model.shared[8:].tolist() == expected
        assert [p.is_coefficient for p in model.parameters] == [True, False, False]
        assert model.parameters[0].dispersion == 0.5
    both = build(NETWORK, [Addition(effect=entry("body.bypass"), place="port", pooling="varying")], SCALES, [shape])
    assert both.shared[8:].tolist() == [False, False]  # two coefficients, no shape
    own = build(NETWORK, [Addition(effect=NAIL, place="port", pooling="varying")], SCALES, [{}])
    assert own.shared[8:].tolist() == [False] * 3
    assert not any(p.is_coefficient for p in own.parameters)


def test_shapes_are_centred_where_they_were_found() -> None:
    shape = {"frequency": 900.0, "damping_ratio": 0.2}
    model = build(NETWORK, [Addition(effect=entry("body.resonator"), place="skin", pooling="varying")], SCALES, [shape])
    mass, frequency, ratio = model.parameters
    assert (mass.centre, mass.prior_sd) == (0.0, 30.0)
    assert (frequency.centre, ratio.centre) == pytest.approx((np.log(900), np.log(0.2)))
    assert (frequency.prior_sd, ratio.prior_sd) == (0.3, 1.0)
    # The prior of a branch's elements is that of any element: its impedance meets the data's in the middle of the band.
    m, n, r = build(NETWORK, [Addition(effect=NAIL, place="port", pooling="shared")], SCALES, [{"m": 1e-4}]).parameters
    for p in (m, n, r):
        size = kind_of(p.name).impedance(1j * SCALES.middle, np.exp(p.centre))
        assert abs(size) == pytest.approx(SCALES.z_middle)
        assert p.prior_sd == 3.0
    assert (m.start, n.start) == (pytest.approx(np.log(1e-4)), n.centre)


def structural(model: Model, values: Mapping[str, float]) -> np.ndarray:
    network = parse(model.notation)
    return Kernel(network).impedance(np.log([values[name] for name in network.elements]), FREQUENCY)


def test_notation_is_the_network_with_the_additions() -> None:
    m, r, t, n = 2e-4, 2.0, 3e-3, 1e-8
    model, z = with_additions((entry("body.relaxation"), "tissue", [r, t]), (entry("body.mass"), "n3", [m]))
    assert set(parse(model.notation).elements) == {*ELEMENTS, "r4", "n4", "m3"}
    extra = {"r4": r, "n4": t / r, "m3": m}
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)
    # What is not made of elements is left out.
    model, _ = with_additions((entry("rig.delay"), "port", [1e-6]), (entry("body.hysteresis"), "n1", [0.1]))
    assert model.notation == str(NETWORK)
    model, z = with_additions((entry("rig.series_compliance"), "port", [n]))
    np.testing.assert_allclose(structural(model, ELEMENTS | {"n4": n}), z, rtol=1e-10)
    model, z = with_additions((NAIL, "limb", [1e-4, 1e-3, 0.3]), (entry("body.bypass"), "port", [0.5, 300.0]))
    extra = {"m3": 1e-4, "n4": 1e-3, "r4": 0.3, "r5": 0.5, "n5": 1 / 300}
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)


def test_notation_with_two_additions_at_an_unlabelled_group() -> None:
    m, r, t = 2e-4, 2.0, 3e-3
    model, z = with_additions((entry("body.mass"), "n2|r2", [m]), (entry("body.relaxation"), "n2|r2", [r, t]))
    names = parse(model.notation).elements
    extra = dict(zip(["m3", "r4", "n4"], [m, r, t / r], strict=True))
    if set(names) != {*ELEMENTS, *extra}:
        raise KeyError(model.notation)
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)


def test_notation_with_the_rig_outermost() -> None:
    m, n = 2e-4, 1e-8
    model, z = with_additions((entry("rig.series_compliance"), "port", [n]), (entry("body.mass"), "port", [m]))
    np.testing.assert_allclose(structural(model, ELEMENTS | {"n4": n, "m3": m}), z, rtol=1e-10)


def test_places_are_found_again_in_a_grown_network() -> None:
    additions = [
        Addition(effect=NAIL, place="n3", pooling="shared"),
        Addition(effect=PAD, place="limb", pooling="shared"),
        Addition(effect=NAIL, place="port", pooling="shared"),
    ]
    model = build(NETWORK, additions, SCALES, [{}, {}, {}])
    paths, grown = inner_places(model), model.kernel.network
    assert set(paths) == {place.name for place in NETWORK.places()}
    assert paths["port"] == ()
    for name, path in paths.items():
        if name != "port":
            node, own = grown.at(Place(path, name)), NETWORK.at(name)
            assert type(node) is type(own)
            assert set(own.elements) <= set(node.elements)
            if isinstance(node, Parallel | Series):
                assert len(node.elements) < len(grown.elements)


# Typical sizes


def test_scales_are_those_of_the_recordings() -> None:
    """Three people whose curves are 1, 2 and 30 dampers; the median has two."""
    frequency = np.geomspace(2, 200, 21)
    subjects = tuple(
        Subject(
            name=str(r),
            frequency_hz=frequency,
            z=np.full((2, 21), r + 0j),
            repetitions=("1", "2"),
            noise_sd=None,
            covariates={},
        )
        for r in (1.0, 2.0, 30.0)
    )
    scales = scales_of(
        Recordings(
            title="t", unit="ohm", network="r1", source="s", licence="l", subjects=subjects, sha256="", warnings=()
        )
    )
    assert (scales.low, scales.middle, scales.high) == pytest.approx(2 * np.pi * np.array([2, 20, 200]))
    assert (scales.z_low, scales.z_middle, scales.z_high, scales.unit) == (2.0, 2.0, 2.0, "ohm")


# An effect of one's own, from a few lines to an estimate


def hide(effect: Effect, values: Mapping[str, float]) -> Experiment:
    """Twenty people with a branch in series with, or beside, all that they are."""

    def hidden(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = parse(effect.branch).impedance(s, values)
        return (z + own if effect.connection == "beside" else 1 / (1 / z + 1 / own)), np.ones(len(z))

    return toy("n1|r1", {"n1": 1e-3, "r1": 2.0}, seed=21, n=20, hidden=hidden)


OWN = (
    (replace(CABLE, id="rig.own", branch="m-r"), {"m": 3e-3, "r": 0.4}),
    (replace(FOOT, id="rig.own", branch="m|r"), {"m": 3.0, "r": 600.0}),
    (replace(NAIL, id="body.own", branch="m-r", places=("port",)), {"m": 3e-3, "r": 0.4}),
)


@pytest.mark.parametrize(("effect", "values"), OWN, ids=["rig beside", "rig in series", "body beside"])
def test_an_effect_of_ones_own_is_screened_and_refitted(
    added: Callable[[Effect], Effect], effect: Effect, values: dict[str, float]
) -> None:
    added(effect)
    experiment = hide(effect, values)
    refitter, fit = experiment.refitter, experiment.fit()
    residuals = person_residuals(fit, [str(i) for i in range(20)])
    screening = screen(fit, residuals, registered(), 1, Serial())
    mine = [k for k, c in enumerate(screening.candidates) if c.effect is effect]
    assert len(mine) > 3
    strength = np.abs(np.nan_to_num(screening.z))
    assert strength[mine].max() > 0.9 * strength.max()
    assert screening.log_p(strength[mine].max()) < np.log(1e-9)
    only = screen(fit, residuals, [effect], 1, Serial())
    trials = try_shortlist(refitter, fit, only)
    best = finalists(refitter, fit, trials, 1)[0]
    assert best.effect is effect
    assert best.gain > 10
    grown = max((t.fit for t in trials), key=lambda f: float(f.evidence.sum()))
    assert grown.model.kernel.elements[:2] == ("n1", "r1")
    # The elements of the branch are those that were hidden.
    columns = grown.model.columns(0)
    found, sd = grown.u[:, columns].mean(axis=0), coefficient_posterior(grown, 1).central.std(axis=0)
    true = np.log([values[e] for e in parse(effect.branch).elements])
    assert [grown.model.kernel.elements[c][0] for c in columns] == list(parse(effect.branch).elements)
    assert np.all(np.abs(found - true) < 3.5 * sd)
    assert np.all(sd < 0.15)
    again = person_residuals(grown, [str(i) for i in range(20)])
    after = screen(grown, again, [effect, entry("rig.delay"), entry("rig.mass")], 1, Serial())
    assert effect not in [c.effect for c in after.candidates]
    assert np.nanmax(np.abs(after.z)) < 5 < strength.max()
