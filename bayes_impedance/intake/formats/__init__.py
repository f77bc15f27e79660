"""Formats: other people's files, read without deciding what their variables mean.

Input: a file, by its path. Output: the file's variables with their units and texts
(:class:`~bayes_impedance.intake.contents.Contents`). Open :mod:`.registry` first: it chooses the reader by the suffix.
"""
