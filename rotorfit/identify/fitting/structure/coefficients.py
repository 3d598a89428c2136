"""Coefficients of a fitted bearing or seal, with their errors by the fit's covariance; stiffness and damping frequency
by frequency as measured, beside them.

``K(w) + jw C(w)`` is the measured dynamic stiffness less that of the rig. Constant coefficients make ``K - w^2 M`` and
C of it; what leaves their band changes with frequency, as gas seals do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import whole_file
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Tabled, text_table
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.identify.fitting.propagation import by_values_of_causes, covariance_of, propagated, theta_at
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.rows import in_words
from rotorfit.lab.io.tables.result_tables import frame_csv
from rotorfit.models.coefficient_tables import COEFFICIENTS, force_planes, plane_force
from rotorfit.models.shafts.angular_rates import angular_rate

if TYPE_CHECKING:
    from pandas import DataFrame


UNITS = {"K": "N/m", "C": "N s/m", "M": "kg"}


def central_differences(function: Callable[[Float], Any], at: Float, step: Float) -> Float:
    """Derivatives of a function of a vector by its entries, in their steps, shape ``(..., n)``."""
    ways = [np.subtract(function(at + own), function(at - own)) for own in np.diag(step)]
    return np.stack(ways, axis=-1) / (2 * step)


class Tabulated:
    """A result with a table."""

    def to_dataframe(self) -> DataFrame:
        """The table."""
        raise NotImplementedError

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV to the file ``path``."""
        with whole_file(Path(path)) as draft:
            draft.write_text(frame_csv(self.to_dataframe()), encoding="utf-8")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Coefficients(ByValue):
    """Stiffness, damping and inertia of the force at a plane at one speed: see :meth:`FitResult.coefficients`.

    ``F = K r + C r' + M r''`` with r = (x, y), F what the rotor exerts on the fluid; positive Kxy and negative Kyx
    drive forward whirl.

    Attributes:
        speed: rotative speed, rad/s.
        condition: the speed in words, after what else parameters were fitted per: ``pressure_bar=5, 3000 rpm``.
        group: number of the parameter group.
        plane: name of the plane.
        values: Kxx, Kxy, Kyx, Kyy, Cxx, ... Myy, SI units, shape ``(12,)``.
        covariance: of these, shape ``(12, 12)``; infinite on the diagonal where the data do not determine one.
        by_name: each with its standard error.
        propagated: the error of a quantity from its value, its slopes by ``values`` and its unit.
    """

    speed: float
    condition: str
    group: int
    plane: str
    values: Float
    covariance: Float
    by_name: Mapping[str, Quantity]
    propagated: Callable[[float, Float, str], Quantity] = field(compare=False)

    def __getitem__(self, name: str) -> Quantity:
        if name not in self.by_name:
            raise KeyError(unknown_name("coefficient", name, COEFFICIENTS))
        return self.by_name[name]

    @cached_property
    def correlation(self) -> Float:
        """Correlations of the coefficients, zero beside one that is known, shape ``(12, 12)``."""
        size = np.sqrt(np.diag(self.covariance))
        scale = np.outer(size, size)
        found = np.divide(self.covariance, scale, out=np.zeros_like(scale), where=(scale > 0) & np.isfinite(scale))
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

    @property
    def whirl_frequency_ratio(self) -> Quantity:
        """Whirl frequency over speed at which the force alone would let a mass whirl, by Lund's formula.

        ``k = (Kxx Cyy + Kyy Cxx - Cyx Kxy - Cxy Kyx) / (Cxx + Cyy)``, its square over the speed's being ``((k - Kxx)
        (k - Kyy) - Kxy Kyx) / (Cxx Cyy - Cxy Cyx)``; Kxy / (Cxx Om) of an isotropic force without inertia. NaN where
        the square is negative (no whirl) and at standstill.
        """

        def ratio(v: Float) -> float:
            (kxx, kxy, kyx, kyy), (cxx, cxy, cyx, cyy) = v[:4], v[4:8]
            determinant = cxx * cyy - cxy * cyx
            if not (cxx + cyy and determinant and self.speed):
                return math.nan
            k = (kxx * cyy + kyy * cxx - cyx * kxy - cxy * kyx) / (cxx + cyy)
            square = ((k - kxx) * (k - kyy) - kxy * kyx) / determinant / self.speed**2
            return math.sqrt(square) if square >= 0 else math.nan

        return self._of(ratio, "1")

    def effective_stiffness(self, frequency: float) -> Quantity:
        """Stiffness that whirl meets, N/m: Re of the dynamic stiffness at ``frequency``, rad/s, signed."""
        w = frequency
        return self._of(lambda v: float((v[0] + v[3]) + w * (v[5] - v[6]) - w**2 * (v[8] + v[11])) / 2, "N/m")

    def effective_damping(self, frequency: float) -> Quantity:
        """Damping that whirl meets, N s/m: Im of the dynamic stiffness over ``frequency``, rad/s, signed.

        Raises:
            ValueError: a frequency of zero.
        """
        w = frequency
        if w == 0:
            raise ValueError("effective damping is that of whirl at a frequency; at zero there is none")
        return self._of(lambda v: float((v[4] + v[7]) - (v[1] - v[2]) / w + w * (v[9] - v[10])) / 2, "N s/m")

    def _of(self, function: Callable[[Float], float], unit: str) -> Quantity:
        """A quantity of the coefficients; its slopes by central differences, exact for what is at most quadratic."""
        value = function(self.values)
        if not math.isfinite(value):
            return Quantity(math.nan, math.nan, unit)
        step = 1e-6 * np.repeat([np.abs(self.values[k : k + 4]).max() or 1.0 for k in (0, 4, 8)], 4)
        return self.propagated(value, central_differences(function, self.values, step), unit)

    def __repr__(self) -> str:
        return f"<Coefficients at {self.plane}, {significant(self.speed * RPM_PER_RAD_S, 4)} rpm>"

    def __str__(self) -> str:
        return str(CoefficientRows((self,)))


