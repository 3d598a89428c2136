"""Modes of a fitted rotor with their errors, and half-power bandwidths of the data beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import interval, plus_minus, significant
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Tabled
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.causes.slopes import eigenvalue_slopes
from rotorfit.identify.fitting.causes.solution import shifted
from rotorfit.identify.fitting.propagation import propagated, theta_at
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import central_differences
from rotorfit.models import Modal, RotorModel, eigenvalues
from rotorfit.models.motion.modes import OVERDAMPED, VibrationMode, modal_assurance, vibration_modes
from rotorfit.models.motion.stability import eigenvalue_gradient, is_image, whirl_sense
from rotorfit.models.parameters import MATRIX_UNITS
from rotorfit.models.shafts.angular_rates import angular_rate

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, kw_only=True)
class Mode:
    """One mode of a fitted rotor."""

    # natural frequency, rad/s: undamped where ``mass`` is there, else damped, negative for backward whirl
    frequency: Quantity
    damping_ratio: Quantity  # share of critical damping
    # the same from the half-power bandwidth of the measured responses, median over these; NaN where none has the
    # peak with both sides
    half_power: float
    # deflection at each plane, one at that of the normalisation; its sign, or, of a rotor that is not passive,
    # its size, whose phase is ``phase``
    shape: Mapping[str, Quantity]
    # lead of each plane's motion in x + j y over that of the normalisation, rad; zero of a passive rotor
    phase: Mapping[str, Quantity]
    # mass, stiffness, damping: of the mode by itself (the paper's M_I, K_I, D_I), kg, N/m, N s/m; None for a
    # rotor that is not passive, whose modes have none of their own
    mass: Quantity | None
    stiffness: Quantity | None
    damping: Quantity | None

    @property
    def vector(self) -> ComplexArray:
        """Deflections as complex numbers, in the order of ``shape``, shape ``(n,)``."""
        size = np.array([q.value for q in self.shape.values()])
        return size * np.exp(1j * np.array([q.value for q in self.phase.values()]))

    def quantities(self) -> dict[str, Quantity]:
        """All that has an error, by name and unit."""
        found = {"frequency_rad_s": self.frequency, "damping_ratio": self.damping_ratio}
        own = {"mass_kg": self.mass, "stiffness_N_m": self.stiffness, "damping_N_s_m": self.damping}
        found |= {name: q for name, q in own.items() if q is not None}
        found |= {f"shape_{plane}": q for plane, q in self.shape.items()}
        return found if self.mass else found | {f"phase_{plane}_rad": q for plane, q in self.phase.items()}


@dataclass(frozen=True, eq=False, repr=False)
class Modes(ByValue, Tabled, Sequence[Mode]):
    """The modes of a fitted rotor at a speed, by natural frequency; ``print`` shows them as a table."""

    modes: tuple[Mode, ...]  # one after the other
    speed: float  # rotative speed, rad/s

    def __len__(self) -> int:
        return len(self.modes)

    def __getitem__(self, number: Any) -> Any:
        """Return one mode, or several, by number from zero."""
        return self.modes[number]

    def mac(self, shapes: Mapping[str, ArrayLike] | ArrayLike) -> Float:
        """Modal assurance criterion of each mode (rows) and each given shape (columns), 1 where they are alike.

        Args:
            shapes: deflections of each shape by plane, ``{"inboard": [1, 1], "outboard": [0.99, -0.94]}``; planes that
                are not named do not count. Or an array ``(planes, shapes)``, planes in the order of ``shape``.

        Raises:
            KeyError: a plane that the rotor has not.
            ValueError: planes with different numbers of shapes, or fewer than two planes.

        Example:
            >>> fit = rf.fit(rf.models.TwoDisk(), rf.datasets.two_disk())
            >>> fit.modes().mac({"inboard": [1, 1], "outboard": [0.99, -0.94]}).round(2).tolist()
            [[1.0, 0.0], [0.0, 1.0]]
        """
        names = list(self.modes[0].shape)
        given = shapes if isinstance(shapes, Mapping) else dict(zip(names, np.asarray(shapes), strict=True))
        for name in given:
            if name not in names:
                raise KeyError(unknown_name("plane of the rotor", name, names))
        columns = [np.atleast_1d(np.asarray(values, dtype=complex)) for values in given.values()]
        if len(columns) < 2 or len({column.shape for column in columns}) > 1:
            raise ValueError("a shape needs its deflections at two planes or more, as many at each plane")
        places = [names.index(name) for name in given]
        others = list(np.stack(columns, axis=1))
        return np.array([[modal_assurance(mode.vector[places], other) for other in others] for mode in self.modes])

    def rows(self) -> list[list[str]]:
        """The table as text, its head first."""
        planes = list(self.modes[0].shape) if self.modes else []
        parts = self.modes[0].mass is not None if self.modes else False
        head = ["mode", "frequency, rpm", "damping ratio", "half-power"]
        head += ["mass, kg", "stiffness, N/m", "damping, N s/m"] * parts
        rows = [[*head, *(f"at {plane}" for plane in planes)]]
        for number, mode in enumerate(self.modes, 1):
            own = [_said(mode.frequency, RPM_PER_RAD_S), _said(mode.damping_ratio)]
            row = [str(number), *(own if mode.damping_ratio.value < OVERDAMPED else ["overdamped", ""])]
            row.append(significant(mode.half_power, 3) if np.isfinite(mode.half_power) else "-")
            row += [_said(q) for q in (mode.mass, mode.stiffness, mode.damping) if q is not None]
            for plane in planes:
                shape, phase = mode.shape[plane], mode.phase[plane]
                turned = f" at {round(np.degrees(phase.value))} deg" if abs(phase.value) > 1e-9 else ""
                row.append((significant(shape.value, 4) if shape.stderr == 0 else _said(shape)) + turned)
            rows.append(row)
        return rows

    def numbers(self) -> list[list[Any]]:
        """The table in SI units, each number with its standard error, its head first."""
        names = list(self.modes[0].quantities()) if self.modes else []
        rows: list[list[Any]] = [["mode", "half_power", *(part for name in names for part in (name, f"{name}_stderr"))]]
        for number, mode in enumerate(self.modes, 1):
            own = mode.quantities().values()
            rows.append([number, mode.half_power, *(part for q in own for part in (q.value, q.stderr))])
        return rows

    def to_dataframe(self) -> DataFrame:
        """A row a mode, SI units, each number with its standard error and 95 % interval."""
        from pandas import DataFrame

        rows = []
        for number, mode in enumerate(self.modes, 1):
            row: dict[str, Any] = {"mode": number, "half_power": mode.half_power}
            for name, q in mode.quantities().items():
                low, high = q.interval()
                row |= {name: q.value, f"{name}_stderr": q.stderr, f"{name}_low": low, f"{name}_high": high}
            rows.append(row)
        return DataFrame(rows)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        rows = self.rows()
        return [Table(rows, ">4 " + ">8 " * (len(rows[0]) - 1))]


def _said(q: Quantity, factor: float = 1.0) -> str:
    return plus_minus(q.value * factor, q.stderr * factor)


class NaturalFrequency(NamedTuple):
    """A mode at a rotative speed: ``for frequency, damping, sense in ...``."""

    frequency: Quantity  # damped, rad/s, negative backward
    damping: Quantity  # damping ratio
    sense: str  # ``forward`` or ``backward``


class NaturalFrequencies(Tabled, tuple[NaturalFrequency, ...]):
    """The modes at a rotative speed, one after the other; ``print`` shows them as a table with 95 % intervals."""

    __slots__ = ()

    def to_dataframe(self) -> DataFrame:
        """A row a mode, SI units, with standard errors and 95 % intervals."""
        from pandas import DataFrame

        rows = []
        for mode in self:
            row: dict[str, Any] = {"sense": mode.sense}
            for name, q in (("frequency_rad_s", mode.frequency), ("damping_ratio", mode.damping)):
                low, high = q.interval()
                row |= {name: q.value, f"{name}_stderr": q.stderr, f"{name}_low": low, f"{name}_high": high}
            rows.append(row)
        return DataFrame(rows)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        rows = [["mode", "", "frequency, rpm", "95 % interval", "damping ratio", "95 % interval"]]
        for number, mode in enumerate(self, 1):
            both = (mode.frequency.to("rpm"), mode.damping) if mode.damping.value < OVERDAMPED else ()
            shown = [cell for q in both for cell in (_said(q), interval(*q.interval()))]
            rows.append([str(number), mode.sense, *(shown or ["overdamped", "", "", ""])])
        return [Table(rows, ">4 <8 >18 >22 >18 >22")]


def natural_frequencies(fit: FitResult, speed: float, at: Mapping[str, Any] | None) -> NaturalFrequencies:
    """Damped natural frequency (rad/s, signed) and damping ratio of each mode; see the result's method."""
    speed = angular_rate(speed)
    model, group = fit.model, fit.group(at)
    theta = theta_at(fit, group, speed)
    modes = []
    back = 1j * speed if model.turns else 0.0  # from turning coordinates
    for found in eigenvalues(model, theta, speed).tolist():
        if not np.isfinite(found) or abs(found) > fit.stability_band or is_image(model, theta, speed, found):
            continue
        s, by_theta, by_causes = _moved(fit, theta, speed, found)
        turn = -1.0 if model.frame == "xy" and whirl_sense(model, theta, speed, np.array([found]))[0] < 0 else 1.0
        w = turn * (s + back).imag
        frequency = propagated(
            fit, group, w, turn * by_theta.imag, "rad/s", speed=speed, by_causes=turn * by_causes.imag
        )
        damping = _damping_ratio(fit, group, speed, s + back, by_theta, by_causes)
        modes.append(NaturalFrequency(frequency, damping, "backward" if w < 0 else "forward"))
    return NaturalFrequencies(modes)


