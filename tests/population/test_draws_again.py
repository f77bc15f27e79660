"""How many draws are made anew, and around which population."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import SHORT

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.anchor import Anchor
from bayes_impedance.population.draws_again import DrawsAgain
from bayes_impedance.population.fit import fit_population
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.population.simulate import Simulation


@pytest.mark.parametrize(
    ("excess", "farther", "expected"),
    [
        (1.1, False, 1024),  # twice as many at least
        (2.5, False, 4096),  # the square of the excess, rounded up
        (9.0, False, 4096),  # and no more than eight times the first
        (0.5, True, 512),  # another range is enough
        (1.1, True, 1024),  # the error was too large as well
    ],
)
def test_as_many_as_the_error_asks_for(excess: float, farther: bool, expected: int) -> None:
    again = DrawsAgain(first=512, last=512, n_persons=71, shared=False)
    assert again.number(excess, farther) == expected


def test_few_people_get_more_and_shared_parameters_fewer() -> None:
    assert DrawsAgain(first=512, last=512, n_persons=20, shared=False).number(9.0, False) == 8192
    assert DrawsAgain(first=512, last=512, n_persons=20, shared=True).number(9.0, False) == 2048
    assert DrawsAgain(first=512, last=2048, n_persons=71, shared=False).number(9.0, False) == 4096


@pytest.mark.long
@pytest.mark.parametrize(
    ("at_home", "elsewhere", "along_valley"),
    [(1000.0, 50.0, False), (10.0, 10.0, True), (1000.0, 2.0, True)],  # the last reach too short along a ridge
)
def test_a_valley_is_followed_only_where_more_draws_do_not_help(
    small_simulation: Simulation,
    monkeypatch: pytest.MonkeyPatch,
    at_home: float,
    elsewhere: float,
    along_valley: bool,
) -> None:
    """From 20 to 800 Hz everybody had hundreds of draws under the reference; those along valleys held 1.4 of them."""
    made: list[tuple[Anchor, int, int]] = []
    draw_once = Posterior._draw_once

    def noted(self: Posterior, anchor: Anchor, n_draws: int, *rest: object) -> None:
        made.append((anchor, n_draws, getattr(self, "redrawn", 0)))
        draw_once(self, anchor, n_draws, *rest)  # type: ignore[arg-type]

    def few(self: KeptDraws, parameters: PopulationParameters) -> np.ndarray:
        return np.full((len(parameters.mu), 5), elsewhere)

    monkeypatch.setattr(Posterior, "_draw_once", noted)
    monkeypatch.setattr(KeptDraws, "effective", few)
    monkeypatch.setattr(KeptDraws, "effective_at_home", lambda self: np.full(5, at_home))
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:5])
    sampler = SamplerSettings(ensembles=2, burn_in=(20,), chunk=20, longest=20)
    fit_population(recordings, settings=replace(SHORT, draws=16, sampler=sampler), seed=7)
    first = [anchor.near is not None for anchor, _, attempt in made if attempt == 0]
    assert first == sorted(first)  # a rough one or more to find the mode, then those for the populations near it
    assert first[-1]
    again = [(anchor, n) for anchor, n, attempt in made if attempt > 0]
    assert any(anchor.along_valley for anchor, _ in again) == along_valley
    assert any(anchor.near is not None for anchor, _ in again) == (not along_valley)
    base = max(n for _, n, attempt in made if attempt == 0)
    assert max(n for _, n in again) == 8 * base
