"""The words that the command line understands, and how they turn into settings."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rotorfit.studies.study import DataFile, Study


def add_output(to: argparse.ArgumentParser) -> None:
    """How much is printed."""
    to.add_argument("--json", action="store_true", help="print the result as JSON instead of tables")
    to.add_argument("--quiet", action="store_true", help="print neither progress nor tables")


def add_files(to: argparse.ArgumentParser) -> None:
    """Test files and how they are read."""
    to.add_argument("files", nargs="+", type=Path, metavar="FILE", help="test files (.csv .uff .nc .mat)")
    to.add_argument(
        "--probe-angles",
        action="append",
        default=[],
        metavar="PLANE=X:Y",
        help="where the probes named x and y sit, degrees from X towards Y",
    )
    to.add_argument(
        "--slow-roll-below",
        type=float,
        metavar="RPM",
        help="subtract each channel's mean reading below this speed (synchronous tests)",
    )
    to.add_argument("--speed", type=float, metavar="RPM", help="rotative speed, for universal files without it")


def add_model(to: argparse.ArgumentParser) -> None:
    """The model and its structure."""
    to.add_argument("--model", required=True, help="see `rotorfit models`")
    to.add_argument("--planes", type=words, default=(), metavar="A,B", help="plane names, in the model's order")
    to.add_argument("--blocks", type=words, default=(), metavar="A,B", help="structural blocks to include")
    to.add_argument("--two-lam", action="store_true", help="lam_D and lam_M of their own in place of one lam")


FIT_LISTS = {
    "--known": ("NAME=VALUE", "not fitted, SI units; NAME=free fits what the model fixes by default"),
    "--bounds": ("NAME=LO:HI", "limits of a parameter, either may be left out"),
    "--prior": ("NAME=MEAN:SD", "Gaussian prior of a parameter (other distributions: `rotorfit run`)"),
    "--start": ("NAME=VALUE", "start value in place of the closed form's"),
    "--per": ("NAME=ATTRIBUTE", "one value for each value of a test attribute: D=speed_rpm"),
}
FIT_FLAGS = {
    "--two-lam": "lam_D and lam_M of their own in place of one lam",
    "--phase-offsets": "fit a phase reference offset for every run but the first",
    "--refine": "add structural blocks while the data ask for them (BIC)",
}


def add_fit_options(fit: argparse.ArgumentParser) -> None:
    """All that a single fit takes."""
    add_files(fit)
    fit.add_argument("--model", required=True, help="see `rotorfit models`")
    fit.add_argument("--out", type=Path, help="folder for tables and figures")
    for name, (metavar, help_text) in FIT_LISTS.items():
        fit.add_argument(name, action="append", default=[], metavar=metavar, help=help_text)
    fit.add_argument("--loss", default="linear", help="linear, or soft_l1, huber, cauchy against outliers")
    fit.add_argument(
        "--planes",
        type=words,
        default=(),
        metavar="A,B",
        help="the data's plane names, in the model's order",
    )
    fit.add_argument("--blocks", type=words, default=(), metavar="A,B", help="structural blocks to include")
    fit.add_argument("--law", default="", metavar="NAME", help="law of eccentricity: muszynska, even-polynomial, ...")
    fit.add_argument("--clearance-um", type=positive, metavar="UM", help="radial clearance at the fluid, for a law")
    for name, help_text in FIT_FLAGS.items():
        fit.add_argument(name, action="store_true", help=help_text)
    more = fit.add_argument_group("uncertainty beyond standard errors")
    more.add_argument(
        "--calibration",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="systematic uncertainty: probe_gain=0.01, probe_phase_deg=0.5, mr=0.005, keyphasor_deg=1",
    )
    more.add_argument("--sample", action="store_true", help="draw from the posterior with emcee; needs some seconds")
    more.add_argument("--ess", type=positive, default=4000.0, help="effective samples to reach [%(default)g]")
    more.add_argument("--max-steps", type=count, default=20_000, help="steps to stop at in any case [%(default)s]")
    more.add_argument("--seed", type=whole, help="of random numbers, for the same draws again")
    more.add_argument(
        "--profile", type=words, default=(), metavar="A,B", help="profile likelihoods: lam,D,threshold_speed"
    )
    more.add_argument("--bootstrap", type=count, default=0, metavar="N", help="simulate and fit N tests")


# ---- from words to settings -------------------------------------------------------------------


def data_files(options: argparse.Namespace) -> tuple[DataFile, ...]:
    """The files of the command line with their read options.

    Raises:
        ValueError: options that cannot be understood.
    """
    from rotorfit.studies.study import DataFile

    read: dict[str, Any] = {}
    if options.probe_angles:
        read["probe_angles"] = pairs("--probe-angles", options.probe_angles, _two_numbers)
    if options.slow_roll_below is not None:
        read["slow_roll_below_rpm"] = options.slow_roll_below
    if options.speed is not None:
        read["speed"] = options.speed * math.pi / 30
    return tuple(DataFile(file, read) for file in options.files)


def fit_study(options: argparse.Namespace) -> Study:
    """The study that the options of ``rotorfit fit`` describe.

    Raises:
        ValueError: options that cannot be understood.
    """
    from rotorfit.studies.study import Study

    return Study(
        files=data_files(options),
        model=options.model,
        out=options.out,
        planes=options.planes,
        blocks=options.blocks,
        two_lam=options.two_lam,
        law=options.law,
        clearance_um=options.clearance_um,
        known=pairs("--known", options.known, _number_or_free),
        bounds=pairs("--bounds", options.bounds, _range),
        priors=pairs("--prior", options.prior, _gaussian),
        start=pairs("--start", options.start, number),
        per=pairs("--per", options.per, str),
        loss=options.loss,
        phase_offsets=options.phase_offsets,
        calibration=pairs("--calibration", options.calibration, number),
        refine=options.refine,
        sample=options.sample,
        seed=options.seed,
        ess=options.ess,
        max_steps=options.max_steps,
        profile=options.profile,
        bootstrap=options.bootstrap,
    )


def positive(text: str) -> float:
    """A number above zero."""
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above zero")
    return value


def whole(text: str) -> int:
    """A whole number from zero."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is below zero")
    return value


