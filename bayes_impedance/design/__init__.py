"""Design inputs: a population as something a device can be designed against.

- :mod:`.users`: virtual users, and the populations of the posterior that they may come from
- :mod:`.representatives`: few users who stand for many
- :mod:`.state_space`: networks in state space, many users at once; poles and zeros
- :mod:`.transfer_functions`: coefficients, poles, matrices; python-control
- :mod:`.two_port`: motors, levers, arms: chain, hybrid and impedance matrices
- :mod:`.additions`: operations of the catalogue as elements; ladders for power laws and layers
- :mod:`.spice`: sub-circuits in both analogies
- :mod:`.verified`: whether what is written is passive
- :mod:`.device`: a haptic device and its sampled controller
- :mod:`.sampled_loop`: poles of the sampled loop; :mod:`.one_row` finds them fast for many gains
- :mod:`.stability`: share of stable users, limits, and why the worst is the worst
- :mod:`.transparency`: what is felt against what was asked for
- :mod:`.answer`: all of it in one sentence; :mod:`.files` writes it down
"""

from bayes_impedance.design.additions import Built, built, power_law
from bayes_impedance.design.answer import DesignAnswer, design_answer
from bayes_impedance.design.device import PHANTOM, Device, Section, read_device
from bayes_impedance.design.representatives import Representatives, representatives
from bayes_impedance.design.sampled_loop import SampledLoop, largest_stiffness, sampled_loop
from bayes_impedance.design.stability import Limit, StabilityMap, limit_of, reason, stability_map
from bayes_impedance.design.state_space import Realisation, realise
from bayes_impedance.design.transfer_functions import read_control, to_control, transfer_function
from bayes_impedance.design.transparency import Transparency, transparency
from bayes_impedance.design.two_port import TwoPort
from bayes_impedance.design.users import Population, Users, percentile_curves, population_of

__all__ = [
    "PHANTOM",
    "Built",
    "DesignAnswer",
    "Device",
    "Limit",
    "Population",
    "Realisation",
    "Representatives",
    "SampledLoop",
    "Section",
    "StabilityMap",
    "Transparency",
    "TwoPort",
    "Users",
    "built",
    "design_answer",
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
