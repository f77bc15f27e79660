"""The job behind ``bayes-impedance compare --networks``: several networks, by how they predict people left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.checking import distinct
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.jobs import fit_dataset, selected, with_terms_of
from bayes_impedance.commands.proposed_network import proposed_network
from bayes_impedance.commands.result_folders import FIT_FILES, interrupted, remove
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json, write_text
from bayes_impedance.runtime.input_files import LARGEST_DESCRIPTION, decode, read_bytes
from bayes_impedance.runtime.output_folder import output_folder, require_ours
from bayes_impedance.runtime.user_table import shown

if TYPE_CHECKING:
    from bayes_impedance.population.fit import FitSettings
    from bayes_impedance.population.given_prior import GivenPrior
    from bayes_impedance.recordings.files import Recordings
    from bayes_impedance.results.leave_one_out import LeftOut
    from bayes_impedance.results.network_comparison import NetworkComparison
    from bayes_impedance.results.result import Result
    from bayes_impedance.runtime.progress import Progress

MOST_REFITS = 5
"""Most people of one network for whom it is fitted again without them. By choice: each refit takes as long as the fit,
and where more people are that influential the network does not describe them, which a refit would only confirm."""

TABLES = ("networks.json", "networks.csv")


@dataclass(frozen=True)
class _Candidate:
    """A network as it was named: its notation and the distributions of people and noise, or its finished result."""

    given: str
    network: str
    result: Result | None
    distribution: str
    noise_distribution: str


def compare_networks(
    dataset: Path,
    out: Path,
    given: Sequence[str],
    options: FitOptions,
    resume: bool,
    progress: Progress,
    distributions: Sequence[str] = (),
    noise_distributions: Sequence[str] = (),
) -> NetworkComparison:
    """Fit each network, leave people out, and write ``networks.json`` and ``networks.csv``.

    Parameters
    ----------
    dataset : Path
    out : Path
        Folder for the tables; the fits are written to ``out/1``, ``out/2``, ... in the order given.
    given : sequence of str
        For each network its notation, a text file that holds it, the verdict of a diagnosis (its network with what was
        missing), or the folder of a finished fit of the same recordings. If none is given, the network of the options
        or of the recordings.
    options : FitOptions
        Of all fits that are made; their `network` is not used.
    resume : bool
        Take the fits that are finished, and continue one that was interrupted.
    progress : callable
    distributions : sequence of str
        With which each network that is not a finished fit is fitted, one after the other; that of the options if none
        is given.
    noise_distributions : sequence of str
        Of the noise, each fitted for each distribution of people; that of the options if none is given.

    Raises
    ------
    InputError
        If the input cannot be used; nothing was written then.
    """
    from bayes_impedance.recordings.files import read_recordings
    from bayes_impedance.results.leave_one_out import FEWEST_PEOPLE, leave_one_out
    from bayes_impedance.results.network_comparison import Entry, NetworkComparison

    recordings = distinct(selected(read_recordings(dataset), options).in_memory(), dataset)
    recordings, options = with_terms_of(recordings, options)
    if len(recordings.subjects) < FEWEST_PEOPLE:
        raise InputError(
            f"{dataset}: networks are compared by how well each subject is predicted from the others; give two or more "
            "subjects"
        )
    given = given or [options.network or recordings.network or ""]
    kinds = list(
        product(distributions or (options.distribution,), noise_distributions or (options.noise_distribution,))
    )
    candidates = [own for text in given for own in _candidates(text, recordings, options, dataset, kinds)]
    _require_different(candidates)
    priors = _priors(candidates, recordings, options)
    folders = [out / str(k) if c.result is None else Path(c.given) for k, c in enumerate(candidates, start=1)]
    for candidate, folder in zip(candidates, folders, strict=True):
        if candidate.result is None:
            _with_distributions(options, candidate).settings()  # refused before anything is written
            require_ours(folder, FIT_FILES, options.overwrite)
    entries = []
    with output_folder(out, TABLES, options.overwrite):
        for k, (candidate, folder) in enumerate(zip(candidates, folders, strict=True), start=1):
            own = _with_distributions(options, candidate)
            own = replace(own, network=candidate.network, prior=priors[k - 1], with_before=False)
            result = candidate.result or (_finished(folder, recordings, own) if resume else None)
            if result is None:
                result = fit_dataset(dataset, folder, own, resume, progress)
            left_out = _with_refits(
                leave_one_out(result), result, recordings, out / f"refits_{k}", options, resume, progress
            )
            name = folder.name if candidate.result is None else candidate.given
            entries.append(Entry(candidate.given, name, result, left_out))
        comparison = NetworkComparison.of(entries)
        remove(out, TABLES)
        identity = {"seed": options.seed, "version": version("bayes_impedance")}
        write_json(out / TABLES[0], {**comparison.summary(), **identity})
        write_text(out / TABLES[1], comparison.csv())
        for k in range(1, len(candidates) + 1):
            _discard_refits(out / f"refits_{k}")
    return comparison


def _with_distributions(options: FitOptions, candidate: _Candidate) -> FitOptions:
    own = candidate.distribution, candidate.noise_distribution
    return replace(options, distribution=own[0], noise_distribution=own[1])


# -------------------------------------------------------------------- what is named


def _candidates(
    text: str, recordings: Recordings, options: FitOptions, dataset: Path, kinds: Sequence[tuple[str, str]]
) -> list[_Candidate]:
    from bayes_impedance.network.notation import parse
    from bayes_impedance.population.requirements import checked_model

    result, network = None, text
    if os.path.isdir(text):
        result = _result_of(Path(text), recordings, dataset)
        return [_Candidate(text, result.summary["network_as_written"], result, *_distributions_of(result))]
    if os.path.isfile(text):
        network = _network_in(Path(text))
    try:
        parse(network)
    except InputError as error:
        if network is text:
            raise InputError(f"{error} (and there is no file or folder of this name)") from None
        raise InputError(f"{text}: {error}") from None
    checked_model(recordings, network, options.covariates)
    return [_Candidate(text, network, None, *kind) for kind in kinds]


def _distributions_of(result: Result) -> tuple[str, str]:
    """Of people and of noise."""
    attributes = result.attributes
    return attributes.get("distribution", "normal"), attributes.get("noise_distribution", "normal")


def _network_in(file: Path) -> str:
    """Notation in a text file, or the second network of a verdict."""
    if file.suffix != ".json":
        return decode(read_bytes(file, LARGEST_DESCRIPTION), str(file)).strip()
    return proposed_network(file)


def _result_of(folder: Path, recordings: Recordings, dataset: Path) -> Result:
    from bayes_impedance.results.leave_one_out import require_absolute
    from bayes_impedance.results.result import load_result

    result = load_result(folder)
    if result.attributes["data_sha256"] != recordings.sha256:
        raise InputError(f"{folder}: is a fit of other recordings than {dataset}; name the right folder or none")
    if _names(result) != recordings.names:
        raise InputError(f"{folder}: is a fit of other subjects of {dataset}; name the same ones with --subject")
    require_absolute(result)
    return result


def _require_different(candidates: Sequence[_Candidate]) -> None:
    from bayes_impedance.network.notation import parse

    if len(candidates) < 2:
        raise InputError(
            "--networks: give two or more, with blanks between, each in quotation marks; or one, and two "
            "--distributions or two --noise-distributions"
        )
    known: dict[tuple[str, str, str], str] = {}
    for c in candidates:
        name = os.path.realpath(c.given) if c.result is not None else str(parse(c.network))
        identity = name, c.distribution, c.noise_distribution
        if identity in known:
            raise InputError(f"--networks: {shown(c.given)} and {shown(known[identity])} are the same; leave one out")
        known[identity] = c.given


def _priors(candidates: Sequence[_Candidate], recordings: Recordings, options: FitOptions) -> list[GivenPrior | None]:
    """What the given prior says of each network's own elements; each of its elements is in one of them."""
    from bayes_impedance.population.calibrated import within_rig
    from bayes_impedance.population.requirements import checked_model

    if options.prior is None:
        return [None] * len(candidates)
    elements = [
        checked_model(recordings, within_rig(recordings, c.network), options.covariates).kernel.elements
        for c in candidates
    ]
    named = {*options.prior.elements, *(name for own in options.prior.order for name in own)}
    unknown = sorted(named - {name for names in elements for name in names})
    if unknown:
        raise InputError(f"--priors: {shown(unknown[0])} is in none of the networks; leave it out")
    return [options.prior.only(names) for names in elements]


