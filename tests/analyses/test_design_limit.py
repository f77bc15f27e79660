"""What is said of the design answer's coverage is what its recorded populations give; one population is made again."""

import csv
import importlib
import re
import sys

import numpy as np
import pytest
from conftest import DATA

FOLDER = DATA.parent / "analyses" / "honesty"
sys.path.insert(0, str(FOLDER))
design_limit = importlib.import_module("design_limit")


def recorded() -> dict[str, np.ndarray]:
    with (FOLDER / "design_limit.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_interval_covers_as_often_as_is_said() -> None:
    rows = recorded()
    covered = (rows["q05"] <= rows["truth"]) & (rows["truth"] <= rows["q95"])
    assert covered.size == 100
    assert 0.86 <= covered.mean() <= 0.94
    assert np.all((rows["q05"] < rows["limit"]) & (rows["limit"] < rows["q95"]))
    for document in ("README.md", "analyses/README.md", "analyses/design_inputs/README.md"):
        text = " ".join((DATA.parent / document).read_text(encoding="utf-8").split())
        found = re.search(r"contain(?:s|ed) the true limit in (\d+) %", text)
        assert found is not None
        assert int(found.group(1)) == round(100 * covered.mean())


@pytest.mark.slow
def test_a_population_made_again_is_the_recorded_one() -> None:
    row, rows = design_limit.one(1), recorded()
    for name in ("truth", "limit", "q05", "q95"):
        assert row[name] == pytest.approx(rows[name][0], rel=0.02)


def test_the_true_limit_is_that_of_the_true_population() -> None:
    from bayes_impedance.design import PHANTOM, UserPopulation
    from bayes_impedance.design.loop.population_limit import limits_of_populations
    from bayes_impedance.network.notation import parse

    truth = design_limit.drawn(np.random.default_rng(5))
    tau = truth.vector(truth.between_persons)
    alone = UserPopulation(
        network=parse(truth.network),
        unit="N s/m",
        mu=np.log(truth.vector(truth.central))[None],
        factor=(tau[:, None] * np.linalg.cholesky(truth.correlation_matrix()))[None],
        between_repetitions=np.zeros((1, 3)),
    )
    (found,) = limits_of_populations(alone, PHANTOM, 0.0, 0.99, highest=1e7)
    assert design_limit.true_limit(truth, 5) == pytest.approx(found, rel=0.03)
