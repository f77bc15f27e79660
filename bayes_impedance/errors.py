"""Exceptions that a caller may want to catch by name."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence for the person who supplied the input: where it is (file and row), what is wrong,
    and what to do about it. The command line prints it as it stands and exits with status 2.
    """


class ConvergenceError(RuntimeError):
    """A computation that did not reach the accuracy it is required to have.

    Attributes
    ----------
    problems : tuple of str
        One sentence for each diagnostic that failed, the worst first.
    """

    def __init__(self, problems: tuple[str, ...]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems
