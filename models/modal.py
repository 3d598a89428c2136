"""Modes alone: what a synchronous test below the next critical speed determines of a rotor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray
from rotorfit.base.names import unknown_name
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex, J, Number
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.parameters import Parameter

Gains: TypeAlias = Literal["probe", "plane"]

MOST_MODES = 9
"""Modes that a model can have: they are numbered with one digit."""


class Modal(RotorModel):
    """A rotor as a sum of modes, seen through probes and forced through planes that need not be the disks'.

    The response at probe plane p to a force at plane r is ``A_p = sum_i g_pi phi_ri F_r / kappa_i`` with
    ``kappa_i = M_i (wn_i^2 + 2 j zeta_i wn_i w - w^2)``: a modal mass ``M``, an undamped natural frequency ``wn`` and a
    damping ratio ``zeta`` for each mode, a participation ``phi`` of each force plane and a complex gain ``g`` of each
    probe. All are normalised at the first plane, whose participation and gain are one, so that ``M`` is the modal mass
    there. Participations are real, those of an undamped mode, unless their imaginary part (``phi_disk2_im``) is freed.

    Names carry the number of the mode where there is more than one: ``wn1``, ``phi1_disk2``.

    Args:
        planes: names of the planes, the one that everything is normalised at first.
        modes: number of modes.
        gains: "probe" gives each probe a gain of its own (``g_disk2_x``), the first plane's x probe having one;
            "plane" one to each plane's x/y pair, of which the component in the direction of the force is taken.
        apart: let the x and the y direction have a natural frequency and a damping ratio each (``wn_x``, ``wn_y``), for
            supports that differ in x and y; the modal mass stays that of the x direction. Needs gains by probe.
        force_planes, probe_planes: planes that are forced and measured, all of them by default. The participation is
            one at the first force plane and the gain is one at the first probe plane; where these are two planes, ``M``
            is negative in modes in which they move against one another.
    """

    name: ClassVar[str] = "modal"

    def __init__(
        self,
        planes: Sequence[str] = ("disk1", "disk2"),
        *,
        modes: int = 1,
        gains: Gains = "probe",
        apart: bool = False,
        force_planes: Sequence[str] | None = None,
        probe_planes: Sequence[str] | None = None,
    ) -> None:
        self.planes = (planes,) if isinstance(planes, str) else tuple(planes)
        if not self.planes or len(set(self.planes)) != len(self.planes):
            raise ValueError(f"modal needs at least one plane, each with a name of its own; got {self.planes}")
        if not (isinstance(modes, int) and 1 <= modes <= MOST_MODES):
            raise ValueError(f"modes is {modes!r}; a modal model has 1 to {MOST_MODES} modes")
        if gains not in ("probe", "plane"):
            raise ValueError(f"gains is {gains!r}; allowed: 'probe', 'plane'")
        if apart and gains == "plane":
            raise ValueError("x and y are apart for each probe alone: a modal model with apart=True has gains='probe'")
        self.modes, self.gains, self.apart = modes, gains, apart
        self.frame: Literal["z", "xy"] = "xy" if gains == "probe" else "z"
        self.force_planes = self._some(force_planes, "force_planes")
        self.probe_planes = self._some(probe_planes, "probe_planes")
        self.parameters = tuple(q for number in range(1, modes + 1) for q in self._of_mode(number))

    def _some(self, given: Sequence[str] | None, what: str) -> tuple[str, ...]:
        names = self.planes if given is None else (given,) if isinstance(given, str) else tuple(given)
        for name in names:
            if name not in self.planes:
                raise ValueError(f"{what}: {unknown_name('plane', name, self.planes)}")
        if not names:
            raise ValueError(f"{what}: name at least one of {', '.join(self.planes)}")
        return tuple(plane for plane in self.planes if plane in names)

    @property
    def _axes(self) -> tuple[Literal["x", "y", "z"], ...]:
        return ("x", "y") if self.frame == "xy" else ("z",)

    def _named(self, letter: str, number: int, *rest: str) -> str:
        return "_".join(
            [f"{letter}{number if self.modes > 1 else ''}", *(part for part in rest if part not in ("", "z"))]
        )

    def _of_mode(self, number: int) -> list[Parameter]:
        """Parameters of one mode: mass, frequencies and dampings, participations, gains."""
        of = f"of mode {number}" if self.modes > 1 else "of the mode"
        forced, probe = self.force_planes[0], self.probe_planes[0]
        found = [
            Parameter(self._named("M", number), "kg", f"modal mass {of} at {probe}", lower=0.0)
            if forced == probe
            else Parameter(self._named("M", number), "kg", f"modal mass {of} between {forced} and {probe}")
        ]
        for axis in ("x", "y") if self.apart else ("",):
            along = f" in {axis}" if self.apart else ""
            found += [
                Parameter(self._named("wn", number, axis), "rad/s", f"natural frequency {of}{along}", 100.0, 0.0),
                Parameter(self._named("zeta", number, axis), "1", f"damping ratio {of}{along}", 0.02),
            ]
        for plane in self.force_planes[1:]:
            found += [
                Parameter(self._named("phi", number, plane), "1", f"participation of a force at {plane}"),
                Parameter(self._named("phi", number, plane, "im"), "1", "its imaginary part", default=0.0),
            ]
        for plane, end in self._free_probes():
            probe = f"{plane} {end}".removesuffix(" z")
            found += [
                Parameter(self._named("g", number, plane, end), "1", f"gain of the probe at {probe}"),
                Parameter(self._named("g", number, plane, end, "im"), "1", "its imaginary part"),
            ]
        return found

    def _free_probes(self) -> Sequence[tuple[str, str]]:
        return [(plane, axis) for axis in self._axes for plane in self.probe_planes][1:]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The planes, then modes and forces, which are auxiliary: modes stand between forces and readings."""
        found = [Coordinate(plane, axis) for axis in self._axes for plane in self.planes]
        found += [Coordinate(f"mode {i + 1}", axis) for axis in self._axes for i in range(self.modes)]
        return (*found, *(Coordinate(f"force at {plane}", axis) for axis in self._axes for plane in self.planes))

    def options(self) -> dict[str, Any]:
        """See :meth:`RotorModel.options`."""
        usual = [name for name in ("force_planes", "probe_planes") if getattr(self, name) == self.planes]
        return super().options() | dict.fromkeys(usual)

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """The modes as equations between readings A, modal coordinates q and forces f.

        Rows of the planes: ``f = F``; rows of the modes: ``kappa_i q_i - phi_i f = 0``; the last ones:
        ``A - sum_i g_i q_i = 0``. A sum of fewer modes than planes has no dynamic stiffness of the planes alone.
        """
        size = len(self.coordinates)
        parts: list[list[list[Number]]] = [[[0.0] * size for _ in range(size)] for _ in range(3)]
        for axis in self._axes:
            for plane in self.planes:
                reading, force = self.coordinate(plane, axis), self.coordinate(f"force at {plane}", axis)
                parts[0][reading][force] = 1.0
                parts[0][force][reading] = 1.0
                for number in range(1, self.modes + 1):
                    mode = self.coordinate(f"mode {number}", axis)
                    parts[0][force][mode] = -self._gain(p, number, plane, axis)
                    one = Complex(float(plane in self.force_planes))
                    free = plane in self.force_planes[1:]
                    parts[0][mode][force] = -(self._complex(p, self._named("phi", number, plane)) if free else one)
            for number in range(1, self.modes + 1):
                mode = self.coordinate(f"mode {number}", axis)
                end = axis if self.apart else ""
                mass = getattr(p, self._named("M", number))
                wn, zeta = (getattr(p, self._named(letter, number, end)) for letter in ("wn", "zeta"))
                for power, value in enumerate((mass * wn**2, 2 * mass * zeta * wn, mass)):
                    parts[power][mode][mode] = value
        return parts

    def _gain(self, p: Any, number: int, plane: str, axis: str) -> Complex:
        if plane not in self.probe_planes:
            return Complex(0.0)
        if (plane, axis) not in self._free_probes():
            return Complex(1.0)
        return self._complex(p, self._named("g", number, plane, axis))

    def _complex(self, p: Any, name: str) -> Complex:
        return Complex.of(getattr(p, name)) + J * Complex.of(getattr(p, f"{name}_im"))

    def inverse(self, coefficients: ComplexArray, s: ComplexArray) -> ComplexArray:
        """Receptance in closed form, as the equations between readings, modes and forces are solved by hand.

        Args:
            coefficients: of powers of s, shape ``(3, row, column, ..., L or 1)``.
            s: j w of each line, shape ``(L,)``.

        Returns:
            inverse of the dynamic stiffness, shape ``(column, row, ..., L)``.
        """
        stiffness, damping, mass = coefficients
        found = np.zeros((*stiffness.shape[:-1], s.size), dtype=complex)
        for axis in self._axes:
            readings = [self.coordinate(plane, axis) for plane in self.planes]
            forces = [self.coordinate(f"force at {plane}", axis) for plane in self.planes]
            for reading, force in zip(readings, forces, strict=True):
                found[reading, force] = found[force, reading] = 1.0
            for mode in (self.coordinate(f"mode {number}", axis) for number in range(1, self.modes + 1)):
                flexibility = 1 / (stiffness[mode, mode] + s * (damping[mode, mode] + s * mass[mode, mode]))
                found[mode, mode] = flexibility
                seen = [-stiffness[force, mode] * flexibility for force in forces]
                for reading, gain in zip(readings, seen, strict=True):
                    found[mode, reading] = gain
                for driven, force in zip(readings, forces, strict=True):
                    participation = -stiffness[mode, force]
                    if not participation.any():
                        continue
                    found[driven, mode] = participation * flexibility
                    for reading, gain in zip(readings, seen, strict=True):
                        found[driven, reading] += participation * gain
        return found

    def _modal_rows(self) -> slice:
        count = len(self._axes) * len(self.planes)
        return slice(count, count + len(self._axes) * self.modes)

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """See :meth:`RotorModel.motion`: the modes alone, which vibrate independently of each other."""
        rows = self._modal_rows()
        return np.asarray(self.coefficients(theta, speed)[..., rows, rows])

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        whole, rows = self.functions.jacobian(theta, speed), self._modal_rows()
        mine = (whole.rows == whole.columns) & (whole.rows >= rows.start) & (whole.rows < rows.stop)
        return whole.select(mine, np.arange(rows.stop) - rows.start)
