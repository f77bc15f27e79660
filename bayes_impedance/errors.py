"""The exceptions that a caller may want to catch by name."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence for the person who supplied the input: where it is (file and row), what is wrong,
    and what to do about it. The command line prints it as it stands and exits with status 2.
    """


class WorkerError(RuntimeError):
    """Work that was lost with its worker again and again.

    The message is one sentence, like that of :class:`InputError`; the command line exits with status 1.
    """


class BusyError(RuntimeError):
    """A folder that another process writes to.

    The message is one sentence, like that of :class:`InputError`; the command line exits with status 1.
    """
