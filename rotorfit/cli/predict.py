"""``rotorfit predict``: what an identified rotor would do at other frequencies, speeds and planes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import give, say, write_results
from rotorfit.cli.arguments import add_figure_format, add_group, add_output, group, numbers
from rotorfit.options.kinds import positive_word
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult
    from rotorfit.uncertainty.prediction import Prediction

DESCRIPTION = "predict responses of an identified rotor, with a band of the mean and one of a new reading"

_POINTS = 400
"""Points along a tested band, as many as a figure of a page's width resolves."""


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("fit", type=Path, metavar="FIT.json", help="a saved fit, fit.json of a folder with results")
    span = "A,B|LO:HI:N"
    to.add_argument("--speed", type=numbers, required=True, metavar=span, help="rotative speeds, rpm")
    how = to.add_mutually_exclusive_group()
    how.add_argument(
        "--frequency", type=numbers, metavar=span, help="frequencies of the force, rpm; negative is backward [tested]"
    )
    how.add_argument("--synchronous", action="store_true", help="the force turns with the shaft, as an unbalance does")
    size = to.add_mutually_exclusive_group()
    size.add_argument("--force", type=positive_word, metavar="N", help="size of the force [1]")
    size.add_argument("--mr-g-mm", type=positive_word, metavar="G_MM", help="unbalance whose force is m r w^2")
    to.add_argument("--force-plane", metavar="PLANE", help="where the force acts")
    to.add_argument("--plane", metavar="PLANE", help="where the motion is predicted [where the force acts]")
    to.add_argument("--direction", metavar="X", help="x or y, of models that keep both apart")
    add_group(to)
    to.add_argument("--level", type=positive_word, default=0.95, help="probability that a band holds [%(default)g]")
    to.add_argument("--whole", action="store_true", help="bands that hold for whole curves, not point by point")
    to.add_argument("--statistical", action="store_true", help="bands without the systematic share")
    to.add_argument("--out", type=Path, help="folder for prediction.csv, summary.txt and prediction.png")
    add_figure_format(to)
    add_output(to)


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.fitting.fit_file import load_fit

    fit = checked(lambda: load_fit(options.fit))
    found = checked(lambda: _prediction(fit, options))

    def write(folder: Path) -> None:
        write_results(found, folder, str(found), options, table="prediction", figure="prediction")

    give(options, write, lambda: _plain(found), str(found), found.notes)
    if fit.success:
        return ExitCode.DONE
    say(f"the fit did not converge: {fit.message}")
    return ExitCode.NOT_CONVERGED


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
        statistical=options.statistical,
        at=group(options),
    )


def _tested(fit: FitResult) -> Any:
    """Forward frequencies of the tested band, or backward ones where only these were tested, rad/s."""
    import numpy as np

    from rotorfit.estimators.blocks.nonlinear import responses_of

    known = [base.frequency for base in map(responses_of, fit.problem.blocks) if base is not None]
    tested = np.concatenate([*known, np.zeros(0)])
    forward = tested[tested > 0] if (tested > 0).any() else tested[tested < 0]
    if not forward.size:
        raise ValueError("the fit has no responses to forces that turn: say --frequency or --synchronous")
    return np.linspace(forward.min(), forward.max(), _POINTS)


def _plain(found: Prediction) -> dict[str, Any]:
    return {
        "speed_rpm": sorted(set((found.speed * RPM_PER_RAD_S).round(6).tolist())),
        "level": found.level,
        "whole": found.whole,
        "notes": found.notes,
        "points": found.to_dataframe().to_dict("records"),
    }
