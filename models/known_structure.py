"""Identification with a known structure: the shaft's matrices are given, what surrounds it is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.accessors import ClassAccessor
from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex, Number
from rotorfit.models.fluid import Clearances, Laws, fluids_of, laws_and_clearances
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.parameters import Parameter
from rotorfit.models.shafts.shaft import KnownStiffness, Shaft, StructureMatrices, complex_matrices

_SUPPORT = (("Ks", "N/m", "support stiffness", 1e5, -math.inf),)
_DAMPER = (("Ds", "N s/m", "external damping", 5.0, -math.inf),)
_MAGNETIC = (
    ("Km", "N/m", "stiffness of the magnets without control, negative,", 1e5, -math.inf),
    ("Kp", "N/m", "stiffness by the controller's proportional gain", 1e6, -math.inf),
    ("Kd", "N s/m", "damping by the controller's derivative gain", 1e3, -math.inf),
    ("tau", "s", "delay of sensor, controller and amplifier", 1e-4, 0.0),
)
"""Parameters of a support, a damper and a magnetic bearing: name, unit, meaning, typical size, lower limit."""


class KnownStructure(RotorModel):
    """A shaft with given matrices in a fluid: fitted are the fluid, external dampers and factors of the structure.

    The lumped models share the stiffness out between K0 and the shaft and have a few modes only; with the shaft's own
    matrices, from finite elements, both errors are gone. The matrices are condensed exactly to the planes, so that a
    fit costs no more than that of a lumped model; with scale factors they are reduced, to an error that the summary of
    a fit states. The stability is that of the whole shaft.

    :meth:`from_ross` takes a rotor of the ROSS package, or the file of one.

    Args:
        M, C, G, K: mass, damping, gyroscopic and stiffness matrices, SI units, of all that is known, supports and disks
            included; C or G may be ``None``. With real coordinates (x, y) they belong to
            ``M q'' + (C + Om G) q' + K q = F``, with complex ones (z) to ``M q'' + (C - j Om G) q' + K q = F``.
        planes: node (counted from zero) of each plane that is forced, measured, damped or in the fluid.
        fluid: plane or planes at which the fluid force of eq. (13) acts. Its parameters are K0, D, lam, Mf; with
            several fluids ``K0_seal`` and so on, by plane.
        damping: planes with an external damper to be fitted: Ds, or ``Ds_disk`` and so on with several.
        supports: planes on a support whose stiffness and damping are fitted, beside what the matrices hold: Ks and Ds,
            or ``Ks_left`` and so on with several. In :class:`~rotorfit.models.Orthotropic` they differ in x and y.
        magnetic: planes in a magnetic bearing whose force is ``-[Km + (Kp + Kd s) exp(-s tau)] z``: Km, negative, is
            the stiffness of the magnets without control, Kp and Kd are the controller's gains times the force that a
            current makes, tau is the delay of sensor, controller and amplifier; ``Km_left`` and so on with several.
            Between Km and Kp a test tells by the delay alone: give Km as known if it is.
        scales: parts of the structure multiplied by a factor that can be fitted, for instance
            ``{"E_scale": {"K": shaft_stiffness}}``; the factor is known = 1 unless freed with
            ``known={"E_scale": None}``. The part is contained in the matrices above.
        tilts: planes at which the slope dx/ds + j dy/ds is measured too.
        dofs: coordinates of each node in their order: ``("z", "r")``, ``("z",)``, or real ones such as
            :data:`~rotorfit.models.ROSS_4`.
        two_lam: let damping and inertia of the fluid turn at ratios of their own, lam_D and lam_M.
        law: how the fluid changes with eccentricity, for instance ``rf.models.Muszynska()``; of several fluids by
            plane, ``{"seal": rf.models.Muszynska()}``, each with that of its own orbit.
        clearance_um: radial clearance at the fluid, micrometres, one or by plane; needed by a law.

    Raises:
        ValueError: matrices that are not isotropic or of unequal size, nodes that do not exist, unknown planes, a law
            without clearance or without fluid.
    """

    name: ClassVar[str] = "known-structure"
    force_alone = True

    late_row: ClassVar[float] = 1e6
    """Factor of the equation of a delayed displacement, N/m: of the size of the stiffness in other rows."""

    from_ross = ClassAccessor()
    """Path and arguments of :meth:`from_ross`, where the matrices are those of a file."""

    def __init__(
        self,
        M: ArrayLike,
        C: ArrayLike | None,
        G: ArrayLike | None,
        K: ArrayLike,
        *,
        planes: Mapping[str, int],
        fluid: str | Sequence[str] = (),
        damping: str | Sequence[str] = (),
        supports: str | Sequence[str] = (),
        magnetic: str | Sequence[str] = (),
        scales: Mapping[str, Mapping[str, ArrayLike]] | None = None,
        tilts: Sequence[str] = (),
        dofs: Sequence[str] = ("z", "r"),
        two_lam: bool = False,
        law: Laws | None = None,
        clearance_um: Clearances | None = None,
    ) -> None:
        given = {kind: matrix for kind, matrix in zip("MCGK", (M, C, G, K), strict=True) if matrix is not None}
        matrices, place = complex_matrices(given, dofs)
        parts = [_part(name, part, matrices, dofs) for name, part in (scales or {}).items()]
        self.planes, self._nodes = tuple(planes), dict(planes)
        self.tilts = _some(tilts, self.planes, "tilts")
        self.fluid = _some(fluid, self.planes, "fluid")
        self.supports = _some(supports, self.planes, "supports")
        self.damping = _some(damping, self.planes, "damping")
        both = [plane for plane in self.damping if plane in self.supports]
        if both:
            raise ValueError(f"a support has a damper of its own: leave {', '.join(both)} out of damping")
        self.magnetic = _some(magnetic, self.planes, "magnetic")
        self.two_lam = two_lam
        self.fluids = fluids_of(self.fluid, law, two_lam=two_lam)
        self.law, self.clearance_um, self.clearance = laws_and_clearances(self.fluids, law, clearance_um, self.name)
        own = {name: _copied(part) for name, part in scales.items()} if scales is not None else None
        self._given = {**_copied({"M": M, "C": C, "G": G, "K": K}), "scales": own}
        self._given |= {"planes": dict(planes), "dofs": tuple(dofs)}
        self.shaft: Shaft = Shaft(matrices, parts, _places(planes, self.tilts, place))
        self.parameters = self._all_parameters(scales or {})
        if len({q.name for q in self.parameters}) != len(self.parameters):
            raise ValueError(f"parameters need different names, got {', '.join(q.name for q in self.parameters)}")
        self._scale_places = np.arange(len(self.parameters) - len(parts), len(self.parameters), dtype=np.intp)
        control = [_named(kind, plane, self.magnetic) for plane in self.magnetic for kind in ("Kp", "Kd", "tau")]
        self._control = np.array([self.parameter_names.index(name) for name in control], dtype=np.intp).reshape(-1, 3)
        if self.magnetic:  # what a controller remembers has no mass
            self.shaft.has_mass, self.in_band_only = False, True

    def _all_parameters(self, scales: Iterable[str]) -> tuple[Parameter, ...]:
        """Supports, dampers, fluids, the law and the factors of the structure."""
        own = (
            Parameter(_named(name, plane, planes), unit, f"{meaning} at the {plane}", scale, lower)
            for kinds, planes in ((_SUPPORT, self.supports), (_DAMPER, self.dampers), (_MAGNETIC, self.magnetic))
            for plane in planes
            for name, unit, meaning, scale, lower in kinds
        )
        fluids = (q for fluid in self.fluids for q in fluid.parameters)
        factors = (
            Parameter(name, "1", "scale factor of the known structure", lower=0.0, default=1.0, nominal=1.0)
            for name in scales
        )
        return (*own, *fluids, *factors)

    @property
    def nodes(self) -> dict[str, int]:
        """Node of each plane, counted from zero."""
        return dict(self._nodes)

    @property
    def dampers(self) -> tuple[str, ...]:
        """Planes with a damper Ds: those of supports, then others."""
        return (*self.supports, *self.damping)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Displacement of every plane, then the slopes asked for."""
        return (*(Coordinate(plane, "z") for plane in self.planes), *(Coordinate(plane, "r") for plane in self.tilts))

    def options(self) -> dict[str, Any]:
        """See :meth:`RotorModel.options`."""
        return {**super().options(), **self._given}

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """Forces on the shaft at its planes: fluid, supports, magnetic bearings and external dampers."""
        size = len(self.coordinates)
        matrices = [[[Complex(0.0)] * size for _ in range(size)] for _ in range(3)]

        def add(plane: str, *force: Number) -> None:
            """By powers of s."""
            at = self.planes.index(plane)
            for matrix, part in zip(matrices, force, strict=False):
                matrix[at][at] = matrix[at][at] + part

        for plane in self.supports:
            add(plane, getattr(p, _named("Ks", plane, self.supports)))
        for plane in self.dampers:
            add(plane, 0.0, getattr(p, _named("Ds", plane, self.dampers)))
        for plane in self.magnetic:  # without delay; known_stiffness adds what the delay changes
            Km, Kp, Kd = (getattr(p, _named(name, plane, self.magnetic)) for name in ("Km", "Kp", "Kd"))
            add(plane, Km + Kp, Kd)
        for fluid in self.fluids:
            add(fluid.plane, *fluid.force(p, speed, eccentricity))
        return matrices

    # ---- the structure ---------------------------------------------------------------------------------------------

    def known_stiffness(self, theta: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
        """See :meth:`RotorModel.known_stiffness`; with what the delays of magnetic bearings change."""
        vectors = np.broadcast_to(theta, (s.size, len(self.parameters)))
        values, slopes = self.shaft.condensed(s, np.broadcast_to(speed, s.shape), vectors[:, self._scale_places])
        if not self.magnetic:
            return KnownStiffness(values, self._scale_places, slopes)
        values, changes = values.copy(), np.zeros((self._control.size, *values.shape), dtype=complex)
        for number, (plane, places) in enumerate(zip(self.magnetic, self._control, strict=True)):
            at = self.planes.index(plane)
            Kp, Kd, tau = vectors[:, places].T
            late = np.expm1(-s * tau)
            values[:, at, at] += (Kp + Kd * s) * late
            by_delay = -s * (Kp + Kd * s) * (late + 1)
            changes[3 * number : 3 * number + 3, :, at, at] = late, s * late, by_delay
        inputs = np.concatenate([self._scale_places, self._control.ravel()])
        return KnownStiffness(values, inputs, np.concatenate([slopes, changes]))

    def control(self, theta: Float, s: ComplexArray, plane: str) -> ComplexArray:
        """Dynamic stiffness that the controller of a magnetic bearing makes, ``(Kp + Kd s) exp(-s tau)``, N/m.

        Args:
            theta: parameter vectors, shape ``(..., P)``.
            s: Laplace variable, shape broadcasting with ``theta[..., 0]``.
            plane: one of those in a magnetic bearing.
        """
        Kp, Kd, tau = np.moveaxis(theta[..., self._control[self.magnetic.index(plane)]], -1, 0)
        return np.asarray((Kp + Kd * s) * np.exp(-s * tau))

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """See :meth:`RotorModel.motion`: all coordinates of the shaft, then the delayed displacement of each magnetic
        bearing, by Pade's fraction of second order: its error at ``|s| tau`` = 1 is 0.14 %, at 0.5 0.004 %."""
        vector = np.asarray(theta, dtype=float)
        added = self.coefficients(vector, speed)
        shape = added.shape[:-3]
        scales = np.broadcast_to(vector[..., self._scale_places], (*shape, self._scale_places.size))
        shaft = self.shaft.coefficients(scales, speed)
        size = self.shaft.matrices.K.shape[0]
        total = np.zeros((*shape, 3, *[size + len(self.magnetic)] * 2), dtype=complex)
        total[..., :size, :size] = shaft
        at = self.shaft.at
        total[..., at[:, None], at] += added
        for late, (plane, places) in enumerate(zip(self.magnetic, self._control, strict=True), size):
            now = at[self.planes.index(plane)]
            Kp, Kd, tau = np.moveaxis(vector[..., places], -1, 0)
            for power, gain in enumerate((Kp, Kd)):
                total[..., power, now, now] -= gain
                total[..., power, now, late] += gain
            for power, (sign, part) in enumerate(((-1, tau**0), (1, tau / 2), (-1, tau**2 / 12))):
                total[..., power, late, late] = self.late_row * part
                total[..., power, late, now] = sign * self.late_row * part
        return total

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        added = self.functions.jacobian(theta, speed)
        own = ~np.isin(added.inputs, self._control)  # gains act on the delayed displacement
        vector, count = np.asarray(theta, dtype=float), len(self.parameters)
        scales = vector[self._scale_places]
        by_speed = self.shaft.coefficients(scales, 1.0) - self.shaft.coefficients(scales, 0.0)
        changes = [(count, by_speed)]
        changes += [
            (int(place), part.coefficients(speed))
            for place, part in zip(self._scale_places, self.shaft.parts, strict=True)
        ]
        size = self.shaft.matrices.K.shape[0]
        for late, (plane, (Kp, Kd, tau)) in enumerate(zip(self.magnetic, self._control.tolist(), strict=True), size):
            now = self.shaft.at[self.planes.index(plane)]
            change = np.zeros((3, 3, *[size + len(self.magnetic)] * 2), dtype=complex)  # by gains and the delay
            change[0, 0, now, late] = change[1, 1, now, late] = 1.0
            change[2, 1, late, [late, now]] = self.late_row / 2
            change[2, 2, late, [late, now]] = np.array([1, -1]) * self.late_row * vector[tau] / 6
            changes += list(zip((Kp, Kd, tau), change, strict=True))
        parts = [CoefficientJacobian.of(place, change) for place, change in changes]
        return CoefficientJacobian.joined([added.select(own, self.shaft.at), *parts])


def _named(symbol: str, plane: str, all_planes: Sequence[str]) -> str:
    return symbol if len(all_planes) == 1 else f"{symbol}_{plane}"


def _some(chosen: str | Sequence[str], planes: Sequence[str], what: str) -> tuple[str, ...]:
    names = (chosen,) if isinstance(chosen, str) else tuple(chosen)
    unknown = [name for name in names if name not in planes]
    if unknown or len(set(names)) != len(names):
        raise ValueError(f"{what} names {', '.join(names)}; each must be one of the planes {', '.join(planes)}, once")
    return names


def _copied(matrices: Mapping[str, ArrayLike | None]) -> dict[str, Any]:
    """Matrices as they are now, whatever their owner makes of them."""
    return {kind: None if matrix is None else np.array(matrix) for kind, matrix in matrices.items()}


def _part(name: str, part: Mapping[str, ArrayLike], whole: StructureMatrices, dofs: Sequence[str]) -> StructureMatrices:
    matrices, _ = complex_matrices(part, dofs) if part else (None, None)
    if matrices is None or matrices.K.shape != whole.K.shape:
        raise ValueError(
            f"scales: {name} needs at least one of M, C, G, K, of the size of the structure's own matrices"
        )
    return matrices


def _places(planes: Mapping[str, int], tilts: Sequence[str], place: Index) -> Index:
    """Coordinates of the shaft that the model sees."""
    if not planes:
        raise ValueError("planes must name at least one node, for instance planes={'journal': 14}")
    for plane, node in planes.items():
        if not 0 <= node < len(place):
            raise ValueError(f"plane {plane} is at node {node}, but the structure has nodes 0 to {len(place) - 1}")
    if len(set(planes.values())) != len(planes):
        raise ValueError(f"planes must be at different nodes, got {dict(planes)}")
    if tilts and (place[:, 1] < 0).any():
        raise ValueError("tilts need slopes among the dofs of a node: r, or alpha and beta")
    return np.array(
        [*(place[node, 0] for node in planes.values()), *(place[planes[t], 1] for t in tilts)], dtype=np.intp
    )
