"""``rotorfit judge``: whether an identified rotor is stable enough, with the probability of each criterion."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import give, say, write_results
from rotorfit.cli.arguments import add_figure_format, add_group, add_output, group
from rotorfit.options.kinds import number_word, pairs, positive_word

if TYPE_CHECKING:
    from rotorfit.uncertainty.stability.record import StabilityReport

DESCRIPTION = "judge the stability of an identified rotor at running speed, with the probability of each criterion"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("fit", type=Path, metavar="FIT.json", help="a saved fit, fit.json of a folder with results")
    to.add_argument("--max-speed", type=positive_word, metavar="RPM", help="highest running speed [highest tested]")
    to.add_argument("--min-speed", type=positive_word, metavar="RPM", help="lowest running speed [the highest]")
    to.add_argument("--min-decrement", type=positive_word, default=0.1, help="required log. decrement [%(default)g]")
    to.add_argument(
        "--min-threshold-ratio",
        type=positive_word,
        default=1.0,
        help="required threshold speed over running speed [%(default)g]",
    )
    to.add_argument(
        "--cross-coupling",
        action="append",
        default=[],
        metavar="PLANE=N/M",
        help="anticipated cross-coupled stiffness at a plane, N/m",
    )
    to.add_argument("--min-cross-coupling-ratio", type=positive_word, default=2.0, help="Q0/Qa [%(default)g]")
    to.add_argument("--unbalance", action="append", default=[], metavar="PLANE=G_MM", help="unbalance at a plane")
    to.add_argument("--plane", metavar="PLANE", help="where unbalance responses are judged [that of the unbalance]")
    to.add_argument("--max-amplitude", type=positive_word, metavar="UM", help="largest deflection at running speeds")
    to.add_argument("--sensitivity", metavar="PLANE", help="bearing whose sensitivity function is judged")
    to.add_argument("--max-sensitivity", type=positive_word, default=3.0, help="its largest value [%(default)g]")
    case = "a further case, as factors on parameters: 'smallest clearance:K0=1.3,D=1.5'"
    to.add_argument("--case", action="append", default=[], metavar="CASE:NAME=FACTOR", help=case)
    add_group(to)
    to.add_argument("--level", type=positive_word, default=0.95, help="probability of the intervals [%(default)g]")
    to.add_argument("--out", type=Path, help="folder for stability.csv, summary.txt and stability.png")
    add_figure_format(to)
    add_output(to)


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.data.findings import errors_in
    from rotorfit.fitting.fit_file import load_fit

    fit = checked(lambda: load_fit(options.fit))
    found = checked(
        lambda: fit.stability_report(
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
    )
    errors = errors_in(fit.findings)
    text = "\n".join([*(f"ERROR in the data, nothing below can be relied on: {words}" for words in errors), str(found)])

    def write(folder: Path) -> None:
        write_results(found, folder, text, options, table="stability", figure="stability")

    warned = (*([found.caution] if found.caution else []), *found.notes)
    give(options, write, lambda: {"errors": list(errors), **_plain(found)}, text, warned)
    for words in errors:
        say(f"error in the data: {words}")
    return ExitCode.NOT_CONVERGED if errors else ExitCode.DONE


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


def _plain(found: StabilityReport) -> dict[str, Any]:
    criteria = found.to_dataframe().to_dict("records")
    return {"criteria": criteria, **{name: getattr(found, name) for name in ("met", "level", "caution", "notes")}}