@dataclass(frozen=True, eq=False, repr=False)
class CoefficientRows(ByValue, Tabled, Tabulated):
    """Coefficients at several speeds: see :meth:`FitResult.coefficient_table`.

    Attributes:
        rows: one a speed.
    """

    rows: tuple[Coefficients, ...]

    def to_dataframe(self) -> DataFrame:
        """A row a condition: ``speed_rpm``, coefficients in SI units, ``<name>_stderr``, ``whirl_frequency_ratio``."""
        from pandas import DataFrame

        table = []
        for row in self.rows:
            speed = round(row.speed * RPM_PER_RAD_S, 6)
            columns: dict[str, Any] = {"plane": row.plane, "condition": row.condition, "speed_rpm": speed}
            for name, own in [*row.by_name.items(), ("whirl_frequency_ratio", row.whirl_frequency_ratio)]:
                columns |= {name: own.value, f"{name}_stderr": own.stderr}
            table.append(columns)
        return DataFrame(table)

    def for_ross(self) -> DataFrame:
        """The table as ROSS calls its columns, for ``BearingElement(n=..., kxx=...)`` or, in a sheet of Excel, for
        ``BearingElement.from_table``: ``speed`` in rad/s, ``kxx`` to ``myy`` in SI units, the condition of each row."""
        from pandas import DataFrame

        entries = {name.lower(): [row[name].value for row in self.rows] for name in COEFFICIENTS}
        own = {"speed": [row.speed for row in self.rows], **entries, "condition": [row.condition for row in self.rows]}
        return DataFrame({**own, "plane": [row.plane for row in self.rows]})

    def by_condition(self, conditions: Sequence[str]) -> list[list[list[str]]]:
        """Tables of stiffness, damping and inertia, a line a condition, and the whirl frequency ratio where there is
        most room.

        Args:
            conditions: their names, one a row.
        """
        ratios = ["WFR", *(_shown(row.whirl_frequency_ratio) for row in self.rows)]
        parts = []
        for letter, own in UNITS.items():
            names = [f"{letter}{entry}" for entry in ENTRIES]
            largest = max(abs(row[name].value) for row in self.rows for name in names)
            unit = f"M{own}" if letter == "K" and largest >= 1e6 else own
            table = [["", *(f"{name}, {unit}" for name in names)]]
            for row, condition in zip(self.rows, conditions, strict=True):
                table.append([condition, *(_shown(row[name].to(unit)) for name in names)])
            parts.append(table)
        narrowest = min(parts, key=lambda table: max(sum(map(len, cells)) for cells in table))
        for cells, ratio in zip(narrowest, ratios, strict=True):
            cells.append(ratio)
        return parts

    def parts(self) -> list[str | Table]:
        """What is printed: one column a speed."""
        lines = [["", *[row.condition for row in self.rows], ""]]
        for name in COEFFICIENTS:
            if any(row[name].value or row[name].stderr for row in self.rows):
                lines.append([name, *[_shown(row[name]) for row in self.rows], UNITS[name[0]]])
        lines.append(["whirl frequency ratio", *[_shown(row.whirl_frequency_ratio) for row in self.rows], "1"])
        return [Table(lines, "<22" + " >22" * len(self.rows) + "  <6")]


