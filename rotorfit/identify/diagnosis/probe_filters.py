"""Effects of a channel on a displacement on its way into a file, integrators, filters, latencies and other units; and
one probe of a pair behind a filter: its ratio to the other one changes with frequency as that of no rotor does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelFilter:
    """A family of filters with one value."""

    code: str
    message: str  # what readings are, with a place for the value
    undo: str  # how it is undone, likewise
    seen: Callable[[ComplexArray, float], ComplexArray]  # what is read of a displacement, by s = jw and the value
    slope: Callable[[ComplexArray], ComplexArray]  # change of the logarithm of that by a little of the filter
    corner: bool = True  # whether the value is a frequency, rad/s, or a time, s

    def shown(self, value: float) -> str:
        """The value with its unit."""
        return f"{significant(value / (2 * np.pi), 3)} Hz" if self.corner else f"{significant(value, 3)} s"

    def words(self, value: float) -> tuple[str, str]:
        """Words for readings behind it, and how it is undone."""
        said = self.shown(value)
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
        code="high-pass-2",
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


_PROBES: tuple[Literal["x", "y"], ...] = ("x", "y")


@dataclass(frozen=True, kw_only=True)
class FilteredProbe:
    """The probe of a pair that is behind a filter, and which."""

    probe: Literal["x", "y"]  # which of the two
    words: tuple[str, str]  # what is said of it, and how it is undone
    kind: ChannelFilter | int  # the filter; a power of the frequency where there is none
    value: float  # corner, rad/s, of the filter; frequency, rad/s, at which that power is one

    def seen(self, s: ComplexArray) -> ComplexArray:
        """Ratio of its readings to those of the other one."""
        return (s / self.value) ** self.kind if isinstance(self.kind, int) else self.kind.seen(s, self.value)


@dataclass(frozen=True, eq=False, kw_only=True)
class Pair:
    """Readings y of a plane beside what an isotropic rotor makes of x, shape ``(N,)``."""

    w: Float  # size of the frequency, rad/s
    expected: ComplexArray  # responses of the model, m
    seen: ComplexArray  # responses measured, m
    noise: Float  # of x and of y, m, shape ``(N, 2)``

    def part(self, some: slice) -> Pair:
        """Some of them."""
        return Pair(**{name: values[some] for name, values in vars(self).items()})


def filtered_probe(pair: Pair, limit: float) -> FilteredProbe | None:
    """The probe of a pair behind a filter that explains how y differs from what x makes one expect, if one does."""
    found: list[tuple[float, FilteredProbe]] = []
    s, middle = np.asarray(1j * pair.w), float(np.exp(np.mean(np.log(pair.w))))
    count = 60  # corners; neighbours differ by a tenth
    for probe in _PROBES:
        for power, (_, *words) in POWERS.items():
            if power < 0:
                continue  # the other one gives velocities, rather
            misfits, factors = _misfits(np.asarray((s / middle)[None] ** power), probe, pair)
            if abs(np.angle(factors[0])) < INSTRUMENT_SCATTER:
                value = middle / float(abs(factors[0])) ** (1 / power)
                one = FilteredProbe(probe=probe, words=(words[0], words[1]), kind=power, value=value)
                found.append((float(misfits[0]), one))
        for kind in CHANNEL_FILTERS:
            if not kind.corner:
                continue  # a probe that comes late is looked for by itself
            tried = values_to_try(kind, pair.w, count)
            for _ in range(4):  # the neighbours of the best are looked at more finely each time
                filters = np.stack([kind.seen(s, value) for value in tried.tolist()])
                misfits, factors = _misfits(filters, probe, pair)
                at = int(np.argmin(misfits))
                if not 0 < at < tried.size - 1:
                    break
                value, left, factor = float(tried[at]), float(misfits[at]), complex(factors[at])
                tried = np.geomspace(tried[at - 1], tried[at + 1], 21)
            else:
                if abs(np.log(factor)) < INSTRUMENT_SCATTER:
                    found.append((left, FilteredProbe(probe=probe, words=kind.words(value), kind=kind, value=value)))
    left, best = min(found, key=lambda one: one[0], default=(np.inf, None))
    return best if left < limit else None


def _misfits(filters: ComplexArray, probe: str, pair: Pair) -> tuple[Float, ComplexArray]:
    """Mean squares over the noise with one probe behind each filter, ``(K, N)``, and the factors left, ``(K,)``."""
    ratio = filters if probe == "y" else 1 / filters
    own, noise = ratio * pair.expected, pair.noise
    factor = np.ones(len(ratio), dtype=complex)
    for _ in range(4):  # of weights that depend on the factor
        weight = 1 / (noise[:, 1] ** 2 + np.abs(factor[:, None] * ratio) ** 2 * noise[:, 0] ** 2)
        factor = np.sum(weight * own.conj() * pair.seen, axis=1) / np.sum(weight * np.abs(own) ** 2, axis=1)
    left = np.mean(weight * np.abs(pair.seen - factor[:, None] * own) ** 2, axis=1) / 2
    return np.asarray(left), np.asarray(factor if probe == "y" else 1 / factor)
