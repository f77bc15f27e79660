"""The command line.

In come arguments; out come folders of results, one line of progress and an exit status. Open :mod:`.cli` first,
then :mod:`.arguments` (what may be given), :mod:`.jobs` (what the commands do), :mod:`.export` and :mod:`.simulate`.
"""
