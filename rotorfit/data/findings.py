"""What the data check reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Finding:
    """One thing that :func:`check` noticed.

    Attributes:
        severity: ``error`` spoils every fit, ``warning`` spoils some or is likely a slip, ``note`` is good to know.
        code: short name of the kind of finding, for programs.
        message: what, where and what to do.
        rows: rows of the experiment concerned, for ``select``; empty if it is about the test as a whole.
        lines: lines of the file that these rows stand in, where they are known.
    """

    severity: Literal["error", "warning", "note"]
    code: str
    message: str
    rows: tuple[int, ...] = ()
    lines: tuple[int, ...] = ()

    def __str__(self) -> str:
        places = _places("Lines", self.lines) if self.lines else _places("Readings", [row + 1 for row in self.rows])
        return f"{self.severity} [{self.code}] {self.message}{places}"


def _places(what: str, places: Sequence[int]) -> str:
    """Numbers in a few words, counted from 1 as people count."""
    if not places:
        return ""
    numbers = np.unique(places)
    ranges = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    words = [f"{part[0]}" if part.size == 1 else f"{part[0]}-{part[-1]}" for part in ranges[:6]]
    more = f", ... ({numbers.size} in all)" if len(ranges) > 6 else ""
    return f" {what} {', '.join(words)}{more}."


def listed(names: Sequence[str]) -> str:
    """Names with commas between, the first six of them."""
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def errors_in(findings: Sequence[Sequence[Finding]], sources: Sequence[str]) -> tuple[str, ...]:
    """What the check of the data calls an error, each once; of several sets of data with the name of its own."""
    several = len(findings) > 1
    return tuple(
        dict.fromkeys(
            f"{source}: {found.message}" if several and source else found.message
            for own, source in zip(findings, sources, strict=True)
            for found in own
            if found.severity == "error"
        )
    )


def warnings_in(findings: Sequence[Sequence[Finding]], sources: Sequence[str]) -> list[str]:
    """What the check of the data warns of, each once, with the sets of data that it was said of."""
    told: dict[str, list[str]] = {}
    for own, source in zip(findings, sources, strict=True):
        for found in own:
            if found.severity == "warning":
                told.setdefault(found.message, []).append(source)
    return [f"warning: {', '.join(filter(None, dict.fromkeys(of[:3])))}: {text}" for text, of in told.items()]


NO_COPIES = "A copy is no second measurement and makes errors look smaller than they are. Leave it out."
"""What is wrong with readings, runs and recordings that are there twice."""

PHASE_DATUM = "phase-datum"
"""Code of the note that the zero of forces and that of readings are unknown to each other."""

_BY_PHASE = frozenset({"conjugated", "negative-damping", "reversed-rotation", "probe-angle"})
"""Codes of what is judged by the phase between force and response."""


def without_phases(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings but those that the phase between force and response was judged by, where it has no common zero yet."""
    return tuple(finding for finding in findings if finding.code not in _BY_PHASE)


def error_sentence(errors: Sequence[str]) -> str:
    """The errors in one sentence for the end of an answer; empty where there are none."""
    return f"the check of the data calls these an error: {' '.join(errors)}" if errors else ""
