"""Design of the next experiment: which measurement would separate two explanations.

Input: two fitted models. Output: expected separations in natural logarithms, and a sentence with the best proposal.
Open :mod:`.expected_separation` first; :mod:`.virtual_recordings` predicts the recordings of each proposed experiment.
"""
