"""What causes do that a rig may have beside its model: to the readings, to the rotor, or to values of the model.

What an act does is its own answer: the change of the predictions, the stiffness that it adds, the values that it
changes, the term that it is at the onset.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse, probe_factors
from rotorfit.models import RotorModel
from rotorfit.models.motion.neglected_terms import Entries, LeftOut

_STEP = 1e-4
"""Share for central differences: truncated at 1e-8, rounded at 1e-12."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """Predictions of a block at parameter vectors, and what changes of them are made of, each worked out once."""

    block: Block
    theta: Float  # shape ``(G, P)``

    @cached_property
    def base(self) -> Responses | None:
        """Its responses to forces; nothing for other blocks."""
        return self.block.responses

    @cached_property
    def linear(self) -> Responses | None:
        """Responses of a linear rotor to circular forces, with what acts beside it; nothing for other blocks."""
        base = self.block.linear
        return None if base is None or base.imposed or not base.frequency.any() else base

    @cached_property
    def circular(self) -> Responses | None:
        """Likewise, the centred orbits of a rotor that is not linear included."""
        base = self.block.circular
        return None if base is None or base.imposed or not base.frequency.any() else base

    @cached_property
    def values(self) -> Float:
        """Parameter vectors of the groups of :attr:`linear`."""
        return self.block.values(self.theta)

    @cached_property
    def receptance(self) -> ComplexArray:
        """Of :attr:`linear`, shape ``(L, n, n)``."""
        base = self.linear
        return np.zeros(0, dtype=complex) if base is None else inverse(dynamic_stiffness(base, self.values))

    @cached_property
    def planes(self) -> ComplexArray:
        """Motion of all coordinates, shape ``(L, n)``."""
        if self.linear is None:
            return self.block.motion(self.theta) if self.circular is not None else np.zeros((0, 0), dtype=complex)
        return np.asarray(np.einsum("lij,lj->li", self.receptance, self.linear.force))

    def pushed(self, force: ComplexArray) -> ComplexArray:
        """Change of the predictions by small forces beside those of the test, shape ``(L, n)``."""
        if self.linear is None:
            return self.read(self.block.pushed(self.theta, force))
        return self.read(np.einsum("lij,lj->li", self.receptance, force))

    @cached_property
    def right(self) -> ComplexArray:
        """Motion of all coordinates at each reading, shape ``(n, R)``."""
        base = self.linear
        return np.zeros((0, 0), dtype=complex) if base is None else self.planes.T[:, base.line]

    @cached_property
    def left(self) -> ComplexArray:
        """What each reading is of a unit force at all coordinates, shape ``(n, R)``."""
        return np.array([self.read(column) for column in np.moveaxis(self.receptance, -1, 0)])

    @cached_property
    def gain(self) -> ComplexArray:
        """Factor of each reading by its probe and by causes, shape ``(R,)``."""
        if self.circular is None:
            return np.ones(self.block.measured.size, dtype=complex)
        return probe_factors(self.circular, self.values) * self.block.by_causes

    @cached_property
    def predicted(self) -> ComplexArray:
        """Predictions, shape ``(R,)``."""
        return self.block.predict(self.theta)

    @cached_property
    def by_values(self) -> ComplexArray:
        """Derivatives of the predictions by the values of each reading's own line, shape ``(R, P)``."""
        return self.block.by_values(self.theta)[1]

    def read(self, motion: ComplexArray) -> ComplexArray:
        """What the probes read of a motion of all coordinates, shape ``(L, n)``."""
        if self.circular is None:
            return np.zeros(self.block.measured.size, dtype=complex)
        return np.asarray(self.block.seen_by_probes(motion) * self.gain)


class Act:
    """What a cause acts on; each kind answers what of it applies."""

    def change(self, motion: Motion) -> ComplexArray:
        """Change of the predictions by a unit of the size, shape ``(R,)``."""
        raise NotImplementedError

    def stiffness(self, base: Responses, theta: Float, size: float) -> ComplexArray | None:
        """Dynamic stiffness of a cause of a size, shape ``(L, n, n)``; nothing where it does not act on the rotor."""
        return None

    def changed(self, model: RotorModel, speed: Float) -> tuple[Float, Float] | None:
        """Share and addition by a unit of the size of each value at rotative speeds, shape ``(C, P)``; nothing for
        what does not depend on the speed alone."""
        return None

    def of_readings(self, motion: Motion) -> ComplexArray | None:
        """Change of the logarithm of each reading, shape ``(R,)``; nothing for other kinds."""
        return None

    def in_full(self, motion: Motion, size: float) -> ComplexArray | None:
        """Logarithm of the factor of each reading at a size, shape ``(R,)``; nothing for other kinds."""
        found = self.of_readings(motion)
        return None if found is None else size * found

    def values_at(self, model: RotorModel, theta: Float, speed: Float | float | None) -> Float | None:
        """Change of parameter vectors ``(..., P)`` at speeds by a unit of the size, without a speed that of the values
        themselves; nothing for other kinds."""
        return None

    def term(self, model: RotorModel, theta: Float, whirl: float) -> LeftOut | None:
        """Term of the equation of motion that a unit of it is for free motion at a whirl frequency; else nothing."""
        return None


