"""A known structure: matrices of a shaft, in complex coordinates, and what it is worth at a few of its coordinates."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.models.shafts.reduction import REDUCTION_TOLERANCE, Reduction, Terms

MATRICES = ("M", "C", "G", "K")
DOFS = ("z", "r", "x", "y", "alpha", "beta", "axial", "torsion")
ROSS_4 = ("x", "y", "alpha", "beta")
"""Degrees of freedom of a node in ROSS up to version 1: displacements, then rotations about x and about y."""
ROSS_6 = ("x", "y", "axial", "alpha", "beta", "torsion")
"""The same from version 2 on."""

_Result = TypeVar("_Result")

_ISOTROPY_TOLERANCE = 1e-8  # of the largest entry of its kind: round-off of an assembly
_LOG_SCALE_RANGE = 0.2  # range of the logarithm of a scale factor for which one reduction holds


@dataclass(frozen=True, eq=False)
class StructureMatrices:
    """Matrices in complex coordinates of ``M q'' + (C + Om G) q' + K q = F``, shape ``(N, N)`` each."""

    M: ComplexArray  # mass, kg, damping, N s/m, gyroscopic matrix, kg, and stiffness, N/m; of slopes times m or m^2
    C: ComplexArray
    G: ComplexArray
    K: ComplexArray

    def coefficients(self, speed: ArrayLike) -> ComplexArray:
        """Coefficients of s^0, s^1, s^2, shape ``(..., 3, N, N)``."""
        Om = np.asarray(speed, dtype=float)[..., None, None]
        damping = self.C + Om * self.G
        return np.stack(np.broadcast_arrays(self.K, damping, self.M), axis=-3)


def complex_matrices(matrices: Mapping[str, ArrayLike], dofs: Sequence[str]) -> tuple[StructureMatrices, Index]:
    """Matrices in complex coordinates, and the place of each node's z and r in them. Real matrices with x and y apart
    become complex ones of half the size, z = x + j y and the slope r = dx/ds + j dy/ds = beta - j alpha, if the
    structure is isotropic. Axial and torsional coordinates are left out."""
    names = tuple(dofs)
    for name in names:
        if name not in DOFS:
            raise ValueError(unknown_name("degree of freedom", name, DOFS))
    lateral = set(names) - {"axial", "torsion"}
    if len(set(names)) != len(names) or lateral not in ({"z"}, {"z", "r"}, {"x", "y"}, set(ROSS_4)):
        raise ValueError(f"dofs must hold z, perhaps with r, or x and y, perhaps with alpha and beta; got {names}")
    given = {kind: np.asarray(value) for kind, value in matrices.items()}
    for kind, matrix in given.items():
        if kind not in MATRICES:
            raise ValueError(unknown_name("matrix", kind, MATRICES))
        largest = 1e100  # whose products stay finite
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not (np.abs(matrix) < largest).all():
            raise ValueError(f"{kind} must be a square matrix of finite numbers, got shape {matrix.shape}")
    size = len(next(iter(given.values())))
    if size % len(names) or any(len(matrix) != size for matrix in given.values()):
        sizes = ", ".join(f"{kind} {len(matrix)}" for kind, matrix in given.items())
        raise ValueError(f"matrices must be of one size, a multiple of the {len(names)} dofs of a node; got {sizes}")
    nodes = size // len(names)
    whole = {kind: given.get(kind, np.zeros((size, size))) for kind in MATRICES}
    if "x" in names:
        parts = {kind: _from_real(kind, matrix, names, nodes) for kind, matrix in whole.items()}
    else:
        order = [names.index(name) for name in ("z", "r") if name in names]
        keep = (np.arange(nodes)[:, None] * len(names) + order).ravel()
        parts = {kind: matrix[np.ix_(keep, keep)].astype(complex) for kind, matrix in whole.items()}
        parts["G"] = parts["G"] * np.complex128(-1j)
    slopes = "r" in names or "beta" in names
    place = np.full((nodes, 2), -1, dtype=np.intp)
    place[:, : 1 + slopes] = np.arange(nodes * (1 + slopes)).reshape(nodes, -1)
    return StructureMatrices(**parts), place


