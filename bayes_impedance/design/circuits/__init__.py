"""A user as a circuit: state space, transfer functions, SPICE, ladders for fractional elements.

Input: users (elements of a network). Output: realisations and files for other programs, checked for passivity.
Open :mod:`.equivalent` first (any users as masses, compliances and dampers, with the ladders of :mod:`.fractional`),
then :mod:`.state_space`, :mod:`.transfer_functions`, :mod:`.spice`, :mod:`.ladders` (for operations of the diagnosis)
and :mod:`.passivity_check`.
"""