# ---- readings ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class OfReadings(Act):
    """Readings that are off by a factor."""

    how: str  # "gain", "phase", "turned", "delay", "clock", "high-pass", "curve"
    plane: str = ""  # of the probes, all where it is empty
    middle: float = 0.0  # of the sweep along which a clock goes off, rad/s
    half: float = 1.0  # from there to its end, rad/s

    def of_readings(self, motion: Motion) -> ComplexArray | None:
        """See :class:`Act`."""
        base = motion.base
        if base is None:
            return None
        s = base.s_read
        match self.how:
            case "gain":
                factor = np.ones(s.size, dtype=complex)
            case "phase":
                factor = np.where(s != 0, base.by_phase, 0.0)
            case "turned":
                factor = np.full(s.size, 1j)
            case "delay":
                factor = -s
            case "clock":
                factor = -s * (np.abs(s.imag) - self.middle) / self.half
            case "high-pass":
                factor = -np.where(s != 0, 1.0, 0.0) / (np.where(s != 0, s, 1.0) + motion.block.corner)
            case _:  # the curve of a probe
                size = np.abs(motion.predicted) * self._own(base)
                factor = (size / max(float(size.max(initial=0.0)), 1e-300)) ** 2 + 0j
        return np.asarray(factor * self._own(base))

    def in_full(self, motion: Motion, size: float) -> ComplexArray | None:
        """See :class:`Act`."""
        found = super().in_full(motion, size)  # of a block whose corner is none yet
        return -np.log1p(-found) if self.how == "high-pass" and found is not None else found

    def _own(self, base: Responses) -> Bool | float:
        return base.read_at[self.plane] if self.plane else 1.0

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        factor = self.of_readings(motion)
        if factor is None:
            return np.zeros(motion.block.measured.size, dtype=complex)
        plain, base = np.asarray(motion.predicted * factor), motion.linear
        if base is None or base.beside is None or not base.beside_read or self.how == "curve":
            return plain
        # The same probes read the dry run: with A + dA they make kappa_dry (1 - dA/A) of it, which acts on the motion.
        off = np.zeros_like(motion.planes)
        off[base.line, base.coordinate] = factor
        return plain - motion.read(np.einsum("lij,ljk,lk->li", motion.receptance, base.beside, off * motion.planes))


# ---- the rotor -----------------------------------------------------------------------------------------------------


class OfRotor(Act):
    """What adds to the dynamic stiffness at some entries."""

    entries: Entries

    def factor(self, base: Responses, theta: Float) -> ComplexArray:
        """What the entries are multiplied by along the lines, shape ``(L,)``."""
        raise NotImplementedError

    def stiffness(self, base: Responses, theta: Float, size: float) -> ComplexArray | None:
        """See :class:`Act`."""
        n = len(base.model.coordinates)
        at = np.zeros((n, n))
        for i, j, weight in self.entries:
            at[i, j] += weight
        return np.asarray((size * self.factor(base, theta))[:, None, None] * at)

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        base = motion.circular
        if base is None:
            return motion.block.shifted(motion.theta, self.term)
        factor = self.factor(base, motion.values)
        if motion.linear is None:
            force = np.zeros_like(motion.planes)
            for i, j, weight in self.entries:
                force[:, i] -= weight * factor * motion.planes[:, j]
            return motion.pushed(force)
        moved = sum((weight * motion.left[i] * motion.right[j] for i, j, weight in self.entries), 0j)
        return np.asarray(-factor[base.line] * moved)


@dataclass(frozen=True, kw_only=True)
class Term(OfRotor):
    """A polynomial term of frequency and speed that the model leaves out."""

    left_out: LeftOut

    @property
    def entries(self) -> Entries:  # type: ignore[override]
        """See :class:`OfRotor`."""
        return self.left_out.entries

    def factor(self, base: Responses, theta: Float) -> ComplexArray:
        """See :class:`OfRotor`."""
        return self.left_out.factor(base.s, base.speed)

    def term(self, model: RotorModel, theta: Float, whirl: float) -> LeftOut | None:
        """See :class:`Act`."""
        return self.left_out


