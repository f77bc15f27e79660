"""Finished runs made of plain arrays: nothing is sampled, so that pictures and pages can be tested at once."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np

from bayes_impedance.network.notation import parse
from bayes_impedance.results.adequacy import Adequacy
from bayes_impedance.results.misfit import noise_scale_summary
from bayes_impedance.results.result import Result

NETWORK = "skin:(n3|r3)-tissue:(m2|r1|n1)"
VALUES = {"n3": 6.8e-7, "r3": 61.4, "m2": 7.9e-4, "r1": 5.0, "n1": 1.15e-3}
CIRCUIT = "r0|(r1-n1)"
CIRCUIT_VALUES = {"r0": 0.017, "r1": 0.03, "n1": 900.0}


def _for_each(noise: float | tuple[float, ...], subjects: int) -> np.ndarray:
    """For everybody alike, or for the first people, with 0.9 for the others."""
    if isinstance(noise, float):
        return np.full(subjects, noise)
    return np.array([*noise, *[0.9] * subjects][:subjects])


def make_result(
    *,
    subjects: int = 6,
    repetitions: int = 3,
    unidentified: tuple[str, ...] = (),
    problems: tuple[str, ...] = (),
    remarks: tuple[str, ...] = (),
    electrical: bool = False,
    covariance: str = "full",
    covariates: tuple[str, ...] = (),
    source: str = "measured on a bench",
    gap: bool = False,
    points: int = 24,
    draws: int = 60,
    seed: int = 0,
    noise: float | tuple[float, ...] = 1.0,
    ranks: tuple[float, float] = (0.4, 0.6),
) -> Result:
    """A run of two ensembles; `gap` leaves one person without data in the upper half of the band.

    `noise` is about what the residuals are over the noise, of all or of the first people; `ranks` are those of the
    replicated errors.
    """
    rng = np.random.default_rng(seed)
    noise_scale = (1 + 0.1 * np.random.default_rng(seed + 1).uniform(-1, 1, subjects)) * _for_each(noise, subjects)
    text, values = (CIRCUIT, CIRCUIT_VALUES) if electrical else (NETWORK, VALUES)
    network, unit = parse(text), "ohm" if electrical else "N s/m"
    elements = list(network.elements)
    p, n, one = len(elements), subjects, subjects == 1
    known = np.array([e not in unidentified for e in elements])
    seen = np.where(known, 1.0, np.nan)
    f = np.geomspace(5.0, 5000.0, points)
    centre = np.log([values[e] for e in elements])

    def impedance(log_elements: np.ndarray) -> np.ndarray:
        return np.asarray(network.impedance(2j * np.pi * f, dict(zip(elements, np.exp(log_elements), strict=True))))

    mu = centre + 0.03 * rng.normal(size=(2, draws, p))
    persons = 0.3 * np.exp(0.1 * rng.normal(size=(2, draws, p)))
    between = 0.05 * np.exp(0.1 * rng.normal(size=(2, draws, p)))
    own = centre + 0.3 * rng.normal(size=(n, p))
    z = np.array([impedance(x) for x in own]) * np.exp(0.01 * rng.normal(size=(n, points)))
    if gap:
        z[0, points // 2 :] = np.nan
    middle = impedance(centre)
    magnitude, phase = np.abs(middle), np.angle(middle, deg=True)
    factors, shifts = np.array([0.6, 0.8, 1.0, 1.25, 1.6]), np.array([-15.0, -6.0, 0.0, 6.0, 15.0])
    band = np.stack([factors[:, None] * magnitude, phase + shifts[:, None]])
    narrow = np.stack([factors[:, None] ** 0.1 * magnitude, phase + 0.1 * shifts[:, None]])
    error = np.stack([0.2 * magnitude, np.full(points, 6.0)])
    pairs = [(j, i) for i in range(p) for j in range(i)]
    correlation = np.broadcast_to(np.eye(p), (2, draws, p, p)).copy()
    if covariance == "full":
        for j, i in pairs:
            correlation[..., i, j] = correlation[..., j, i] = np.tanh(0.4 + 0.2 * rng.normal(size=(2, draws)))

    posterior = {
        "mu": mu * seen,
        "central": np.exp(mu) * seen,
        "person_log_elements": (own + 0.02 * rng.normal(size=(2, draws, n, p))) * seen,
    }
    if not one:
        posterior["dispersion_between_persons"] = persons * seen
        posterior["correlation"] = correlation * seen[:, None] * seen
        if repetitions > 1:
            posterior["dispersion_between_repetitions"] = between * seen
    if covariates:
        posterior["slope"] = 0.1 * rng.normal(size=(2, draws, p, len(covariates))) * seen[:, None]
    groups = {
        "posterior": posterior,
        "observed_data": {},
        "constant_data": {
            "observed_re": z.real,
            "observed_im": z.imag,
            "band_centre": narrow,
            "band_person": band,
            "band_recording": band,
            "network_curve": np.stack([magnitude, phase]),
            "error_population_network": error,
            "error_lookup_mean": (0.0 if one else 0.95) * error,
            "error_lookup_median": (0.0 if one else 0.9) * error,
            "replicated_error": np.stack([0.8 * error, error, 1.3 * error], axis=1),
            "coverage_50": np.full((2, points), 0.5),
            "coverage_90": np.full((2, points), 0.9),
            "noise_relative": np.abs(0.01 + 0.002 * rng.normal(size=(n, points))),
            "noise_scale": noise_scale,
            "person_relative_rms": 0.02 + 0.002 * rng.random(n),
            "person_curve_re": (0.99 * z).real,
            "person_curve_im": (0.99 * z).imag,
            "pareto_k": 0.3 * rng.random(n) - 0.1,
            "effective_draws": np.full(n, 200.0),
            "repetitions": np.full(n, repetitions),
            "identified": known.astype(np.int8),
            "prior_centre": centre + 1.0,
        },
    }
    interval = ("q05", "median", "q95")

    def summary_of(draws_of: np.ndarray, shown: bool) -> dict[str, float | None]:
        if not shown or problems:
            return dict.fromkeys(interval)
        return dict(zip(interval, np.quantile(draws_of, (0.05, 0.5, 0.95)).tolist(), strict=True))

    curve = {"delta_magnitude": 1.2, "delta_magnitude_sd": 0.4, "delta_phase_deg": 6.0, "delta_phase_deg_sd": 2.0}
    rank = {"replicated_rank_magnitude": ranks[0], "replicated_rank_phase": ranks[1]}
    lookup = dict.fromkeys(curve, 0.0) if one else curve
    summary = {
        "schema": 1,
        "reliable": not problems,
        "problems": list(problems),
        "remarks": list(remarks),
        "title": "ten <fingers> & a thumb",
        "findings": [],
        "adequacy": Adequacy().summary(),
        "network": text,
        "network_as_written": text,
        "combinations": [],
        "unit": unit,
        "subjects": n,
        "repetitions": repetitions,
        "seed": 7,
        "data_sha256": "ab12" * 16,
        "covariance": covariance,
        "elements": {
            e: {
                "unit": "",
                "identified": bool(known[i]),
                "marked": False,
                "central": summary_of(np.exp(mu[..., i]), known[i]),
                "dispersion_between_persons": summary_of(persons[..., i], known[i] and not one),
                "dispersion_between_repetitions": summary_of(between[..., i], known[i] and not one and repetitions > 1),
            }
            for i, e in enumerate(elements)
        },
        "correlation": []
        if one or problems or covariance != "full"
        else [[elements[j], elements[i], 0.38, 0.1, 0.6] for j, i in pairs if known[i] and known[j]],
        "errors": {
            "population_network": curve | rank,
            "lookup_mean": lookup,
            "lookup_median": lookup,
            "subjects": {
                "relative_rms_median": 0.021,
                "relative_rms_max": 0.022,
                "delta_magnitude": 0.05,
                "delta_phase_deg": 0.3,
            },
        },
        "coverage": {"50": 0.5, "90": 0.9},
        "coverage_by_frequency": {"50": [0.3, 0.7], "90": [0.75, 1.0]},
        "noise_scale": noise_scale_summary(noise_scale),
        "sampler": {
            "ensembles": 2,
            "steps": 200,
            "walkers": 24,
            "rhat_max": 1.2 if problems else 1.002,
            "ess_min": 900.0,
            "tau_max": 20.0,
            "acceptance": 0.3,
            "log_likelihood_variance": 0.02,
            "pareto_k_max": 0.2,
            "effective_draws_min": 200.0,
            "reference_moved": 0,
        },
        "versions": {"bayes_impedance": "0.1.0", "numpy": "2.4.6"},
        "seconds": {"modes": 0.5, "population": 20.0},
    }
    coords = {
        "element": elements,
        "element_2": elements,
        "subject": [f"P{i:02d}" for i in range(n)],
        "frequency_hz": f,
    } | ({"covariate": list(covariates)} if covariates else {})
    attributes = {
        "title": summary["title"],
        "unit": unit,
        "source": source,
        "licence": "",
        "network": text,
        "seed": 7,
        "data_sha256": summary["data_sha256"],
        "covariance": covariance,
        "versions": json.dumps(summary["versions"]),
        "reading_warnings": json.dumps(["row 12 has no value and was dropped"]),
    }
    result = Result(summary, groups, coords, attributes)
    for e in elements:
        summary["elements"][e]["unit"] = result.element_unit(e)
    return result


VARIANTS = {
    "people": {},
    "one subject": {"subjects": 1, "repetitions": 1, "electrical": True},
    "one repetition": {"repetitions": 1, "electrical": True},
    "two people": {"subjects": 2},
    "an element unseen": {"unidentified": ("n3",)},
    "no element seen": {"unidentified": tuple(VALUES)},
    "one element seen": {"unidentified": tuple(e for e in VALUES if e != "r3")},
    "with problems": {"problems": ("the ensembles disagree (R-hat 1.200, limit 1.05): repeat it without --quick",)},
    "diagonal covariance": {"covariance": "diagonal", "gap": True},
    "with a covariate": {"covariates": ("contact_force_n",), "source": "simulated by hand"},
}

MISFITS = {
    "gross misfit": {"noise": 38.4},
    "misfit in some": {"subjects": 20, "noise": (6.0, 6.0, 9.0)},
    "misfit in one of many": {"subjects": 30, "noise": (6.0,)},
    "misfit beyond the replicates": {"noise": 3.0, "ranks": (0.0, 0.02)},
    "one subject with a misfit": {"subjects": 1, "repetitions": 1, "noise": 12.0},
    "more scatter expected": {"ranks": (0.97, 0.99)},
}
"""Residuals that are more than noise: pages and sentences of them; their pictures are those of the others."""


def described_worse(result: Result) -> SimpleNamespace:
    """A network that describes the recordings of a result by hand worse, as if something had been added to it."""
    kept = result.groups["constant_data"]
    return SimpleNamespace(
        magnitude=2 * kept["band_recording"][0, [0, 2, 4]],
        phase_deg=kept["band_recording"][1, [0, 2, 4]],
        delta_magnitude=3 * kept["error_population_network"][0],
        delta_phase_deg=4 * kept["error_population_network"][1],
        coverage90=0.5 * kept["coverage_90"],
        subject_rms_relative=np.full(len(kept["observed_re"]), 0.1),
        person_curve=0.5 * (kept["observed_re"] + 1j * kept["observed_im"]),
    )