# -------------------------------------------------------------------- fits


def _finished(folder: Path, recordings: Recordings, options: FitOptions) -> Result | None:
    """The result in a folder, if it is what the options would give; else None."""
    from bayes_impedance.population.calibrated import within_rig
    from bayes_impedance.population.requirements import checked_model, too_few_for_correlations
    from bayes_impedance.results.leave_one_out import require_absolute
    from bayes_impedance.results.result import load_result

    try:
        result = load_result(folder)
        require_absolute(result)
    except InputError:
        return None
    network, settings = within_rig(recordings, options.network), options.settings()
    kernel = checked_model(recordings, network, options.covariates).kernel
    few = too_few_for_correlations(len(recordings.subjects), len(kernel.elements))
    summary, attributes = result.summary, result.attributes
    wanted = {
        "network": str(kernel.network),
        "seed": options.seed,
        "data_sha256": recordings.sha256,
        "covariance": "diagonal" if few else options.covariance,
    }
    same = _distributions_of(result) == (options.distribution, options.noise_distribution)
    same = same and all(attributes[name] == value for name, value in wanted.items())
    same = same and _names(result) == recordings.names and _settings_of(result).covariates == options.covariates
    same = same and summary["sampler"]["ensembles"] == settings.sampler.ensembles
    same = same and attributes.get("prior", "") == ("" if options.prior is None else options.prior.text())
    same = same and summary["versions"]["bayes_impedance"] == version("bayes_impedance")
    return result if same else None


