"""A delay between the channels that leaves Re z positive, as of a load with losses.

Where Re z is negative, :mod:`.negative_real_part` says it, and this is not asked. Of 120 populations of
``analyses/other_worlds`` six are named, each with an effect that turns the phase without the magnitude (delay, echo,
reflex) or nearly so (bypass, mount); with a delay of three tenths of a period of the highest frequency 84 % of them
are, with one tenth 57 %.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.phase_relation import excess_phase
from bayes_impedance.units import number_with_unit

_MOST = 0.5
"""Share of the subjects above which a delay is reported: it is the rig's, and the same for all."""


def late_channel(recordings: Recordings) -> tuple[str | None, str] | None:
    """The subject if it is the only one, and what is said of a delay; None if there is none."""
    found = [excess_phase(one.frequency_hz, one.mean) for one in recordings.subjects]
    sizes = [one.size for one in found if one is not None and one.cause == "lag"]
    if len(sizes) <= _MOST * len(found):
        return None
    size = float(np.median(sizes))
    late, other = ("motion", "force") if size > 0 else ("force", "motion")
    only = recordings.subjects[0].name if len(found) == 1 else None
    whose = f"{len(sizes)} of {len(found)} subjects" if only is None else f'subject "{only}"'
    return only, (
        f"{whose}: the phase differs from that of the magnitude by an angle that grows "
        f"with frequency, as if the {late} were recorded about {number_with_unit(abs(size), 's', 1)} later than the "
        f"{other}; 'bayes-impedance diagnose' measures such a delay and says whether it is one"
    )
