"""Virtual recordings with one concealed effect, and the truth to compare a diagnosis with.

``cases.py`` defines the strength of an effect, ``visibility.py`` its largest possible evidence.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from cases import COVARIATE, Case, followers, prepare, stream
from forms import EFFECTS, NOTHING, PARAMETERS, VERDICT_ID, equivalents, same_places
from nearest import bands
from people import ELEMENTS, NETWORK, Conditions, record
from visibility import visibility

from bayes_impedance.recordings.dataset import Recordings, Subject


def concealed(
    effect_id: str,
    place: str | None,
    strength: float,
    seed: int,
    n_subjects: int = 40,
    n_repetitions: int = 3,
    n_points: int = 201,
    band: tuple[float, float] = (5.0, 5000.0),
    conditions: Conditions | None = None,
) -> tuple[Recordings, dict[str, Any]]:
    """Record virtual people with one concealed effect.

    Parameters
    ----------
    effect_id : str
        A key of ``forms.EFFECTS``.
    place : str or None
        Where; None takes one of the effect's usual places, by the seed.
    strength : float
        See ``cases.py``.
    seed : int
        The same seed gives the same people and noise, whatever is concealed.
    n_subjects, n_repetitions, n_points : int
    band : (float, float)
        In Hz; frequencies are spaced logarithmically.
    conditions : Conditions, optional
        Noise, repositioning, correlation, gain error.

    Returns
    -------
    recordings : Recordings
        Without a trace of the effect in title or source.
    truth : dict
        ``id, mismatch, place, places`` (the same network under other names), ``side, pooling, parameters, also``
        (numbers that say the same as the parameters), ``bands_hz`` (where the change over the noise, rms over
        recordings, exceeds half of its maximum), ``visible`` (by how many standard errors the effect could stand out
        at most), ``visible_bands_hz`` (as `bands_hz`, for what the elements cannot absorb), ``subjects, covariate,
        network, strength, seed, elements, conditions``. Ready for JSON.
    """
    case = prepare(effect_id, place, strength, seed, n_subjects, n_repetitions, n_points, band, conditions)
    z, sd = record(case.concealed, case.frequency_hz, case.conditions, stream(seed, "noise"))
    width = len(str(n_subjects))
    subjects = tuple(
        Subject(
            name=f"V{i + 1:0{width}d}",
            frequency_hz=case.frequency_hz,
            z=z[i],
            repetitions=tuple(str(j + 1) for j in range(n_repetitions)),
            covariates={name: float(values[i]) for name, values in case.people.covariates.items()},
        )
        for i in range(n_subjects)
    )
    recordings = Recordings(
        title=f"virtual fingertips {seed}",
        unit="N s/m",
        network=NETWORK,
        source="simulated: virtual persons, not measured",
        licence="MIT",
        subjects=subjects,
    )
    return recordings, _truth(case, sd, recordings.names)


def _truth(case: Case, sd: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    """The verdict of a perfect diagnosis; sd (N, J, F) is the noise."""
    effect, missing = EFFECTS[case.id], case.id not in NOTHING
    parameters: dict[str, dict[str, Any]] = {
        name: {"value": case.values[own], "unit": unit, "dispersion": effect.spread.get(own, 0.0)}
        for own, (name, unit) in PARAMETERS[case.id].items()
    }
    if case.id == "body.covariate":
        slope = next(iter(parameters.values()))
        slope["per_sd"] = slope["value"] * float(np.std(np.log(case.people.covariates[COVARIATE])))
        slope["signs"] = followers(case.place)
    relative = np.abs(case.concealed - case.without)[case.members] / sd[case.members]
    visible, outside = visibility(case, sd) if missing else (0.0, np.zeros(case.frequency_hz.size))
    return {
        "id": VERDICT_ID.get(case.id, case.id),
        "mismatch": missing,
        "place": case.place if missing else None,
        "places": list(same_places(case.id, case.place)) if missing else [],
        "side": case.id.split(".")[0] if missing else None,
        "pooling": effect.pooling if missing else None,
        "parameters": parameters,
        "also": {
            name: {"value": float(value), "unit": unit}
            for name, (value, unit) in equivalents(case.id, case.values).items()
        },
        "bands_hz": bands(case.frequency_hz, np.sqrt(np.mean(relative**2, axis=(0, 1)))) if missing else [],
        "visible": visible,
        "visible_bands_hz": bands(case.frequency_hz, outside) if missing else [],
        "subjects": "all" if case.members.all() else [n for n, m in zip(names, case.members, strict=True) if m],
        "covariate": COVARIATE if case.id == "body.covariate" else None,
        "network": NETWORK,
        "strength": case.strength if missing else 0.0,
        "seed": case.seed,
        "elements": {
            name: {
                "central": float(np.exp(case.population.log_centre[i])),
                "dispersion_between_persons": float(case.population.between_persons[i]),
                "dispersion_between_repetitions": float(case.population.between_repetitions[i]),
            }
            for i, name in enumerate(ELEMENTS)
        },
        "conditions": asdict(case.conditions) | {"repositioning": list(case.conditions.repositioning)},
    }
