"""A disk on a shaft that is not round and that twists: turning anisotropy and lateral-torsional coupling (Figs 37, 38).

Equations (g is the angle of the stiff direction ahead of the Keyphasor mark, theta = Om t + phi)::

    M z'' + D z' + K z + dK exp(2j(theta + g)) conj(z) = M e (theta'^2 - j theta'') exp(j theta) + F + P
    (J + M e^2) phi'' + M e Im(z'' exp(-j theta)) + ct phi' + kt phi = dK Im(conj(z)^2 exp(2j(theta + g)))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex
from rotorfit.models.lumped import one_per_coordinate
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.parameters import Parameter
from rotorfit.models.shafts.combination_lines import LATERAL, TWIST, Jet, Order, ShaftValues, Torsion, solve_lines
from rotorfit.models.shafts.turning import TurningFrame

Wording = Literal["modal", "stiffness"] | None

_TORSION = {
    "modal": (
        Parameter("nu_t", "rad/s", "natural frequency of the twist", scale=300.0, lower=0.0),
        Parameter("zeta_t", "1", "damping ratio of the twist", scale=0.01, lower=0.0),
    ),
    "stiffness": (
        Parameter("kt", "N m/rad", "torsional stiffness", scale=20.0, lower=0.0),
        Parameter("ct", "N m s/rad", "torsional damping", scale=1e-3, lower=0.0),
    ),
}


_RUNOUT = (
    Parameter("R1c", "m", "run-out at 1x along the Keyphasor mark", scale=1e-5),
    Parameter("R1s", "m", "run-out at 1x ahead of the Keyphasor mark", scale=1e-5),
    Parameter("R2c", "m", "run-out at 2x along the Keyphasor mark", scale=1e-5),
    Parameter("R2s", "m", "run-out at 2x ahead of the Keyphasor mark", scale=1e-5),
)


class AnisotropicShaft(RotorModel):
    """A disk on a shaft with two lateral stiffnesses, K + dK and K - dK, that turn with it, and twist.

    The anisotropy enters as ``dK_cos = dK cos 2g`` and ``dK_sin = dK sin 2g``, which have a meaning for a round shaft
    too, where the angle g of the stiff direction has none; :meth:`anisotropy` makes dK and g of them,
    :meth:`components` the other way round. So do ``ec``, ``es`` (eccentricity along the Keyphasor mark and ahead of it)
    and ``Px``, ``Py`` (side load).

    Args:
        planes: name of the disk's plane.
        torsion: how stiffness and damping of the twist are given, "modal" (nu_t, zeta_t) or "stiffness" (kt, ct), or
            ``None`` for a shaft that does not twist.
        runout: whether the readings at 1x and 2x hold run-out, to be fitted; the start-ups of a shaft tell it.
    """

    name: ClassVar[str] = "anisotropic-shaft"
    turns = True

    def __init__(self, planes: Sequence[str] = ("disk",), *, torsion: Wording = "modal", runout: bool = False) -> None:
        if torsion is not None and torsion not in _TORSION:
            raise ValueError(unknown_name("torsion", torsion, _TORSION))
        self.planes = one_per_coordinate(planes, 1, self.name)
        self.torsion, self.runout = torsion, runout
        twist = (Parameter("J", "kg m^2", "polar inertia of the disk", scale=1e-3, lower=0.0),) if torsion else ()
        self.parameters = (
            Parameter("M", "kg", "mass of the disk", scale=1.0, lower=0.0),
            Parameter("D", "N s/m", "external damping", scale=10.0),
            Parameter("K", "N/m", "mean lateral stiffness", scale=1e4),
            Parameter("dK_cos", "N/m", "turning anisotropy, dK cos 2g", scale=1e3),
            Parameter("dK_sin", "N/m", "turning anisotropy, dK sin 2g", scale=1e3),
            Parameter("ec", "m", "eccentricity along the Keyphasor mark", scale=1e-4),
            Parameter("es", "m", "eccentricity ahead of the Keyphasor mark", scale=1e-4),
            Parameter("Px", "N", "side load in x", scale=10.0),
            Parameter("Py", "N", "side load in y", scale=10.0),
            *twist,
            *(_TORSION[torsion] if torsion else ()),
            *(_RUNOUT if runout else ()),
        )

        over_inertia = ("ec", "es", "Px", "Py", *(("kt", "ct") if torsion == "stiffness" else ()))
        self.ratios = {"J": over_inertia} if torsion else {}

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """The round part of the shaft; what turns is in :meth:`turning_stiffness`."""
        return [[p.K]], [[p.D]], [[p.M]]

    def turning_stiffness(self, p: Any) -> Matrix:
        """See :meth:`RotorModel.turning_stiffness`."""
        return [[Complex(p.dK_cos, p.dK_sin)]]

    # ---- free motion: Floquet exponents ---------------------------------------------------------------------------

    @cached_property
    def turning(self) -> TurningFrame:
        """The lateral equations in turning coordinates, where their coefficients are constant."""
        return TurningFrame(self)

    @property
    def speed_dependent(self) -> bool:
        """In turning coordinates always."""
        return True

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """Lateral free motion in turning coordinates; its eigenvalues plus j Om are whirl frequencies in fixed ones."""
        return self.turning.coefficients(theta, speed)

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        return self.turning.motion_jacobian(theta, speed)

    # ---- forced motion: lines ---------------------------------------------------------------------------------------

    def lines(
        self, theta: ArrayLike, direction: str, order: Order, frequency: ArrayLike, speed: ArrayLike, force: ArrayLike
    ) -> ComplexArray:
        """Complex amplitude of one line under a rotating force.

        Args:
            theta: parameter vectors, shape ``(..., P)``.
            direction: ``z`` for the lateral motion, ``twist`` for the twist.
            order: orders (m, n) of the line, see :mod:`rotorfit.models.shafts.combination_lines`.
            frequency: w, rad/s, signed.
            speed: Om, rad/s.
            force: complex amplitude of the force at w, N.

        Returns:
            m or rad, relative to ``exp(j nu t)`` with nu the line's signed frequency.
        """
        return np.asarray(self.several_lines(theta, [(direction, order)], frequency, speed, force)[0, 0])

    def lines_jacobian(
        self, theta: ArrayLike, direction: str, order: Order, frequency: ArrayLike, speed: ArrayLike, force: ArrayLike
    ) -> tuple[ComplexArray, ComplexArray]:
        """The lines of :meth:`lines`, and their derivatives by the parameters, shape ``(..., P)``.

        Args:
            theta, direction, order, frequency, speed, force: see :meth:`lines`.
        """
        found = self.several_lines(theta, [(direction, order)], frequency, speed, force, derivatives=True)[:, 0]
        return found[0], np.moveaxis(found[1:], 0, -1)

    def several_lines(
        self,
        theta: ArrayLike,
        kinds: Sequence[tuple[str, Order]],
        frequency: ArrayLike,
        speed: ArrayLike,
        force: ArrayLike,
        *,
        derivatives: bool = False,
    ) -> ComplexArray:
        """Lines of several kinds, which have nearly all their arithmetic in common.

        Args:
            theta: parameter vectors, shape ``(..., P)``.
            kinds: direction and orders of each.
            frequency, speed, force: see :meth:`lines`.
            derivatives: whether the derivatives by the parameters are wanted too.

        Returns:
            complex amplitudes, and behind them their derivatives where wanted, shape ``(1 or 1 + P, len(kinds), ...)``.

        Raises:
            ValueError: the shaft has no such line.
        """
        for direction, order in kinds:
            if order not in (TWIST if direction == "twist" else LATERAL).values():
                raise ValueError(f"{self.name} has no line of orders {order} in the direction {direction}")
            if direction == "twist" and self.torsion is None:
                raise ValueError(f"{self.name} with torsion=None does not twist: leave readings of the twist out")
        vectors = np.asarray(theta, dtype=float)
        count = vectors.shape[-1]
        others = [np.asarray(frequency, dtype=float), np.asarray(speed, dtype=float), np.asarray(force, dtype=complex)]
        shape = np.broadcast_shapes(vectors.shape[:-1], *(other.shape for other in others))
        if vectors.size > count:  # one vector is not repeated
            vectors = np.broadcast_to(vectors, (*shape, count))
        vectors = vectors.reshape(-1, count)
        w, Om, F = (np.broadcast_to(other, shape).ravel() for other in others)
        found = np.zeros((1 + count if derivatives else 1, len(kinds), w.size), dtype=complex)
        step = 128 if derivatives else 1024  # frequencies worked out together: they stay in the processor's cache
        for start in range(0, w.size, step):
            piece = slice(start, start + step)
            own = vectors if len(vectors) == 1 else vectors[piece]
            parameters = Jet.parameters(own, derivatives=derivatives)
            for k, line in enumerate(self._lines(parameters, kinds, w[piece].real, Om[piece].real, F[piece])):
                found[0, k, piece] = line.value[0]
                if line.slope is not None:
                    found[1:, k, piece] = line.slope[:, 0]
        return np.asarray(found.reshape(*found.shape[:2], *shape))

    def _lines(
        self,
        parameters: Sequence[Jet],
        kinds: Sequence[tuple[str, Order]],
        frequency: Float,
        speed: Float,
        force: ComplexArray,
    ) -> list[Jet]:
        p = dict(zip(self.parameter_names, parameters, strict=True))
        if self.torsion == "modal":
            p["kt"] = p["J"] * p["nu_t"] * p["nu_t"]
            p["ct"] = p["zeta_t"] * p["nu_t"] * p["J"] * 2.0
        values = ShaftValues(
            M=p["M"],
            D=p["D"],
            K=p["K"],
            delta=p["dK_cos"] + p["dK_sin"] * 1j,
            eps=p["ec"] + p["es"] * 1j,
            side=p["Px"] + p["Py"] * 1j,
            speed=speed,
            frequency=frequency,
            force=force,
            torsion=None if self.torsion is None else Torsion(J=p["J"], kt=p["kt"], ct=p["ct"]),
        )
        wanted: tuple[list[Order], list[Order]] = ([], [])
        for direction, order in kinds:
            wanted[direction == "twist"].append(order)
        lateral, twist = solve_lines(values, *wanted)
        if self.runout:  # seen by the probes alone
            for place, name in (((0, 0), "R1"), ((0, 1), "R2")):
                if place in lateral:
                    lateral[place] = lateral[place] + (p[f"{name}c"] + p[f"{name}s"] * 1j)
        still = Jet(np.zeros((1, speed.size)))  # what only the twist drives, of a shaft that does not twist
        return [twist[order] if direction == "twist" else lateral.get(order, still) for direction, order in kinds]

    # ---- the anisotropy in other words -----------------------------------------------------------------------------

    @staticmethod
    def components(dK: float, angle: float) -> dict[str, float]:
        """``dK_cos`` and ``dK_sin`` of dK, N/m, with the stiff direction ``angle`` rad ahead of the mark.

        Args:
            dK: difference of the two stiffnesses, N/m.
            angle: of the stiff direction ahead of the Keyphasor mark, rad.
        """
        return {"dK_cos": dK * math.cos(2 * angle), "dK_sin": dK * math.sin(2 * angle)}

    def anisotropy(self, theta: ArrayLike) -> tuple[Float, Float]:
        """Turning anisotropy dK, N/m, and angle g of the stiff direction, rad in (-pi/2, pi/2].

        Args:
            theta: parameter vectors, shape ``(..., P)``.
        """
        vectors = np.asarray(theta, dtype=float)
        c, s = (vectors[..., self.parameter_names.index(name)] for name in ("dK_cos", "dK_sin"))
        return np.hypot(c, s), np.arctan2(s, c) / 2