def _settings_of(result: Result) -> FitSettings:
    """Settings with which a result was fitted, as far as the command's options go."""
    from bayes_impedance.population.fit import QUICK_SETTINGS, FitSettings
    from bayes_impedance.population.given_prior import GivenPrior

    quick = result.summary["sampler"]["ensembles"] == QUICK_SETTINGS.sampler.ensembles
    base = QUICK_SETTINGS if quick else FitSettings()
    covariates = tuple(str(name) for name in result.coords.get("covariate", ()))
    prior = GivenPrior.of_text(result.attributes.get("prior", ""))
    return replace(
        base,
        covariance=result.attributes["covariance"],
        covariates=covariates,
        prior=prior,
        distribution=_distributions_of(result)[0],
        noise_distribution=_distributions_of(result)[1],
    )


def _with_refits(
    left_out: LeftOut,
    result: Result,
    recordings: Recordings,
    checkpoints: Path,
    options: FitOptions,
    resume: bool,
    progress: Progress,
) -> LeftOut:
    """Replace values whose weights cannot be believed, if they are few."""
    import numpy as np

    from bayes_impedance.network.notation import parse
    from bayes_impedance.results.leave_one_out import refit_without
    from bayes_impedance.runtime.executors import executor_of

    who = np.flatnonzero(left_out.doubtful).tolist()
    shared = any(p.shared for p in parse(result.attributes["network"]).parameters)
    if not who or len(who) > MOST_REFITS or shared:  # a refit holds no draws for other values of what is shared
        return left_out
    if not resume:
        _discard_refits(checkpoints)
    kept = "the same command with --resume takes the fits that are finished, and continues"
    with interrupted(kept), executor_of(options.threads, options.workers, options.scheduler) as executor:
        return refit_without(
            recordings,
            who,
            left_out,
            result,
            _settings_of(result),
            options.threads,
            lambda stage, done, total: progress(f"without one: {stage}", done, total),
            executor,
            checkpoints,
        )


