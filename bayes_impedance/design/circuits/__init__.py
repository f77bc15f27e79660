"""A user as a circuit: state space, transfer functions, SPICE, ladders for fractional elements.

The input is users (elements of a network); the output is realisations and files for other programs, checked for
passivity.
Open :mod:`.state_space` first, then :mod:`.transfer_functions`, :mod:`.spice`, :mod:`.ladders` and
:mod:`.passivity_check`.
"""
