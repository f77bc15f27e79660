"""Intake: raw signals and other people's files to recordings.

Input: files of spectra in any of six forms, or of force and motion signals. Output: :class:`Imported`, recordings with
their noise, and how to do it again. Open :mod:`.importing` first (the whole job). It reads files (:mod:`.formats`,
:mod:`.text_tables`) to variables (:mod:`.contents`), finds out which variable is what (:mod:`.columns`,
:mod:`.recipes`, :mod:`.names`), makes impedances of spectra (:mod:`.spectra`, :mod:`.quantities`) or of signals
(:mod:`.signals`, which calls the estimators :mod:`.periodic`, :mod:`.stepped_sine`, :mod:`.averaged_spectra` and
:mod:`.local_polynomial`), takes the rig out by runs with known loads (:mod:`.calibrating`, with the maps
:mod:`.two_port` and :mod:`.smooth_rig`), and puts the repetitions of each person together (:mod:`.assembly`).
"""

from bayes_impedance.intake.importing import Imported, ImportSettings, import_recordings

__all__ = ["ImportSettings", "Imported", "import_recordings"]
