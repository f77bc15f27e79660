"""Readers of files: each returns variables with units, without deciding what they mean.

Open :mod:`.registry` first: it chooses the reader by the suffix.
"""
