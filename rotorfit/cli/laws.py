"""``rotorfit compare-laws``: which law of eccentricity the data ask for, if any."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer, finite
from rotorfit.cli.arguments import add_files, add_model, add_output, fit_study, option
from rotorfit.options.kinds import positive_word, words
from rotorfit.options.table import LAW_RANKING

if TYPE_CHECKING:
    from rotorfit.fitting.structure.law_ranking import LawComparison, LawFit

HELP = "fit several laws of eccentricity to the same files and rank them by AIC and BIC"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    add_model(to, LAW_RANKING)
    option(to, "--clearance-um UM", "radial clearance at the fluid", positive_word, required=True)
    help = "laws to compare: muszynska,collapse [constant, muszynska, two even polynomials, a spline]"
    option(to, "--laws A,B", help, words)
    add_output(to, "law_comparison.csv, summary.txt and law.png")


def answer(options: argparse.Namespace) -> Answer:
    """The ranking of the laws."""
    found, wrong, warned = _comparison(options)
    failed = [entry for entry in found.laws if entry.fit is not None and not entry.fit.success]
    problems = [*([wrong] if wrong else []), *(f"{entry.law!r}: {entry.reason}" for entry in failed)]
    return Answer(
        text="\n".join([str(found), *warned]),
        write=partial(_write, found),
        plain=lambda: {**_plain(found), "warnings": warned},
        warned=warned,
        said=problems,
        good=not problems,
    )


def _comparison(options: argparse.Namespace) -> tuple[LawComparison, str, list[str]]:
    """The ranking, what is wrong with the data, and what their check warns of."""
    from rotorfit.data.findings import attributed, error_sentence, errors_in, warnings_in
    from rotorfit.fitting.structure.law_ranking import compare_laws
    from rotorfit.models import LAWS
    from rotorfit.models.parameters import unknown_name
    from rotorfit.studies.data_files import no_progress, read_files
    from rotorfit.studies.study_model import build_model, check_model

    study = fit_study(options, LAW_RANKING)
    check_model(study)
    for name in options.laws or ():
        if name not in LAWS:
            raise ValueError(f"--laws: {unknown_name('law', name, LAWS)}")
    tests, findings = read_files(study.files, no_progress)
    found = compare_laws(
        build_model(study, tests),
        tests,
        None if options.laws is None else [LAWS[name]() for name in options.laws],
        clearance_um=options.clearance_um,
        known=study.known,
        bounds=study.bounds,
        priors=study.priors,
        per=study.per,
        start=study.start,
        phase_offsets=study.phase_offsets,
        loss=study.loss,
    )
    everything = attributed(findings, [test.source or test.title for test in tests])
    return found, error_sentence(errors_in(everything)), warnings_in(everything)


def _write(found: LawComparison, folder: Path) -> None:
    from rotorfit.io.tables.result_tables import records_csv

    (folder / "law_comparison.csv").write_text(records_csv([_row(entry) for entry in found.laws]), encoding="utf-8")
    # There is something to draw of a law that changes with eccentricity alone.
    drawn = next((e.fit for e in found.laws if e.law.parameters and e.fit is not None and not e.reason), None)
    note = "law.png: no law that changes with eccentricity could be fitted"
    if drawn is not None:
        from rotorfit.plots.style import picture_of

        (folder / "law.png").write_bytes(picture_of(drawn.plot_law(), dpi=150))
        note = f"law.png: {drawn.model.options()['law']!r}"
    (folder / "summary.txt").write_text(f"{found}\n\n{note}\n\n{found.best.summary()}\n", encoding="utf-8")


def _row(entry: LawFit) -> dict[str, Any]:
    """One law of the ranking; what was not fitted is ``None``."""
    return {
        "law": repr(entry.law),
        "fitted": entry.count,
        "redchi": None if entry.fit is None else finite(entry.fit.redchi),
        "aic": finite(entry.aic),
        "bic": finite(entry.bic),
        "weight": entry.weight,
        "reason": entry.reason,
    }


def _plain(found: LawComparison) -> dict[str, Any]:
    best = found.best
    return {
        "model": best.model.name,
        "laws": [_row(entry) for entry in found.laws],
        "best": repr(found.laws[0].law),
        "parameters": {
            p.name: {"value": p.value, "stderr": p.stderr, "unit": p.unit, "fitted": p.vary}
            for p in best.params.values()
        },
        "nonlinear": found.nonlinear,
        "nonlinear_stiffness": found.nonlinear_stiffness,
        "stiffness_aic": found.stiffness,
        "verdict": found.verdict,
    }
