"""Records of a store: tests, fits, and the outcome for a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rotorfit.fitting.arithmetic import shown_unit
from rotorfit.fitting.digits import plus_minus


@dataclass(frozen=True, kw_only=True)
class StoredValue:
    """A parameter of a stored fit, SI units.

    Attributes:
        value: estimate, NaN where the data do not determine it.
        stderr: its standard error.
        systematic: standard uncertainty by what the model leaves out or takes as known.
        unit: SI unit.
    """

    value: float
    stderr: float
    systematic: float
    unit: str

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return "not determined"
        return f"{plus_minus(self.value, math.hypot(self.stderr, self.systematic))} {shown_unit(self.unit)}".rstrip()


@dataclass(frozen=True, kw_only=True)
class StoredTest:
    """A test in a store.

    Attributes:
        number: by which the store knows it, in order of arrival.
        batch: the same of tests that were added together.
        content: hash of its readings.
        kind: what was measured.
        readings: how many.
        machine: the machine, by the attribute ``machine`` of the data or as it was added; may be empty.
        date: ISO 8601, by the attribute ``date`` of the data, else the time of the file.
        date_given: whether the data give it.
        conditions: attributes: the mean of numbers, the text of texts.
        sources: files and folders it was found in.
        findings: errors and warnings of the check of the data.
        superseded: number of the later test that holds the same files, completed; none where this one counts.
    """

    number: int
    batch: int
    content: str
    kind: str
    readings: int
    machine: str
    date: str
    date_given: bool
    conditions: Mapping[str, float | str]
    sources: tuple[str, ...]
    findings: tuple[str, ...]
    superseded: int | None


@dataclass(frozen=True, kw_only=True)
class StoredFit:
    """A fit in a store; :meth:`Store.result` gives the whole of it.

    Attributes:
        number: by which the store knows it.
        test: number of the test.
        model: name of the model.
        settings: hash of the settings.
        success: whether it converged.
        message: how it ended, or why there is none.
        redchi: as of :class:`rotorfit.FitResult`, NaN without a fit.
        errors: errors of the data, in words.
        warnings: of the check of the data and of the fit.
        params: values by name; the threshold speed is among them, by the name ``threshold_speed``.
        version: of rotorfit that made it.
    """

    number: int
    test: int
    model: str
    settings: str
    success: bool
    message: str
    redchi: float
    errors: tuple[str, ...]
    warnings: tuple[str, ...]
    params: Mapping[str, StoredValue]
    version: str

    @property
    def good(self) -> bool:
        """True if its values may be followed: it converged and the data have no error."""
        return self.success and not self.errors


@dataclass(frozen=True, kw_only=True)
class Added:
    """The outcome for one file, or for the recordings of one folder.

    Attributes:
        source: the file or folder.
        test: number of the test, none where it was refused.
        fit: number of the fit, none without a study.
        new_test, new_fit: whether the store did not have them before.
        refusal: why the file was refused, empty where it was not.
    """

    source: str
    test: int | None = None
    fit: int | None = None
    new_test: bool = False
    new_fit: bool = False
    refusal: str = field(default="")
