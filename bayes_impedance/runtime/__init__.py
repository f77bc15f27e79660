"""How work is run: executors, files that are complete or absent, checkpoints, progress; what users give, checked.

In come a function of a module and data of many persons; out come results in the persons' order, whoever has worked.
Nothing here knows about impedance. Open :mod:`.executors` first, then :mod:`.sharded` (data that stay with the
workers), :mod:`.broadcast` (data lent to workers), :mod:`.atomic_files` and :mod:`.checkpoint` (what survives a killed
run), :mod:`.input_files` and :mod:`.user_table` (files and tables that a user gives, read within bounds and checked).

Executors are imported when they are first used: to tell somebody that an argument is wrong needs none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_impedance.runtime.executors import executor_of

__all__ = ["executor_of"]


def __getattr__(name: str) -> Any:
    if name != "executor_of":
        raise AttributeError(f"module 'bayes_impedance.runtime' has no attribute '{name}'")
    from bayes_impedance.runtime.executors import executor_of

    return executor_of
