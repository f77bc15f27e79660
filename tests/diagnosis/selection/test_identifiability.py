"""Names that hold, and names that together stand for something that has none."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from experiments import MASS, TOY, Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.residuals.locate import locate
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection import identifiability
from bayes_impedance.diagnosis.selection.identifiability import felt, names_that_hold
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.diagnosis.selection.unnamed import Realised, stand_in_network, structure_remains
from bayes_impedance.diagnosis.types import OnePort

FREQUENCY = np.geomspace(2, 2000, 25)

PLACES = ("skin:(n2|r2)-tissue:(n1|r1)", {"n2": 1e-4, "r2": 8.0, "n1": 1e-3, "r1": 1.0})
"""A network with more places than the port."""

NAIL = Effect(
    id="body.nail",
    name="nail on its bed",
    side="body",
    pooling="varying",
    places=("port", "groups"),
    branch="m-(n|r)",
    formula="z + 1/(1/(s m) + 1/(r + 1/(s n)))",
    story="The nail rides on its bed. It moves along at low and stays behind at high frequencies.",
    look_for="a bump at its resonance",
    separates="a recording with the nail clamped",
    source="ours",
)
"""What a user registers, as in the README."""

EFFECTS = {
    "power law": entry("body.springpot", "beside_power"),
    "relaxation": entry("body.relaxation"),
    "resonator": entry("body.resonator"),
    "nail": NAIL,
    "mass": entry("body.mass"),
    "hysteresis": entry("body.hysteresis"),
}


def power_law(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return z + 3.0 * (s / 400) ** -0.5


def relaxation(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return z + 1 / (1 / 1.0 + s * 2e-3)


def resonator(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A mass on a spring and a damper, of another size in everybody, with its resonance at 150 Hz."""
    mass = 2e-4 * np.exp(0.3 * rng.normal(size=(len(z), 1, 1)))
    stiffness = mass * (2 * np.pi * 150) ** 2
    damping = 0.4 * np.sqrt(mass * stiffness)
    return z + 1 / (1 / (s * mass) + 1 / (damping + stiffness / s))


