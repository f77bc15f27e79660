"""Diagnoses of the paper's published curves, and of real battery spectra with the two-arc network.

    python analyses/concealed/real.py [-o analyses/concealed/results]

For the battery the explanation found on all spectra is cross-validated: parameters that all spectra share are estimated
without a fold, and the spectra in the fold are fitted with these parameters held. Written to
``real.json`` and printed. The real recordings are found through the environment variable BAYES_IMPEDANCE_REAL_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.stepwise import search
from bayes_impedance.diagnosis.verdict.model_bands import own_errors
from bayes_impedance.recordings.files import Recordings, read_recordings

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[1] / "data"
FOLDS = 5


def said(recordings: Recordings) -> dict[str, Any]:
    """The verdict, shortened."""
    diagnosis = diagnose(recordings, quick=True)
    verdict = diagnosis.verdict
    entries = [
        {
            "id": entry.id,
            "place": entry.place,
            "parameters": {name: [p.q05, p.median, p.q95, p.unit] for name, p in entry.parameters.items()},
            "not told from": [f"{alias.id} at {alias.place}" for alias in entry.aliases if not alias.separated],
        }
        for entry in verdict.physics
    ]
    best = [f"{port.place}: {port.share:.3f}" for port in diagnosis.one_ports[:4]]
    error = [float(np.median(s.subject_rms_relative)) for s in (diagnosis.before, diagnosis.after) if s is not None]
    return {
        "summary": verdict.summary,
        "physics": entries,
        "bands_hz": verdict.where.bands_hz,
        "relative error before, after": error,
        "places that close most of the gap": best,
        "network": verdict.network,
        "remarks": verdict.remarks,
    }


def held_out_spectra(recordings: Recordings, seed: int = 1) -> dict[str, Any]:
    """Relative errors of held-out spectra: their fold was used neither to choose the additions nor to estimate them."""
    n = len(recordings.subjects)
    fold = np.random.default_rng(seed).permutation(n) % FOLDS
    before, after = np.empty(n), np.empty(n)
    names: list[list[str]] = []
    with ThreadPoolExecutor(2) as executor:
        for k in range(FOLDS):
            inside, outside = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
            training, test = (recordings.select([recordings.names[i] for i in rows]) for rows in (outside, inside))
            trained = fit_network(training, None, seed, executor, lambda *_: None)
            found = search(trained.refitter, trained.fit, training.names, registered(), seed, executor, lambda *_: None)
            names.append([f"{a.effect.id} at {a.place}" for a in found.final.model.additions])
            own = fit_network(test, None, seed, executor, lambda *_: None)
            before[inside] = own_errors(test, person_residuals(own.fit, test.names))
            fitted = _under(own.refitter, found.final, own.fit, seed)
            after[inside] = own_errors(test, person_residuals(fitted, test.names))
    return {
        "relative error before: median, largest": [float(np.median(before)), float(before.max())],
        "relative error after: median, largest": [float(np.median(after)), float(after.max())],
        "share of spectra below 2 %": float(np.mean(after < 0.02)),
        "found without each fold": names,
    }


def _under(refitter: Refitter, trained: Refit, own: Refit, seed: int) -> Refit:
    """Fit held-out spectra with a population and shared parameters that were estimated from the others."""
    model = trained.model
    start = np.tile(trained.u.mean(axis=0), (len(own.u), 1))
    start[:, : model.n_elements] = own.u
    fit = refitter.fit(model, start, trained.population, 80, hold_population=True, hold_additions=True)
    return refitter.settle(fit, seed, hold=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    out = parser.parse_args().out
    report: dict[str, Any] = {name: said(read_recordings(DATA / "appendix_a" / name)) for name in ("vf_median", "sit")}
    folder = os.environ.get("BAYES_IMPEDANCE_REAL_DATA")
    if folder:
        battery = read_recordings(Path(folder) / "battery_130")
        report["battery_130"] = said(battery) | {"held out over spectra": held_out_spectra(battery)}
    else:
        print("BAYES_IMPEDANCE_REAL_DATA is not set: the battery spectra are left out")
    out.mkdir(parents=True, exist_ok=True)
    (out / "real.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
