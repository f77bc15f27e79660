"""How elements are distributed over people and repetitions: covariates, drift, groups, correlations.

In come everybody's quadratic likelihoods of the elements; out come tests, each with its held-out gain.
Open :mod:`.tests` first (all of them), then :mod:`.person_likelihoods` and :mod:`.reml` (the normal model),
:mod:`.bootstrap` (p-values), :mod:`.regression`, :mod:`.subgroups` with :mod:`.two_groups`, :mod:`.correlations`,
:mod:`.gain`.
"""
