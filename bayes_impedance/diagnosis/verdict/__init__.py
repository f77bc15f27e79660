"""The verdict: all findings, as they are reported.

Input: the results of search, location and tests. Output: the verdict and its sentences.
Open :mod:`.verdict` first, then :mod:`.entries` (one for each effect), :mod:`.ranking` (all candidates),
:mod:`.model_bands` (how well a model describes the recordings) and :mod:`.sentence`.
"""
