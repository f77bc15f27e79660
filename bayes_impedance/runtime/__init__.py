"""Running computations: executors, atomic files, checkpoints, progress; checked user input.

Input: a module-level function and data of many persons. Output: results in the persons' order, on any executor.
Nothing here depends on impedance. Open :mod:`.executors` first, then :mod:`.sharded` (data that stay with the
workers), :mod:`.broadcast` (data sent to workers once), :mod:`.atomic_files` and :mod:`.checkpoint` (data that survive
a killed run), :mod:`.input_files` and :mod:`.user_table` (files and tables from users, read within bounds and checked).

Executors are imported at first use: they are not needed to report a wrong argument.
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
