"""Fits without causes, of tests that are about estimators, readers and rigs: what the noise alone leaves."""

from __future__ import annotations

from typing import Any

import rotorfit as rf


def plain_fit(model: rf.models.RotorModel, experiments: Any, **options: Any) -> rf.FitResult:
    """As ``rf.fit`` with ``causes=None``."""
    return rf.fit(model, experiments, causes=None, **options)
