"""Design inputs: virtual users, circuits and stability limits from a population, for the design of haptic devices.

Input: a result. Output: users, circuits, stability limits and files. Open :mod:`.users` first (virtual users, and the
posterior draws of the population; :mod:`.body` takes the rig out of the network), then :mod:`.representatives` (a few
representative users), ``circuits`` (a user as a circuit), ``loop`` (a device held by a user), :mod:`.answer` (a summary
in one sentence) and :mod:`.files` (the output files).
"""

from bayes_impedance.design.answer import DesignAnswer, design_answer
from bayes_impedance.design.body import Body, body_of
from bayes_impedance.design.circuits.equivalent import Equivalent, NotRealisableError, equivalent
from bayes_impedance.design.circuits.ladders import Built, built, power_law
from bayes_impedance.design.circuits.state_space import Realisation, realise
from bayes_impedance.design.circuits.transfer_functions import read_control, to_control, transfer_function
from bayes_impedance.design.loop.device import PHANTOM, Device, Section, read_device
from bayes_impedance.design.loop.sampled_loop import SampledLoop, largest_stiffness, sampled_loop
from bayes_impedance.design.loop.stability import Limit, StabilityMap, limit_of, reason, stability_map
from bayes_impedance.design.loop.transparency import Transparency, transparency
from bayes_impedance.design.loop.two_port import TwoPort
from bayes_impedance.design.percentiles import percentile_curves
from bayes_impedance.design.representatives import Representatives, representatives
from bayes_impedance.design.users import UserPopulation, Users, population_of

__all__ = [
    "PHANTOM",
    "Body",
    "Built",
    "DesignAnswer",
    "Device",
    "Equivalent",
    "Limit",
    "NotRealisableError",
    "Realisation",
    "Representatives",
    "SampledLoop",
    "Section",
    "StabilityMap",
    "Transparency",
    "TwoPort",
    "UserPopulation",
    "Users",
    "body_of",
    "built",
    "design_answer",
    "equivalent",
    "largest_stiffness",
    "limit_of",
    "percentile_curves",
    "population_of",
    "power_law",
    "read_control",
    "read_device",
    "realise",
    "reason",
    "representatives",
    "sampled_loop",
    "stability_map",
    "to_control",
    "transfer_function",
    "transparency",
]
