"""All methods of the paper's section 4.2 on one set of recordings, compared with this package's own.

Each gives one curve for the whole population, and eq. 5 measures its error against each subject's curve.

=======================  ==========================================================================================
the paper's words        what is done here
=======================  ==========================================================================================
amplitude, Mean, Median  magnitudes of each person's mean recording fitted by Levenberg-Marquardt; mean or median of
                         every element
phase, Mean, Median      the same with phases, which leave the common scale of the elements open: it stays that of the
                         start. Two further rows take it from the magnitudes
LuT Mean, Median         no model: mean or median over people at every frequency, magnitude and phase apart
VFMean, VFMedian         vector fitting of these two curves with weights 1/abs(z), as many poles as the network has, all
                         of them free
SIT                      a rational function of the network's orders with its pole at 0, complex least squares without
                         weights as a toolbox does by default
(not in the paper)       element-wise fits of the complex impedance; the centre of the population network; the
                         pointwise median of the posterior predictive
=======================  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.classical.coefficients import CoefficientEquations
from bayes_impedance.classical.elementwise import ElementwiseFit, fit_elements, with_magnitude_of
from bayes_impedance.classical.mapping import NetworkMapping, map_to_network
from bayes_impedance.classical.normality import MINIMUM_PEOPLE, Normality, normality
from bayes_impedance.classical.passivity import Passivity, check_passivity
from bayes_impedance.classical.system_identification import identify
from bayes_impedance.classical.vector_fitting import vector_fit
from bayes_impedance.display import Brief, heading, joined, lines, short, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.curve_errors import ErrorCurves, common_grid, error_curves, lookup_table, on_grid
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.units import counted

if TYPE_CHECKING:
    import pandas as pd

MAGNITUDES, PHASES, TABLES = "fitted to magnitudes", "fitted to phases", "look-up table"
RATIONAL, COMPLEX, OURS = "rational function", "fitted to complex values", "population posterior"
FAMILIES = (MAGNITUDES, PHASES, TABLES, RATIONAL, COMPLEX, OURS)
"""Families of methods, by the data they use or the kind of model."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Method(Brief):
    """One curve for the population, and how it was found.

    Attributes
    ----------
    id : str
        Short and stable.
    label : str
    paper : str
        Its name in fig. 4 of the paper; empty if it is not in the figure.
    family : str
        One of :data:`FAMILIES`.
    curve : ndarray, complex, shape (F,)
        Magnitude and phase of the model.
    errors : ErrorCurves
        Eq. 5.
    elements : dict of str to float, or None
        Elements of the network, if the method gives any.
    stopped : dict of str to int
        Number of subjects for whom an element diverged to its bound, because the curve does not determine it.
    transfer : TransferFunction or None
    passivity : Passivity or None
        Of the rational function, over the whole frequency axis.
    """

    id: str
    label: str
    paper: str
    family: str
    curve: np.ndarray
    errors: ErrorCurves
    elements: dict[str, float] | None = None
    stopped: dict[str, int] | None = None
    transfer: TransferFunction | None = None
    passivity: Passivity | None = None

    def summary(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "id": self.id,
            "label": self.label,
            "in_the_paper": self.paper or None,
            "family": self.family,
            **self.errors.summary(),
            "elements": self.elements,
            "stopped": self.stopped,
            "numerator": None if self.transfer is None else [float(c) for c in self.transfer.numerator],
            "denominator": None if self.transfer is None else [float(c) for c in self.transfer.denominator],
            "positive_real": None if self.passivity is None else self.passivity.positive_real,
            "not_positive_real_because": None if self.passivity is None else list(self.passivity.reasons),
        }