def mass(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return z + s * MASS * np.exp(0.3 * rng.normal(size=(len(z), 1, 1)))


def loss(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Part of a stiffness of 1000 N/m that turns into a loss at all rates."""
    return z + 0.2j * 1000.0 / s


HIDDEN = {f.__name__: f for f in (power_law, relaxation, resonator, mass, loss)}


@dataclass(frozen=True, kw_only=True)
class Searched:
    """A search and what it has left.

    Attributes
    ----------
    experiment : Experiment
    found : Found
    residuals : tuple of PersonResiduals
        With what was found.
    remains : bool
        Whether structure remains.
    one_ports : tuple of OnePort
        Before anything was added.
    """

    experiment: Experiment
    found: Found
    residuals: tuple[PersonResiduals, ...]
    remains: bool
    one_ports: tuple[OnePort, ...]

    @property
    def names(self) -> list[tuple[str, str]]:
        return sorted((a.effect.id, a.place) for a in self.found.final.model.additions)

    def held(self, remains: bool | None = None, rest: Realised | None = None) -> tuple[Found, Realised | None]:
        remains = self.remains if remains is None else remains
        with ThreadPoolExecutor(1) as executor:
            return names_that_hold(
                self.experiment.refitter, self.found, rest, remains, self.residuals, self.one_ports, 1, executor
            )


@cache
def searched(hidden: tuple[str, ...], names: tuple[str, ...], many_places: bool = False, n: int = 16) -> Searched:
    def change(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        for name in hidden:
            z = HIDDEN[name](s, z, rng)
        return z, np.zeros(len(z))

    experiment = toy(*(PLACES if many_places else TOY), seed=1, n=n, hidden=change, frequency_hz=FREQUENCY)
    people = [str(i) for i in range(n)]
    effects = [EFFECTS[name] for name in names]
    with ThreadPoolExecutor(1) as executor:
        found = search(experiment.refitter, experiment.fit(), people, effects, 1, executor, lambda *_: None)
    residuals = tuple(person_residuals(found.final, people))
    return Searched(
        experiment=experiment,
        found=found,
        residuals=residuals,
        remains=structure_remains(found, locate(residuals, 1).p_value),
        one_ports=missing_one_ports(found.base, found.steps[0].residuals),
    )


def assert_kept(result: Searched, held: tuple[Found, Realised | None]) -> None:
    assert held[0] is result.found
    assert held[1] is None


def assert_taken_back(result: Searched, held: tuple[Found, Realised | None]) -> None:
    """No name is left, and what was found stands in for what has none: it gains on people who were held out."""
    found, unknown = held
    assert found.base is found.final is result.found.base
    assert not found.final.model.additions
    assert found.steps == result.found.steps[:1]
    assert unknown is not None
    assert unknown.trial.fit is result.found.final
    assert unknown.gain_se is not None
    assert unknown.gain > 3 * unknown.gain_se > 0


# One name


@pytest.mark.parametrize("remains", [False, True])
@pytest.mark.parametrize("hidden", ["relaxation", "resonator"])
def test_a_single_right_name_stays_even_if_structure_remains(hidden: str, remains: bool) -> None:
    result = searched((hidden,), (hidden,))
    assert result.names == [(f"body.{hidden}", "port")]
    assert not result.remains
    assert_kept(result, result.held(remains))


def test_a_single_name_of_a_user_stays() -> None:
    result = searched(("resonator",), ("nail",))
    assert result.names == [("body.nail", "port")]
    assert_kept(result, result.held())


# Terms of a sum


def test_two_relaxations_that_stand_for_a_power_law_are_taken_back_if_structure_remains() -> None:
    result = searched(("power_law",), ("relaxation",), many_places=True)
    assert [name for name, _ in result.names] == ["body.relaxation"] * 2
    assert result.remains
    assert_taken_back(result, result.held())


def test_two_relaxations_stay_if_they_leave_nothing() -> None:
    """What is left is said to be noise."""
    result = searched(("power_law",), ("relaxation",), many_places=True)
    assert_kept(result, result.held(remains=False))


# Two names for one thing


@pytest.mark.parametrize(
    ("hidden", "names"),
    [
        (("relaxation", "power_law"), ("relaxation", "power law")),
        (("resonator", "relaxation"), ("resonator", "relaxation")),
        (("resonator", "relaxation"), ("nail", "relaxation")),
    ],
    ids=["catalogue, smooth", "catalogue, resonant", "user's own"],
)
def test_two_names_at_one_place_in_one_band_are_taken_back(hidden: Sequence[str], names: Sequence[str]) -> None:
    result = searched(tuple(hidden), tuple(names))
    assert len({name for name, _ in result.names}) == 2
    assert {place for _, place in result.names} == {"port"}
    assert not result.remains
    assert_taken_back(result, result.held())


@pytest.mark.parametrize("remains", [False, True])
def test_names_at_different_places_in_different_bands_stay(remains: bool) -> None:
    """A mass acts at high frequencies on the port, a loss of the spring at low ones inside."""
    result = searched(("mass", "loss"), ("mass", "hysteresis"))
    assert result.names == [("body.hysteresis", "n1"), ("body.mass", "port")]
    assert_kept(result, result.held(remains))


def test_as_many_names_as_are_looked_for_are_taken_back_if_structure_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    result = searched(("mass", "loss"), ("mass", "hysteresis"))
    monkeypatch.setattr(identifiability, "MOST_ADDITIONS", 2)
    assert_taken_back(result, result.held(remains=True))
    assert_kept(result, result.held(remains=False))


@pytest.mark.parametrize("remains", [False, True])
def test_two_names_at_one_place_in_different_bands_stay(remains: bool) -> None:
    """Tissue that moves along is felt at high frequencies, a power law beside it at lower ones."""
    result = searched(("mass", "power_law"), ("mass", "power law"))
    assert result.names == [("body.mass", "port"), ("body.springpot", "port")]
    assert_kept(result, result.held(remains))


def test_too_few_people_take_no_name_back() -> None:
    """Of nine people nobody can be held out."""
    result = searched(("power_law",), ("relaxation",), many_places=True)
    refitter, few = result.experiment.refitter, range(9)
    with ThreadPoolExecutor(1) as executor:
        held = names_that_hold(
            refitter.subset(few), result.found, None, True, result.residuals, result.one_ports, 1, executor
        )
    assert_kept(result, held)


# A network that does more than the names


def test_a_network_that_does_more_than_the_names_takes_their_place() -> None:
    """One relaxation explains a part of a power law, and a sum of two in one branch explains more than that."""
    result = searched(("power_law",), ("relaxation",), n=12)
    assert result.names == [("body.relaxation", "port")]
    assert result.remains
    with ThreadPoolExecutor(1) as executor:
        refitter, final = result.experiment.refitter, result.found.final
        ports = missing_one_ports(final, result.residuals)
        rest = stand_in_network(refitter, final, result.residuals, ports, 1, executor)
    assert rest is not None
    found, unknown = result.held(rest=rest)
    assert found.final is found.base
    assert unknown is not None
    assert unknown.trial.effect.id == "unknown"
    assert len(unknown.trial.fit.model.additions) == 1
    # The relaxation leaves more than the noise, so it would not stay if the network did little beside it either.
    little = replace(rest, trial=replace(rest.trial, gain=1.0))
    found, both = result.held(rest=little)
    assert found.final is found.base
    assert both is not None
    assert both.trial.fit is rest.trial.fit


# Where something is felt


def test_what_is_felt_is_the_change_of_the_recordings_over_their_noise() -> None:
    result = searched(("mass", "loss"), ("mass", "hysteresis"))
    fit = result.found.final
    for k, addition in enumerate(fit.model.additions):
        columns = fit.model.columns(k)
        frequency, size = felt(fit, columns, result.residuals)
        step = np.zeros(fit.u.shape[1])
        step[columns] = 1e-5
        change = fit.model.kernel.impedance(fit.u + step, frequency) - fit.model.kernel.impedance(
            fit.u - step, frequency
        )
        sd = np.concatenate([person.sd for person in result.residuals])
        expected = np.sqrt(np.sum(np.abs(change / 2e-5 / sd) ** 2, axis=0))
        np.testing.assert_allclose(size, expected, rtol=1e-6)
        low = size[: len(size) // 2].max() > size[len(size) // 2 :].max()
        assert low == (addition.effect.id == "body.hysteresis")