def _shown(found: Quantity) -> str:
    if math.isnan(found.value):
        return "none"
    if found.stderr == 0:
        return f"{found.value:.6g} known"
    return found.shown().number


def coefficients_of(
    fit: FitResult, speed: float, plane: str | None, at: Mapping[str, Any] | None, eccentricity: float
) -> Coefficients:
    """See :meth:`FitResult.coefficients`."""
    speed = angular_rate(speed)
    planes = force_planes(fit.model)
    if plane is None and len(planes) > 1:
        raise ValueError(f"{fit.model.name} has forces at {', '.join(planes)}: say at which, plane={planes[0]!r}")
    where = plane or planes[0]
    group = fit.group(_at_speed(fit, speed) if at is None else at)
    force = plane_force(fit.model, theta_at(fit, group, speed), speed, where, eccentricity)
    values, slopes = force.values.reshape(-1), force.slopes.reshape(len(COEFFICIENTS), -1)

    made = partial(_made, fit, group, slopes, speed)
    columns = zip(COEFFICIENTS, values.tolist(), np.eye(values.size), strict=True)
    by_name = {name: made(value, unit, UNITS[name[0]]) for name, value, unit in columns}
    pulled = np.array([fit.problem.space.pull_back(row, group) for row in slopes])
    covariance = covariance_of(fit, pulled, by_values_of_causes(fit, slopes, group, speed))
    for place, name in enumerate(COEFFICIENTS):
        if not math.isfinite(by_name[name].stderr):
            covariance[place, place] = by_name[name].stderr
    return Coefficients(
        speed=speed,
        condition=_condition(fit, group, speed),
        group=group,
        plane=where,
        values=values,
        covariance=covariance,
        by_name=by_name,
        propagated=made,
    )


def _made(
    fit: FitResult, group: int, slopes: Float, speed: float, value: float, by_values: Float, unit: str
) -> Quantity:
    """A quantity of the coefficients, of which ``slopes`` are the derivatives by the parameters."""
    return propagated(fit, group, value, by_values @ slopes, unit, speed=speed)


def _at_speed(fit: FitResult, speed: float) -> Mapping[str, Any] | None:
    """The group of a speed where parameters were fitted speed by speed."""
    if set(fit.settings.per.values()) != {"speed_rpm"}:
        return None
    rpm = speed * RPM_PER_RAD_S
    tested = fit.speeds * RPM_PER_RAD_S
    nearest = float(tested[np.argmin(np.abs(tested - rpm))])
    if abs(nearest - rpm) > 1e-3 * max(abs(nearest), 1.0):
        there = ", ".join(significant(value, 5) for value in tested.tolist())
        raise ValueError(
            f"parameters were fitted speed by speed, at {there} rpm; {significant(rpm, 5)} rpm is none of them"
        )
    return {"speed_rpm": float(np.round(nearest, 6))}


def _is_speed(fit: FitResult, name: str) -> bool:
    """True of the speed among attributes, and of a column that holds the speed that was meant."""
    if name == "speed_rpm":
        return True
    nominal = 0.02  # share by which a speed may be off the one that was meant
    pairs = [(test.attribute(name), test.set_speed * RPM_PER_RAD_S) for test in fit.experiments]
    return all(own.dtype.kind in "fi" and np.allclose(own, speed, rtol=nominal, atol=0) for own, speed in pairs)


def _condition(fit: FitResult, group: int, speed: float) -> str:
    """Name of a condition: the speed, after what else parameters were fitted per."""
    words: list[str] = []
    for label in fit.problem.space.labels[group]:  # such as speed_rpm+pressure_bar=3000+2
        names, _, values = label.partition("=")
        pairs = list(zip(names.split("+"), values.split("+"), strict=False))
        whole = len(pairs) < values.count("+") + 1
        words += [label] if whole else [f"{name}={value}" for name, value in pairs if not _is_speed(fit, name)]
    return ", ".join([*dict.fromkeys(words), f"{significant(speed * RPM_PER_RAD_S, 5)} rpm"])


