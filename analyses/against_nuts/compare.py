"""Population posterior of the package against NUTS on the full joint posterior: a table of every parameter.

Run from anywhere: ``python analyses/against_nuts/compare.py [seed]``. Needs numpyro (``pip install .[oracle,test]``).
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from nuts_model import POPULATION, Comparison, compare, from_fit, run_nuts, virtual_recordings

from bayes_impedance.population.fit import fit_population


def row(c: Comparison, seconds: tuple[float, float]) -> str:
    """One line of the table."""
    ours, nuts = c.ours, c.nuts
    return (
        f"{c.name:14s} {ours.mean:9.4f} {ours.sd:7.4f} {nuts.mean:9.4f} {nuts.sd:7.4f} "
        f"{c.shift:6.2f} +- {c.shift_error:4.2f} {c.spread:6.3f} +- {c.spread_error:5.3f} "
        f"{ours.effective:6.0f} {nuts.effective:6.0f} "
        f"{ours.effective / seconds[0]:6.0f} {nuts.effective / seconds[1]:6.0f}"
    )


def main() -> None:
    """Fit, sample, print."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    fit = fit_population(virtual_recordings(seed), POPULATION.network, seed=seed)
    ours, nuts = from_fit(fit), run_nuts(fit, seed=seed)
    both = (ours.seconds, nuts.seconds)
    print(
        f"ours {both[0]:.1f} s, variance of the log likelihood {fit.diagnostics.log_likelihood_variance:.3f}, "
        f"Pareto k up to {fit.diagnostics.pareto_k.max():.2f}, {fit.diagnostics.problems or 'no problems'}"
    )
    print(f"NUTS {both[1]:.1f} s, {nuts.divergences} divergences")
    print(
        f"{'':14s} {'ours':>9s} {'sd':>7s} {'NUTS':>9s} {'sd':>7s} {'shift (sd)':>14s} {'spread ratio':>15s} "
        f"{'ESS':>6s} {'ESS':>6s} {'ESS/s':>6s} {'ESS/s':>6s}"
    )
    table = compare(ours, nuts)
    people = [c for c in table if c.name.startswith("person")]
    for c in table:
        if c not in people:
            print(row(c, both))
    print(f"largest R-hat of NUTS {max(c.nuts.rhat for c in table):.4f}")
    print(f"{len(people)} log elements of persons: worst shift and worst spread")
    print(row(max(people, key=lambda c: abs(c.shift)), both))
    print(row(max(people, key=lambda c: abs(c.spread - 1)), both))


if __name__ == "__main__":
    main()
