"""Design summary for a population and a device: stability limit, its causes and transparency, in one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_impedance.design.loop.device import Device
from bayes_impedance.design.loop.sampled_loop import largest_stiffness
from bayes_impedance.design.loop.stability import (
    Limit,
    Reason,
    StabilityMap,
    limit_of,
    loop_of,
    reason,
    stability_map,
)
from bayes_impedance.design.loop.transparency import Transparency, transparency
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.display import heading, joined, lines, number, short, table
from bayes_impedance.runtime.atomic_files import finite_or_none
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.user_table import number_in, whole_number_in
from bayes_impedance.units import rounded

_GRID_LOW = 0.02
"""Lowest stiffness of the map relative to the highest, if no stiffness is known at which all users are stable. By
choice: a lower one shows more of the stable region at a coarser grid."""

_DAMPINGS = 400
"""Number of dampings scanned for the largest stable one. By choice: over eight decades neighbours differ by 5 %."""

LEAST_GRID = 2
"""Fewest gains on each axis of the map: its two ends."""

_LARGEST = 1e4
"""Largest damping that is scanned, in N s/m. By choice, far above what sampled devices can render."""

_HIGHEST = 1e7
"""Largest stiffness that is searched, in N/m. By choice: stiffer than any wall that a haptic device renders."""


@dataclass(frozen=True)
class DesignAnswer:
    """Stability and transparency of a device over a population.

    Attributes
    ----------
    map : StabilityMap
    limit : Limit
        At the chosen virtual damping.
    reason : Reason
        Elements that make the worst user's limit the lowest.
    transparency : Transparency or None
        At half the limit; None if there is no limit above zero.
    """

    map: StabilityMap
    limit: Limit
    reason: Reason
    transparency: Transparency | None

    def __repr__(self) -> str:
        limit = self.limit
        return (
            f"<DesignAnswer for {short(self.map.device.name)}: {rounded(limit.stiffness)} N/m for "
            f"{100 * limit.share:g} % of users at B = {limit.damping:g} N s/m>"
        )

    def _repr_html_(self) -> str:
        limit = self.limit
        rows = [
            (f"{100 * limit.share:g} % of users", limit.stiffness, f"{number(limit.low)} to {number(limit.high)}"),
            (f"worst of {len(limit.each)} users", float(limit.each[limit.worst]), None),
            ("mean user", limit.mean_user, None),
            ("classical bound", limit.classical, None),
        ]
        limits = table(["limit of the stiffness", "N/m", "90 % interval"], rows)
        return joined(heading(repr(self).strip("<>")), lines([self.sentence]), limits)

    @property
    def sentence(self) -> str:
        """The answer in words."""
        limit, worst = self.limit, self.map.users.names[self.limit.worst]
        at = f"at virtual damping B = {limit.damping:g} N s/m"
        share = f"{100 * limit.share:g} % of users"
        if not limit.stiffness > 0:
            return f"{self.map.device.name}: {at} it is not stable for {share} at any stiffness."
        main = self.reason.elements[0]
        more = "more" if self.reason.change[0] > 0 else "less"
        return (
            f"{self.map.device.name}: {at} it is stable for {share} up to K = {rounded(limit.stiffness)} N/m "
            f"(90 % interval {rounded(limit.low)} to {rounded(limit.high)}), limited by an oscillation at "
            f"{limit.each_hz[limit.worst]:.0f} Hz in users with {more} {main}. For the worst of {len(limit.each)} "
            f"users, {worst}, the limit is {rounded(limit.each[limit.worst])} N/m. From the mean user alone it would "
            f"be {rounded(limit.mean_user)} N/m, from the classical passivity bound {rounded(limit.classical)} N/m."
        )

    def described(self) -> dict[str, Any]:
        """For JSON."""
        limit, m = self.limit, self.map
        worst = m.users.of(limit.worst)
        return {
            "schema": 1,
            "answer": self.sentence,
            "device": m.device.described(),
            "damping": limit.damping,
            "share": limit.share,
            "stiffness_limit": {"unit": "N/m", "value": limit.stiffness, "q05": limit.low, "q95": limit.high},
            "mean_user_limit": limit.mean_user,
            "classical_limit": limit.classical,
            "share_stable_at_mean_user_limit": float(np.mean(limit.each >= limit.mean_user)),
            "worst_user": {
                "name": m.users.names[limit.worst],
                "limit": float(limit.each[limit.worst]),
                "oscillation_hz": finite_or_none(limit.each_hz[limit.worst]),
                "elements": worst,
                "units": m.users.units,
                "because": [
                    {"element": e, "relative_to_centre": float(np.exp(c)), "part_of_log_limit": float(x)}
                    for e, c, x in zip(self.reason.elements, self.reason.change, self.reason.part, strict=True)
                ],
                "log_limit_relative_to_centre": self.reason.difference,
            },
            "users": len(m.users),
            "effective_users": m.effective_users,
        }


def design_answer(
    population: UserPopulation,
    users: Users,
    device: Device,
    *,
    damping: float = 0.0,
    share: float = 0.99,
    grid: int = 40,
    seed: int = 1,
    workers: int = 2,
    progress: Progress | None = None,
) -> DesignAnswer:
    """Stability map, limit, causes and transparency of a device over a population.

    Parameters
    ----------
    population : UserPopulation
    users : Users
        Drawn from it.
    device : Device
    damping : float
        Virtual damping B in N s/m at which the limit is computed.
    share : float
        Share of users with whom the loop must be stable.
    grid : int
        Gains on each axis of the map, which spans the stable gains of the population's centre.
    seed : int
    workers : int
        Threads.
    progress : callable, optional

    Raises
    ------
    InputError
        If a number is outside of its range.
    """
    number_in(damping, "damping", at_least=0)
    number_in(share, "share", above=0, below=1)
    whole_number_in(grid, "grid", LEAST_GRID)
    whole_number_in(seed, "seed", 0)
    whole_number_in(workers, "workers", 1)
    limit = limit_of(population, users, device, damping, share=share, highest=_HIGHEST, seed=seed)
    stiffness, dampings = gains(population, device, grid, limit.stiffness / 2)
    found = stability_map(population, users, device, stiffness, dampings, seed=seed, workers=workers, progress=progress)
    why = reason(population, users, limit.worst, device, damping, _HIGHEST)
    felt = None
    if limit.stiffness > 0:
        frequency = np.geomspace(1.0, 0.49 / device.period_s, 120)
        felt = transparency(users, device, limit.stiffness / 2, damping, frequency)
    return DesignAnswer(found, limit, why, felt)


def gains(population: UserPopulation, device: Device, grid: int, lowest: float) -> tuple[np.ndarray, np.ndarray]:
    """Grid that spans the stable gains of the population's centre.

    Parameters
    ----------
    population : UserPopulation
    device : Device
    grid : int
        Number on each axis.
    lowest : float
        Stiffness in N/m that the grid must include, if it is above zero.

    Returns
    -------
    stiffness : ndarray, shape (grid,)
        In N/m, logarithmic.
    damping : ndarray, shape (grid,)
        In N s/m, quadratic spacing: denser at low damping.
    """
    centre = loop_of(device, population.median_user())
    scan = np.concatenate([[0.0], np.geomspace(1e-4, _LARGEST, _DAMPINGS)])
    soft = centre.inside(np.full((1, scan.size), 1.0), scan[None])[0]
    widest = float(scan[int(np.argmin(soft)) - 1]) if not soft.all() else float(scan[-1])
    damping = 1.03 * max(widest, 1e-3) * np.linspace(0.0, 1.0, grid) ** 2
    limits = [largest_stiffness(centre, float(b), _HIGHEST)[0][0] for b in damping]
    highest = max(1.2 * max(limits), 1.0)
    low = min(lowest, limits[0] / 2) if lowest > 0 else _GRID_LOW * highest
    return np.geomspace(max(low, 1e-4 * highest), highest, grid), damping
