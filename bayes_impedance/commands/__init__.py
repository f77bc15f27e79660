"""The command line.

The input is arguments; the output is folders of results, one line of progress and an exit status. Open :mod:`.cli`
first, then :mod:`.arguments` (the arguments), :mod:`.jobs` (the work of the commands), :mod:`.export` and
:mod:`.simulate`.
"""