def _from_real(kind: str, matrix: NDArray[Any], names: tuple[str, ...], nodes: int) -> ComplexArray:
    if np.iscomplexobj(matrix):
        raise ValueError(f"{kind} is complex, but dofs {names} have x and y apart: then matrices are real")
    first = ["x", *(["beta"] if "beta" in names else [])]  # dx/ds = beta
    second = ["y", *(["alpha"] if "alpha" in names else [])]  # dy/ds = -alpha
    base = np.arange(nodes)[:, None] * len(names)
    u, v = ((base + [names.index(name) for name in group]).ravel() for group in (first, second))
    sign = np.tile([1.0, -1.0][: len(second)], nodes)
    others = np.setdiff1d(np.arange(len(matrix)), np.concatenate([u, v]))
    lateral = np.concatenate([u, v])
    across = sum(np.abs(matrix[np.ix_(*way)]).max(initial=0) for way in ((lateral, others), (others, lateral)))
    if across > _ISOTROPY_TOLERANCE * np.abs(matrix).max(initial=0):
        raise ValueError(f"{kind} couples lateral motion with axial or torsional motion, which this model leaves out")
    uu, uv = matrix[np.ix_(u, u)], matrix[np.ix_(u, v)] * sign
    vu, vv = sign[:, None] * matrix[np.ix_(v, u)], sign[:, None] * matrix[np.ix_(v, v)] * sign
    _check_isotropic(kind, uu - vv, np.maximum(np.abs(uu), np.abs(vv)), len(first), "xx and yy")
    _check_isotropic(kind, uv + vu, np.maximum(np.abs(uv), np.abs(vu)), len(first), "xy and -yx")
    return np.asarray((uu + vv + 1j * (vu - uv)) / 2)


def _check_isotropic(kind: str, difference: Float, level: Float, per_node: int, what: str) -> None:
    """Compare entries with the largest of their kind: forces and moments have sizes of their own."""
    for row in range(per_node):
        for column in range(per_node):
            gap = np.abs(difference[row::per_node, column::per_node])
            size = level[row::per_node, column::per_node].max()
            if gap.max() > _ISOTROPY_TOLERANCE * size:
                node, other = np.unravel_index(int(np.argmax(gap)), gap.shape)
                raise ValueError(
                    f"{kind} is not isotropic: its {what} entries between nodes {node} and {other} differ by "
                    f"{significant(gap.max(), 3)}, the largest being {significant(size, 3)}. A known structure "
                    "must be the same in x and in y"
                )


@dataclass(frozen=True, eq=False)
class KnownStiffness:
    """Dynamic stiffness of a known structure at a model's coordinates."""

    values: ComplexArray  # shape ``(L, n, n)``, N/m
    inputs: Index  # places of the structure's scale factors in the model's parameter vector, shape ``(S,)``
    slopes: ComplexArray  # derivatives by these, shape ``(S, L, n, n)``


