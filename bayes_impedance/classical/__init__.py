"""The paper's methods: fits of single curves, look-up tables, rational functions, and the mapping onto a network.

Input: recordings, or one curve. Output: elements, rational functions and tables, each method's own. Open
:mod:`.methods` first, which applies all of them to one dataset:

==========================  =======================================================================================
:mod:`.elementwise`         each subject's elements from magnitudes, phases or complex values; their mean or median
:mod:`.system_identification`  a rational function of given orders by complex least squares (SIT)
:mod:`.vector_fitting`      poles and residues by relaxed vector fitting (VF); :mod:`.order` chooses how many
:mod:`.passivity`           whether a rational function is a passive impedance, and the nearest one that is
:mod:`.mapping`             a rational function mapped onto a network
:mod:`.normality`           whether impedances are normally distributed over people
:mod:`.methods`             all of them on one set of recordings
==========================  =======================================================================================
"""

from bayes_impedance.classical.coefficients import CoefficientEquations, ExactSolution, exact_solutions
from bayes_impedance.classical.elementwise import ElementwiseFit, fit_elements, with_magnitude_of
from bayes_impedance.classical.mapping import NetworkMapping, map_to_network
from bayes_impedance.classical.methods import Method, MethodComparison, compare_methods
from bayes_impedance.classical.normality import Normality, normality
from bayes_impedance.classical.order import OrderSelection, select_order
from bayes_impedance.classical.passivity import Passivity, check_passivity, enforce_passivity
from bayes_impedance.classical.pole_residue import PoleResidue, partial_fractions
from bayes_impedance.classical.system_identification import Identification, identify
from bayes_impedance.classical.vector_fitting import VectorFit, vector_fit

__all__ = [
    "CoefficientEquations",
    "ElementwiseFit",
    "ExactSolution",
    "Identification",
    "Method",
    "MethodComparison",
    "NetworkMapping",
    "Normality",
    "OrderSelection",
    "Passivity",
    "PoleResidue",
    "VectorFit",
    "check_passivity",
    "compare_methods",
    "enforce_passivity",
    "exact_solutions",
    "fit_elements",
    "identify",
    "map_to_network",
    "normality",
    "partial_fractions",
    "select_order",
    "vector_fit",
    "with_magnitude_of",
]
