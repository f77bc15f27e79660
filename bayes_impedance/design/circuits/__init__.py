"""A user as a circuit: state space, transfer functions, SPICE, ladders for fractional elements.

In come users (elements of a network); out come realisations and files of other programs, certified passive.
Open :mod:`.state_space` first, then :mod:`.transfer_functions`, :mod:`.spice`, :mod:`.ladders` and
:mod:`.passivity_check`.
"""
