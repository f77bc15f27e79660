"""How many draws are made for each person where the first ones leave too large an error for a chain's populations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_MOST, _MOST_OF_FEW, _DRAWS_OF_ALL = 8, 16, 2**14
"""Largest factor on the number of draws: the second if at first all persons together had no more than the third. By
choice, for time: sampling takes as many times longer. With 8 an error of 0.2 to 0.4 fell to 0.1 to 0.12 in narrow
bands, not quite what is wanted, with 16 to 0.06 to 0.08 (24 persons)."""
_MOST_SHARED = 4
"""The same where parameters are shared by all. By choice, for time: each draw is computed at up to 86 points."""
_FEWEST = 2
"""Least such factor, where other draws alone will not do. By choice: it is a power of two."""


@dataclass(frozen=True, kw_only=True)
class DrawsAgain:
    """How many draws there are.

    Attributes
    ----------
    first, last : int
        For each person, at first and now.
    n_persons : int
    shared : bool
        Whether there are parameters that are the same for everybody.
    """

    first: int
    last: int
    n_persons: int
    shared: bool

    def number(self, excess: float, farther: bool) -> int:
        """For each person, a power of two as the first number is.

        Parameters
        ----------
        excess : float
            The error in units of the wanted one.
        farther : bool
            Whether the range of dispersions between repetitions has moved: if the error is small, that will do.
        """
        most = _MOST_OF_FEW if self.first * self.n_persons <= _DRAWS_OF_ALL else _MOST
        if self.shared:
            most = min(most, _MOST_SHARED)
        fewest = 1 if farther and excess <= 1 else _FEWEST
        needed = self.last * np.clip(excess**2, fewest, most)
        return int(min(most * self.first, 2 ** int(np.ceil(np.log2(needed)))))
