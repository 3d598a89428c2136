"""Modes alone: what a synchronous test below the next critical speed determines of a rotor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.names import unknown_name
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex, J, Number
from rotorfit.models.line_terms import LineTerms, Weights
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.parameters import Parameter

Gains: TypeAlias = Literal["probe", "plane"]


class Modal(RotorModel):
    """A rotor as a sum of modes, seen through probes and forced through planes that need not be the disks'.

    The response at probe plane p to a force at plane r is ``A_p = sum_i g_pi phi_ri F_r / kappa_i`` with
    ``kappa_i = M_i (wn_i^2 + 2 j zeta_i wn_i w - w^2)``: a modal mass ``M``, an undamped natural frequency ``wn`` and a
    damping ratio ``zeta`` for each mode, a participation ``phi`` of each force plane and a complex gain ``g`` of each
    probe. All are normalised at the first plane, whose participation and gain are one, so that ``M`` is the modal mass
    there. Participations are real, those of an undamped mode, unless their imaginary part (``phi_disk2_im``) is freed.

    Names carry the number of the mode where there is more than one: ``wn1``, ``phi1_disk2``.

    Modes above and below the tested band add ``(c_p + a_p / s^2) F`` to each reading, s = j w: a constant compliance
    ``c`` and an accelerance ``a``, complex numbers of each probe, as gains are (``c_disk2``, ``a_disk2``; ``c_p_r``
    where forces act at several planes r).

    Args:
        planes: names of the planes, the one that everything is normalised at first.
        modes: number of modes.
        gains: "probe" gives each probe a gain of its own (``g_disk2_x``), the first plane's x probe having one;
            "plane" one to each plane's x/y pair, of which the component in the direction of the force is taken.
        apart: let the x and the y direction have a natural frequency and a damping ratio each (``wn_x``, ``wn_y``), for
            supports that differ in x and y; the modal mass stays that of the x direction. Needs gains by probe.
        force_planes, probe_planes: planes that are forced and measured, all of them by default; of a plane with one
            probe that probe, ``"nde.x"``, with gains by probe. The participation is one at the first force plane and
            the gain is one at the first probe plane; where these are two planes, ``M`` is negative in modes in which
            they move against one another.
        residuals: give each probe such terms of modes outside the band; None lets a fit do so where the data ask for
            them (BIC).
    """

    name: ClassVar[str] = "modal"
    of_modes = True
    has_causes = False  # gains and angles are those of probes and forces as they are

    no_closed_form = "a modal model starts from a rational fit of its own, which is no estimate with errors"
    advice = "add modes, or let x and y differ (apart)"

    def __init__(
        self,
        planes: Sequence[str] = ("disk1", "disk2"),
        *,
        modes: int = 1,
        gains: Gains = "probe",
        apart: bool = False,
        force_planes: Sequence[str] | None = None,
        probe_planes: Sequence[str] | None = None,
        residuals: bool | None = None,
    ) -> None:
        self.planes = (planes,) if isinstance(planes, str) else tuple(planes)
        if not self.planes or len(set(self.planes)) != len(self.planes):
            raise ValueError(f"modal needs at least one plane, each with a name of its own; got {self.planes}")
        if not (isinstance(modes, int) and modes >= 1):
            raise ValueError(f"modes is {modes!r}; a modal model has one mode or more")
        if gains not in ("probe", "plane"):
            raise ValueError(f"gains is {gains!r}; allowed: 'probe', 'plane'")
        if apart and gains == "plane":
            raise ValueError("x and y are apart for each probe alone: a modal model with apart=True has gains='probe'")
        if residuals not in (True, False, None):
            raise ValueError(f"residuals is {residuals!r}; allowed: True, False, None where the data decide")
        self.modes, self.gains, self.apart, self.residuals = modes, gains, apart, residuals
        self.frame: Literal["z", "xy"] = "xy" if gains == "probe" else "z"
        self.force_planes = self._some(force_planes, "force_planes")
        self._probes = self._probes_of(probe_planes)
        self._coordinates = tuple(self._all_coordinates())
        self.parameters = tuple(q for number in range(1, modes + 1) for q in self._of_mode(number))
        self.parameters += tuple(self._of_rests())

    def _some(self, given: Sequence[str] | None, what: str) -> tuple[str, ...]:
        names = self.planes if given is None else (given,) if isinstance(given, str) else tuple(given)
        for name in names:
            if name not in self.planes:
                raise ValueError(f"{what}: {unknown_name('plane', name, self.planes)}")
        if not names:
            raise ValueError(f"{what}: name at least one of {', '.join(self.planes)}")
        return tuple(plane for plane in self.planes if plane in names)

    def _probes_of(self, given: Sequence[str] | None) -> tuple[tuple[str, str], ...]:
        """Plane and axis of each probe, those along x first."""
        names = self.planes if given is None else (given,) if isinstance(given, str) else tuple(given)
        ends = {f"{plane}.{axis}": plane for plane in self.planes for axis in self._axes if axis != "z"}
        read = self._some([name if name in self.planes else ends.get(name, name) for name in names], "probe_planes")
        return tuple((p, axis) for axis in self._axes for p in read if p in names or f"{p}.{axis}" in names)

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
        forced, probe = self.normalised_at
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
        for plane, end in self._probes[1:]:
            probe = f"{plane} {end}".removesuffix(" z")
            found += [
                Parameter(self._named("g", number, plane, end), "1", f"gain of the probe at {probe}"),
                Parameter(self._named("g", number, plane, end, "im"), "1", "its imaginary part"),
            ]
        return found

    def _of_rests(self) -> Iterator[Parameter]:
        """Parameters of what modes outside the band add to each reading."""
        said = {
            "c": ("m/N", "compliance of modes above the band", 1e-6),
            "a": ("1/kg", "accelerance of modes below the band", 0.1),
        }
        for plane, axis in self._probes if self.residuals else ():
            where = f"at {plane} {axis}".removesuffix(" z")
            for letter, (unit, meaning, scale) in said.items():
                for forced in self.force_planes:
                    name, whole = self.rest(letter, plane, axis, forced), f"{meaning}, {where}"
                    whole += f" by a force at {forced}" if len(self.force_planes) > 1 else ""
                    yield Parameter(name, unit, whole, scale)
                    yield Parameter(f"{name}_im", unit, "its imaginary part", scale)

    def rest(self, letter: str, plane: str, axis: str, forced: str) -> str:
        """Name of a term of modes outside the band, which says the force plane too where there are several.

        Args:
            letter: ``c`` of those above it, ``a`` of those below.
            plane, axis: those of the probe.
            forced: plane of the force.
        """
        return "_".join([letter, plane, *axis.strip("z"), *([forced] if len(self.force_planes) > 1 else [])])

    @property
    def read_planes(self) -> tuple[str, ...]:
        """See :attr:`RotorModel.read_planes`: no mode tells how planes without a probe move."""
        return tuple(plane for plane in self.planes if any(plane == own for own, _ in self._probes))

    @property
    def probe_planes(self) -> tuple[str, ...]:
        """Planes with probes, as they may be given: of those with one the probe, ``nde.x``."""
        own = {plane: [axis for at, axis in self._probes if at == plane] for plane in self.read_planes}
        return tuple(p if len(axes) == len(self._axes) else f"{p}.{axes[0]}" for p, axes in own.items())

    @property
    def normalised_at(self) -> tuple[str, str]:
        """Planes of the force whose participation and of the probe whose gain is one."""
        return self.force_planes[0], self._probes[0][0]

    def is_read(self, plane: str, axis: str) -> bool:
        """See :meth:`RotorModel.is_read`."""
        return (plane, axis) in self._probes

    def is_forced(self, plane: str) -> bool:
        """See :meth:`RotorModel.is_forced`: no mode tells what a force does where none acted."""
        return plane in self.force_planes

    @cached_property
    def speed_dependent(self) -> bool:
        """Modes do not change with speed."""
        return False

    @cached_property
    def eccentricity_dependent(self) -> bool:
        """Nor with eccentricity."""
        return False

    @property
    def mode_count(self) -> int:
        """See :attr:`RotorModel.mode_count`."""
        return self.modes

    def alternatives(self, probes: Set[tuple[str, str]]) -> tuple[RotorModel, ...]:
        """See :meth:`RotorModel.alternatives`: without gains of probes that are not there; without and with terms of
        modes outside the band."""
        read = probes if self.frame == "xy" else {(plane, "z") for plane, _ in probes}
        own = [f"{plane}.{axis}".removesuffix(".z") for plane, axis in self._probes if (plane, axis) in read]
        seen = self if len(own) in (0, len(self._probes)) else self.variant(probe_planes=own)
        return (seen,) if self.residuals is not None else tuple(seen.variant(residuals=one) for one in (False, True))

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The planes, then modes, free masses and forces, which are auxiliary: they are between forces and readings."""
        return self._coordinates

    def _all_coordinates(self) -> Iterator[Coordinate]:
        groups = [self.planes, [f"mode {i + 1}" for i in range(self.modes)]]
        groups += [[f"free at {plane}" for plane in self.force_planes if self.residuals]]
        groups += [[f"force at {plane}" for plane in self.planes]]
        return (Coordinate(name, axis) for names in groups for axis in self._axes for name in names)

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
            self._write_rests(p, parts, axis)
            for number in range(1, self.modes + 1):
                mode = self.coordinate(f"mode {number}", axis)
                end = axis if self.apart else ""
                mass = getattr(p, self._named("M", number))
                wn, zeta = (getattr(p, self._named(letter, number, end)) for letter in ("wn", "zeta"))
                for power, value in enumerate((mass * wn**2, 2 * mass * zeta * wn, mass)):
                    parts[power][mode][mode] = value
        return parts

    def _write_rests(self, p: Any, parts: Sequence[Sequence[list[Number]]], axis: str) -> None:
        """Terms of modes outside the band: forces, and motion of free masses of one kilogram that they push."""
        for forced in self.force_planes if self.residuals else ():
            free, force = (self.coordinate(f"{what} at {forced}", axis) for what in ("free", "force"))
            parts[2][free][free] = 1.0
            parts[0][free][force] = -1.0
            for plane in (plane for plane, end in self._probes if end == axis):
                row = self.coordinate(f"force at {plane}", axis)
                for letter, seen in (("c", force), ("a", free)):
                    parts[0][row][seen] = -self._complex(p, self.rest(letter, plane, axis, forced))

    def _gain(self, p: Any, number: int, plane: str, axis: str) -> Complex:
        if (plane, axis) not in self._probes:
            return Complex(0.0)
        if (plane, axis) == self._probes[0]:
            return Complex(1.0)
        return self._complex(p, self._named("g", number, plane, axis))

    def _complex(self, p: Any, name: str) -> Complex:
        return Complex.of(getattr(p, name)) + J * Complex.of(getattr(p, f"{name}_im"))

    @cached_property
    def _place(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.parameter_names)}

    def _places(self, letter: str, axis: str) -> Index:
        """Places of a parameter of all modes."""
        end = axis if self.apart and letter != "M" else ""
        return np.array([self._place[self._named(letter, i, end)] for i in range(1, self.modes + 1)], dtype=np.intp)

    @property
    def _rests(self) -> tuple[str, ...]:
        """Letters of the terms of a probe and a force that stand for modes outside the band."""
        return ("c", "a") if self.residuals else ()

    @cached_property
    def weights(self) -> Weights:
        """See :attr:`RotorModel.weights`: terms are the modes, then forces and forces over s^2, axis by axis."""
        each = self.modes + len(self._rests) * len(self.force_planes)
        shape = len(self.coordinates), len(self._axes) * each
        real, imaginary, constant = np.full(shape, -1), np.full(shape, -1), np.zeros(shape)
        for first, axis in zip(range(0, shape[1], each), self._axes, strict=True):
            for plane in (plane for plane, end in self._probes if end == axis):
                row = self.coordinate(plane, axis)
                names = [self._named("g", i, plane, axis) for i in range(1, self.modes + 1)]
                if (plane, axis) == self._probes[0]:
                    constant[row, first : first + self.modes] = 1.0
                    names = [""] * self.modes
                names += [
                    self.rest(letter, plane, axis, forced) for letter in self._rests for forced in self.force_planes
                ]
                for term, name in enumerate(names, first):
                    if name:
                        real[row, term], imaginary[row, term] = self._place[name], self._place[f"{name}_im"]
        return Weights(real=real, imaginary=imaginary, constant=constant)

    def line_terms(self, theta: Float, s: ComplexArray, force: ComplexArray) -> LineTerms:
        """See :meth:`RotorModel.line_terms`."""
        each = self.modes + len(self._rests) * len(self.force_planes)
        values: list[ComplexArray] = []
        slopes: list[ComplexArray] = []
        inputs: list[Index] = []
        terms: list[Index] = []
        for first, axis in zip(range(0, len(self._axes) * each, each), self._axes, strict=True):
            places = {letter: self._places(letter, axis) for letter in ("M", "wn", "zeta")}
            mass, wn, zeta = (np.swapaxes(theta[..., places[letter]], -1, -2) for letter in ("M", "wn", "zeta"))
            flexibility = 1 / (wn**2 + 2 * zeta * wn * s + s**2)
            forces = np.array([force[:, self.coordinate(plane, axis)] for plane in self.force_planes])
            drive: ComplexArray = np.broadcast_to(forces[0], flexibility.shape).astype(complex)
            for plane, pushed in zip(self.force_planes[1:], forces[1:], strict=True):
                names = [self._named("phi", i, plane) for i in range(1, self.modes + 1)]
                for factor, end in ((1.0, ""), (1j, "_im")):
                    own = np.array([self._place[name + end] for name in names], dtype=np.intp)
                    drive += factor * np.swapaxes(theta[..., own], -1, -2) * pushed
                    inputs.append(own)
                    slopes.append(factor * pushed * flexibility / mass)
            motion = drive * flexibility / mass
            inputs += [places["M"], places["wn"], places["zeta"]]
            slopes += [
                -motion / mass,
                -motion * flexibility * (2 * wn + 2 * zeta * s),
                -motion * flexibility * (2 * wn * s),
            ]
            terms += [np.arange(first, first + self.modes)] * (len(inputs) - len(terms))
            values.append(motion)
            if self.residuals:
                over = np.divide(1.0, s**2, out=np.zeros_like(s), where=s != 0)
                rest = np.concatenate([forces, forces * over])
                values.append(np.broadcast_to(rest, (*motion.shape[:-2], *rest.shape)))
        return LineTerms(
            values=np.concatenate(values, axis=-2),
            inputs=np.concatenate(inputs),
            terms=np.concatenate(terms),
            slopes=np.concatenate(slopes, axis=-2),
        )

    def _modal_rows(self) -> slice:
        count = len(self._axes) * len(self.planes)
        return slice(count, count + len(self._axes) * self.modes)

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """See :meth:`RotorModel.motion`: the modes alone, which vibrate independently of each other."""
        theta = np.asarray(theta, dtype=float)
        theta = np.broadcast_to(theta, (*np.broadcast_shapes(theta.shape[:-1], np.shape(speed)), theta.shape[-1]))
        count = len(self._axes) * self.modes
        found = np.zeros((*theta.shape[:-1], 3, count, count), dtype=complex)
        places = {q: np.concatenate([self._places(q, axis) for axis in self._axes]) for q in ("M", "wn", "zeta")}
        mass, wn, zeta = (theta[..., own] for own in places.values())
        for power, values in enumerate((mass * wn**2, 2 * mass * zeta * wn, mass)):
            found[..., power, np.arange(count), np.arange(count)] = values
        return found

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        whole, rows = self.functions.jacobian(theta, speed), self._modal_rows()
        mine = (whole.rows == whole.columns) & (whole.rows >= rows.start) & (whole.rows < rows.stop)
        return whole.select(mine, np.arange(rows.stop) - rows.start)
