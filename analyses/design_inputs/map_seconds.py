"""Seconds for the stability map of 1000 users over 40 x 40 gains, from the folder of a finished fit."""

import sys
import time
from dataclasses import replace
from pathlib import Path

from bayes_impedance.design import PHANTOM, population_of, stability_map
from bayes_impedance.design.answer import gains
from bayes_impedance.results.result import load_result


def main(result: Path) -> None:
    population = population_of(load_result(result))
    users = population.draw(1000, seed=1)
    for delay in (0.0, 0.5e-3, 2.5e-3):
        device = replace(PHANTOM, delay_s=delay)
        stiffness, damping = gains(population, device, 40, 100.0)
        for workers in (1, 2):
            started = time.perf_counter()
            found = stability_map(population, users, device, stiffness, damping, workers=workers)
            print(
                f"delay {1e3 * delay:g} ms, {workers} thread(s): {time.perf_counter() - started:.1f} s, "
                f"{found.effective_users:.0f} effective users"
            )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
