"""Effects of a channel on a displacement on its way into a file: integrators, filters, latencies, other units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant


@dataclass(frozen=True, kw_only=True)
class ChannelFilter:
    """A family of filters with one value."""

    code: str
    message: str  # what readings are, with a place for the value
    undo: str  # how it is undone, likewise
    seen: Callable[[ComplexArray, float], ComplexArray]  # what is read of a displacement, by s = jw and the value
    slope: Callable[[ComplexArray], ComplexArray]  # change of the logarithm of that by a little of the filter
    corner: bool = True  # whether the value is a frequency, rad/s, or a time, s

    def words(self, value: float) -> tuple[str, str]:
        """Words for readings behind it, and how it is undone."""
        said = f"{significant(value / (2 * np.pi), 3)} Hz" if self.corner else f"{significant(value, 3)} s"
        return self.message.format(value=said), self.undo.format(value=said)


POWERS = {
    1: ("velocities", "velocities, read as displacements", "divide them by j w"),
    2: ("accelerations", "accelerations, read as displacements", "divide them by -w^2"),
    -1: (
        "integrated-once-too-often",
        "integrated once too often, or read as velocities and integrated",
        "multiply them by j w",
    ),
}
"""Powers of s = jw by which readings are not displacements: code, what they are, and how that is undone."""

_LIKE = {
    2.0: "peak-to-peak amplitudes read as 0-peak",
    2**-0.5: "rms amplitudes read as 0-peak",
    25.4: "um read as mil",
    1 / 25.4: "mil read as um",
    10.0: "a decimal point",
    0.1: "a decimal point",
    1000.0: "um read as mm",
    0.001: "mm read as um",
}
SAME_FACTOR = 0.03
"""Relative difference of factors that are the same, as gains of two probes: results move by half of it. Chosen."""
INSTRUMENT_SCATTER = 0.1
"""Logarithm of a factor, angles in rad, up to which forces and instruments scatter without an error. Chosen."""

CHANNEL_FILTERS = (
    ChannelFilter(
        code="high-pass",
        message="behind a high-pass of first order with its corner at {value}, as AC-coupled channels are",
        undo="record with DC coupling, or divide by j f / (j f + {value})",
        seen=lambda s, corner: s / (s + corner),
        slope=lambda s: 1 / s,
    ),
    ChannelFilter(
        code="high-pass",
        message="behind a high-pass of second order with its corner at {value}, as velocity sensors have",
        undo="divide by (j f)^2 / ((j f)^2 + 1.414 j f {value} + ({value})^2)",
        seen=lambda s, corner: s**2 / (s**2 + np.sqrt(2) * corner * s + corner**2),
        slope=lambda s: 1 / s,
    ),
    ChannelFilter(
        code="low-pass",
        message="behind a low-pass of first order with its corner at {value}",
        undo="take it out, or divide by 1 / (1 + j f / ({value}))",
        seen=lambda s, corner: 1 / (1 + s / corner),
        slope=lambda s: s,
    ),
    ChannelFilter(
        code="delay",
        message="{value} late against the forces, at all frequencies alike",
        undo="give the delays of the channels (delays)",
        seen=lambda s, late: np.exp(-s * late),
        slope=lambda s: s,
        corner=False,
    ),
)


def values_to_try(kind: ChannelFilter, frequency: Float, count: int) -> Float:
    """Corners, rad/s, or latencies, s, that readings at some frequencies can tell, ascending."""
    size = np.abs(frequency)
    low, high = (max(size.min(), size.max() / 100) / 4, 10 * size.max()) if kind.corner else (0.02, 3.0) / size.max()
    return np.asarray(np.geomspace(low, high, count))


def likeness(factor: float) -> str:
    """Likely cause of readings that are so many times too large, as ", as by ..."; empty where nothing is likely."""
    like = [text for value, text in _LIKE.items() if abs(np.log(factor / value)) < SAME_FACTOR]
    return f", as by {like[0]}" if like else ""
