"""Images of a perturbation at 2 Om - w, which a shaft shows whose stiffness turns with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.estimators.signals.local_response import LocalResponse
from rotorfit.models.array_types import ComplexArray
from rotorfit.recordings.reduction.reduced_record import ReducedRecord, is_pair


def image_seen(reduced: ReducedRecord, found: LocalResponse) -> bool:
    """True if what responses to a forward sweep leave over follows ``conj(f) exp(2j theta)`` where two probes are.

    The image of a backward one is above its band, where nothing was looked at.
    """
    if reduced.shaft_angle is None or reduced.whirl < 0:
        return False
    image = reduced.unit_force.conj() * np.exp(2j * reduced.shaft_angle)
    drives = [reduced.spectrum(signal) for signal in (image, image.conj())]  # of z and of its conjugate
    row = 0
    for plane in reduced.record.planes:
        pair = is_pair(reduced.record, plane)
        # Share of what the responses leave over that is the image, from which it stands out of the noise
        image_share = 0.4
        if pair and _share(found, row, drives) > image_share:
            return True
        row += 4 if pair else 1
    return False


def _share(found: LocalResponse, row: int, drives: Sequence[ComplexArray]) -> float:
    """Share of the power left over that drives explain, those of two rows from one on."""
    explained = left = 0.0
    # Spectral lines of a band in which the response to the image's drive is one number: noise explains 1/12 so.
    lines = 12
    for rest, drive in zip(found.residual[0][row : row + 2], drives, strict=True):
        inside = np.flatnonzero(np.isfinite(rest))
        count = inside.size // lines * lines
        if not count:
            continue
        r, d = (values[inside[:count]].reshape(-1, lines) for values in (rest, drive))
        power = np.sum(np.abs(d) ** 2, axis=1)
        drive_power_share = 0.1  # power of the drive over that of its median band from which it counts
        counts = power > drive_power_share * np.median(power[power > 1e-3 * power.max()])
        explained += float(np.sum((np.abs(np.sum(d.conj() * r, axis=1)) ** 2 / np.maximum(power, 1e-300))[counts]))
        left += float(np.sum(np.abs(r[counts]) ** 2))
    return explained / left if left else 0.0
