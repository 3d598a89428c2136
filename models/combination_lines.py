"""Spectral lines of a shaft that is not round, and of its twist: harmonic balance in turning coordinates.

With ``z = zeta exp(j Om t)`` every motion under a force at w is a sum of lines ``exp(j(m (w - Om) + n Om) t)``, m and n
integers. Without twist the lines go in pairs (m, n), (-m, -n), which are solved exactly. Twist is driven by products of
lateral lines and drives them back in proportion to itself; that is followed by ``SWEEPS`` passes, the coupling being
weak: at the resonance of the twist of the record behind Figs 37 and 38 first order misses 5e-4 of the motion, one pass
2e-6, which is what the lines that are left out amount to.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from rotorfit.models.complexes import Complex, J, Number
from rotorfit.models.parameters import unknown_name

Order = tuple[int, int]

SWEEPS = 1
"""Passes of the twist's action back on the lateral motion; none is first order in the coupling."""

LATERAL: dict[str, Order] = {
    "w": (1, 0),
    "2Om-w": (-1, 0),
    "1x": (0, 0),
    "2x": (0, 1),
    "0": (0, -1),
    "w-Om": (1, -1),
    "3Om-w": (-1, 1),
    "w+Om": (1, 1),
    "Om-w": (-1, -1),
    "2w-Om": (2, 0),
    "3Om-2w": (-2, 0),
}
"""Lines of the lateral motion by name, with their orders (m, n) in turning coordinates."""

TWIST: dict[str, Order] = {
    "w-Om": (1, 0),
    "w-2Om": (1, -1),
    "2w-2Om": (2, 0),
    "w": (1, 1),
    "1x": (0, 1),
    "2x": (0, 2),
    "0": (0, 0),
}
"""Lines of the twist by name, ``phi = Re(Phi exp(j nu t))`` with signed nu, with their orders."""

_SPELLINGS = {"2(w-Om)": "2w-2Om", "Om": "1x", "2Om": "2x", "-w+2Om": "2Om-w", "-2Om+w": "w-2Om", "-Om+w": "w-Om"}


def line_order(direction: str, name: str) -> Order:
    """Orders (m, n) of a line, of the lateral motion or (direction ``twist``) of the twist.

    Args:
        direction: ``twist``, or anything else for the lateral motion.
        name: of the line as files write it, ``2Om-w`` for instance; blanks and ``*`` do not count.

    Raises:
        ValueError: no such line; the message lists those there are.
    """
    lines = TWIST if direction == "twist" else LATERAL
    plain = re.sub(r"[\s*]", "", name)
    plain = _SPELLINGS.get(plain, plain)
    if plain not in lines:
        raise ValueError(unknown_name("line of the twist" if direction == "twist" else "lateral line", name, lines))
    return lines[plain]


@dataclass(frozen=True, kw_only=True)
class ShaftValues:
    """What the lines depend on, numbers or symbols.

    Attributes:
        M, D, K: kg, N s/m, N/m.
        delta: ``dK exp(2jg)``, N/m.
        eps: eccentricity, ahead of the Keyphasor mark as a complex number, m.
        side: side load, N.
        J, kt, ct: polar inertia, stiffness and damping of the twist, kg m^2, N m/rad, N m s/rad;
            unused without twist.
        speed, frequency: Om and w, rad/s.
        force: complex amplitude at w, N.
    """

    M: Number
    D: Number
    K: Number
    delta: Complex
    eps: Complex
    side: Complex
    J: Number
    kt: Number
    ct: Number
    speed: Number
    frequency: Number
    force: Complex

    def turning_frequency(self, order: Order) -> Complex:
        """Frequency of an order in turning coordinates, rad/s.

        Args:
            order: the pair (m, n) of :func:`line_order`.
        """
        m, n = order
        return float(m) * (Complex.of(self.frequency) - self.speed) + float(n) * Complex.of(self.speed)

    def fixed_frequency(self, order: Order) -> Complex:
        """Frequency of a lateral line in fixed coordinates, rad/s.

        Args:
            order: the pair (m, n) of :func:`line_order`, of the lateral motion.
        """
        return self.turning_frequency(order) + self.speed


Lines = dict[Order, Complex]


