"""Hum of the mains: lines at 50 or 60 Hz and multiples.

Input: whitened residuals. Output: :class:`~.line.Hum` with line frequency, amplitude and affected points.
Open :mod:`.line` first; :mod:`.neighbours` compares a point with its neighbours, :mod:`.leakage` finds hum that the
analyser's window spreads over several points.
"""
