"""A stiffness that turns with the shaft, on supports that differ in two directions and stand still.

The first couples a line at w with 2 Om - w, the second with -w, so that one force makes the chain of lines::

    ... w + 2 Om  <- turning ->  -w  <- support ->  w  <- turning ->  2 Om - w  <- support ->  w - 2 Om ...

(lines at -w + 2k Om are images: their conjugates are the unknowns). Amplitudes fall off along the chain where nothing
resonates; it is cut some lines to either side of w and 2 Om - w, and what the cut costs is computed with more lines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.models.complexes import Complex
from rotorfit.models.model import RotorModel
from rotorfit.models.orthotropic import support_parameters, support_planes, support_symbol
from rotorfit.models.shafts.angular_rates import angular_rate
from rotorfit.models.shafts.turning import Line, Turning, chain

LINES: dict[str, Line] = {
    "w": (0, False),
    "2Om-w": (1, True),
    "-w": (0, True),
    "w-2Om": (-1, False),
    "w+2Om": (1, False),
    "4Om-w": (2, True),
    "-w-2Om": (-1, True),
}
"""Lines of the lateral motion that can be read, by name."""


class TurningOnSupports(Turning):
    """A rotor with a turning element on supports whose stiffness and damping differ in two directions.

    Parameters are those of :class:`Turning`, then those of :class:`~rotorfit.models.orthotropic.Orthotropic`: for each
    support ``dKs = K_1 - K_2`` and ``dDs = D_1 - D_2`` along and across a direction at the angle ``angle_s`` from x,
    known to be 0 unless freed.

    Args:
        base: the rotor with its turning element.
        at: planes with such a support, by default the last of the rotor's.
        terms: lines beyond w and 2 Om - w, to either side of them in the chain, that are taken into account.

    Raises:
        ValueError: a rotor without a turning element, with tilts or a known structure, a plane that it does not have,
            or no terms.
    """

    name: ClassVar[str] = "turning-on-supports"

    def __init__(self, base: Turning, at: str | Sequence[str] = (), terms: int = 4) -> None:
        if not base.line_places or base.line_count > 2:
            raise ValueError(f"{base.name} has no turning element; use Turning(...), or Orthotropic for supports alone")
        if any(coordinate.axis != "z" for coordinate in base.coordinates):
            raise ValueError(f"{base.name} has tilts, whose supports are not modelled in two directions")
        if terms < 1:
            raise ValueError(f"terms is a number of lines, one or more, got {terms}")
        super().__init__(base.base, base.element)
        self.rotor, self.terms, self.line_count = base, terms, 2 + 2 * terms
        if self.shaft is not None:
            raise ValueError(f"{base.base.name} has a known structure; on supports of two directions use Orthotropic")
        self.at = support_planes(at, base.base)
        self.parameters = (*base.parameters, *support_parameters(self.at))

    def options(self) -> dict[str, Any]:
        """See :meth:`~rotorfit.models.model.RotorModel.options`."""
        return {"base": self.rotor, "at": self.at, "terms": self.terms}

    @property
    def line_places(self) -> dict[str, int]:
        """See :attr:`Turning.line_places`."""
        present = chain(self.terms)
        return {name: present.index(line) for name, line in LINES.items() if line in present}

    def with_more_lines(self, count: int) -> TurningOnSupports:
        """See :meth:`~rotorfit.models.model.RotorModel.with_more_lines`."""
        return self.variant(terms=self.terms + count)

    def support_coupling(self, p: Any) -> Sequence[Complex]:
        """See :meth:`~rotorfit.models.model.RotorModel.support_coupling`."""
        size = len(self.coordinates)
        found = []
        for kind in ("dKs", "dDs"):
            matrix = Complex(ca.SX(size, size), ca.SX(size, size))
            for i, plane in enumerate(self.at):
                half = 0.5 * getattr(p, support_symbol(kind, i, self.at))
                angle = 2.0 * getattr(p, support_symbol("angle_s", i, self.at))
                place = self.coordinate(plane, "z")
                matrix.re[place, place], matrix.im[place, place] = half * ca.cos(angle), half * ca.sin(angle)
            found.append(matrix)
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class HarmonicSet(ByValue):
    """Lines of a motion ``z = sum ahead_k exp(j(w + 2k Om)t) + behind_k exp(j(-w + 2k Om)t)``, k = -N ... N.

    Attributes:
        frequency, speed: w and Om, rad/s.
        ahead, behind: amplitudes, m, shape ``(2N + 1, n)``.
        error: largest change that the last lines added made to any other, over the largest line.
    """

    frequency: float
    speed: float
    ahead: ComplexArray
    behind: ComplexArray
    error: float

    @property
    def terms(self) -> int:
        """N."""
        return (len(self.ahead) - 1) // 2

    @property
    def frequencies(self) -> tuple[Float, Float]:
        """Signed frequencies of the lines ahead and behind, rad/s."""
        shift = 2.0 * self.speed * np.arange(-self.terms, self.terms + 1, dtype=float)
        return np.asarray(shift + self.frequency), np.asarray(shift - self.frequency)

    def at(self, time: ArrayLike) -> ComplexArray:
        """The motion at instants.

        Args:
            time: s, shape ``(T,)``.

        Returns:
            m, shape ``(T, n)``.
        """
        t = np.asarray(time, dtype=float)[:, None]
        ahead, behind = self.frequencies
        return np.asarray(np.exp(1j * t * ahead) @ self.ahead + np.exp(1j * t * behind) @ self.behind)


def harmonic_set(
    model: RotorModel,
    theta: ArrayLike,
    frequency: float,
    speed: float,
    force: Mapping[str, complex],
    support: Mapping[str, complex],
    *,
    tolerance: float = 1e-10,
    most: int = 60,
) -> HarmonicSet:
    """Forced motion of a rotor with turning anisotropy in orthotropic supports.

    In ``kappa(d/dt) z + Delta exp(2j Om t) conj(z) + S conj(z) = F exp(jwt)`` both together make all lines w + 2k Om
    and -w + 2k Om. Their amplitudes fall off with k where nothing resonates; how many are needed is found by adding
    pairs of lines until nothing changes.

    Args:
        model: in complex coordinates, with or without a turning stiffness.
        theta: parameter vector, shape ``(P,)``.
        frequency: w, rad/s, signed and not zero.
        speed: Om, rad/s.
        force: complex amplitude at w by plane, N.
        support: by plane ``dK exp(2jh)``, N/m, dK half the difference of the support's two stiffnesses, h the direction
            of the greater one from x.
        tolerance: change of the lines, over the largest, at which no more are added.
        most: largest N.

    Raises:
        ValueError: a model in x and y, a frequency or speed that is no finite number, or lines that do not settle with
            ``most`` terms.
        KeyError: a plane that the model does not have.
    """
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; its supports may be orthotropic as they are")
    frequency, speed = angular_rate(frequency, "frequency"), angular_rate(speed)
    n = len(model.coordinates)
    drive, still = np.zeros(n, dtype=complex), np.zeros((n, n), dtype=complex)
    for plane, amplitude in force.items():
        drive[model.coordinate(plane, "z")] = amplitude
    for plane, stiffness in support.items():
        at = model.coordinate(plane, "z")
        still[at, at] = stiffness
    turning = _turning(model, np.asarray(theta, dtype=float))
    before, change = _solve(model, theta, frequency, speed, drive, still, turning, 1), np.inf
    for terms in range(2, most + 1):
        now = _solve(model, theta, frequency, speed, drive, still, turning, terms)
        grown = np.pad(before, ((0, 0), (1, 1), (0, 0)))
        change = float(np.abs(now - grown).max() / np.abs(now).max())
        before = now
        if change <= tolerance:
            return HarmonicSet(frequency=frequency, speed=speed, ahead=now[0], behind=now[1], error=change)
    raise ValueError(
        f"{2 * most + 1} pairs of lines leave a change of {significant(change, 2)} of the largest, more than the "
        f"tolerance {significant(tolerance, 2)}: the anisotropies are too large for lines that fall off, or the "
        "motion is unstable"
    )


def _turning(model: RotorModel, theta: Float) -> ComplexArray:
    """The matrix that turns, at a parameter vector."""
    p = SimpleNamespace(**dict(zip(model.parameter_names, theta.tolist(), strict=True)))
    matrix = Complex.matrix(model.turning_stiffness(p))
    return np.asarray(ca.DM(matrix.re).full() + 1j * ca.DM(matrix.im).full())


def _solve(
    model: RotorModel,
    theta: ArrayLike,
    frequency: float,
    speed: float,
    drive: ComplexArray,
    still: ComplexArray,
    turning: ComplexArray,
    terms: int,
) -> ComplexArray:
    """Lines ahead and behind, shape ``(2, 2N + 1, n)``; unknowns are those ahead and the conjugates of those behind.

    The line w + 2k Om meets ``Delta conj(b_(1-k)) + S conj(b_-k)``, the line -w + 2k Om the same of the lines ahead.
    """
    k = np.arange(-terms, terms + 1)
    count, n = k.size, drive.size
    ahead = model.dynamic_stiffness(theta, frequency + 2 * k * speed, speed)
    behind = model.dynamic_stiffness(theta, 2 * k * speed - frequency, speed).conj()
    matrix = np.zeros((2, count, n, 2, count, n), dtype=complex)
    for i, order in enumerate(k.tolist()):
        matrix[0, i, :, 0, i], matrix[1, i, :, 1, i] = ahead[i], behind[i]
        for partner, coupling in ((1 - order, turning), (-order, still)):
            if abs(partner) <= terms:
                other = partner + terms
                matrix[0, i, :, 1, other] += coupling
                matrix[1, i, :, 0, other] += coupling.conj()
    right = np.zeros((2, count, n), dtype=complex)
    right[0, terms] = drive
    size = 2 * count * n
    found = np.linalg.solve(matrix.reshape(size, size), right.reshape(size)).reshape(2, count, n)
    return np.stack([found[0], found[1].conj()])
