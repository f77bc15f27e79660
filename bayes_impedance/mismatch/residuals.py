r"""What is left of everybody's recordings when the model has done what it can.

With noise sd sigma (the person's own scale included) and z - Z stacked as real parts, then imaginary parts,

.. math:: r_{ij} = \begin{pmatrix}\operatorname{Re}(z_{ij} - Z(\hat\theta_{ij}))/\sigma_{ij}\\
          \operatorname{Im}(z_{ij} - Z(\hat\theta_{ij}))/\sigma_{ij}\end{pmatrix} \in \mathbb R^{2F}

is standard normal noise, less what the elements have absorbed. Everything here is looked at **outside of the tangent
space** :math:`\partial Z/\partial\theta` of each single recording: with Q an orthonormal basis of it,
:math:`(1 - QQ^T)\,r \sim N(0, 1 - QQ^T)` when nothing is missing, whatever the elements of that recording are and
however they are distributed between people.

Leaving the elements this free costs little power. Holding them to the population's distribution instead makes the
*shape* of that distribution part of the evidence: simulated populations with nothing missing then "show" a constant
stiffness at the port with z = -9.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PersonResiduals:
    """Whitened residuals of one person's J recordings on F frequencies.

    Attributes
    ----------
    name : str
    frequency_hz : ndarray, shape (F,)
    model : ndarray, complex, shape (J, F)
        Fitted impedance of each recording.
    sd : ndarray, shape (J, F)
        Noise of the real and of the imaginary part, the person's own scale included.
    white : ndarray, shape (J, 2 F)
        Residuals over sd: real parts, then imaginary parts.
    basis : ndarray, shape (J, 2 F, P)
        Orthonormal basis of what each recording's elements can absorb, in the same coordinates; columns of zeros
        where the band does not see an element.
    """

    name: str
    frequency_hz: np.ndarray
    model: np.ndarray
    sd: np.ndarray
    white: np.ndarray
    basis: np.ndarray

    def outside(self, vectors: np.ndarray) -> np.ndarray:
        """The part of whitened vectors (J, 2 F, ...) that no element can absorb, same shape."""
        inside = np.einsum("jfp,jf...->jp...", self.basis, vectors)
        return np.asarray(vectors - np.einsum("jfp,jp...->jf...", self.basis, inside))