def solve_lines(v: ShaftValues, sweeps: int = SWEEPS, *, twisting: bool = True) -> tuple[Lines, Lines]:
    """Lateral lines and lines of the twist.

    Args:
        v: the shaft, its speed and its force.
        sweeps: passes of the twist's action back on the lateral motion; zero is first order in the coupling.
        twisting: whether the shaft twists at all.

    Returns:
        complex amplitudes of ``z exp(-j Om t)``, m, and of ``phi = Re(...)``, rad, by their orders.
    """
    unbalance = Complex.of(v.M) * v.eps * v.speed * v.speed
    sources: Lines = {(1, 0): v.force, (0, 0): unbalance, (0, -1): v.side}
    lateral = _pairs(v, sources, [(1, 0), (0, 0), (0, 1)])
    if not twisting:
        return lateral, {}
    twist = _twist(v, lateral)
    for _ in range(sweeps):
        back = _back_action(v, lateral, twist)
        total = {order: back[order] + sources[order] if order in sources else back[order] for order in back}
        lateral = _pairs(v, total, [(1, 0), (0, 0), (0, 1), (1, 1), (1, -1), (2, 0)])
        twist = _twist(v, lateral)
    return lateral, twist


def _pairs(v: ShaftValues, force: Mapping[Order, Complex], orders: list[Order]) -> Lines:
    """Solve ``kappa(w) A + delta conj(B) = F, kappa(2 Om - w) B + delta conj(A) = G`` for each pair of orders."""
    zero = Complex(0.0)
    lines: Lines = {}
    for order in orders:
        image = (-order[0], -order[1])
        own, other = _stiffness(v, order), _stiffness(v, image)
        F, G = force.get(order, zero), force.get(image, zero)
        below = other.conj() * own - v.delta.abs2()
        lines[order] = (other.conj() * F - v.delta * G.conj()) / below
        if image != order:
            lines[image] = (own.conj() * G - v.delta * F.conj()) / below.conj()
    return lines


def _stiffness(v: ShaftValues, order: Order) -> Complex:
    w = v.fixed_frequency(order)
    return Complex.of(v.K) + J * w * v.D - w * w * v.M


def _twist(v: ShaftValues, lateral: Lines) -> Lines:
    """Twist under the torque ``Im(delta conj(zeta)^2) - M Im(conj(eps) z'' exp(-j Om t))``, zeta with all its lines."""
    torque: Lines = {}
    for order, z in lateral.items():
        w = v.fixed_frequency(order)
        _add(torque, order, v.eps.conj() * z * w * w * v.M)
    for (m, n), first in lateral.items():
        for (k, j), second in lateral.items():
            _add(torque, (-m - k, -n - j), v.delta * first.conj() * second.conj())
    zero = Complex(0.0)
    lines: Lines = {}
    inertia = v.eps * v.eps.conj() * v.M + v.J
    stiffness = _turned(v, lateral) + v.kt
    for order in TWIST.values():
        both = torque.get(order, zero) - torque.get((-order[0], -order[1]), zero).conj()
        if order == (0, 0):
            both = both * 0.5
        nu = v.turning_frequency(order)
        lines[order] = both / J / (stiffness + J * nu * v.ct - nu * nu * inertia)
    return lines


def _turned(v: ShaftValues, lateral: Lines) -> Complex:
    """What the steady motion adds to the torsional stiffness, ``M Om^2 Re(conj(eps) U) - 2 Re(delta conj(zeta)^2)``."""
    U, sag, twice = (lateral[0, n].conj() for n in (0, -1, 1))
    steady = v.eps.conj() * lateral[0, 0] * v.speed * v.speed * v.M - v.delta * (U * U + sag * twice * 2.0) * 2.0
    return Complex(steady.re)


def _back_action(v: ShaftValues, lateral: Lines, twist: Lines) -> Lines:
    """Lateral force ``M eps (2 Om phi' - j phi'' + j Om^2 phi) - 2j phi delta conj(zeta)`` in turning coordinates."""
    both: Lines = {}
    for (m, n), amplitude in twist.items():
        _add(both, (m, n), amplitude * 0.5)
        _add(both, (-m, -n), amplitude.conj() * 0.5)
    force: Lines = {}
    for order, phi in both.items():
        w = v.fixed_frequency(order)
        _add(force, order, J * v.eps * w * w * v.M * phi)
        for (k, j), z in lateral.items():
            _add(force, (order[0] - k, order[1] - j), J * (-2.0) * v.delta * phi * z.conj())
    return force


def _add(lines: Lines, order: Order, value: Complex) -> None:
    lines[order] = lines[order] + value if order in lines else value
