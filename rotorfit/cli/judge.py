"""``rotorfit judge``: whether an identified rotor is stable enough, with the probability of each criterion."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer, write_results
from rotorfit.cli.arguments import add_group, add_output, group, option
from rotorfit.options.kinds import number_word, pairs, positive_word

if TYPE_CHECKING:
    from rotorfit.uncertainty.stability.record import StabilityReport

HELP = "judge the stability of an identified rotor at running speed, with the probability of each criterion"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("fit", type=Path, metavar="FIT.json", help="a saved fit, fit.json of a folder with results")
    option(to, "--max-speed RPM", "highest running speed [highest tested]", positive_word)
    option(to, "--min-speed RPM", "lowest running speed [the highest]", positive_word)
    option(to, "--min-decrement MIN_DECREMENT", "required log. decrement [%(default)g]", positive_word, default=0.1)
    words = "required threshold speed over running speed [%(default)g]"
    option(to, "--min-threshold-ratio MIN_THRESHOLD_RATIO", words, positive_word, default=1.0)
    option(to, "--cross-coupling PLANE=N/M ...", "anticipated cross-coupled stiffness at a plane, N/m")
    option(to, "--min-cross-coupling-ratio MIN_CROSS_COUPLING_RATIO", "Q0/Qa [%(default)g]", positive_word, default=2.0)
    option(to, "--unbalance PLANE=G_MM ...", "unbalance at a plane")
    option(to, "--plane PLANE", "where unbalance responses are judged [that of the unbalance]")
    option(to, "--max-amplitude UM", "largest deflection at running speeds", positive_word)
    option(to, "--sensitivity PLANE", "bearing whose sensitivity function is judged")
    option(to, "--max-sensitivity MAX_SENSITIVITY", "its largest value [%(default)g]", positive_word, default=3.0)
    words = "a further case, as factors on parameters: 'smallest clearance:K0=1.3,D=1.5'"
    option(to, "--case CASE:NAME=FACTOR ...", words)
    add_group(to)
    option(to, "--level LEVEL", "probability of the intervals [%(default)g]", positive_word, default=0.95)
    add_output(to, "stability.csv, summary.txt and stability.png", figures=True)


def answer(options: argparse.Namespace) -> Answer:
    """The criteria, each with its probability."""
    from rotorfit.data.findings import errors_in
    from rotorfit.fitting.fit_file import load_fit

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

    def write(folder: Path) -> None:
        write_results(found, folder, text, options, table="stability", figure="stability")

    return Answer(
        text=text,
        write=write,
        plain=lambda: {"errors": list(errors), **_plain(found)},
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


def _plain(found: StabilityReport) -> dict[str, Any]:
    criteria = found.to_dataframe().to_dict("records")
    return {"criteria": criteria, **{name: getattr(found, name) for name in ("met", "level", "caution", "notes")}}
