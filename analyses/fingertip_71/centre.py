"""Derivation of the virtual fingertips' centre from the two published curves.

Each curve is fitted with the paper's network. Where both determine an element the geometric mean is taken, otherwise
the value of the one that does. Run from the repository's root: python analyses/fingertip_71/centre.py
"""

from pathlib import Path

import numpy as np

from bayes_impedance import fit_population, read_recordings

DATA = Path(__file__).parents[2] / "data" / "appendix_a"


def main() -> None:
    fits = [fit_population(read_recordings(DATA / curve), seed=1) for curve in ("sit", "vf_median")]
    logs = np.array([np.where(f.identified, np.median(f.parameters.mu, axis=0), np.nan) for f in fits])
    centre = np.exp(np.nanmean(logs, axis=0))
    print("element        SIT   VFMedian     centre   (nan: this curve does not determine it)")
    for name, values, middle in zip(fits[0].kernel.elements, np.exp(logs).T, centre, strict=True):
        print(f"{name:4} {values[0]:13.4g} {values[1]:10.4g} {middle:10.3g}")


if __name__ == "__main__":
    main()
