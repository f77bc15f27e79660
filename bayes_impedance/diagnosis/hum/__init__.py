"""Hum of the mains: lines at 50 or 60 Hz and multiples.

In come whitened residuals; out comes :class:`~.line.Hum` with line, amplitude and the points it has spoilt.
Open :mod:`.line` first; :mod:`.neighbours` compares a point with its neighbours, :mod:`.leakage` finds hum that the
analyser's window has spread over several points.
"""
