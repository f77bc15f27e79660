"""What a fit leaves: where it is, how large, and which one-port would close the gap.

In come whitened residuals of everybody; out come bands with family-wise error control and missing one-ports.
Open :mod:`.locate` first, then :mod:`.windows` (scan statistics) and :mod:`.nodes` (residuals pooled over people);
:mod:`.amplitudes` says who carries a misfit, :mod:`.sensitivity` and :mod:`.missing_impedance` look inside the network.
"""
