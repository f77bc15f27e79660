"""Structure in the residuals of a fit: frequency bands, people, and the missing one-port.

In come whitened residuals of everybody; out come bands with family-wise error control and missing one-ports.
Open :mod:`.locate` first, then :mod:`.windows` (scan statistics) and :mod:`.nodes` (residuals pooled over people);
:mod:`.amplitudes` names the people who have it; :mod:`.sensitivity` and :mod:`.missing_impedance` look inside the
network.
"""