@dataclass(frozen=True, kw_only=True)
class Hysteresis(OfRotor):
    """Damping that does not grow with frequency."""

    entries: Entries

    def factor(self, base: Responses, theta: Float) -> ComplexArray:
        """See :class:`OfRotor`."""
        return np.asarray(1j * np.sign(base.s.imag))

    def term(self, model: RotorModel, theta: Float, whirl: float) -> LeftOut | None:
        """See :class:`Act`."""
        return LeftOut("", "", "", self.entries, ((1j * np.sign(whirl), 0, 0),))


@dataclass(frozen=True, kw_only=True)
class Lag(OfRotor):
    """A damping force of the fluid that lags, as of a compliance in series: ``D (w - lam Om)^2`` by its time."""

    entries: Entries
    ending: str = ""  # of the names of the fluid's parameters

    def stiffness(self, base: Responses, theta: Float, size: float) -> ComplexArray | None:
        """See :class:`Act`."""
        slip = 1j * (base.s.imag - _fluid(base.model, theta[base.group], self.ending)[1] * base.speed)
        found = super().stiffness(base, theta, size)
        return None if found is None else found / (1 + size * slip)[:, None, None]

    def factor(self, base: Responses, theta: Float) -> ComplexArray:
        """See :class:`OfRotor`."""
        D, lam = _fluid(base.model, theta[base.group], self.ending)
        return np.asarray(D * (base.s.imag - lam * base.speed) ** 2, dtype=complex)

    def term(self, model: RotorModel, theta: Float, whirl: float) -> LeftOut | None:
        """See :class:`Act`."""
        D, lam = (float(value) for value in _fluid(model, theta, self.ending))
        return LeftOut("", "", "", self.entries, ((-D, 2, 0), (2j * D * lam, 1, 1), (D * lam**2, 0, 2)))


def _fluid(model: RotorModel, theta: Float, ending: str) -> tuple[Float, Float]:
    """D and the ratio at which it turns, of parameter vectors."""
    names = model.parameter_names
    lam = names.index(f"lam_D{ending}" if f"lam_D{ending}" in names else f"lam{ending}")
    return theta[..., names.index(f"D{ending}")], theta[..., lam]


# ---- values --------------------------------------------------------------------------------------------------------


class OfValues(Act):
    """Values of the model that are not what it takes them for."""

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        base, block = motion.base, motion.block
        none = np.zeros(block.measured.size, dtype=complex)
        if base is not None:
            (index, group, _), speed = base.condition, (motion.linear or base).condition[2]
            model, of_reading = base.model, index[base.line]
        elif block.speed_read is not None:
            speed, group, model = block.speed_read, block.reading_group, block.model  # type: ignore[attr-defined]
            of_reading = np.arange(speed.size)
        else:
            return none
        found = self.changed(model, speed)
        if found is None:
            return none
        by_unit = motion.theta[group] * found[0] + found[1]
        some = np.flatnonzero(by_unit.any(axis=0))
        return np.asarray(np.sum(motion.by_values[:, some] * by_unit[:, some][of_reading], axis=1))


@dataclass(frozen=True, kw_only=True)
class Changing(OfValues):
    """A value of the fluid that changes with the speed; its size is the share at twice the mean speed."""

    names: tuple[str, ...]  # of the parameters that change together
    mean: float  # rad/s

    def changed(self, model: RotorModel, speed: Float) -> tuple[Float, Float] | None:
        """See :class:`Act`."""
        own = np.array([name in self.names for name in model.parameter_names], dtype=float)
        scaled = (np.abs(speed) / self.mean - 1)[:, None] * own
        return scaled, np.zeros_like(scaled)

    def values_at(self, model: RotorModel, theta: Float, speed: Float | float | None) -> Float | None:
        """See :class:`Act`."""
        if speed is None:
            return None
        own = np.array([name in self.names for name in model.parameter_names])
        return np.where(own, theta, 0.0) * (np.abs(speed) / self.mean - 1)[..., None]


@dataclass(frozen=True, kw_only=True)
class OfLines(Act):
    """A value that is not the same on all lines, in which the dynamic stiffness is linear."""

    name: str

    def share(self, base: Responses, theta: Float) -> Float:
        """Share by which it is off on each line by a unit of the size, shape ``(L,)``."""
        raise NotImplementedError

    def stiffness(self, base: Responses, theta: Float, size: float) -> ComplexArray | None:
        """See :class:`Act`."""
        without = theta.copy()
        without[:, base.model.parameter_names.index(self.name)] = 0.0
        own = dynamic_stiffness(base, theta) - dynamic_stiffness(base, without)
        return np.asarray((size * self.share(base, theta))[:, None, None] * own)

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        base = motion.linear or motion.base
        if base is None:
            return np.zeros(motion.block.measured.size, dtype=complex)
        place = base.model.parameter_names.index(self.name)
        value = motion.values[base.reading_group, place] * self.share(base, motion.values)[base.line]
        return np.asarray(motion.by_values[:, place] * value)


