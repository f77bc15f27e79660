"""Networks of masses, springs, dampers and more: notation and computation.

Input: notation such as ``(n3|r3)-(m2|r1|n1)``, or circuits such as ``R0-p(R1,CPE1)``. Output: impedance over frequency
with its derivatives. Open :mod:`.notation` first (the text), then :mod:`.tree` and :mod:`.elements` (mass, compliance,
damper), :mod:`.parameters` and :mod:`.constructs` (power laws, wrappers; what is shared or held), :mod:`.program` (the
network as arrays) and :mod:`.kernel` (compiled evaluation). :mod:`.electrical` reads and prints circuits,
and :mod:`.spellings` says where the user is shown both spellings.
:mod:`.operations` is the table of operations on the impedance of a place, :mod:`.transform` their formulas
(:mod:`.own_motion` that of an element which follows its motion), :mod:`.rational` the network as a ratio of
polynomials. :mod:`.redundancy` says what no recording can tell apart, :mod:`.passivity` whether a network is passive by
construction. :mod:`.schematic` draws it.

The kernel is imported at first use: the notation alone needs no compiler.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayes_impedance.network.notation import PAPER_NETWORK, Element, Network, parse

if TYPE_CHECKING:
    from bayes_impedance.network.kernel import Kernel

__all__ = ["PAPER_NETWORK", "Element", "Kernel", "Network", "parse"]


def __getattr__(name: str) -> Any:
    if name != "Kernel":
        raise AttributeError(f"module 'bayes_impedance.network' has no attribute '{name}'")
    from bayes_impedance.network.kernel import Kernel

    return Kernel
