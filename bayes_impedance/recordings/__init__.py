"""Datasets: recordings of all subjects and repetitions, and their files.

Input: folders of CSV, Parquet and TOML files. Output: :class:`Recordings`, subjects with complex impedances.
Open :mod:`.dataset` first (the data in memory), then :mod:`.files` (reading and writing), which calls
:mod:`.csv_table`, :mod:`.long_table`, :mod:`.metadata`, :mod:`.parquet`; :mod:`.repetitions` finds common grids,
:mod:`.out_of_core` reads lazily.
"""

from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.files import read_recordings, write_recordings

__all__ = ["Recordings", "Subject", "read_recordings", "write_recordings"]
