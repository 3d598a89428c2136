"""Fits without causes, of tests that are about estimators, readers and rigs, and what causes move."""

from __future__ import annotations

from typing import Any

import rotorfit as rf


def plain_fit(model: rf.models.RotorModel, experiments: Any, **options: Any) -> rf.FitResult:
    """As ``rf.fit`` with ``causes=None``."""
    return rf.fit(model, experiments, causes=None, **options)


def moves_of(fit: rf.FitResult, cause: str, name: str) -> float:
    """Change of a fitted value by a unit of a cause."""
    solved = fit.settings.solved
    assert solved is not None
    place = [one.name for one in solved.causes].index(cause)
    return float(solved.errors.moves[fit.var_names.index(name), place])


def summary_words(fit: rf.FitResult) -> str:
    """The summary without its line breaks, which part sentences."""
    return " ".join(fit.summary().split())


def table_row(fit: rf.FitResult, name: str) -> list[str]:
    """Words of a parameter's line in the table of a summary."""
    table = fit.summary().partition("\nparameter ")[2]
    return next(line.split() for line in table.splitlines() if line.startswith(f"{name} "))
