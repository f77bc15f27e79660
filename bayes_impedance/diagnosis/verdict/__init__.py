"""The verdict: everything that was found, as it is reported.

In comes what search, location and tests have found; out comes the verdict and its sentences.
Open :mod:`.verdict` first, then :mod:`.entries` (one for each effect), :mod:`.ranking` (all candidates),
:mod:`.model_bands` (how well a model describes everybody) and :mod:`.sentence`.
"""
