"""The command line.

In come arguments; out come folders of results, one line of progress and an exit status. Open :mod:`.cli` first
(arguments), then :mod:`.jobs` (what each command does) and :mod:`.export`.
"""
