"""Pictures of a finished run. They show the numbers of the result and compute no new ones.

Input: a result or a diagnosis. Output: matplotlib figures, and files of them. Open :mod:`.access` first (what pictures
read from a result), then :mod:`.parameters`, :mod:`.joint` (elements), :mod:`.spectra` (curves and errors),
:mod:`.missing_physics`, :mod:`.comparison`, :mod:`.design`, :mod:`.paper`; :mod:`.style` holds colours and axes.

Each picture is a function that draws into the matplotlib Figure or Axes it is given, and returns it. Draw inside
:func:`style`, which sets their common style and restores matplotlib's settings afterwards::

    with style():
        figure = bands(new_figure(8, 8), result)
        figure.savefig("bands.png")

:mod:`.quick` needs no prepared figure: ``plot_bode``, ``plot_nyquist``, ``plot_person`` and ``plot_predictive_check``
return the axes that they are given or have made. :func:`write_pictures` writes all that apply to a run. Those of
:mod:`bayes_impedance.plots.paper` show measured curves with models from any source and need no run;
:func:`save_figure` writes them. matplotlib is imported when the first picture is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.plots.access import identified, subjects, variable
from bayes_impedance.plots.comparison import COMPARISON_PICTURES
from bayes_impedance.plots.joint import corner_central, corner_dispersion
from bayes_impedance.plots.missing_physics import DIAGNOSIS_PICTURES
from bayes_impedance.plots.paper import all_curves, bode, error_bars
from bayes_impedance.plots.parameters import correlation, forest, overview, priors, traces
from bayes_impedance.plots.quick import plot_bode, plot_nyquist, plot_person, plot_predictive_check
from bayes_impedance.plots.spectra import bands, coverage, curves, errors, noise
from bayes_impedance.plots.style import new_figure, style
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.atomic_files import replacing

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.figure import Figure

    from bayes_impedance.classical import MethodComparison
    from bayes_impedance.diagnosis.types import Diagnosis

__all__ = [
    "PICTURES",
    "Picture",
    "all_curves",
    "bands",
    "bode",
    "corner_central",
    "corner_dispersion",
    "correlation",
    "coverage",
    "curves",
    "error_bars",
    "errors",
    "forest",
    "new_figure",
    "noise",
    "overview",
    "plot_bode",
    "plot_nyquist",
    "plot_person",
    "plot_predictive_check",
    "priors",
    "save_figure",
    "style",
    "traces",
    "write_comparison",
    "write_diagnosis_pictures",
    "write_pictures",
]

_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
"""Metadata of each file format, without dates and versions: the same figure gives the same bytes."""
_DPI = 130
"""Dots per inch of PNG files. By choice: sharpness against file size."""
_WIDTH = 8.2
"""Width of a figure in inches. By choice: about a page, so that letters in pictures are as large as the page's text."""


@dataclass(frozen=True, repr=False)
class Picture(Brief):
    """One picture of a run.

    Attributes
    ----------
    name : str
        Name of its files, without suffix.
    draw : callable
        Draws a result into a figure.
    size : callable
        Returns width and height in inches for a result.
    applies : callable
        Returns whether the result has the quantities that the picture shows.
    constrained : bool
        Whether matplotlib's constrained layout arranges the panels.
    """

    name: str
    draw: Callable[[Figure, Result], object]
    size: Callable[[Result], tuple[float, float]]
    applies: Callable[[Result], bool] = lambda _: True
    constrained: bool = True

    def figure(self, result: Result) -> Figure:
        """The finished picture; call inside :func:`style`."""
        figure = new_figure(*self.size(result), constrained=self.constrained)
        self.draw(figure, result)
        _arrange(figure)
        return figure


def _fixed(height: float, width: float = _WIDTH) -> Callable[[Result], tuple[float, float]]:
    return lambda _: (width, height)


def _per_element(base: float, each: float, width: float = _WIDTH) -> Callable[[Result], tuple[float, float]]:
    return lambda result: (width, base + each * len(result.elements))


def _corner_size(result: Result) -> tuple[float, float]:
    side = max(4.0, 1.7 + 1.0 * int(identified(result).sum()))
    return side, side


def _known(result: Result) -> int:
    return int(identified(result).sum())


def _dispersed(result: Result) -> bool:
    return variable(result, "dispersion_between_persons") is not None and _known(result) > 0


def _correlated(result: Result) -> bool:
    # In a diagonal model all correlations are zero: no picture is needed.
    return result.attributes.get("covariance") != "diagonal" and _dispersed(result) and _known(result) > 1


def _noise_height(result: Result) -> tuple[float, float]:
    return _WIDTH, 6.2 if len(subjects(result)) > 1 else 3.4