@dataclass(frozen=True, kw_only=True)
class MethodComparison:
    """All methods on one set of recordings.

    Attributes
    ----------
    title, unit, network : str
    frequency_hz : ndarray, shape (F,)
    observed : ndarray, complex, shape (N, F)
        Mean recording of each subject.
    methods : tuple of Method
    normality : Normality or None
        None with too few subjects for a test.
    mapping : NetworkMapping
        Mapping of the system identification's rational function onto the network.
    problems : tuple of str
        Why the population posterior's rows must not be used.
    """

    title: str
    unit: str
    network: str
    frequency_hz: np.ndarray
    observed: np.ndarray
    methods: tuple[Method, ...]
    normality: Normality | None
    mapping: NetworkMapping
    problems: tuple[str, ...]

    def __repr__(self) -> str:
        count = f"{counted(len(self.methods), 'method')}, {counted(len(self.observed), 'subject')}"
        return f"<MethodComparison of {short(self.title)}: {count}>"

    def _repr_html_(self) -> str:
        frame = self.to_dataframe()
        units = frame.attrs["units"]
        columns = ["method", *(f"{name} in {unit}" for name, unit in units.items()), "passive"]
        rows = [
            (row["label"], *(float(row[name]) for name in units), _yes_or_no(row["positive_real"]))
            for _, row in frame.iterrows()
        ]
        return joined(heading(repr(self).strip("<>")), lines(self.problems), table(columns, rows))

    def method(self, id: str) -> Method:
        """The method with this id.

        Raises
        ------
        KeyError
            If there is none.
        """
        return {m.id: m for m in self.methods}[id]

    def csv(self) -> str:
        """The table as text, one line for each method."""
        return self.to_dataframe().to_csv(lineterminator="\n")

    def to_dataframe(self) -> pd.DataFrame:
        """The table of methods.

        Returns
        -------
        DataFrame
            One row for each method, whose id is the index. Columns label, in_the_paper and family; mean and standard
            deviation over frequency of the errors of eq. 5, with their units in ``attrs["units"]``; positive_real
            (whether the curve belongs to a passive port), missing where a method has no rational function.
        """
        import pandas as pd

        errors = list(self.methods[0].errors.summary())
        columns = ["id", "label", "in_the_paper", "family", *errors, "positive_real"]
        frame = pd.DataFrame([m.summary() for m in self.methods], columns=columns).set_index("id")
        frame = frame.astype({"positive_real": "boolean"})
        frame.attrs["units"] = {name: "deg" if "phase" in name else self.unit for name in errors}
        return frame

    def summary(self) -> dict[str, Any]:
        """For ``comparison.json``."""
        return {
            "schema": 1,
            "problems": list(self.problems),
            "title": self.title,
            "unit": self.unit,
            "network": self.network,
            "subjects": int(self.observed.shape[0]),
            "frequencies": int(self.frequency_hz.size),
            "methods": [m.summary() for m in self.methods],
            "normality": None if self.normality is None else _without_nan(self.normality.summary()),
            "mapping_of_sit": self.mapping.summary(),
        }


def compare_methods(
    recordings: Recordings,
    result: Result,
    *,
    seed: int = 1,
    progress: Progress = lambda *_: None,
) -> MethodComparison:
    """Run the paper's methods on recordings, and compare them with a finished population fit of the same.

    Parameters
    ----------
    recordings : Recordings
    result : Result
        The fit; names the network.
    seed : int
        Of the element-wise fits' random starts.
    progress : callable, optional

    Raises
    ------
    InputError
        If the result is of other recordings.
    """
    if [str(s) for s in result.coords["subject"]] != list(recordings.names):
        raise InputError("the finished fit is of other subjects: fit these recordings, or give the folder of their fit")
    network = parse(result.attributes["network"])
    frequency = common_grid(recordings)
    observed = on_grid(recordings, frequency)
    bench = _Bench(
        recordings=recordings, network=network, frequency_hz=frequency, observed=observed, result=result, seed=seed
    )
    stages: tuple[Callable[[], list[Method]], ...] = (
        bench.magnitudes,
        bench.phases,
        bench.tables,
        bench.rational,
        bench.complex_fits,
        bench.posterior,
    )
    methods: list[Method] = []
    for i, stage in enumerate(stages):
        progress("the paper's methods", i, len(stages) + 1)
        methods += stage()
    progress("the paper's methods", len(stages), len(stages) + 1)
    sit = next(m for m in methods if m.id == "sit")
    assert sit.transfer is not None  # it is a rational function
    mapping = map_to_network(sit.transfer, network, frequency, unit=recordings.unit, seed=seed)
    progress("the paper's methods", len(stages) + 1, len(stages) + 1)
    return MethodComparison(
        title=recordings.title,
        unit=recordings.unit,
        network=str(network),
        frequency_hz=frequency,
        observed=observed,
        methods=tuple(methods),
        normality=normality(observed) if len(recordings) >= MINIMUM_PEOPLE else None,
        mapping=mapping,
        problems=tuple(result.problems),
    )


