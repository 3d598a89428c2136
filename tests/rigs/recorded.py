"""A small recording made of known motion and angles, for tests of reading: volts by channel."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
RATE = 3200.0
ATTRIBUTES: dict[str, float | str] = {
    "sample_rate_hz": RATE, "speed_rpm": 1200.0, "sensitivity_V_per_mm": 7.87, "probe_angle_deg_X": 0.0,
    "probe_angle_deg_Y": 90.0, "force_plane": "disk", "whirl": "forward", "mr_kg_m": 2e-5,
    "heavy_spot_deg_ahead_of_mark": 40.0, "keyphasor": "falling edge of a notch, -2 V to -8 V",
}  # fmt: skip
"""What the recording says of itself."""


def shaft_angle(t: Float) -> Float:
    """20 turns a second, the mark 0.9 rad ahead at the start."""
    return 2 * np.pi * 20.0 * t + 0.9


def perturbator_angle(t: Float) -> Float:
    """5 to 45 turns a second in 4 s."""
    return 2 * np.pi * (5.0 * t + 5.0 * t**2)


def motion(t: Float, whirl: int = 1) -> NDArray[np.complex128]:
    """30 um with the shaft and 50 um with the perturbator, m."""
    return 30e-6 * np.exp(1j * (shaft_angle(t) + 0.5)) + 50e-6 * np.exp(1j * whirl * (perturbator_angle(t) - 0.3))


def notch(angle: Float, spread: float = 0.02) -> Float:
    """-8 V in a notch of 30 degrees, -2 V outside, with the edge spread over some samples as filters do, rad."""
    position = np.mod(angle, 2 * np.pi)
    return -5.0 + 3.0 * (
        np.tanh((position - np.pi / 6) / spread) - np.tanh(position / spread) + np.tanh((2 * np.pi - position) / spread)
    )


def volts(
    seconds: float = 4.0, *, whirl: int = 1, angles: tuple[float, float] = (0.0, 90.0), noise: float = 3e-3
) -> dict[str, Float]:
    """All channels of the recording."""
    t = np.arange(round(seconds * RATE)) / RATE
    rng = np.random.default_rng(11)
    z = motion(t, whirl)
    found = {
        f"disk_{axis}": -10.0 + 7870.0 * (z * np.exp(-1j * np.radians(angle))).real + noise * rng.normal(size=t.size)
        for axis, angle in zip("XY", angles, strict=True)
    }
    found["keyphasor_shaft"] = notch(shaft_angle(t))
    found["keyphasor_perturbator"] = notch(perturbator_angle(t))
    return found


def write_hdf5(path: Path, channels: dict[str, Float], attributes: dict[str, float | str] | None = None) -> Path:
    """As the recordings of most loggers: 16-bit counts with their scale, attributes on the file."""
    with h5py.File(path, "w") as file:
        file.attrs.update(ATTRIBUTES if attributes is None else attributes)
        for name, values in channels.items():
            finite = np.nan_to_num(values)
            scale = max(float(np.abs(finite).max()) / 32000, 1e-6)
            data = np.round(finite / scale).astype("i2") if np.isfinite(values).all() else values
            item = file.create_dataset(name, data=data)
            if data is not values:
                item.attrs["volts_per_count"] = scale
    return path


SETUP = """
rotation = "ccw"
sample_rate_hz = 3200.0
speed_rpm = 1200.0
[shaft]
channel = "keyphasor_shaft"
[perturbator]
channel = "keyphasor_perturbator"
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
sensitivity_V_per_mm = 7.87
[[probe]]
plane = "disk"
channel = "disk_Y"
angle_deg = 90.0
sensitivity_mV_per_um = 7.87
[force]
plane = "disk"
mr_g_mm = 20.0
angle_deg = 40.0
whirl = "forward"
"""
"""The same said by a setup."""
