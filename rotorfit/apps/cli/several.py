"""Several runs fitted, each by itself: ``rotorfit campaign``."""

from __future__ import annotations

import argparse
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rotorfit.apps.cli.answer import Answer, answered, progress_line
from rotorfit.apps.cli.arguments import add_jobs, add_output, add_paths, option, workers_of
from rotorfit.apps.store.store import Store
from rotorfit.apps.study_files.data_files import DataFile, look_over, no_progress, read_as, read_files
from rotorfit.apps.study_files.study import Study, build_model, check_model
from rotorfit.apps.study_files.study_file import read_study
from rotorfit.identify.fitting.quantities import FittedParameter, Quantity
from rotorfit.identify.options.kinds import count_word, words
from rotorfit.identify.options.table import FIT, LAW, MODEL, PARAMETERS
from rotorfit.lab.data.findings import attributed, error_sentence, errors_in, warnings_in
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW
from rotorfit.studies.campaigns.campaign import Campaign
from rotorfit.studies.campaigns.campaign import campaign as fit_campaign


def add_campaign(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    help = "model, known values and files as TOML keys; `rotorfit template study` prints an example"
    to.add_argument("study", type=Path, metavar="STUDY.toml", help=help)
    help = "test files to fit instead; the study's files then say, by patterns of names, how they are read"
    add_paths(to, help, "*")
    option(to, "--split ATTRIBUTE", "column that separates the runs [%(default)s]", of=fit_campaign)
    option(to, "--shared A,B", "parameters with one value for all runs", words, of=fit_campaign)
    option(to, "--against A,B", "columns that trends are shown against: pressure_psi,oil_C", words)
    option(to, "--by ATTRIBUTE", "column that makes groups: inlet")
    option(
        to, "--degree N", "degree of the trends' polynomials; 1: lines [%(default)s]", count_word, of=Campaign.trends
    )
    option(to, "--follow A,B", "parameters whose trends are shown [K0, lam, D]", words)
    add_jobs(to, "reduce recordings and fit")
    option(to, "--store STORE", "store that keeps each fit; the same command continues there after a stop", Path)
    option(to, "--lazy", "read each file where its runs are fitted, so that no process holds all data")
    add_output(to, "runs.csv, summary.txt, report.html and trends.png", figures=True)


_TAKEN = (*MODEL, *LAW, "modes", "gains", "apart", "residuals", *PARAMETERS, "loss")
"""Keys of a study that a campaign has: what is neither known nor shared has a value of its own for each run."""


@answered
def campaign(options: argparse.Namespace) -> Answer:
    """Every run fitted, and the trends."""
    found, wrong, warned = _campaign(options)
    text = found.summary(options.follow, against=options.against, by=options.by, degree=options.degree)
    table = found.table(None if options.against is None else [a for a in (*options.against, options.by) if a])
    text = "\n".join([*warned, *([""] if warned else []), text])
    said = [wrong] if wrong else []
    silent = [one.name for one in found.runs if one.silent]
    if silent:
        said.append(f"left out of trends, since they say nothing: {', '.join(silent)}")
    if not found.success:
        bad = [one.name for one in found.runs if not one.success]
        what = f"{len(bad)} of {len(found.runs)} runs" if bad else "the shared parameters"
        said.append(f"{what} did not converge{': ' + ', '.join(bad) if bad else ''}")
    return Answer(
        text=f"{table}\n\n{text}",
        files=partial(_campaign_files, found, text, options),
        plain=lambda: {**_campaign_json(found, options), "warnings": warned},
        warned=warned,
        said=said,
        good=found.success and not wrong,
    )


def _campaign(options: argparse.Namespace) -> tuple[Campaign, str, list[str]]:
    """The fits of all runs, what is wrong with the data, and what their check warns of."""
    if options.against is None and (options.by or options.follow or options.degree > 1):
        raise ValueError("--by, --follow and --degree shape the trends: say --against what")
    study = _study(options)
    options.out = options.out or study.out
    with workers_of(options) as executor, progress_line(options) as line:
        parts, first, findings = _data_of(study, options.lazy, executor)
        found = fit_campaign(
            build_model(study, first),
            parts,
            split=options.split,
            shared=options.shared,
            **{name: getattr(study, name) for name in (*PARAMETERS, "loss")},
            executor=executor,
            store=None if options.store is None else Store(options.store),
            progress=lambda done, total: line(f"{done} of {total} runs", done / total),
        )
    everything = attributed(*findings)
    return found, error_sentence(errors_in(everything)), warnings_in(everything)


def _study(options: argparse.Namespace) -> Study:
    """The settings, and the files that are given in place of the study's."""
    study = read_study(options.study, of_a_store=bool(options.files))
    plain = Study(files=(), model=study.model)
    idle = [name for name in FIT if name not in _TAKEN and getattr(study, name) != getattr(plain, name)]
    if idle:
        raise ValueError(f"{options.study}: {idle[0]} is for a fit of all runs together, `rotorfit run`; leave it out")
    check_model(study)
    if not options.files:
        return study
    if raw := [file.name for file in options.files if file.suffix.lower() in ALWAYS_RAW]:
        raise ValueError(f"{raw[0]} is a recording: name recordings with their setup in the files of {options.study}")
    return replace(study, files=tuple(read_as(file, study.files) for file in options.files))


def _data_of(study: Study, lazy: bool, executor: Executor | None) -> tuple[Any, tuple[Experiment, ...], Any]:
    """Tables, or what reads them where they are fitted; the tests that the model is made for; findings and of what."""
    if not lazy:
        tests, findings = read_files(study.files, no_progress, executor)
        return tests, tests, (findings, [test.source or test.title for test in tests])
    files = [file for file in study.files if isinstance(file, DataFile)]
    if len(files) < len(study.files):
        raise ValueError("--lazy is for files of vectors; `rotorfit vectors` makes those of recordings")
    findings = look_over(files, executor)
    return [file.read for file in files], (files[0].read(),), (findings, [file.path.name for file in files])


def _campaign_files(found: Campaign, text: str, options: argparse.Namespace) -> dict[str, Any]:
    from rotorfit.show.plots.style import picture_of
    from rotorfit.studies.campaigns.campaign_report import write_campaign_report

    shown = {"against": options.against, "by": options.by, "degree": options.degree}
    files = {
        "runs.csv": found.to_csv,
        "summary.txt": f"{found.table()}\n\n{text}\n",
        "report.html": partial(write_campaign_report, found, parameters=options.follow, **shown),
    }
    if options.against is not None and found.trends(options.follow, **shown):
        figure = found.plot.trends(options.follow, **shown)
        files[f"trends.{options.figure_format}"] = picture_of(figure, options.figure_format)
    return files


def _estimate(parameter: FittedParameter | Quantity) -> dict[str, Any]:
    return {"value": parameter.value, "stderr": parameter.stderr, "unit": parameter.unit}


def _campaign_json(found: Campaign, options: argparse.Namespace) -> dict[str, Any]:
    """The campaign for JSON, numbers in SI units."""
    result: dict[str, Any] = {
        "model": found.model.name,
        "success": found.success,
        "shared": {name: _estimate(p) for name, p in found.shared.items()},
        "runs": [
            {
                "run": one.name,
                **one.attributes,
                "params": {name: _estimate(p) for name, p in one.params.items() if p.vary},
                **{name: getattr(one, name) for name in ("redchi", "success", "silent", "message")},
            }
            for one in found.runs
        ],
    }
    if options.against is not None:
        result["trends"] = [
            {
                **{name: getattr(t, name) for name in ("parameter", "group", "against", "scatter")},
                "runs": len(t.runs),
                "slope": t.slope.value,
                "slope_stderr": t.slope.stderr,
                "coefficients": [_estimate(c) for c in t.coefficients],
            }
            for t in found.trends(options.follow, against=options.against, by=options.by, degree=options.degree)
        ]
    return result