def of_a_rig(fit: FitResult) -> bool:
    """True if a fit is of a seal or bearing alone, its rig taken out or left to the coefficients."""
    rig = fit.settings.baseline is not None or fit.settings.stator_mass_kg is not None
    if not (fit.success and fit.speeds.size and (rig or (fit.model.force_alone and fit.model.shaft is None))):
        return False
    return len(force_planes(fit.model)) == 1


def coefficient_rows(fit: FitResult, speeds: Sequence[float] | None, plane: str | None) -> CoefficientRows:
    """See :meth:`FitResult.coefficient_table`."""
    by_speed = len(fit.thetas) == 1 or set(fit.settings.per.values()) == {"speed_rpm"}
    if by_speed:
        wanted: list[tuple[float, Mapping[str, Any] | None]] = [
            (speed, None) for speed in (fit.speeds.tolist() if speeds is None else speeds)
        ]
    else:
        tested = (zip(b.group.tolist(), b.set_speed.tolist(), strict=True) for b in fit.problem.responses)
        pairs = {(group, round(speed, 9)) for own in tested for group, speed in own}
        pairs = pairs if speeds is None else {(group, speed) for group, _ in pairs for speed in speeds}
        labels = fit.problem.space.labels
        wanted = [(speed, dict(one.split("=", 1) for one in labels[group])) for group, speed in sorted(pairs)]
    return CoefficientRows(tuple(coefficients_of(fit, speed, plane, at, 0.0) for speed, at in wanted))


def groups_by_speed(fit: FitResult, at: Mapping[str, Any] | None) -> dict[float, int]:
    """Number of the parameter group of each set speed, rad/s, of parameters fitted speed by speed, of those groups that
    have the values ``at``; empty where one group holds at every speed.

    Raises:
        ValueError: several groups of one speed.
    """
    wanted = {name: in_words(value) for name, value in (at or {}).items()}
    found: dict[float, set[int]] = {}
    for block in fit.problem.responses:
        for group, speed in zip(block.group.tolist(), block.set_speed.tolist(), strict=True):
            if wanted.items() <= _settings(fit, group).items():
                found.setdefault(round(speed, 6), set()).add(group)
    if len(set().union(*found.values())) < 2:
        return {}
    if several := [groups for groups in found.values() if len(groups) > 1]:
        first, other = (_settings(fit, group) for group in sorted(several[0])[:2])
        differing = next(name for name in first if first[name] != other.get(name))
        raise ValueError(
            f"parameters were fitted per {differing} too: say of which the table is, at={{{differing!r}: "
            f"{first[differing]}}}"
        )
    return {speed: groups.pop() for speed, groups in sorted(found.items())}


def _settings(fit: FitResult, group: int) -> dict[str, str]:
    """Values of the attributes that a group of parameters was fitted per."""
    found: dict[str, str] = {}
    for label in fit.problem.space.labels[group]:  # such as speed_rpm+pressure_bar=3000+2
        names, _, values = label.partition("=")
        found |= dict(zip(names.split("+"), values.split("+"), strict=False))
    return found


def lines_by_condition(fit: FitResult) -> list[str]:
    """Coefficients of a seal or bearing alone in several conditions, which are the parameters of the fit; else none."""
    if len(fit.thetas) == 1 or fit.model.frame == "z" or not of_a_rig(fit):
        return []
    found = fit.coefficient_table()
    labels = [fit.problem.space.labels[row.group] for row in found.rows]
    heads = {own[0].partition("=")[0] for own in labels if own}
    if len(heads) != 1 or {len(own) for own in labels} != {1}:
        return _lines(found.by_condition([row.condition for row in found.rows]))
    return [f"by {heads.pop()}", *_lines(found.by_condition([own[0].partition("=")[2] for own in labels]))]


def _lines(tables: Sequence[Sequence[Sequence[str]]]) -> list[str]:
    return [line for table in tables for line in text_table(table, "<10" + " >14" * (len(table[0]) - 1))]


# ---- frequency by frequency ------------------------------------------------------------------------------------------


