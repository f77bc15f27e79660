"""The search: which candidates explain what is missing, and whether they can be named.

Input: a fitted network and the catalogue. Output: :class:`~.stepwise.Found`, the additions in the order they were
found. Open :mod:`.stepwise` first: it calls :mod:`.score_scan` (all candidates in one pass), :mod:`.shortlist` (refits;
:mod:`.far_starts` and :mod:`.in_some_people` begin elsewhere), :mod:`.finalists` (iterates the best to convergence),
:mod:`.compare` (which of two is better), :mod:`.one_sweep` (whether one sweep can show it) and :mod:`.what_remains`
(which leaves nothing); then :mod:`.restart`, :mod:`.unnamed`, :mod:`.identifiability`, :mod:`.cross_validation`.
"""
