"""Of a rotor before and after its test: ``rotorfit plan``, ``predict`` and ``judge``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.cli.answer import Answer, answered, checked, result_files
from rotorfit.apps.cli.arguments import add_group, add_output, group, numbers, option
from rotorfit.apps.study_files.plan_file import read_plan, run_plan
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S
from rotorfit.identify.fitting.fit_file import load_fit
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.options.kinds import number_word, pairs, positive_word, probability_word
from rotorfit.identify.uncertainty.predict import predict as predicted
from rotorfit.identify.uncertainty.prediction import Prediction
from rotorfit.identify.uncertainty.stability.report import stability_report
from rotorfit.lab.data.findings import errors_in
from rotorfit.studies.planning.record import Plan


def add_plan(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("study", type=Path, metavar="PLAN.toml", help="rotor, noise and limits of the rig as TOML keys")
    out = "plan.csv to fill in, lines.csv, summary.txt and plan.png, in place of the file's"
    add_output(to, out, figures=True)


@answered
def plan(options: argparse.Namespace) -> Answer:
    """The plan."""
    study = read_plan(options.study)
    if options.out is None and study["out"]:
        options.out = Path(study["out"])
    found = checked(lambda: run_plan(study), options.study)

    to_fill_in = {} if found.test is None else {"plan.csv": found.to_csv}
    return Answer(
        text=str(found),
        files=lambda: {**to_fill_in, **result_files(found, str(found), options, "lines", "plan")},
        plain=lambda: _plan_json(found),
        warned=found.notes,
    )


def _plan_json(found: Plan) -> dict[str, Any]:
    return {
        "model": found.model.name,
        "quantity": found.quantity,
        "expected": {
            name: {
                "value": one.value,
                "stderr": one.stderr,
                "stderr_low": one.low,
                "stderr_high": one.high,
                "stderr_all_lines_alike": found.even[name].stderr,
                "unit": one.unit,
            }
            for name, one in found.expected.items()
        },
        "certificate": {name: getattr(found.certificate, name) for name in ("optimal", "gap", "efficiency")},
        "time_s": found.time_s,
        "suggestions": found.suggestions,
        "notes": found.notes,
        "lines": found.to_dataframe().to_dict("records"),
    }


def add_predict(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("fit", type=Path, metavar="FIT.json", help="a saved fit, fit.json of a folder with results")
    option(to, "--speed A,B|LO:HI:N", "rotative speeds, rpm", numbers, required=True)
    how = to.add_mutually_exclusive_group()
    words = "frequencies of the force, rpm; negative is backward [tested]"
    option(how, "--frequency A,B|LO:HI:N", words, numbers)
    option(how, "--synchronous", "the force turns with the shaft, as an unbalance does")
    size = to.add_mutually_exclusive_group()
    option(size, "--force N", "size of the force [1]", positive_word)
    option(size, "--mr-g-mm G_MM", "unbalance whose force is m r w^2", positive_word)
    option(to, "--force-plane PLANE", "where the force acts")
    option(to, "--plane PLANE", "where the motion is predicted [where the force acts]")
    option(to, "--direction X", "x or y, of models that keep both apart")
    add_group(to)
    option(to, "--level P", "probability that a band holds [%(default)g]", probability_word, of=predicted)
    option(to, "--whole", "bands that hold for whole curves, not point by point")
    option(to, "--noise-only", "bands by the noise alone, as if every cause were known")
    add_output(to, "prediction.csv, summary.txt and prediction.png", figures=True)


@answered
def predict(options: argparse.Namespace) -> Answer:
    """What an identified rotor would do."""
    fit = load_fit(options.fit)
    found = _prediction(fit, options)

    return Answer(
        text=str(found),
        files=partial(result_files, found, str(found), options, "prediction", "prediction"),
        plain=lambda: {
            "speed_rpm": sorted(set((found.speed * RPM_PER_RAD_S).round(6).tolist())),
            **{name: getattr(found, name) for name in ("level", "whole", "notes")},
            "points": found.to_dataframe().to_dict("records"),
        },
        warned=found.notes,
        said=[] if fit.success else [f"the fit did not converge: {fit.message}"],
        good=fit.success,
    )


def _prediction(fit: FitResult, options: argparse.Namespace) -> Prediction:
    speed = options.speed * RAD_S_PER_RPM
    if options.synchronous:
        frequency = None
    elif options.frequency is not None:
        frequency = options.frequency * RAD_S_PER_RPM
    else:
        frequency = _tested(fit)
    if frequency is not None and speed.size > 1 and speed.size != frequency.size:
        raise ValueError(
            f"--speed has {speed.size} values for {frequency.size} frequencies: give one speed, as many speeds as "
            "frequencies, or --synchronous"
        )
    return fit.predict(
        frequency,
        speed,
        force_plane=options.force_plane,
        force=options.force,
        mr=None if options.mr_g_mm is None else options.mr_g_mm * 1e-6,
        plane=options.plane,
        direction=options.direction,
        level=options.level,
        whole=options.whole,
        share="noise" if options.noise_only else "all",
        at=group(options),
    )


def _tested(fit: FitResult) -> Any:
    """Forward frequencies of the tested band, or backward ones where only these were tested, rad/s."""
    known = [base.frequency for base in fit.problem.responses]
    tested = np.concatenate([*known, np.zeros(0)])
    forward = tested[tested > 0] if (tested > 0).any() else tested[tested < 0]
    if not forward.size:
        raise ValueError("the fit has no responses to forces that turn: say --frequency or --synchronous")
    points = 400  # points along a tested band, as many as a figure of a page's width resolves
    return np.linspace(forward.min(), forward.max(), points)


def add_judge(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("fit", type=Path, metavar="FIT.json", help="a saved fit, fit.json of a folder with results")
    option(to, "--max-speed RPM", "highest running speed [highest tested]", positive_word)
    option(to, "--min-speed RPM", "lowest running speed [the highest]", positive_word)
    option(to, "--min-decrement RATE", "required log. decrement [%(default)g]", positive_word, of=stability_report)
    words = "required threshold speed over running speed [%(default)g]"
    option(to, "--min-threshold-ratio RATIO", words, positive_word, of=stability_report)
    option(to, "--cross-coupling PLANE=N/M ...", "anticipated cross-coupled stiffness at a plane, N/m")
    option(to, "--min-cross-coupling-ratio RATIO", "Q0/Qa [%(default)g]", positive_word, of=stability_report)
    option(to, "--unbalance PLANE=G_MM ...", "unbalance at a plane")
    option(to, "--plane PLANE", "where unbalance responses are judged [that of the unbalance]")
    option(to, "--max-amplitude UM", "largest deflection at running speeds", positive_word)
    option(to, "--sensitivity PLANE", "bearing whose sensitivity function is judged")
    option(to, "--max-sensitivity VALUE", "its largest value [%(default)g]", positive_word, of=stability_report)
    words = "a further case, as factors on parameters: 'smallest clearance:K0=1.3,D=1.5'"
    option(to, "--case CASE:NAME=FACTOR ...", words)
    add_group(to)
    option(to, "--level P", "probability of the intervals [%(default)g]", probability_word, of=stability_report)
    add_output(to, "stability.csv, summary.txt and stability.png", figures=True)


@answered
def judge(options: argparse.Namespace) -> Answer:
    """The criteria, each with its probability."""
    fit = load_fit(options.fit)
    found = fit.stability_report(
        max_speed_rpm=options.max_speed,
        min_speed_rpm=options.min_speed,
        min_decrement=options.min_decrement,
        min_threshold_ratio=options.min_threshold_ratio,
        cross_coupling=pairs("--cross-coupling", options.cross_coupling, number_word),
        min_cross_coupling_ratio=options.min_cross_coupling_ratio,
        unbalance_g_mm=pairs("--unbalance", options.unbalance, number_word),
        plane=options.plane,
        max_amplitude_um=options.max_amplitude,
        sensitivity=options.sensitivity,
        max_sensitivity=options.max_sensitivity,
        cases=_cases(options.case),
        level=options.level,
        at=group(options),
    )
    errors = errors_in(fit.findings)
    text = "\n".join([*(f"ERROR in the data, nothing below can be relied on: {words}" for words in errors), str(found)])

    return Answer(
        text=text,
        files=partial(result_files, found, text, options, "stability", "stability"),
        plain=lambda: {
            "errors": list(errors),
            "criteria": found.to_dataframe().to_dict("records"),
            **{name: getattr(found, name) for name in ("met", "level", "caution", "notes")},
        },
        warned=(*([found.caution] if found.caution else []), *found.notes),
        said=[f"error in the data: {words}" for words in errors],
        good=not errors,
    )


def _cases(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """Factors on parameters by name of a case."""
    found: dict[str, dict[str, float]] = {}
    for word in words:
        name, colon, factors = (part.strip() for part in word.partition(":"))
        if not (name and colon and factors):
            raise ValueError(f"--case takes CASE:NAME=FACTOR, such as 'smallest clearance:K0=1.3,D=1.5'; got {word!r}")
        if name in found:
            raise ValueError(f"--case names {name} twice")
        found[name] = pairs(f"--case {name}", [factors], number_word)
    return found
