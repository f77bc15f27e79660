"""Structure in the residuals of a fit: frequency bands, people, and the missing one-port.

Input: whitened residuals of all people. Output: bands with family-wise error control, and missing one-ports.
Open :mod:`.locate` first, then :mod:`.windows` (scan statistics) and :mod:`.nodes` (residuals pooled over people);
:mod:`.amplitudes` finds the people who have a structure; :mod:`.absolute_fit` says whether the model describes
everybody; :mod:`.sensitivity` and :mod:`.missing_impedance` refer what is missing to places inside the network.
"""