def _moved(fit: FitResult, theta: Float, speed: float, found: complex) -> tuple[complex, ComplexArray, ComplexArray]:
    """An eigenvalue with what causes add to it, and its derivatives by the parameters and by causes."""
    _, by_theta = eigenvalue_gradient(fit.model, theta, speed, found)
    solved = fit.settings.solved
    if solved is None:
        return found, by_theta, np.zeros(0, dtype=complex)
    by_causes = eigenvalue_slopes(fit.model, theta, speed, found, solved)
    return complex(found + by_causes @ solved.errors.value), by_theta, by_causes


def _damping_ratio(
    fit: FitResult, group: int, speed: float, s: complex, by_theta: ComplexArray, by_causes: ComplexArray
) -> Quantity:
    """Damping ratio of an eigenvalue with its error."""
    slope, beside = _damping_slope(s, by_theta), _damping_slope(s, by_causes)
    return propagated(fit, group, -s.real / abs(s), slope, "1", speed=speed, by_causes=beside)


def _damping_slope(s: complex, by: ComplexArray) -> Float:
    """Derivatives of the damping ratio ``-Re s / |s|`` of an eigenvalue by what it has the derivatives ``by``."""
    along = s / abs(s)
    return np.asarray((-by.real + along.real * (along.real * by.real + along.imag * by.imag)) / abs(s))


