"""Findings about data and fits, and the warning that carries them where data are read."""

from __future__ import annotations

import inspect
import logging
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool

_PACKAGE = __name__.partition(".")[0]
_LOG = logging.getLogger(__name__)


class DataWarning(UserWarning):
    """Data that were read have an error, or were not read in full."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, odd or worth knowing about data or what was worked out of them.

    Attributes:
        severity: ``error`` spoils every fit, ``warning`` spoils some or is likely an error, ``note`` is good to know.
        code: short name of the kind of finding, for programs.
        message: what, where and what to do.
        rows: rows of the experiment concerned, for ``select``; empty if it is about the test as a whole.
        lines: lines of the file that these rows stand in, where they are known.
        remedy: what mends it, in a phrase, where that is known.
        source: the data concerned, where there are several sets.
        origin: what it is about: the data as they were read, a recording, the fit, its noise, or the model.
        correction: name under which a study undoes it, ``--undo NAME``, where the data can be corrected as they stand.
    """

    severity: Literal["error", "warning", "note"]
    code: str
    message: str
    rows: tuple[int, ...] = field(default=(), repr=False)  # may be all rows of a test
    lines: tuple[int, ...] = field(default=(), repr=False)
    remedy: str | None = None
    source: str = ""
    origin: Literal["reading", "recording", "fit", "noise", "model"] = "reading"
    correction: str | None = None

    @property
    def words(self) -> str:
        """The message, with the source where it is given, and how the data are corrected as they stand."""
        return f"{self._said}{self._undoing}"

    @property
    def _said(self) -> str:
        return f"{self.source}: {self.message}" if self.source else self.message

    @property
    def _undoing(self) -> str:
        return f' (undo = ["{self.correction}"], --undo "{self.correction}")' if self.correction else ""

    def at_rows(self, numbers: NDArray[np.intp]) -> Finding:
        """The finding of a part of a test as one of the whole.

        Args:
            numbers: rows of the whole by rows of the part.
        """
        return replace(self, rows=tuple(numbers[list(self.rows)].tolist()))

    def __str__(self) -> str:
        places = _places("Lines", self.lines) if self.lines else _places("Readings", [row + 1 for row in self.rows])
        return f"{self.severity} [{self.code}] {self._said}{places}{self._undoing}"


def warn_of(findings: Iterable[Finding]) -> None:
    """Warn of findings where somebody outside this package called."""
    for finding in findings:
        _LOG.info("%s", finding)
        warnings.warn(finding.message, DataWarning, stacklevel=level_of_caller())


def level_of_caller() -> int:
    """Level of the stack, as :func:`warnings.warn` counts, at which somebody outside this package called."""
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
        frame, level = frame.f_back, level + 1
    return level


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


def told_once(findings: Iterable[Finding], names: Sequence[str]) -> tuple[Finding, ...]:
    """Findings that begin with the name of a recording, ``a: what``, as one where several say the same."""
    found: dict[Finding, list[str]] = {}
    for finding in findings:
        name, colon, what = finding.message.partition(": ")
        several = bool(colon) and name in names and not finding.rows
        found.setdefault(replace(finding, message=what) if several else finding, []).extend([name] * several)
    return tuple(
        replace(finding, message=f"{listed(of)}: {finding.message}") if of else finding for finding, of in found.items()
    )


def rows_of(mask: Bool) -> tuple[int, ...]:
    """Numbers of the rows that a mask names."""
    return tuple(np.flatnonzero(mask).tolist())


def errors_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings by severity."""
    order = ("error", "warning", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def attributed(findings: Sequence[Iterable[Finding]], sources: Sequence[str]) -> list[Finding]:
    """Findings of several sets of data in one list, errors first; of more than one with the name of its source."""
    several = len(findings) > 1
    pairs = zip(findings, sources, strict=True)
    return errors_first(replace(found, source=source if several else "") for own, source in pairs for found in own)


def errors_in(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The errors among findings in words, each once."""
    return tuple(dict.fromkeys(found.words for found in findings if found.severity == "error"))


def warnings_in(findings: Iterable[Finding]) -> list[str]:
    """The warnings among findings in words, each once, with the sets of data that it was said of."""
    sources: dict[str, list[str]] = {}
    for found in findings:
        if found.severity == "warning":
            sources.setdefault(found.message, []).append(found.source)
    return [
        f"warning: {', '.join([*filter(None, dict.fromkeys(of[:3]))] or ['data'])}: {text}"
        for text, of in sources.items()
    ]


LOCAL_MINIMUM, INTERNAL_PROBLEM, BAD_LINES = "local-minimum", "internal-problem", "bad-lines"
"""Codes of what a diagnosis finds of the fit itself, of the program, and of a few lines that alone miss a fit."""


def of_the_fit(findings: Iterable[Finding]) -> list[Finding]:
    """Findings about a fit and the program, not about its data."""
    return [found for found in findings if found.code in (LOCAL_MINIMUM, INTERNAL_PROBLEM)]


NO_COPIES = "A copy is no second measurement and makes errors look smaller than they are. Leave it out."
"""Sentence on readings, runs and recordings that are there twice."""

PHASE_DATUM = "phase-datum"
"""Code of the note that the zero of forces and that of readings are unknown to each other."""

_BY_PHASE = frozenset({"conjugated", "negative-damping", "reversed-rotation"})
"""Codes of what is judged by the phase between force and response."""


def without_phases(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings but those that the phase between force and response was judged by, where it has no common zero yet."""
    return tuple(finding for finding in findings if finding.code not in _BY_PHASE)


def error_sentence(errors: Sequence[str]) -> str:
    """The errors in one sentence for the end of an answer; empty where there are none."""
    return f"the check of the data calls these an error: {' '.join(errors)}" if errors else ""
