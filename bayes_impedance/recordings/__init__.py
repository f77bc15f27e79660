"""Datasets: what was measured, for whom, how often, and the files that hold it.

In come folders of CSV, Parquet and TOML; out comes :class:`Recordings`, a tuple of subjects with complex impedances.
Open :mod:`.dataset` first (the data in memory), then :mod:`.files` (reading and writing), which calls
:mod:`.csv_table`, :mod:`.long_table`, :mod:`.metadata`, :mod:`.parquet`; :mod:`.repetitions` puts them on grids,
:mod:`.out_of_core` reads lazily.
"""

from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.files import read_recordings, write_recordings

__all__ = ["Recordings", "Subject", "read_recordings", "write_recordings"]
