"""The two published functions of appendix A seen as the network of eq. 4: the mapping that the paper could not do.

Run from the repository's root: python analyses/paper/mapping.py
Prints the equations and the result, and writes results/mapping.json and results/published.png and .svg.
"""

import json
import tomllib
from pathlib import Path

import numpy as np

from bayes_impedance.classical import (
    CoefficientEquations,
    check_passivity,
    enforce_passivity,
    identify,
    map_to_network,
    partial_fractions,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.plots import bode, new_figure, save_figure, style
from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.results.curve_errors import common_grid, on_grid

ROOT, OUT = Path(__file__).parents[2], Path(__file__).parent / "results"
NETWORK = parse(PAPER_NETWORK)
FREQUENCY_HZ = np.geomspace(5, 5000, 401)
S = 2j * np.pi * FREQUENCY_HZ


def published() -> dict[str, TransferFunction]:
    """The printed functions with the sign turned, without the imaginary parts that are rounding errors."""
    text = (ROOT / "data" / "appendix_a" / "coefficients.toml").read_text(encoding="utf-8")
    entries = tomllib.loads(text).items()
    return {k: TransferFunction.from_coefficients([-c for c in e["numerator"]], e["denominator"]) for k, e in entries}


def rounding(transfer: TransferFunction, seed: int = 1) -> float:
    """Relative rms change of the curve when coefficients move within their three printed digits."""
    rng = np.random.default_rng(seed)

    def moved(coefficients: np.ndarray) -> list[float]:
        unit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(coefficients), 1e-300))) - 2)
        return (coefficients + unit * rng.uniform(-0.5, 0.5, coefficients.size) * (coefficients != 0)).tolist()

    curves = [
        TransferFunction.from_coefficients(moved(transfer.numerator), moved(transfer.denominator)) for _ in range(300)
    ]
    return float(np.sqrt(np.mean([np.abs(c(S) / transfer(S) - 1) ** 2 for c in curves])))


def main() -> None:
    print("\n".join(CoefficientEquations.of(NETWORK).text()))
    functions = published()
    functions["vf_median, pole at 0 kept"] = identify(FREQUENCY_HZ, functions["vf_median"](S)).transfer
    summary, curves, nearest = {}, {}, {}
    for name, transfer in functions.items():
        mapping = map_to_network(transfer, NETWORK, FREQUENCY_HZ)
        passivity = check_passivity(transfer, unit="N s/m")
        summary[name] = {**mapping.summary(), "rounding": rounding(transfer), "not_passive": list(passivity.reasons)}
        print(
            f"\n{name}: {100 * mapping.distance:.2f} % from eq. 4, worst {100 * mapping.worst_relative:.0f} % at "
            f"{mapping.worst_hz:.0f} Hz; printed digits explain {100 * summary[name]['rounding']:.2f} %"
        )
        print(f"  obstacles {mapping.obstacles}; exact real solutions {len(mapping.exact)}")
        if not passivity.positive_real:
            passive = enforce_passivity(partial_fractions(transfer), FREQUENCY_HZ)
            distance = np.sqrt(np.mean(np.abs(passive(S) / transfer(S) - 1) ** 2))
            summary[name]["distance_from_passive"] = float(distance)
            print(f"  {'; '.join(passivity.reasons)}; the nearest passive function is {100 * distance:.1f} % away")
        for element, e in mapping.elements.items():
            value = "not determined" if e.value is None else f"{e.value:.3g} ({e.q05:.3g} to {e.q95:.3g}) {e.unit}"
            held = "" if e.value is None else ", ".join(f"{c} {x:+.1f}" for c, x in e.held_by)
            print(f"  {element}  {value:42} error x {e.amplification:9.3g}   held by {held}")
        curves[name] = transfer(S)
        nearest[name] = Kernel(NETWORK).impedance(mapping.log_elements, FREQUENCY_HZ)
    OUT.mkdir(exist_ok=True)
    (OUT / "mapping.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    people = read_recordings(ROOT / "data" / "fingertip_71")
    observed = on_grid(people, common_grid(people))
    titles = {"sit": "SIT, published", "vf_median": "VFMedian, published"}
    shown = {}
    for name, title in titles.items():
        shown[title], shown[f"eq. 4 nearest to {title.split(',')[0]}"] = curves[name], nearest[name]
    with style():
        figure = new_figure(8.2, 7.0)
        for axes, part in zip(figure.subplots(2, 1, sharex=True), ("magnitude", "phase"), strict=True):
            bode(axes, FREQUENCY_HZ, shown, observed, "N s/m", part, legend=False)
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        save_figure(figure, OUT, "published")


if __name__ == "__main__":
    main()
