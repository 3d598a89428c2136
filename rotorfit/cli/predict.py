"""``rotorfit predict``: what an identified rotor would do at other frequencies, speeds and planes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer, write_results
from rotorfit.cli.arguments import add_group, add_output, group, numbers, option
from rotorfit.options.kinds import positive_word
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult
    from rotorfit.uncertainty.prediction import Prediction

HELP = "predict responses of an identified rotor, with a band of the mean and one of a new reading"

_POINTS = 400
"""Points along a tested band, as many as a figure of a page's width resolves."""


def add_options(to: argparse.ArgumentParser) -> None:
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
    option(to, "--level LEVEL", "probability that a band holds [%(default)g]", positive_word, default=0.95)
    option(to, "--whole", "bands that hold for whole curves, not point by point")
    option(to, "--statistical", "bands without the systematic share")
    add_output(to, "prediction.csv, summary.txt and prediction.png", figures=True)


def answer(options: argparse.Namespace) -> Answer:
    """What an identified rotor would do."""
    from rotorfit.fitting.fit_file import load_fit

    fit = load_fit(options.fit)
    found = _prediction(fit, options)

    def write(folder: Path) -> None:
        write_results(found, folder, str(found), options, table="prediction", figure="prediction")

    return Answer(
        text=str(found),
        write=write,
        plain=lambda: _plain(found),
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
    speeds = sorted(set((found.speed * RPM_PER_RAD_S).round(6).tolist()))
    more = {name: getattr(found, name) for name in ("level", "whole", "notes")}
    return {"speed_rpm": speeds, **more, "points": found.to_dataframe().to_dict("records")}
