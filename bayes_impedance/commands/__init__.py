"""The command line.

Input: arguments. Output: folders of results, one line of progress and an exit status. Open :mod:`.cli` first, then
:mod:`.arguments` (the arguments), :mod:`.jobs` (the work of ``run``, ``fit``, ``check``, ``report`` and ``diagnose``),
:mod:`.comparison` and :mod:`.network_comparison` (``compare``), :mod:`.export`, :mod:`.simulate`;
:mod:`.result_folders` says what may be replaced, :mod:`.terminal` what is printed.
"""