@dataclass(frozen=True, kw_only=True)
class Drifting(OfLines):
    """A value that changes along a sweep; its size is the share from the middle of the sweep to its end."""

    middle: float  # rad/s
    half: float  # rad/s

    def share(self, base: Responses, theta: Float) -> Float:
        """See :class:`OfLines`."""
        along = (np.abs(base.frequency) - self.middle) / self.half
        return np.where(base.frequency != 0, along, 0.0)


@dataclass(frozen=True, kw_only=True)
class Film(OfLines):
    """A film's value that grows with the square of the orbit over the clearance, ``Film.share`` being that square."""

    at: int  # coordinate of the journal
    clearance: float  # m

    def share(self, base: Responses, theta: Float) -> Float:
        """See :class:`OfLines`; orbits are those without it."""
        z = np.einsum("lj,lj->l", inverse(dynamic_stiffness(base, theta))[:, self.at], base.force)
        return np.asarray(np.abs(z / self.clearance) ** 2)


@dataclass(frozen=True, kw_only=True)
class Known(OfValues):
    """A value that was taken as known."""

    name: str

    def changed(self, model: RotorModel, speed: Float) -> tuple[Float, Float] | None:
        """See :class:`Act`."""
        added = np.zeros((speed.size, len(model.parameter_names)))
        added[:, model.parameter_names.index(self.name)] = 1.0
        return np.zeros_like(added), added

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`; of every kind of test."""
        model = motion.block.model if motion.base is None else motion.base.model  # type: ignore[attr-defined]
        return np.asarray(motion.by_values[:, model.parameter_names.index(self.name)])

    def values_at(self, model: RotorModel, theta: Float, speed: Float | float | None) -> Float | None:
        """See :class:`Act`."""
        own = np.array([float(name == self.name) for name in model.parameter_names])
        return own if speed is None else np.asarray(np.ones_like(np.asarray(speed, dtype=float))[..., None] * own)


@dataclass(frozen=True, kw_only=True)
class Resting(OfValues):
    """A value of the fluid that is larger where the journal rests off the centre; what is fitted is then the centred
    one, and the size is the square of the eccentricity."""

    name: str
    times: float  # share by which the value grows with the square of the eccentricity

    def changed(self, model: RotorModel, speed: Float) -> tuple[Float, Float] | None:
        """See :class:`Act`."""
        own = np.array([name == self.name for name in model.parameter_names], dtype=float)
        grown = np.tile(self.times * own, (speed.size, 1))
        return grown, np.zeros_like(grown)


# ---- places, labels, the clearance -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class OffPlane(Act):
    """A probe or a force that is a share of the way towards another plane."""

    what: str  # "probe" or "force"
    at: int  # coordinate at which it is taken to be
    towards: int  # coordinate towards which it lies

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        base, told, z = motion.circular, motion.base, motion.planes
        if base is None or told is None:
            return np.zeros(motion.block.measured.size, dtype=complex)
        if self.what == "force":
            force = np.zeros_like(z)
            force[:, self.towards], force[:, self.at] = told.force[:, self.at], -told.force[:, self.at]
            return motion.pushed(force)
        read = base.coordinate == self.at
        return np.asarray(np.where(read, (z[:, self.towards] - z[:, self.at])[base.line], 0.0) * motion.gain)


@dataclass(frozen=True, kw_only=True)
class Flexible(Act):
    """Motion at the force's own plane in step with it, as of modes above the band."""

    at: int

    def moved(self, base: Responses) -> ComplexArray:
        """Motion of all coordinates by a unit of the size, shape ``(L, n)``."""
        found = np.zeros_like(base.force)
        found[:, self.at] = base.force[:, self.at]
        return found

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        base = motion.base
        if motion.circular is None or base is None:
            return np.zeros(motion.block.measured.size, dtype=complex)
        return motion.read(self.moved(base))


@dataclass(frozen=True, kw_only=True)
class SpeedLabel(Act):
    """Rotative speeds that are all off by one share."""

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        block = motion.block
        if motion.base is None and block.speed_read is None:
            return np.zeros(block.measured.size, dtype=complex)
        up, down = (block.at_speeds(1 + way * _STEP).predict(motion.theta) for way in (1, -1))
        return np.asarray((up - down) / (2 * _STEP))


@dataclass(frozen=True, kw_only=True)
class OfClearance(Act):
    """The radial clearance that a law of eccentricity takes as known; its size is a share of it."""

    def change(self, motion: Motion) -> ComplexArray:
        """See :class:`Act`."""
        up, down = (motion.block.in_clearance(1 + way * _STEP).predict(motion.theta) for way in (1, -1))
        return np.asarray((up - down) / (2 * _STEP))


def moving(act: Act) -> bool:
    """True for what moves the rotor, and is no matter of forces and readings."""
    return isinstance(act, OfRotor | OfValues)
