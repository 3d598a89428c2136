"""What the check of data says, as its tests ask for it."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorfit.identify.diagnosis.check import check
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment


def found(test: Experiment, code: str) -> Finding:
    """The only finding of its kind."""
    findings = [finding for finding in check(test) if finding.code == code]
    assert len(findings) == 1, [str(f) for f in check(test)]
    finding = findings[0]
    assert finding.message[0].isupper()
    assert finding.message.endswith(".")
    return finding


def codes(test: Experiment, *severities: str) -> set[str]:
    return {f.code for f in check(test) if not severities or f.severity in severities}


def rows(mask: Any) -> tuple[int, ...]:
    return tuple(np.flatnonzero(mask).tolist())
