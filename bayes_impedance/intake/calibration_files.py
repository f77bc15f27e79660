"""What a calibration has found, as files beside the dataset: the map at each frequency, and the rig's parameters."""

from __future__ import annotations

import json

from bayes_impedance.intake.calibrating import Calibrated
from bayes_impedance.intake.smooth_rig import PARAMETERS, SmoothRig, rig_around
from bayes_impedance.recordings.calibration_map import MAP_FILE

RIG_FILE = "rig.toml"


def calibration_files(calibration: Calibrated) -> dict[str, bytes]:
    """Contents of the files by their names."""
    files = {}
    if calibration.two_port is not None:
        files[MAP_FILE] = calibration.two_port.recorded.csv()
    if calibration.rig is not None:
        files[RIG_FILE] = _rig_toml(calibration.rig, calibration.spectra[0].unit).encode()
    return files


def _rig_toml(rig: SmoothRig, unit: str) -> str:
    lines = [
        "# The rig that was taken out of the recordings. Its parameters are the same for everybody. Their errors",
        "# (normal, with this covariance in the order of the parameters) are common to all recordings and no part of",
        "# noise_sd; what is left of them in the recordings is in dataset.toml, [calibration], and fits estimate it.",
        "# `held` is the rig at these values around a network, for recordings that were imported without calibration.",
        f"impedance_unit = {json.dumps(unit)}",
        f"held = {json.dumps(rig_around('NETWORK', rig.values, bool(rig.values[5] > 0)))}",
        f"shared = {json.dumps(rig_around('NETWORK', None, rig.mount_is_seen))}",
        f"covariance = {json.dumps([[float(v) for v in row] for row in rig.covariance])}",
    ]
    if rig.misfit is not None:
        lines.append(f"reduced_chi_square = {rig.misfit!r}")
    for (name, of_translation), value, sd in zip(PARAMETERS, rig.values, rig.sds, strict=True):
        lines += ["", "[[parameters]]", f'name = "{name}"', f"mean = {float(value)!r}", f"sd = {float(sd)!r}"]
        if unit == "N s/m":
            lines.append(f'unit = "{of_translation}"')
    return "\n".join(lines) + "\n"