class SeenShaft(Protocol):
    """A known structure as free motion needs it."""

    @property
    def at(self) -> Index:
        """Coordinates seen."""

    @property
    def has_mass(self) -> bool:
        """True if every coordinate has inertia."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShaftApart:
    """A known structure with x and y apart, all x first."""

    at: Index  # see :class:`SeenShaft`
    has_mass: bool


class _Latest(OrderedDict[bytes, _Result]):
    """Results that were worked out last, by the arrays that they follow from."""

    def of(self, work: Callable[..., _Result], *arrays: NDArray[Any]) -> _Result:
        """The result that is kept, or worked out now."""
        key = blake2b(b"".join(np.ascontiguousarray(part).tobytes() for part in arrays)).digest()
        if key not in self:
            self[key] = work(*arrays)
        self.move_to_end(key)
        structures_kept = 24  # condensed structures kept
        if len(self) > structures_kept:
            self.popitem(last=False)
        return self[key]


class Shaft(ByValue):
    """Known structure, of which scale factors multiply ``parts``, seen at coordinates ``at``, shape ``(n,)``."""

    def __init__(self, matrices: StructureMatrices, parts: Sequence[StructureMatrices], at: Index) -> None:
        self.matrices = matrices
        self.parts = tuple(parts)
        self.at = at
        self.terms = Terms.of(matrices, parts, at)
        inertia = np.abs(np.diag(matrices.M))
        self.has_mass = bool(inertia.all())
        largest_condition = 1e12  # condition of the mass matrix, unit diagonal, beyond which some motion has no inertia
        if self.has_mass:
            unit = 1 / np.sqrt(inertia)
            self.has_mass = bool(np.linalg.cond(unit[:, None] * matrices.M * unit) < largest_condition)
        self._kept: _Latest[tuple[ComplexArray, ComplexArray]] = _Latest()
        self._reductions: _Latest[Reduction | None] = _Latest()

    def coefficients(self, scales: Float, speed: ArrayLike) -> ComplexArray:
        """Coefficients of s^0, s^1, s^2 of all coordinates, shape ``(..., 3, N, N)``."""
        total = self.matrices.coefficients(speed)
        for number, part in enumerate(self.parts):
            total = total + (scales[..., number] - 1.0)[..., None, None, None] * part.coefficients(speed)
        return total

    def condensed(self, s: ComplexArray, speed: Float, scales: Float) -> tuple[ComplexArray, ComplexArray]:
        """Dynamic stiffness between the coordinates seen, the others being free of force. Exact where the structure has
        no scale factors, or few coordinates, or where few lines are asked for; else of a reduced structure whose error
        is below :data:`~rotorfit.models.shafts.reduction.BASIS_TOLERANCE`. It is kept, because it does not change in a
        fit as long as the scale factors do not."""
        return self._kept.of(self._condense, s, speed, scales)

    def _condense(self, s: ComplexArray, speed: Float, scales: Float) -> tuple[ComplexArray, ComplexArray]:
        large = 40  # coordinates from which a structure with scale factors is reduced
        many_lines = 32  # lines from which that is worth its while
        if not self.parts or self.terms.size < large or s.size < many_lines or not (scales > 0).all():
            return self.terms.condense(s, speed, scales)
        n = self.at.size
        values = np.empty((s.size, n, n), dtype=complex)
        slopes = np.empty((len(self.parts), s.size, n, n), dtype=complex)
        ranges, place = np.unique(np.round(np.log(scales) / _LOG_SCALE_RANGE).astype(int), axis=0, return_inverse=True)
        for number, steps in enumerate(ranges):
            lines = np.flatnonzero(place.reshape(-1) == number)
            terms = self.terms
            if lines.size >= many_lines:  # reduced for these lines, unless that would not be exact
                found = self._reductions.of(self._reduction, s[lines], speed[lines], steps)
                terms = terms if found is None or found.error > REDUCTION_TOLERANCE else found.small
            values[lines], slopes[:, lines] = terms.condense(s[lines], speed[lines], scales[lines])
        return values, slopes

    def _reduction(self, s: ComplexArray, speed: Float, steps: Index) -> Reduction | None:
        try:
            return Reduction(self.terms, s, speed, np.exp((steps + np.array([[-0.5], [0.5]])) * _LOG_SCALE_RANGE))
        except np.linalg.LinAlgError:  # no energy to measure by, or a resonance: then as it is
            return None

    @property
    def reductions(self) -> tuple[Reduction, ...]:
        """Reduced structures in use."""
        return tuple(r for r in self._reductions.values() if r is not None and r.error <= REDUCTION_TOLERANCE)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": _Latest(), "_reductions": _Latest()}