def modes_of(fit: FitResult, speed: float, normalise: str | None, at: Mapping[str, Any] | None) -> Modes:
    """See :meth:`FitResult.modes`."""
    speed, model, group = angular_rate(speed), fit.model, fit.group(at)
    if _are_parameters(model):
        raise ValueError(
            f"the modes of {model.name} are its parameters, see fit.params; fit.plot.mode_shapes() draws them"
        )
    theta = theta_at(fit, group, speed)
    names = [c.plane if c.axis == "z" else f"{c.plane}.{c.axis}" for c in model.coordinates]
    if normalise is not None and normalise not in names:
        raise KeyError(unknown_name("plane of the rotor", normalise, names))
    place = names.index(normalise) if normalise is not None else 0
    found = vibration_modes(model, theta, speed, normalised_at=place)
    slopes = _slopes(fit, theta, speed, place, found)
    curves = list(_measured(fit))
    back = speed if model.turns else 0.0  # from turning coordinates
    units = ("rad/s", "1", "kg", "N/m", "N s/m", *["1"] * len(names), *["rad"] * len(names))
    modes = []
    for mode, slope in zip(found, slopes, strict=True):
        if abs(mode.s) > fit.stability_band:
            continue
        by_causes = _by_causes(fit, theta, speed, mode)
        made = zip(_numbers(mode).tolist(), slope, units, strict=True)
        own = [
            propagated(fit, group, v + _shift(fit, by_causes, row), s, u, speed=speed, by_causes=by_causes.get(row))
            for row, (v, s, u) in enumerate(made)
        ]
        frequency = Quantity(own[0].value + back, own[0].stderr, own[0].unit, own[0].freedom)
        ratio, (mass, stiffness, damping) = own[1], (own[2:5] if np.isfinite(mode.mass) else (None, None, None))
        if mass is None:  # one of the eigenvalues that natural_frequencies prints
            s, *slopes_of_s = _moved(fit, theta, speed, _eigenvalue(fit, theta, speed, mode))
            ratio = _damping_ratio(fit, group, speed, s + 1j * back, *slopes_of_s)
        modes.append(
            Mode(
                frequency=frequency,
                damping_ratio=ratio,
                half_power=half_power(curves, frequency.value),
                shape=dict(zip(names, own[5 : 5 + len(names)], strict=True)),
                phase=dict(zip(names, own[5 + len(names) :], strict=True)),
                mass=mass,
                stiffness=stiffness,
                damping=damping,
            )
        )
    return Modes(tuple(modes), speed)


