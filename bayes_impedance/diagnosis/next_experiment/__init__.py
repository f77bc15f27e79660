"""Which measurement would tell two explanations apart.

In come two fitted models; out come expected separations in natural logarithms, and the best sentence.
Open :mod:`.expected_separation` first; :mod:`.virtual_recordings` says what each proposed experiment would record.
"""