@dataclass(frozen=True, kw_only=True)
class _Bench:
    """Data and settings shared by all methods."""

    recordings: Recordings
    network: Network
    frequency_hz: np.ndarray
    observed: np.ndarray
    result: Result
    seed: int

    def magnitudes(self) -> list[Method]:
        fit = fit_elements(self.recordings, self.network, "magnitude", seed=self.seed)
        return self._elementwise("magnitude", "magnitude fit", "amplitude, ", MAGNITUDES, fit)

    def phases(self) -> list[Method]:
        fit = fit_elements(self.recordings, self.network, "phase", seed=self.seed)
        scaled = with_magnitude_of(fit, self.recordings, self.network)
        return [
            *self._elementwise("phase", "phase fit", "phase, ", PHASES, fit),
            *self._elementwise("phase_scaled", "phase fit, scale from |z|", "", PHASES, scaled),
        ]

    def tables(self) -> list[Method]:
        methods = []
        for statistic in ("mean", "median"):
            curve = self._table(statistic)
            methods.append(
                self._method(
                    f"lookup_{statistic}", f"look-up table, {statistic}", f"LuT {statistic.capitalize()}", TABLES, curve
                )
            )
        return methods

    def rational(self) -> list[Method]:
        n_zeros, n_poles, at_zero = _orders(self.network)
        methods = []
        for statistic in ("mean", "median"):
            vf = vector_fit(
                self.frequency_hz,
                self._table(statistic),
                n_poles,
                constant=n_zeros >= n_poles,
                linear=n_zeros > n_poles,
            )
            methods.append(
                self._rational(
                    f"vector_fitting_{statistic}",
                    f"vector fitting, {statistic}",
                    f"VF{statistic.capitalize()}",
                    vf.model.transfer_function(),
                    check_passivity(vf.model),
                )
            )
        sit = identify(self.frequency_hz, self.observed, n_zeros, n_poles, pole_at_zero=at_zero, weighting="none")
        passivity = check_passivity(sit.transfer)
        return [*methods, self._rational("sit", "system identification", "SIT", sit.transfer, passivity)]

    def complex_fits(self) -> list[Method]:
        fit = fit_elements(self.recordings, self.network, "complex", weighting="relative", seed=self.seed)
        return self._elementwise("complex", "complex fit", "", COMPLEX, fit)

    def posterior(self) -> list[Method]:
        constant = self.result.groups["constant_data"]
        central = {
            name: entry["central"]["median"]
            for name, entry in self.result.summary["elements"].items()
            if entry["central"]["median"] is not None
        }
        centre, predicted = constant["network_curve"], constant["band_recording"][:, 2]
        return [
            self._method("population_network", "population network", "", OURS, _polar(*centre), elements=central),
            self._method("posterior_predictive", "posterior predictive, median", "", OURS, _polar(*predicted)),
        ]

    def _table(self, statistic: str) -> np.ndarray:
        return _polar(*lookup_table(self.observed, statistic))

    def _elementwise(self, id: str, label: str, paper: str, family: str, fit: ElementwiseFit) -> list[Method]:
        kernel = Kernel(self.network)
        stopped = dict(zip(fit.elements, fit.stopped.sum(axis=0).tolist(), strict=True))
        methods = []
        for statistic, elements in (("mean", fit.mean()), ("median", fit.median())):
            curve = kernel.impedance(np.log([elements[e] for e in fit.elements]), self.frequency_hz)
            name = f"{paper}{statistic.capitalize()}" if paper else ""
            label_here = f"{label}, {statistic}"
            methods.append(
                self._method(f"{id}_{statistic}", label_here, name, family, curve, elements=elements, stopped=stopped)
            )
        return methods

    def _rational(self, id: str, label: str, paper: str, transfer: TransferFunction, passivity: Passivity) -> Method:
        curve = transfer(2j * np.pi * self.frequency_hz)
        return self._method(id, label, paper, RATIONAL, curve, transfer=transfer, passivity=passivity)

    def _method(self, id: str, label: str, paper: str, family: str, curve: np.ndarray, **more: Any) -> Method:
        errors = error_curves(np.abs(curve), np.angle(curve, deg=True), self.observed)
        return Method(id=id, label=label, paper=paper, family=family, curve=curve, errors=errors, **more)


def _without_nan(values: dict[str, float]) -> dict[str, float | None]:
    return {k: v if np.isfinite(v) else None for k, v in values.items()}


def _yes_or_no(value: object) -> str | None:
    """Of a truth value that may be missing (pandas.NA)."""
    return ("yes" if value else "no") if isinstance(value, bool | np.bool_) else None


def _polar(magnitude: np.ndarray, phase_deg: np.ndarray) -> np.ndarray:
    return np.asarray(magnitude * np.exp(1j * np.radians(phase_deg)))


def _orders(network: Network) -> tuple[int, int, bool]:
    """Degrees of a network's numerator and denominator, and whether it has a pole at 0."""
    names = CoefficientEquations.of(network).names
    degree = {letter: max(int(n[1:]) for n in names if n[0] == letter) for letter in "ab"}
    return degree["b"], degree["a"], "a0" not in names