def _are_parameters(model: RotorModel) -> bool:
    """True if a model is written in modes, which are coordinates beside its planes."""
    return any(coordinate.plane not in model.planes for coordinate in model.coordinates)


def own_modes(fit: FitResult) -> Modes | None:
    """Modes of a passive rotor that rotation does not change, each with a mass of its own; None of other rotors."""
    model = fit.model
    if model.frame != "z" or model.shaft is not None or model.speed_dependent or len(fit.thetas) > 1:
        return None
    if _are_parameters(model):
        return None
    found = fit.modes() if len(model.coordinates) > 1 else ()
    return found if isinstance(found, Modes) and found and found[0].mass is not None else None


def _numbers(mode: VibrationMode) -> Float:
    """Frequency, damping ratio, mass, stiffness, damping, sizes and phases of the shape."""
    passive = np.isfinite(mode.mass)
    parts = (mode.mass, mode.stiffness, mode.damping) if passive else (0.0, 0.0, 0.0)
    sizes = mode.shape.real if passive else np.abs(mode.shape)
    turns = 0.0 * sizes if passive else np.angle(mode.shape)
    return np.concatenate([[mode.frequency, mode.damping_ratio, *parts], sizes, turns])


def _slopes(fit: FitResult, theta: Float, speed: float, place: int, modes: list[VibrationMode]) -> list[Float]:
    """Derivatives of a mode's numbers by the parameters, shape ``(numbers, P)``, by central differences; by those that
    are held too, whose values may be off."""
    found = [np.zeros((_numbers(mode).size, theta.size)) for mode in modes]
    relative = 1e-6  # relative step of central differences: errors of 1e-10 of smooth functions
    for i in range(theta.size):
        step = np.zeros(theta.size)
        step[i] = relative * (abs(theta[i]) or fit.model.parameters[i].scale)
        sides = [vibration_modes(fit.model, theta + sign * step, speed, normalised_at=place) for sign in (1, -1)]
        for mode, slope in zip(modes, found, strict=True):
            near = (min(side, key=lambda m: abs(m.s - mode.s)) for side in sides)
            ahead, behind = (_numbers(replace(m, turn=mode.turn)) for m in near)
            change = ahead - behind
            turns = slice(5 + mode.shape.size, None)
            change[turns] = (change[turns] + np.pi) % (2 * np.pi) - np.pi
            change[[5 + place, 5 + mode.shape.size + place]] = 0.0  # normalised there
            slope[:, i] = change / (2 * step[i])
    return found


def _by_causes(fit: FitResult, theta: Float, speed: float, mode: VibrationMode) -> dict[int, Float]:
    """Derivatives of some of a mode's numbers, by their places, by causes that act on the rotor beside its values."""
    if fit.settings.solved is None:
        return {}
    s = _eigenvalue(fit, theta, speed, mode)
    by = eigenvalue_slopes(fit.model, theta, speed, s, fit.settings.solved)
    if not np.isfinite(mode.mass):
        return {0: mode.turn * by.imag}
    ratio = _damping_slope(s, by)
    return {0: (np.conj(s) * by).real / abs(s), 1: ratio, 4: 2 * np.sqrt(mode.stiffness * mode.mass) * ratio}


def _eigenvalue(fit: FitResult, theta: Float, speed: float, mode: VibrationMode) -> complex:
    """The eigenvalue of a mode."""
    every = eigenvalues(fit.model, theta, speed)
    return complex(every[np.nanargmin(np.abs(every - mode.s))])


def _shift(fit: FitResult, by_causes: Mapping[int, Float], row: int) -> float:
    """What causes that were found add to a mode's number, by its place."""
    solved = fit.settings.solved
    return float(by_causes[row] @ solved.errors.value) if solved and row in by_causes else 0.0


def _measured(fit: FitResult) -> Iterator[tuple[Float, Float]]:
    """Signed frequencies, ascending, and sizes of each measured response per unit force, causes and all."""
    solved = fit.settings.solved
    problem = fit.problem if solved is None else shifted(fit.problem, [-part for part in solved.shift])
    for base in problem.responses:
        if base.imposed:
            continue
        drive = np.abs(base.force).max(axis=1)[base.line]
        w = base.frequency[base.line]
        for label in np.unique(base.label):
            for side in (w > 0, w < 0):
                rows = np.flatnonzero((base.label == label) & side & (drive > 0))
                rows = rows[np.argsort(w[rows])]
                if rows.size:
                    yield w[rows], np.abs(base.measured[rows]) / drive[rows]


