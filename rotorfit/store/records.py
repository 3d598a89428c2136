"""Records of a store: tests, fits, and the outcome for a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rotorfit.fitting.arithmetic import shown_unit
from rotorfit.models.digits import plus_minus


@dataclass(frozen=True, kw_only=True)
class StoredValue:
    """A parameter of a stored fit, SI units."""

    value: float  # estimate, NaN where the data do not determine it
    stderr: float  # its standard error
    systematic: float  # standard uncertainty by what the model leaves out or takes as known
    unit: str  # SI unit

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return "not determined"
        return f"{plus_minus(self.value, math.hypot(self.stderr, self.systematic))} {shown_unit(self.unit)}".rstrip()


@dataclass(frozen=True, kw_only=True)
class StoredTest:
    """A test in a store."""

    number: int  # by which the store knows it, in order of arrival
    batch: int  # the same of tests that were added together
    content: str  # hash of its readings
    kind: str  # what was measured
    readings: int  # how many
    machine: str  # the machine, by the attribute ``machine`` of the data or as it was added; may be empty
    date: str  # ISO 8601, by the attribute ``date`` of the data, else the time of the file
    date_given: bool  # whether the data give it
    conditions: Mapping[str, float | str]  # attributes: the mean of numbers, the text of texts
    sources: tuple[str, ...]  # files and folders it was found in
    findings: tuple[str, ...]  # errors and warnings of the check of the data
    superseded: int | None  # number of the later test that holds the same files, completed; none where this one counts


@dataclass(frozen=True, kw_only=True)
class StoredFit:
    """A fit in a store; :meth:`Store.result` gives the whole of it."""

    number: int  # by which the store knows it
    test: int  # number of the test
    model: str  # name of the model
    settings: str  # hash of the settings
    success: bool  # whether it converged
    message: str  # how it ended, or why there is none
    redchi: float  # as of :class:`rotorfit.FitResult`, NaN without a fit
    errors: tuple[str, ...]  # errors of the data, in words
    warnings: tuple[str, ...]  # of the check of the data and of the fit
    # values by name; the threshold speed is among them, by the name ``threshold_speed``
    params: Mapping[str, StoredValue]
    version: str  # of rotorfit that made it

    @property
    def good(self) -> bool:
        """True if its values may be followed: it converged and the data have no error."""
        return self.success and not self.errors


@dataclass(frozen=True, kw_only=True)
class Added:
    """The outcome for one file, or for the recordings of one folder."""

    source: str  # the file or folder
    test: int | None = None  # number of the test, none where it was refused
    fit: int | None = None  # number of the fit, none without a study
    new_test: bool = False  # new_test, new_fit: whether the store did not have them before
    new_fit: bool = False
    refusal: str = field(default="")  # why the file was refused, empty where it was not
