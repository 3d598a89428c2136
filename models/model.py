"""The base class of all rotor models: one symbolic equation of motion, everything else derived from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, lru_cache
from inspect import signature
from types import MappingProxyType, SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self
from uuid import uuid4

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Tabled
from rotorfit.models.coefficients import CoefficientJacobian, CompiledModel, Symbolic
from rotorfit.models.complexes import Complex, Number
from rotorfit.models.fluid import PlaneFluid
from rotorfit.models.line_terms import LineTerms, Weights
from rotorfit.models.parameters import Parameter
from rotorfit.models.probes import Probes, with_probes
from rotorfit.models.shafts.angular_rates import angular_rates

if TYPE_CHECKING:
    from rotorfit.models.shafts.shaft import KnownStiffness, SeenShaft

Matrix = Complex | Sequence[Sequence[Number]]


@dataclass(frozen=True)
class Coordinate:
    """One generalised coordinate: what is measured (or left unmeasured) at a plane.

    Attributes:
        plane: name of the plane.
        axis: ``z`` for the complex displacement x + j y, ``r`` for the complex slope dx/ds + j dy/ds, and ``x`` or
            ``y`` in models that keep the two lateral directions apart.
    """

    plane: str
    axis: Literal["z", "r", "x", "y"]

    def __str__(self) -> str:
        return f"{self.plane}.{self.axis}"


class RotorModel(ByValue, Tabled, ABC):
    """A rotor as polynomial dynamic stiffness, ``kappa(s) = sum_k C_k s^k`` with ``s = j w``.

    A model of your own needs ``name``, ``planes``, ``parameters`` and :meth:`equation`; one whose entries change with
    the eccentricity at their planes needs ``clearance``, m, one or by plane, too. In models with complex
    coordinates (``frame = "z"``) the frequency w is signed and C_k complex; with ``frame = "xy"`` the coordinates are
    all x, then all y, the coefficients real and phasors refer to ``exp(+j |w| t)``.
    """

    name: ClassVar[str]
    frame: Literal["z", "xy"] = "z"
    planes: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    # radial, m, or by plane: the eccentricity of an entry of the equation is the orbit's radius there over it
    clearance: float | Mapping[str, float] | Sequence[tuple[str, float]] | None = None
    fluids: tuple[PlaneFluid, ...] = ()  # forces of eq. (13), where the model is made of them
    caveats: tuple[str, ...] = ()  # sentences that belong beside the numbers of this model
    probes: Probes = ()  # between the planes, with their shares of the planes' motion
    shaft: SeenShaft | None = None  # a structure whose matrices are known
    ratios: Mapping[str, tuple[str, ...]] = MappingProxyType({})  # what data may tell only over a positive parameter
    line_count: int = 2  # coordinates of each motion that turns: its own and those of its image
    has_causes: bool = True  # whether effects beside it are listed for its fits: not where its values hold them
    in_band_only: bool = False  # its free motion is that of the rotor up to the tested frequencies only
    magnetic: tuple[str, ...] = ()  # planes in a magnetic bearing
    # numbers that a first screen of its fits shows: names of parameters, or what ``headline.py`` works out of them
    leads: tuple[str, ...] = (
        "threshold speed", "frequencies", "anisotropy", "least damping", "D", "lam", "lam_D", "lam_M", "law", "Mf", "K0"
    )  # fmt: skip
    no_closed_form: str = ""  # why a closed form of it says nothing with errors, in words
    advice: str = ""  # what to do where it limits a fit, other than to let data ask for blocks
    of_modes: bool = False  # its coordinates are modes, x and y each for itself
    at_one_speed: bool = False  # its numbers are those of the speed of the test, and say nothing of another
    force_alone: bool = False  # it is the force of a bearing or seal, its structure standing apart or left out
    made_from: Mapping[str, Any] = MappingProxyType({})  # what read a known structure from a file, and its arguments
    turns: bool = False  # free motion (see motion) is written in turning coordinates, each motion with its image

    @abstractmethod
    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """Return the coefficient matrices of s^0, s^1, s^2, ... (stiffness, damping, mass).

        Args:
            p: the parameters by name, symbolic (``p.K0``).
            speed: rotative speed Omega, rad/s, symbolic.
            eccentricity: orbit radius over clearance at the plane of the entry that it changes, symbolic.
        """

    def clearance_at(self, plane: str) -> float | None:
        """Radial clearance at a plane, m.

        Args:
            plane: one of the model's planes.
        """
        whole = self.clearance
        return whole if whole is None or isinstance(whole, int | float) else dict(whole).get(plane)

    @property
    def least_clearance(self) -> float | None:
        """The smallest radial clearance, m."""
        whole = self.clearance
        return whole if whole is None or isinstance(whole, int | float) else min(dict(whole).values())

    def turning_stiffness(self, p: Any) -> Matrix:
        """Stiffness that turns with the shaft, the factor of ``exp(2j Om t) conj(z)``; none unless overridden.

        Args:
            p: parameters by name, CasADi symbols: ``p.K0``.
        """
        size = len(self.coordinates)
        return [[0.0] * size for _ in range(size)]

    def support_coupling(self, p: Any) -> Sequence[Complex]:
        """Stiffness and damping that stand still, factors of conj(z) and of its rate; none unless overridden.

        Args:
            p: parameters by name, CasADi symbols: ``p.K0``.
        """
        return ()

    def orbit_start(self, values: Mapping[str, float]) -> dict[str, float]:
        """Where a fit may begin with parameters that act at an eccentricity only: at their scales unless overridden.

        Args:
            values: of the other parameters by name, as a rotor with its journal centred has them.
        """
        begin = {name: v for own in self.fluids if own.law.parameters for name, v in own.start(values).items()}
        if begin or not self.eccentricity_dependent:
            return begin
        typical = np.array([min(max(q.scale, q.lower), q.upper) for q in self.parameters])
        count, share = typical.size, 1e-4  # of the effect at an eccentricity, which is none beside the centre
        effect = np.zeros((2, count + 2))
        for size, eccentricity in zip(effect, (1e-6, 0.3), strict=True):
            found = self.functions.jacobian(typical, 100.0, eccentricity)
            np.maximum.at(size, found.inputs, np.abs(found.values))
        return {
            q.name: float(value)
            for q, value, (centred, moved) in zip(self.parameters, typical, effect[:, :count].T, strict=True)
            if centred < share * moved
        }

    def probe_factors(self, p: Any) -> Sequence[Number]:
        """Factor by which each coordinate's reading is multiplied: ``beta1``, ... of the probes, where there are any.

        Args:
            p: parameters by name, CasADi symbols: ``p.K0``.
        """
        names = {plane: f"beta{i}" for i, plane in enumerate(self.read_planes, 1)}
        return [getattr(p, names.get(c.plane, ""), 1.0) if c.axis != "r" else 1.0 for c in self.coordinates]

    def alternatives(self, probes: Set[tuple[str, str]]) -> tuple[RotorModel, ...]:
        """Models that stand for this one where it leaves a choice to the data: a fit takes that of least BIC.

        Args:
            probes: plane and direction of those that the data are of.
        """
        return (self,)

    @property
    def nodes(self) -> dict[str, int]:
        """Nodes of a known structure by plane."""
        return {}

    def with_modes(self, s: ComplexArray, shapes: ComplexArray) -> Float | None:
        """Parameters of the rotor that has given modes; None where modes do not tell them.

        Args:
            s: eigenvalues, 1/s, shape ``(m,)``.
            shapes: deflections of the coordinates, shape ``(n, m)``.
        """
        return None

    @property
    def turning(self) -> RotorModel:
        """The equations in coordinates where their coefficients are constant."""
        return self

    @property
    def round_rotor(self) -> RotorModel | None:
        """The rotor without what turns with it, where its parameters come first; None where nothing turns."""
        return None

    @property
    def line_places(self) -> Mapping[str, int]:
        """Lines that can be read, by name, with their place among those of :attr:`turning`; of most models none."""
        return {}

    def with_more_lines(self, count: int) -> RotorModel | None:
        """The same with more lines that a force brings about, None where none were left out.

        Args:
            count: lines more on either side.
        """
        return None

    @property
    def on_own_supports(self) -> RotorModel:
        """The rotor itself where this model is one on other supports."""
        return self

    @property
    def mode_count(self) -> int:
        """Modes that responses in one plane of motion consist of."""
        return len(self.planes)

    @property
    def weights(self) -> Weights | None:
        """How readings weigh the terms of :meth:`line_terms`; None for models whose response is no such sum."""
        return None

    def line_terms(self, theta: Float, s: ComplexArray, force: ComplexArray) -> LineTerms:
        """Functions of the line that the response is a sum of, see :attr:`weights`.

        Args:
            theta: parameter vectors of all lines, shape ``(..., 1, P)``, or of each line its own, ``(..., L, P)``.
            s: j w of each line, shape ``(L,)``.
            force: generalised force of each line, shape ``(L, n)``.

        Raises:
            TypeError: the response of this model is no such sum.
        """
        raise TypeError(f"the response of {self.name} is no sum of terms that all probes share")

    @property
    def read_planes(self) -> tuple[str, ...]:
        """Planes at which probes may be: those of the model, then the probes between them."""
        return (*self.planes, *(name for name, _ in self.probes))

    def is_read(self, plane: str, axis: str) -> bool:
        """True if the model knows how a plane moves along an axis.

        Args:
            plane: one of the model's planes.
            axis: ``"z"``, or ``"x"`` or ``"y"`` of models with both.
        """
        return plane in self.read_planes

    def is_forced(self, plane: str) -> bool:
        """True if the model knows what a force at a plane does.

        Args:
            plane: one of the model's planes.
        """
        return plane in self.planes

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Generalised coordinates, in the order of the matrix rows."""
        axes: tuple[Literal["x", "y", "z"], ...] = ("z",) if self.frame == "z" else ("x", "y")
        return tuple(Coordinate(plane, axis) for axis in axes for plane in self.read_planes)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of every parameter vector."""
        return tuple(parameter.name for parameter in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Look a parameter up by name.

        Args:
            name: of the parameter, ``"K0"``.

        Raises:
            KeyError: no such parameter; the message names the nearest.
        """
        if name in self._by_name:
            return self._by_name[name]
        raise KeyError(unknown_name(f"parameter of {self.name}", name, self.parameter_names))

    @cached_property
    def _by_name(self) -> dict[str, Parameter]:
        return {parameter.name: parameter for parameter in self.parameters}

    def vector(self, values: Mapping[str, float]) -> Float:
        """Arrange named values as a parameter vector; parameters with a default may be left out.

        Args:
            values: by parameter name, SI units.

        Raises:
            KeyError: unknown or missing names.
        """
        for name in values:
            self.parameter(name)
        missing = [q.name for q in self.parameters if q.name not in values and q.default is None]
        if missing:
            raise KeyError(f"{self.name} needs a value for {', '.join(missing)}")
        return np.array([values.get(q.name, q.default) for q in self.parameters], dtype=float)

    # ---- the equation of motion as compiled functions -------------------------------------------------------------

    @cached_property
    def symbolic(self) -> Symbolic:
        """The symbols (parameters, speed, eccentricity), the coefficient matrices and the probe factors."""
        return _symbolic(self)

    @property
    def order(self) -> int:
        """Highest power of s in the equation of motion."""
        return len(self.symbolic[3]) - 1

    @cached_property
    def speed_dependent(self) -> bool:
        """True if the coefficients depend on the rotative speed."""
        return self._depends_on(self.symbolic[1])

    @cached_property
    def eccentricity_dependent(self) -> bool:
        """True if the coefficients depend on the orbit's eccentricity (a nonlinear model)."""
        return self._depends_on(self.symbolic[2])

    def _depends_on(self, symbol: ca.SX) -> bool:
        flat = ca.vertcat(*[ca.vec(part) for m in self.symbolic[3] for part in (m.re, m.im)])
        return bool(ca.depends_on(flat, symbol))

    @cached_property
    def functions(self) -> CompiledModel:
        """The compiled coefficient functions."""
        return _compiled(self)

    def coefficients(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike = 0.0) -> ComplexArray:
        """Coefficient matrices of the equation of motion.

        Args:
            theta: parameter vectors, shape ``(..., P)``, SI units.
            speed: rotative speed, rad/s, shape broadcasting with ``theta[..., 0]``.
            eccentricity: orbit radius over clearance, likewise.

        Returns:
            shape ``(..., order + 1, n, n)``.

        Raises:
            ValueError: speeds that are not finite numbers, or none.
        """
        return self.functions.values(theta, angular_rates(speed), eccentricity)

    def dynamic_stiffness(
        self, theta: ArrayLike, frequency: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike = 0.0
    ) -> ComplexArray:
        """Complex dynamic stiffness matrix kappa (eqs 4, 10 to 13, 18, 22).

        Args:
            theta: parameter vector, shape ``(P,)`` or ``(..., P)``, SI units.
            frequency: perturbation frequency w, rad/s, signed (``frame = "xy"``: its magnitude counts).
            speed: rotative speed, rad/s.
            eccentricity: orbit radius over clearance.

        Returns:
            shape ``(..., n, n)``, N/m for displacement coordinates.

        Raises:
            ValueError: frequencies or speeds that are not finite numbers, or none.
        """
        w = angular_rates(frequency, "frequency")
        s = np.asarray(1j * (w if self.frame == "z" else np.abs(w)))
        coefficients = self.coefficients(theta, speed, eccentricity)
        kappa = np.zeros(1, dtype=complex)
        for power in range(self.order, -1, -1):
            kappa = kappa * s[..., None, None] + coefficients[..., power, :, :]
        stiffness: ComplexArray = np.asarray(kappa, dtype=complex)
        if self.shaft is None:
            return stiffness
        lines = np.broadcast_shapes(stiffness.shape[:-2], s.shape, np.shape(speed))
        count = len(self.parameters)  # none where all is known
        vectors = np.broadcast_to(theta, (*lines, count)).reshape(int(np.prod(lines)), count)
        speeds = np.broadcast_to(np.asarray(speed, dtype=float), lines).ravel()
        known = self.known_stiffness(vectors, np.broadcast_to(s, lines).ravel(), speeds)
        return stiffness + known.values.reshape(*lines, *known.values.shape[1:])

    def known_stiffness(self, theta: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
        """Dynamic stiffness of the known structure, condensed to the coordinates; it adds to the polynomial's.

        Args:
            theta: parameter vectors, shape ``(P,)`` or ``(L, P)``.
            s: j w of each line, shape ``(L,)``.
            speed: rotative speed, rad/s, shape ``(L,)``.

        Raises:
            TypeError: the model has no known structure.
        """
        raise TypeError(f"{self.name} has no known structure")

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """Coefficient matrices of free motion, those of :meth:`coefficients` unless coordinates were condensed away.

        Args:
            theta: parameter vector, shape ``(P,)``, or many, shape ``(..., P)``.
            speed: rotative speed, rad/s, one or as many as vectors.
        """
        return self.coefficients(theta, speed)

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """Derivatives of :meth:`motion` by parameters and speed.

        Args:
            theta: parameter vector, shape ``(P,)``, or many, shape ``(..., P)``.
            speed: rotative speed, rad/s, one or as many as vectors; of a known structure one vector and speed.
        """
        return self.functions.jacobian(theta, speed)

    def receptance(
        self, theta: ArrayLike, frequency: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike = 0.0
    ) -> ComplexArray:
        """Matrix of responses to unit forces, ``inv(kappa)``, m/N.

        Args:
            theta: parameter vector, shape ``(P,)``, or many, shape ``(..., P)``.
            frequency: signed perturbation frequencies, rad/s, shape ``(N,)``.
            speed: rotative speed, rad/s, one or shape ``(N,)``.
            eccentricity: of the journal, for models with a law.
        """
        return np.asarray(np.linalg.inv(self.dynamic_stiffness(theta, frequency, speed, eccentricity)), dtype=complex)

    def force_vector(self, plane: str, frequency: ArrayLike, force: ArrayLike, along: str = "circular") -> ComplexArray:
        """Generalised force at a plane: of a circular force (eq. 2), or of one along x or y.

        In complex coordinates ``Re(F exp(jwt))`` along x is half of F at +w and half of conj(F) at -w; along y both are
        multiplied by j.

        Args:
            plane: name of the force plane.
            frequency: signed frequency, shape ``(L,)``; its sign is the sense of the force, or says which of its two
                parts is meant.
            force: phasor ``F exp(j delta)`` of eq. (2), or of the component along the axis, N, shape ``(L,)``.
            along: ``circular``, ``x`` or ``y``.

        Returns:
            shape ``(L, n)``.

        Raises:
            KeyError: unknown plane, or a probe between the planes.
        """
        if plane in self.read_planes[len(self.planes) :]:
            raise KeyError(f"{plane} is a probe between the planes; forces act at {', '.join(self.planes)}")
        w, phasor = np.broadcast_arrays(np.asarray(frequency, dtype=float), np.asarray(force, dtype=complex))
        vector = np.zeros((*w.shape, len(self.coordinates)), dtype=complex)
        if self.frame == "z":
            share = {"circular": 1.0, "x": 0.5, "y": 0.5j}[along]
            vector[..., self.coordinate(plane, "z")] = share * np.where(w < 0, phasor.conj(), phasor)
        elif along != "circular":
            vector[..., self.coordinate(plane, along)] = phasor
        else:
            vector[..., self.coordinate(plane, "x")] = phasor
            vector[..., self.coordinate(plane, "y")] = np.where(w < 0, 1j, -1j) * phasor
        return vector

    def coordinate(self, plane: str, axis: str) -> int:
        """Index of a coordinate.

        Args:
            plane: one of the model's planes.
            axis: ``"z"``, ``"r"`` for a slope, or ``"x"`` or ``"y"`` of models with both.

        Raises:
            KeyError: the model has no such plane or axis; both lists are shown.
        """
        for index, coordinate in enumerate(self.coordinates):
            if (coordinate.plane, coordinate.axis) == (plane, axis):
                return index
        raise KeyError(
            f"{self.name} has no coordinate {plane}.{axis}; it has {', '.join(map(str, self.coordinates))}. "
            "Map other plane names (planes=, --planes)"
        )

    def options(self) -> dict[str, Any]:
        """Arguments that make this model again, by name: its attributes that are called like arguments of its class."""
        found = {name: getattr(self, name) for name in signature(type(self)).parameters if hasattr(self, name)}
        return found | ({"probes": {name: dict(shares) for name, shares in self.probes}} if "probes" in found else {})

    def variant(self, **changes: Any) -> Self:
        """The same model with other options, for instance ``blocks`` or ``two_lam``.

        Args:
            **changes: options of the model's class, by name.

        Raises:
            ValueError: the model has no such option.
        """
        unknown = set(changes) - set(self.options())
        if unknown:
            raise ValueError(f"{self.name} has no option {', '.join(unknown)}; it has {', '.join(self.options())}")
        return type(self)(**{**self.options(), **changes})

    def __getstate__(self) -> dict[str, Any]:
        """What a copy in another process needs, and what tells this model from others, for what was compiled."""
        cached = [n for kind in type(self).__mro__ for n, v in vars(kind).items() if isinstance(v, cached_property)]
        return {name: value for name, value in self.__dict__.items() if name not in cached} | {"_origin": self._origin}

    @cached_property
    def _origin(self) -> str:
        """Of which model this one is a copy, where its equation may draw on more than its attributes: it is the same as
        itself and its copies only."""
        return "" if _is_ours(self) and _is_ours(self.options()) else uuid4().hex

    @cached_property
    def _hash(self) -> int:
        return super().__hash__()

    def __hash__(self) -> int:
        return self._hash

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(planes={self.planes}, parameters={list(self.parameter_names)})"

    def describe(self) -> str:
        """Table of the parameters: name, unit, meaning, limits."""
        return str(self)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        rows = [["", "name", "unit", "meaning"]]
        for q in self.parameters:
            limits = "" if np.isinf([q.lower, q.upper]).all() else f"  [{q.lower:g}, {q.upper:g}]"
            default = "" if q.default is None else f"  known = {q.default:g} unless freed"
            rows.append(["", q.name, q.unit, f"{q.meaning}{limits}{default}"])
        return [f"{self.name}: planes {', '.join(self.planes)}", Table(rows, "<0 <7 <7 <1")]


_PACKAGE = __name__.partition(".")[0]


def _is_ours(value: object) -> bool:
    """True if a value is plain, or of a class of this package, or holds nothing else."""
    if isinstance(value, Mapping):
        return all(map(_is_ours, value.values()))
    if isinstance(value, tuple | list):
        return all(map(_is_ours, value))
    return type(value).__module__.partition(".")[0] in ("builtins", "numpy", _PACKAGE)


@lru_cache
def _symbolic(model: RotorModel) -> Symbolic:
    theta = ca.SX.sym("theta", len(model.parameters))
    speed, eccentricity = ca.SX.sym("speed"), ca.SX.sym("eccentricity")
    p = SimpleNamespace(**{name: theta[i] for i, name in enumerate(model.parameter_names)})
    matrices = [Complex.matrix(m) for m in model.equation(p, speed, eccentricity)]
    if model.probes:
        matrices = with_probes(matrices, model.planes, model.probes)
    size = len(model.coordinates)
    for power, matrix in enumerate(matrices):
        if matrix.shape != (size, size):
            raise ValueError(
                f"{model.name}: coefficient of s^{power} has shape {matrix.shape}, "
                f"but {size} coordinates need ({size}, {size})"
            )
    return theta, speed, eccentricity, matrices, [Complex.of(f) for f in model.probe_factors(p)]


@lru_cache
def _compiled(model: RotorModel) -> CompiledModel:
    return CompiledModel(model.symbolic)