def half_power(curves: Sequence[tuple[Float, Float]], frequency: float) -> float:
    """Damping ratio from where measured responses fall to half the power of their peak near a frequency, rad/s, median
    over the responses (frequencies, ascending, and sizes); NaN where none has a peak there with both of its sides."""
    found = []
    for w, size in curves:
        near = np.flatnonzero(np.abs(w - frequency) < 0.2 * abs(frequency))  # none of an overdamped mode
        if near.size < 3:
            continue
        peak = int(near[np.argmax(size[near])])
        level = size[peak] / np.sqrt(2)
        low = np.flatnonzero(size <= level)
        before, behind = low[low < peak], low[low > peak]
        if peak not in (near[0], near[-1]) and before.size and behind.size:
            # One over the power of a mode is a parabola of w^2: what is between the readings follows from it.
            part = slice(int(before[-1]), int(behind[0]) + 1)
            square, power = (w[part] / w[peak]) ** 2, (size[part] / size[peak]) ** 2
            curve, slope, offset = np.polyfit(square, 1 / power, 2, w=power**1.5)  # errors of 1/power go with that
            top = -slope / (2 * curve)
            least = offset + slope * top / 2
            if curve > 0 and least > 0 and top > 0:
                found.append(np.sqrt(least / curve) / (2 * top))
    return float(np.median(found)) if found else float("nan")


def two_disk_from_modes(fit: FitResult) -> dict[str, Quantity]:
    """Masses, stiffnesses and dampings of a two-disk rotor (eq. 19) from its two modes.

    With the mode shapes as columns, ``phi = [[1, 1], [phi1, phi2]]``, and modal masses, stiffnesses and dampings on
    diagonals, ``M = phi^-T M_m phi^-1`` and so for K and D (eq. 23). Shapes are those of the participations of forces.
    Damping that couples the modes is left out, as in the paper; the standard errors of D do not count that.

    Args:
        fit: of a ``Modal`` of two modes whose two planes, both forced, are the disks.

    Returns:
        ``M1, M2, K1, K2, K3, D11, D12, D21, D22`` of :class:`rotorfit.models.TwoDisk`, the off-diagonal mass ``M12``,
        which lumped disks do not have, and standard errors by the delta method.

    Raises:
        ValueError: another model, or modes of one shape.

    Example:
        >>> modes = rf.models.Modal(("inboard", "outboard"), modes=2, gains="plane")
        >>> disks = rf.two_disk_from_modes(rf.fit(modes, rf.datasets.two_disk()))
        >>> f"{disks['M1'].value:.2f} {disks['M1'].unit}"
        '0.73 kg'
    """
    model = fit.model
    if not isinstance(model, Modal) or model.modes != 2 or len(model.planes) != 2 or model.apart:
        raise ValueError("eq. (23) needs a fit of Modal with two modes at two planes, x and y not apart")
    if len(model.force_planes) != 2:
        raise ValueError("eq. (23) needs a participation of both planes: force both")
    theta = fit.thetas[0]
    values = disk_values(model, theta)
    step = 1e-6 * np.maximum(np.abs(theta), 1e-3)
    slopes = central_differences(lambda theta: list(disk_values(model, theta).values()), theta, step)
    pairs = zip(values.items(), slopes, strict=True)
    return {name: fit.propagate(value, slope, MATRIX_UNITS[name[0]]) for (name, value), slope in pairs}


def disk_values(model: Modal, theta: Float) -> dict[str, float]:
    """Entries of the two-disk rotor's matrices from the parameters of two modes, shape ``(P,)``."""
    p = dict(zip(model.parameter_names, theta.tolist(), strict=True))
    second = model.planes[1]
    shapes = np.array([[1.0, 1.0], [p[f"phi1_{second}"], p[f"phi2_{second}"]]])
    if abs(np.linalg.det(shapes)) < 1e-9 * np.abs(shapes).max():
        raise ValueError("the two modes have one shape: no two disks vibrate so")
    back = np.linalg.inv(shapes)
    mass, wn, zeta = (np.array([p[f"{letter}{i}"] for i in (1, 2)]) for letter in ("M", "wn", "zeta"))
    M, K, D = (back.T @ np.diag(modal) @ back for modal in (mass, mass * wn**2, 2 * mass * zeta * wn))
    return {
        "M1": float(M[0, 0]), "M2": float(M[1, 1]), "M12": float(M[0, 1]),
        "K1": float(K[0, 0] + K[0, 1]), "K2": float(-K[0, 1]), "K3": float(K[1, 1] + K[0, 1]),
        "D11": float(D[0, 0]), "D12": float(-D[0, 1]), "D21": float(-D[1, 0]), "D22": float(D[1, 1]),
    }  # fmt: skip