ENTRIES = ("xx", "xy", "yx", "yy")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyCoefficients:
    """Stiffness and damping against frequency in one condition; entries xx, xy, yx, yy along the first axis."""

    condition: str  # its name
    frequency: Float  # rad/s, shape ``(L,)``
    stiffness: Float  # stiffness, damping: as measured, N/m and N s/m, shape ``(4, L)``
    damping: Float
    stiffness_stderr: Float  # stiffness_stderr, damping_stderr: from the noise of readings, forces and dry run
    damping_stderr: Float
    fitted_stiffness: Float  # fitted_stiffness, fitted_damping: by the fitted coefficients, ``K - w^2 M`` and C
    fitted_damping: Float
    fitted_stiffness_stderr: Float  # fitted_stiffness_stderr, fitted_damping_stderr: their standard errors
    fitted_damping_stderr: Float


@dataclass(frozen=True, eq=False)
class FrequencyRows(ByValue, Tabulated):
    """Stiffness and damping against frequency of all conditions: see :meth:`FitResult.frequency_coefficients`."""

    rows: tuple[FrequencyCoefficients, ...]  # one a condition

    def to_dataframe(self) -> DataFrame:
        """A row for each condition and frequency, SI units, ``frequency_hz``."""
        from pandas import DataFrame, concat

        tables = []
        for row in self.rows:
            columns: dict[str, object] = {"condition": row.condition, "frequency_hz": row.frequency / (2 * np.pi)}
            for letter, kind in (("K", "stiffness"), ("C", "damping")):
                for (number, entry), prefix in product(enumerate(ENTRIES), ("", "fitted_")):
                    name = f"{prefix}{letter}{entry}"
                    columns[name] = getattr(row, f"{prefix}{kind}")[number]
                    columns[f"{name}_stderr"] = getattr(row, f"{prefix}{kind}_stderr")[number]
            tables.append(DataFrame(columns))
        return concat(tables, ignore_index=True)


def frequency_coefficients_of(fit: FitResult, speeds: Sequence[float] | None) -> FrequencyRows:
    """See :meth:`FitResult.frequency_coefficients`."""
    if not of_a_rig(fit) or fit.model.frame == "z" or len(fit.model.coordinates) != 2:
        raise ValueError(
            "stiffness and damping against frequency are those of a seal or bearing alone, forced and read along x and "
            f"y: fit Anisotropic of one plane, with the rig taken out (baseline, stator_mass_kg); not {fit.model.name}"
        )
    found = []
    for at in coefficient_rows(fit, speeds, None).rows:
        for block in fit.problem.responses:
            whole = stiffness_matrices(block)
            mine = np.abs(whole.speed - at.speed) <= 1e-3 * max(at.speed, 1.0)
            mine &= block.group[whole.first_line] == at.group
            w = whole.frequency[mine]
            if not w.size:
                continue
            beside = 0.0 if block.beside is None else block.beside[whole.first_line[mine]]
            kappa = (whole.kappa[mine] - beside).reshape(-1, 4).T
            sigma = whole.sigma[mine].reshape(-1, 4).T
            slopes = np.zeros((4, w.size, 12))
            for entry in range(4):
                slopes[entry, :, entry] = 1.0
                slopes[entry, :, 8 + entry] = -(w**2)
            found.append(
                FrequencyCoefficients(
                    condition=at.condition,
                    frequency=w,
                    stiffness=kappa.real,
                    damping=kappa.imag / w,
                    stiffness_stderr=sigma,
                    damping_stderr=sigma / w,
                    fitted_stiffness=slopes @ at.values,
                    fitted_stiffness_stderr=standard_error(slopes, at.covariance),
                    fitted_damping=np.repeat(at.values[4:8, None], w.size, axis=1),
                    fitted_damping_stderr=np.repeat(np.sqrt(np.diag(at.covariance)[4:8])[:, None], w.size, axis=1),
                )
            )
    if not found:
        raise ValueError(
            "no line was forced and read along both axes, or forward and backward, so that its stiffness cannot be "
            "measured by itself; force both ways at the same frequencies and speeds"
        )
    return FrequencyRows(tuple(found))


def measured_by_frequency(fit: FitResult) -> bool:
    """True if some line was forced and read along both axes, so that it has a stiffness of its own."""
    return any(stiffness_matrices(block).frequency.size for block in fit.problem.responses)
