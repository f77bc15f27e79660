"""Population parameters of mechanical impedance networks, with honest uncertainty.

The public names, in the order of a session:

>>> from bayes_impedance import diagnose, fit_population, load_result, make_result, population_of, predict
>>> from bayes_impedance import read_recordings, save_result
>>> recordings = read_recordings("data/fingertip_71")
>>> fit = fit_population(recordings, seed=1)  # of the dataset's own network, or of one that is given
>>> fit.diagnostics.problems  # look here first
()
>>> save_result(make_result(fit, predict(fit), fit.seconds), "out")
>>> diagnose(recordings, seed=1, quick=True).verdict  # what the network leaves out
<Verdict: ...>
>>> users = population_of(load_result("out")).draw(1000, seed=1)  # to design against
>>> len(users)
1000

Names are imported when they are first used, so that ``import bayes_impedance`` costs nothing.
"""

import os
import sys


def _leave_working_directory() -> None:
    """``python -m bayes_impedance`` looks for modules in the working directory first; a file there is nobody's code.

    While Python looks for the package that ``-m`` names, the first argument is ``-m`` itself. A package that lies in
    the working directory itself is found there after all else. Nothing but what
    the interpreter has loaded already may be imported before this.
    """
    given = sys.orig_argv
    asked = (
        any(given[i : i + 2] == ["-m", "bayes_impedance"] for i in range(len(given))) or "-mbayes_impedance" in given
    )
    if sys.flags.safe_path or not asked or not sys.argv or sys.argv[0] != "-m":
        return
    directory = sys.path.pop(0)
    if __path__[0] == os.path.join(directory, "bayes_impedance"):
        sys.path.append(directory)


_leave_working_directory()

from importlib import import_module  # noqa: E402  (from a path that is now safe)
from typing import TYPE_CHECKING, Any  # noqa: E402

if TYPE_CHECKING:
    from bayes_impedance.classical import compare_methods, identify, map_to_network, vector_fit
    from bayes_impedance.design import PHANTOM, Device, Section, Users, design_answer, population_of, read_device
    from bayes_impedance.diagnosis import Diagnosis, diagnose, search_covariates
    from bayes_impedance.errors import InputError
    from bayes_impedance.intake import ImportSettings, import_recordings
    from bayes_impedance.network import PAPER_NETWORK, Element, Kernel, Network, parse
    from bayes_impedance.population import FitSettings, PopulationFit, fit_population
    from bayes_impedance.population.fingertip import FINGERTIP
    from bayes_impedance.population.given_prior import ElementPrior, GivenPrior, read_prior
    from bayes_impedance.population.sample_prior import sample_prior
    from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
    from bayes_impedance.quality import check_recordings, describe
    from bayes_impedance.recordings import Recordings, Subject, read_recordings, write_recordings
    from bayes_impedance.report import write_report
    from bayes_impedance.results import Predictive, Result, load_result, make_result, predict, save_result

_MODULES = {
    "check_recordings": "quality",
    "describe": "quality",
    "compare_methods": "classical",
    "identify": "classical",
    "map_to_network": "classical",
    "vector_fit": "classical",
    "PHANTOM": "design",
    "Device": "design",
    "Section": "design",
    "Users": "design",
    "design_answer": "design",
    "population_of": "design",
    "read_device": "design",
    "InputError": "errors",
    "ImportSettings": "intake",
    "import_recordings": "intake",
    "Kernel": "network",
    "PAPER_NETWORK": "network",
    "Element": "network",
    "Network": "network",
    "parse": "network",
    "FitSettings": "population",
    "PopulationFit": "population",
    "fit_population": "population",
    "Diagnosis": "diagnosis",
    "diagnose": "diagnosis",
    "search_covariates": "diagnosis",
    "Predictive": "results",
    "predict": "results",
    "Recordings": "recordings",
    "Subject": "recordings",
    "read_recordings": "recordings",
    "write_recordings": "recordings",
    "write_report": "report",
    "Result": "results",
    "load_result": "results",
    "make_result": "results",
    "save_result": "results",
    "ElementPrior": "population.given_prior",
    "GivenPrior": "population.given_prior",
    "read_prior": "population.given_prior",
    "sample_prior": "population.sample_prior",
    "FINGERTIP": "population.fingertip",
    "VirtualPopulation": "population.simulate",
    "simulate_recordings": "population.simulate",
}

__all__ = [
    "FINGERTIP",
    "PAPER_NETWORK",
    "PHANTOM",
    "Device",
    "Diagnosis",
    "Element",
    "ElementPrior",
    "FitSettings",
    "GivenPrior",
    "ImportSettings",
    "InputError",
    "Kernel",
    "Network",
    "PopulationFit",
    "Predictive",
    "Recordings",
    "Result",
    "Section",
    "Subject",
    "Users",
    "VirtualPopulation",
    "check_recordings",
    "compare_methods",
    "describe",
    "design_answer",
    "diagnose",
    "fit_population",
    "identify",
    "import_recordings",
    "load_result",
    "make_result",
    "map_to_network",
    "parse",
    "population_of",
    "predict",
    "read_device",
    "read_prior",
    "read_recordings",
    "sample_prior",
    "save_result",
    "search_covariates",
    "simulate_recordings",
    "vector_fit",
    "write_recordings",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'bayes_impedance' has no attribute '{name}'")
    return getattr(import_module(f"bayes_impedance.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