PICTURES: tuple[Picture, ...] = (
    Picture("curves", curves, _fixed(6.0)),
    Picture("bands", bands, _fixed(8.6)),
    Picture("corner_central", corner_central, _corner_size, lambda r: _known(r) > 0, constrained=False),
    Picture("corner_dispersion", corner_dispersion, _corner_size, _dispersed, constrained=False),
    Picture("overview", overview, _per_element(1.2, 0.42), lambda r: _known(r) > 0),
    Picture("correlation", lambda figure, r: correlation(figure.subplots(), r), _fixed(4.6, 6.2), _correlated),
    Picture("forest", forest, lambda r: (_WIDTH, 0.5 + 2.0 * ((len(r.elements) + 1) // 2)), _dispersed),
    Picture("errors", errors, _fixed(6.0)),
    Picture("coverage", coverage, _fixed(5.4), lambda r: len(subjects(r)) > 1),
    Picture("noise", noise, _noise_height),
    Picture("traces", traces, _per_element(0.9, 0.8), lambda r: _known(r) > 0),
    Picture("priors", priors, _per_element(1.2, 0.55)),
)
"""All pictures of a run. Heights and sizes are in inches. By choice, for legibility."""


_HERE = ("corner_central", "corner_dispersion", "curves", "bands", "noise")
"""Pictures drawn in this process if there is a helper: half of the work, including those that need ArviZ, which is
already imported here."""


def write_pictures(result: Result, folder: str | os.PathLike[str], helper: Executor | None = None) -> dict[str, Path]:
    """Write every picture that applies, as PNG and as SVG.

    The same result gives the same bytes. A picture appears under its name only when it is complete.

    Parameters
    ----------
    result : Result
    folder : path
        Made if it does not exist.
    helper : Executor, optional
        Another process, which draws some of them; threads would block each other.

    Returns
    -------
    dict of str to Path
        Name of the picture to its PNG file; the SVG is beside it.
    """
    names = [picture.name for picture in PICTURES if picture.applies(result)]
    theirs = [name for name in names if helper is not None and name not in _HERE]
    drawn = None if helper is None else helper.submit(_write, theirs, result, folder)
    written = _write([name for name in names if name not in theirs], result, folder)
    if drawn is not None:
        written |= drawn.result()
    return {name: written[name] for name in names}


def prepare() -> None:
    """Import the modules for drawing, which takes half the time of a process's first picture."""
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg  # noqa: F401


def _write(names: Sequence[str], result: Result, folder: str | os.PathLike[str]) -> dict[str, Path]:
    with style():
        return {p.name: save_figure(p.figure(result), folder, p.name) for p in PICTURES if p.name in names}


def write_comparison(comparison: MethodComparison, folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Write the paper's figures of a comparison of methods, each as PNG and as SVG.

    Parameters
    ----------
    comparison : MethodComparison
    folder : path
        Made if it does not exist.

    Returns
    -------
    dict of str to Path
        Name of the picture to its PNG file.
    """
    with style():
        return {name: save_figure(draw(comparison), folder, name) for name, draw in COMPARISON_PICTURES.items()}


def write_diagnosis_pictures(
    diagnosis: Diagnosis, folder: str | os.PathLike[str], formats: Sequence[str] = ("svg", "png")
) -> dict[str, Path]:
    """Write every picture of a diagnosis that applies.

    Parameters
    ----------
    diagnosis : Diagnosis
    folder : path
        Made if it does not exist.
    formats : sequence of str
        Of ``png``, ``svg`` and ``pdf``.

    Returns
    -------
    dict of str to Path
        Name of the picture to its PNG file, or to that of the last format if there is no PNG.
    """
    written = {}
    with style():
        for name, draw in DIAGNOSIS_PICTURES.items():
            figure = draw(diagnosis)
            if figure is not None:
                written[name] = save_figure(figure, folder, name, formats)
    return written


def save_figure(
    figure: Figure, folder: str | os.PathLike[str], name: str, formats: Sequence[str] = ("svg", "png")
) -> Path:
    """Write a figure, as PNG and as SVG by default; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
        Drawn inside :func:`style`. Its panels stay where they are now arranged.
    folder : path
        Made if it does not exist.
    name : str
        Of the files, without a suffix.
    formats : sequence of str
        Of ``png``, ``svg`` and ``pdf``.

    Returns
    -------
    Path
        The PNG file, or that of the last format if there is no PNG; the others are beside it.

    Raises
    ------
    InputError
        If there is no format, or one that is not known.
    """
    unknown = sorted(set(formats) - set(_METADATA))
    if unknown or not formats:
        raise InputError(
            f"pictures cannot be written as {', '.join(unknown) or 'nothing'}: choose from png, svg and pdf"
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with style():  # the names of an SVG's parts come from a setting
        _arrange(figure)
        files = [_save(figure, folder / f"{name}.{kind}", _METADATA[kind]) for kind in formats]
    return files[list(formats).index("png")] if "png" in formats else files[-1]


def _arrange(figure: Figure) -> None:
    """Place the panels once, and not again for every file format."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def _save(figure: Figure, file: Path, metadata: dict[str, Any]) -> Path:
    """Write a picture, complete or not at all."""
    with replacing(file) as temporary:
        figure.savefig(temporary, format=file.suffix[1:], dpi=_DPI, metadata=metadata)
    return file
