"""Effect of the misprints of eq. 4 on a fit: the printed and the corrected form on the same recordings.

Run from the repository's root: python analyses/paper/printed_eq4.py
As printed, r2 stands for r3 in the skin's term and the mass m2 has the wrong sign. Each form is fitted to the median
look-up table from many starts, to magnitudes, phases or complex values, and judged by eq. 5.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.results.curve_errors import common_grid, error_curves, lookup_table, on_grid, wrapped_deg

Form = Callable[[np.ndarray, np.ndarray], np.ndarray]
RECORDINGS = read_recordings(Path(__file__).parents[2] / "data" / "fingertip_71")
FREQUENCY_HZ = common_grid(RECORDINGS)
PEOPLE = on_grid(RECORDINGS, FREQUENCY_HZ)
# Typical elements of a fingertip, in the order n3, r2, m2, r1, n1, m1, n2, r3; starts are spread around them.
CENTRE = np.log([7e-7, 4.0, 8e-4, 1.5, 1.2e-3, 0.05, 5e-3, 60.0])


def eq4(s: np.ndarray, x: np.ndarray, sign: float, skin_damper: float) -> np.ndarray:
    n3, r2, m2, r1, n1, m1, n2 = x[:7]
    limb = 1 / (1 / (s * m1) + s * n2 / (s * n2 * r2 + 1))
    tissue = (sign * s**2 * m2 * n1 + s * n1 * r1 + 1) / (s * n1) + limb
    return 1 / (s * n3 / (s * skin_damper * n3 + 1) + 1 / tissue)


FORMS: dict[str, Form] = {
    "printed": lambda s, x: eq4(s, x, -1.0, x[1]),
    "printed, r3 in the skin": lambda s, x: eq4(s, x, -1.0, x[7]),
    "printed, mass corrected": lambda s, x: eq4(s, x, +1.0, x[1]),
    "corrected": lambda s, x: eq4(s, x, +1.0, x[7]),
}


def best_fit(form: Form, part: str, target: np.ndarray, n_starts: int = 60) -> np.ndarray:
    s, rng = 2j * np.pi * FREQUENCY_HZ, np.random.default_rng(1)

    def residual(theta: np.ndarray) -> np.ndarray:
        z = form(s, np.exp(theta))
        if part == "magnitude":
            return np.abs(z) - np.abs(target)
        if part == "phase":
            return np.radians(wrapped_deg(np.angle(z, deg=True) - np.angle(target, deg=True)))
        return np.concatenate([(z / target - 1).real, (z / target - 1).imag])

    starts = CENTRE + np.vstack([np.zeros(8), rng.normal(0, 1.0, (n_starts, 8))])
    fits = [least_squares(residual, t, bounds=(CENTRE - 14, CENTRE + 14), max_nfev=200) for t in starts]
    return form(s, np.exp(min(fits, key=lambda f: f.cost).x))


def main() -> None:
    magnitude, phase = lookup_table(PEOPLE, "median")
    target = magnitude * np.exp(1j * np.radians(phase))
    print(f"{'form of eq. 4':28}{'fitted to':14}{'|z| (N s/m)':>14}{'phase (deg)':>14}{'Re z < 0 at':>14}")
    for name, form in FORMS.items():
        for part in ("magnitude", "phase", "complex"):
            z = best_fit(form, part, target)
            errors = error_curves(np.abs(z), np.angle(z, deg=True), PEOPLE).summary()
            cells = f"{errors['delta_magnitude']:14.2f}{errors['delta_phase_deg']:14.2f}{np.mean(z.real < 0):14.0%}"
            print(f"{name:28}{part:14}{cells}")


if __name__ == "__main__":
    main()