def count(text: str) -> int:
    """A whole number from one."""
    if whole(text) == 0:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return int(text)


def words(text: str) -> tuple[str, ...]:
    """Words with commas between."""
    return tuple(word.strip() for word in text.split(","))


def pairs(option: str, given: Sequence[str], parse: Callable[[str], Any]) -> dict[str, Any]:
    """``NAME=VALUE`` words, several of them also in one word with commas between."""
    values: dict[str, Any] = {}
    for item in (part for word in given for part in word.split(",")):
        name, _, text = (part.strip() for part in item.partition("="))
        if not (name and text):
            raise ValueError(f"{option} takes NAME=VALUE, got {item!r}")
        if name in values:
            raise ValueError(f"{option} names {name} twice")
        try:
            values[name] = parse(text)
        except ValueError as problem:
            raise ValueError(f"{option} {item}: {problem}") from problem
    return values


def number(text: str) -> float:
    """A number, refused in words otherwise."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number") from None


def _number_or_free(text: str) -> float | None:
    return None if text.lower() in ("free", "none") else number(text)


def _two(text: str) -> tuple[str, str]:
    first, colon, second = text.partition(":")
    if not colon:
        raise ValueError("give two numbers with a colon between")
    return first, second


def _two_numbers(text: str) -> tuple[float, float]:
    first, second = _two(text)
    return number(first), number(second)


def _range(text: str) -> tuple[float, float]:
    low, high = _two(text)
    return number(low or "-inf"), number(high or "inf")


def _gaussian(text: str) -> Any:
    from rotorfit.studies.study import frozen_prior

    return frozen_prior("prior", "norm", _two_numbers(text))