def _discard_refits(folder: Path) -> None:
    from bayes_impedance.runtime.checkpoint import discard

    if folder.is_dir() and not folder.is_symlink():
        for own in sorted(folder.glob("without_*")):
            discard(own)
        with suppress(OSError):  # the folder holds other files
            folder.rmdir()


def _names(result: Result) -> tuple[str, ...]:
    return tuple(str(name) for name in result.coords["subject"])


# -------------------------------------------------------------------- text


def lines_of(comparison: NetworkComparison) -> list[str]:
    """The comparison as text: what is wrong first, then the table, then what it says."""
    from bayes_impedance.results.network_comparison import UNDECIDED

    entries, rows = comparison.entries, comparison.rows()
    labels = [comparison.label(entry) for entry in entries]
    lines = []
    for entry, label in zip(entries, labels, strict=True):
        lines += [f"NOT RELIABLE ({label}): {problem}" for problem in entry.result.problems]
        lines += [f"MISFIT ({label}): {sentence}" for sentence in entry.result.summary["adequacy"]["misfit"]]
    unit = entries[0].result.attributes["unit"]
    lines += ["", f"{len(entries[0].left_out.subjects)} subjects, each predicted from all others", ""]
    width = max(len("network"), *(len(label) for label in labels)) + 2
    lines.append(
        f"{'network':{width}}{'elpd':>12}{'less than best':>22}{'worst k':>9}{'|z|, ' + unit:>16}{'phase, deg':>12}"
        f"{'own rms, %':>12}"
    )
    for entry, label, row in zip(entries, labels, rows, strict=True):
        behind = "" if entry is comparison.best else f"{row['difference']:.1f} ± {row['difference_se']:.1f}"
        worst = "-" if row["pareto_k_max"] is None else f"{row['pareto_k_max']:.2f}"
        mark = ("*" if row["doubtful"] else "") + ("" if row["reliable"] else "!")
        lines.append(
            f"{label:{width}}{row['elpd']:12.1f}{behind:>22}{worst + mark:>9}{row['delta_magnitude']:16.3g}"
            f"{row['delta_phase_deg']:12.3g}{100 * row['relative_rms_median']:12.3g}"
        )
    lines.append("")
    if any(row["doubtful"] for row in rows):
        lines.append(f"* {_doubts(labels, rows)}: the sum over subjects is uncertain")
    if any(row["refitted"] for row in rows):
        lines.append(
            f"{sum(row['refitted'] for row in rows)} value(s) come from refits without the subject (Pareto k above 0.7)"
        )
    if not all(row["reliable"] for row in rows):
        lines.append("! not reliable: see above")
    lines.append(
        "elpd: log predictive density, summed over subjects, each predicted from all others; ±: one standard error"
    )
    same, best = [comparison.label(entry) for entry in comparison.as_good], comparison.label(comparison.best)
    if comparison.best.result.problems:
        lines.append("no fit is reliable, so none is named the best")
    elif same:
        lines.append(f"best: {best}; not separated from it (within {UNDECIDED:g} standard errors): {', '.join(same)}")
    else:
        lines.append(f"best: {best}")
    return lines


def _doubts(labels: Sequence[str], rows: Sequence[dict[str, Any]]) -> str:
    each = zip(labels, rows, strict=True)
    return ", ".join(f"{row['doubtful']} of {label}" for label, row in each if row["doubtful"]) + (
        " have Pareto k above 0.7 and were not fitted again"
    )
