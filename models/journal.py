"""The journal of a nonlinear model: where the eccentricity enters, and what it changes there."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.compiled import array_function
from rotorfit.models.model import RotorModel


class Journal:
    """The one coordinate whose orbit changes the fluid, and the drive-point stiffness that changes there.

    Only the entry (b, b) of the coefficient matrices depends on the eccentricity. A rotor of n planes therefore
    condenses to a scalar equation: with ``Delta(eps)`` the change of that entry and ``H`` the receptance of the
    centred rotor, ``A_b = (H F)_b / (1 + H_bb Delta)``.

    Attributes:
        model: the rotor.
        at: number of the coordinate b.
        clearance: m.
    """

    def __init__(self, model: RotorModel) -> None:
        if model.frame != "z":
            raise ValueError(f"{model.name} keeps x and y apart; laws of eccentricity need complex coordinates")
        theta, speed, eccentricity, matrices, _ = model.symbolic
        self.model = model
        self.at = _coordinate(model)
        if model.clearance is None:
            raise ValueError(f"{model.name} depends on eccentricity and has no clearance")
        self.clearance = model.clearance
        entries = [part for m in matrices for part in (m.re[self.at, self.at], m.im[self.at, self.at])]
        drive = ca.densify(ca.vertcat(*entries))
        change = drive - ca.substitute(drive, eccentricity, 0.0)
        slope = ca.jacobian(drive, eccentricity)
        # F = C0(|z|/c) z has the derivative C0 + coupling (1 + exp(2 j phi) conj) by z, phi being the direction of z.
        coupling = ca.densify(slope[:2] * eccentricity / 2)
        inputs = ca.vertcat(theta, speed, eccentricity)
        self._change = array_function(ca.Function("change", [inputs], [ca.densify(ca.vertcat(change, slope))]))
        self._coupling = array_function(ca.Function("coupling", [inputs], [coupling]))
        by_theta = ca.densify(ca.jacobian(coupling, theta))
        self._coupling_jacobian = array_function(ca.Function("coupling_jacobian", [inputs], [by_theta]))

    def change(
        self, theta: ArrayLike, s: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike
    ) -> tuple[ComplexArray, ComplexArray]:
        """Change of the drive-point stiffness against the centred journal, and its slope in eccentricity, N/m.

        Args:
            theta: parameter vectors, shape ``(..., P)``.
            s: j w, shape broadcasting with ``theta[..., 0]``; so the others.
            speed: rotative speed, rad/s.
            eccentricity: orbit radius over clearance.
        """
        flat = self._change(_arguments(theta, speed, eccentricity))
        half = flat.shape[0] // 2
        values = flat[:half:2] + 1j * flat[1:half:2], flat[half::2] + 1j * flat[half + 1 :: 2]
        return _polynomial(values[0], s), _polynomial(values[1], s)

    def coefficient_change(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Change of the journal's coefficients by powers of s against the centred journal, shape ``(order + 1, ...)``.

        Arguments as for :meth:`change`.
        """
        flat = self._change(_arguments(theta, speed, eccentricity))
        half = flat.shape[0] // 2
        return np.asarray(flat[:half:2] + 1j * flat[1:half:2])

    def coupling(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Half the eccentricity times the slope of the static stiffness, N/m.

        About an equilibrium at an angle phi a small displacement ``dz`` of the journal changes the force by
        ``C0 dz + coupling (dz + exp(2 j phi) conj(dz))``.
        """
        flat = self._coupling(_arguments(theta, speed, eccentricity))
        return np.asarray(flat[0] + 1j * flat[1])

    def coupling_jacobian(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Derivatives of :meth:`coupling` by the parameters, shape ``(P, ...)``."""
        flat = self._coupling_jacobian(_arguments(theta, speed, eccentricity))
        return np.asarray(flat[0::2] + 1j * flat[1::2])


@lru_cache(maxsize=64)
def journal(model: RotorModel) -> Journal:
    """The journal of a model that depends on eccentricity, compiled once.

    Raises:
        ValueError: the model has none, or eccentricity enters in more than one place.
    """
    return Journal(model)


def _coordinate(model: RotorModel) -> int:
    functions = model.functions
    chosen = functions.inputs == functions.n_parameters + 1
    places = set(zip(functions.rows[chosen].tolist(), functions.columns[chosen].tolist(), strict=True))
    if not places:
        raise ValueError(f"{model.name} as used here does not depend on eccentricity; give it a law")
    if len(places) > 1 or any(row != column for row, column in places):
        raise ValueError(
            f"{model.name}: eccentricity enters the stiffness at {len(places)} places; one diagonal entry is allowed"
        )
    return int(next(iter(places))[0])


def _arguments(theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> list[Float]:
    theta = np.asarray(theta, dtype=float)
    return [*np.moveaxis(theta, -1, 0), np.asarray(speed, dtype=float), np.asarray(eccentricity, dtype=float)]


def _polynomial(coefficients: ComplexArray, s: ArrayLike) -> ComplexArray:
    total = np.asarray(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * np.asarray(s) + coefficient
    return np.asarray(total)
