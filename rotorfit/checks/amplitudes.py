"""Amplitudes that no rotor in a bearing or seal can have, or that no probe resolves: slips of the unit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from rotorfit.data.experiments import DisplacementTest, PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.models.array_types import ComplexArray, Float

LARGEST, SUSPECT, SMALLEST = 0.05, 5e-3, 1e-6
"""Displacements, m: impossible, larger than any clearance in use, and the largest of a sweep that hardly shows.

A fit cannot notice a wrong unit: forces over displacements scale every mass, damping and stiffness alike.
"""


def amplitudes(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    """Amplitudes that are too large or too small to be true."""
    size = sizes(test, test.response) if isinstance(test, PerturbationTest) else np.abs(test.displacement)
    largest = float(size.max())
    if largest > SUSPECT:
        severity: Literal["error", "warning"] = "error" if largest > LARGEST else "warning"
        text = (
            f"Amplitudes reach {largest:.3g} m 0-peak; no rotor in a bearing or seal moves that far. Check the unit "
            "of the amplitude column (um, mil, m)."
        )
        yield Finding(severity, "large-amplitude", text, tuple(np.flatnonzero(size > SUSPECT).tolist()))
    elif 0 < largest < SMALLEST:
        text = (
            f"The largest amplitude is {largest:.3g} m 0-peak, little for a rotor and hardly more than probes resolve. "
            "Check the unit of the amplitude column (amplitude_um, amplitude_mm): wrong, it goes into every mass, "
            "damping and stiffness, and no fit can notice."
        )
        yield Finding("warning", "small-amplitude", text)


def sizes(test: PerturbationTest, response: ComplexArray) -> Float:
    """Amplitudes in metres, slopes with a tenth of a metre: one of 0.5 rad is as impossible as 50 mm."""
    lines = test.lines
    lever = np.array([0.1 if direction.startswith("r") else 1.0 for direction in lines.names["direction"]])
    return np.asarray(np.abs(response) * lever[lines.number["direction"]])
