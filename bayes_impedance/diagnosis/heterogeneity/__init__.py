"""Distribution of the elements over people and repetitions: covariates, drift, groups, correlations.

Input: the quadratic likelihood of each person's elements. Output: tests, with held-out gains of covariates and drift.
Open :mod:`.tests` first (all of them), then :mod:`.person_likelihoods` and :mod:`.reml` (the normal model),
:mod:`.bootstrap` (p-values), :mod:`.regression` (on covariates) and :mod:`.within_persons` (drift, circumstances)
with their :mod:`.trends`, :mod:`.subgroups` with :mod:`.two_groups`, :mod:`.correlations`,
:mod:`.gain`; :mod:`.compare_populations` compares a claimed simulation with the recordings.
"""
