"""What the network leaves out: where recordings and model differ, which physics is missing, and how much it helps.

The way through the rooms: a network with additions (``effects``, ``catalogue``, ``model``, ``places``) is fitted to
everybody (``equations``, ``refit``); what is left (``residuals``) is located (``locate`` and its neighbours,
``inversion``) and compared with every candidate (``screen``); the best are refitted (``confirm``, ``search``),
measured (``coefficients``; ``surface`` and ``surrogate`` for what is the body's; ``held_out``), said to be the rig's or
the body's (``sides``), told from each other (``proposals``) or replaced by a small network (``unknown``); names that
do not hold are taken back (``naming``), and if none is left the search begins elsewhere (``corrected``); ``diagnose``
makes a verdict of it.
"""

from bayes_impedance.mismatch.diagnose import diagnose
from bayes_impedance.mismatch.diagnosis import Diagnosis
from bayes_impedance.mismatch.effects import Coefficient, Effect, register, registered, unregister

__all__ = ["Coefficient", "Diagnosis", "Effect", "diagnose", "register", "registered", "unregister"]
