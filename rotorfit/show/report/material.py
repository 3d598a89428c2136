"""Input of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from rotorfit.base.significance import P_CHANCE
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.refine import Refinement
from rotorfit.identify.uncertainty.bootstrap import Bootstrap
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.identify.uncertainty.profile import Profile
from rotorfit.lab.data.findings import Finding

if TYPE_CHECKING:
    from rotorfit.lab.recordings.recording import Recording

LEVEL = 1 - P_CHANCE
"""Probability of every interval in a report."""


FigureFormat = Literal["png", "pdf", "svg", "none"]
"""Of the figures' files; "none" leaves figures out of the report too."""


@dataclass(frozen=True, kw_only=True)
class ReportInput:
    """All that a report is written from, as :func:`write_report` takes it."""

    fit: FitResult
    posterior: Posterior | None = None
    refinement: Refinement | None = None
    findings: Sequence[Sequence[Finding]] = ()
    profiles: Sequence[Profile] = ()
    bootstrap: Bootstrap | None = None
    shares: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    operating_speed: float | None = None
    figure_format: FigureFormat = "png"
    recordings: Sequence[Recording] = ()
    turns: int | None = None
    command: str = ""
    reading: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    interactive: bool = False
    pictures: dict[str, bytes] = field(default_factory=dict)
