"""How work is run: executors, files that are complete or absent, checkpoints, progress.

In come a function of a module and data of many persons; out come results in the persons' order, whoever has worked.
Nothing here knows about impedance. Open :mod:`.executors` first, then :mod:`.sharded` (data that stay with the
workers), :mod:`.broadcast` (data lent to workers), :mod:`.atomic_files` and :mod:`.checkpoint` (what survives a killed
run).
"""

from bayes_impedance.runtime.executors import executor_of

__all__ = ["executor_of"]
