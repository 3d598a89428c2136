"""Bearings and seals for the ROSS package, made of a fitted model."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import whole_file
from rotorfit.base.digits import significant
from rotorfit.lab.io.shafts.ross_rotor import SPEED_FROM, imported_ross, installed_ross, line_of
from rotorfit.models import RotorModel
from rotorfit.models.coefficient_tables import force_planes, plane_force

ElementKind: TypeAlias = Literal["bearing", "seal"]
"""Class of ROSS: BearingElement or SealElement."""

LEAST_SPEEDS = 5
"""Rows that a table of ROSS 2.x needs for its cubic splines to hold what is quadratic in speed."""

_SAME_SPEED = 1e-3
"""Relative distance up to which a speed is one that was tested, as in tables of coefficients."""
_LEAST_TESTED = 2
"""Rows between which there is something to interpolate."""

_CLASSES = {"bearing": "BearingElement", "seal": "SealElement"}
_AXES = (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1), ("yx", 1, 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class RossElement:
    """A bearing or seal of ROSS with what was fitted at one plane."""

    kind: str  # name of the class, ``BearingElement`` or ``SealElement``
    line: int  # line of ROSS that the arguments are for, 2 or 3: the other reads them as something else
    # of the class, by name: coefficients in N/m, N s/m and kg, speeds in rad/s, ``n`` and ``tag``
    arguments: Mapping[str, Any]
    # largest error of ROSS's interpolation between the speeds of the table, over the largest coefficient of its kind
    between: float

    def build(self) -> Any:
        """The element, an object of the ROSS package."""
        here = installed_ross()
        if here is None or line_of(here) != self.line:
            there = "not installed here" if here is None else f"of version {here} here"
            raise ValueError(
                f"the element is for ROSS {self.line}.x, and ROSS is {there}; its arguments go into "
                f"ross.{self.kind}(**element.arguments) there, or save it"
            )
        return getattr(imported_ross(), self.kind)(**self.arguments)

    def named(self, tag: str) -> RossElement:
        """The same with another tag."""
        return replace(self, arguments={**self.arguments, "tag": tag})

    def save(self, path: str | Path) -> None:
        """Write the element as ROSS's own ``element.save`` does; ``ross.BearingElement.load(path)`` reads it."""
        path = Path(path)
        name = f"{self.kind}_{self.arguments['tag']}"
        if path.suffix.lower() == ".json":
            text = json.dumps({name: self.arguments}, indent=2) + "\n"
        elif path.suffix.lower() == ".toml":
            rows = [f"{key} = {json.dumps(value)}" for key, value in self.arguments.items()]
            text = "\n".join([f"# {self}", f"[{json.dumps(name)}]", *rows, ""])
        else:
            raise ValueError(f"{path.name}: ROSS keeps elements as .toml or .json")
        with whole_file(path) as draft:
            draft.write_text(text, encoding="utf-8")

    def __str__(self) -> str:
        speeds = self.arguments.get("speed" if self.line >= SPEED_FROM else "frequency")
        other = f"{SPEED_FROM}.x or later" if self.line < SPEED_FROM else "2.x"
        table = (
            "the same at all speeds"
            if speeds is None
            else f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} rad/s; between them ROSS interpolates to "
            f"{significant(self.between, 1)}. Not for ROSS {other}, which reads the table as something else"
        )
        return f"{self.kind} {self.arguments['tag']} at node {self.arguments['n']}, for ROSS {self.line}.x: {table}"


def put_into(rotor: Any, elements: Mapping[str, RossElement]) -> Any:
    """A rotor of ROSS with elements in place of those of their tags, see
    :meth:`rotorfit.identify.fitting.result.FitResult.to_ross_rotor`."""
    if not hasattr(rotor, "bearing_elements"):
        raise TypeError(f"rotor must be a rotor of ROSS, ross.Rotor(...), not {type(rotor).__name__}")
    last = max(int(node) for node in rotor.nodes)
    for plane, element in elements.items():
        if not 0 <= element.arguments["n"] <= last:
            raise ValueError(f"{plane} is at node {element.arguments['n']}, the rotor has nodes 0 to {last} (nodes=)")
    built = [element.build() for element in elements.values()]
    kept = [element for element in rotor.bearing_elements if element.tag not in elements]
    return type(rotor)(
        rotor.shaft_elements,
        rotor.disk_elements,
        [*kept, *built],
        getattr(rotor, "point_mass_elements", None),
        **getattr(rotor, "parameters", {}),
        tag=rotor.tag,
    )


def ross_elements(
    model: RotorModel,
    values_at: Callable[[float], Float],
    speeds: ArrayLike,
    *,
    version: str | int | None,
    nodes: Mapping[str, int] | None,
    element: ElementKind,
    eccentricity: float,
) -> dict[str, RossElement]:
    """Elements by plane, see :meth:`rotorfit.identify.fitting.result.FitResult.to_ross`; values at rotative speeds."""
    at = np.unique(np.asarray(speeds, dtype=float).reshape(-1))
    if at.size < LEAST_SPEEDS or not np.isfinite(at).all() or at[0] < 0:
        raise ValueError(
            f"speeds must be at least {LEAST_SPEEDS} different ones from zero, rad/s, so that ROSS's interpolation "
            f"holds what is quadratic in speed; got {at.tolist()}"
        )
    forces = _forces(model, values_at, at, eccentricity)
    return _elements(model, at, forces, version, nodes, element)


def elements_of_speeds(
    model: RotorModel,
    values_at: Callable[[float], Float],
    speeds: Float,
    tested: Sequence[float],
    *,
    version: str | int | None,
    nodes: Mapping[str, int] | None,
    element: ElementKind,
    eccentricity: float,
) -> dict[str, RossElement]:
    """The same of values that were fitted speed by speed, at some of these. Where ROSS needs more rows for its splines,
    rows between are interpolated as later lines of ROSS do it, without overshoot."""
    from scipy.interpolate import PchipInterpolator

    known = np.asarray(tested)
    nearest = known[np.abs(known[:, None] - speeds.reshape(-1)).argmin(axis=0)]
    off = np.abs(nearest - speeds.reshape(-1)) > _SAME_SPEED * np.maximum(nearest, 1.0)
    if off.any() or nearest.size < _LEAST_TESTED:
        there = ", ".join(significant(v, 6) for v in known.tolist())
        raise ValueError(
            f"parameters were fitted speed by speed, at {there} rad/s: a table has rows at {_LEAST_TESTED} of these or "
            f"more; got {np.asarray(speeds).tolist()}"
        )
    at = np.unique(nearest)
    forces = _forces(model, values_at, at, eccentricity)
    while at.size < LEAST_SPEEDS and _line(version) < SPEED_FROM:
        more = np.sort(np.concatenate([at, (at[1:] + at[:-1]) / 2]))
        forces = {plane: PchipInterpolator(at, force)(more) for plane, force in forces.items()}
        at = more
    return _elements(model, at, forces, version, nodes, element)


def _forces(
    model: RotorModel, values_at: Callable[[float], Float], speeds: Float, eccentricity: float
) -> dict[str, Float]:
    """Real matrices of x and y by powers of s, shape ``(speeds, 3, 2, 2)``, by plane."""
    return {
        plane: np.array([plane_force(model, values_at(v), v, plane, eccentricity).values for v in speeds.tolist()])
        for plane in force_planes(model)
    }


def _line(version: str | int | None) -> int:
    """Line of ROSS that elements are for, by default the one that is installed."""
    given = installed_ross() if version is None else str(version)
    if given is None:
        raise ValueError("ROSS is not installed here: give the version that the element is for, version='2.3' or '3.1'")
    return line_of(given)


def _elements(
    model: RotorModel,
    at: Float,
    forces: dict[str, Float],
    version: str | int | None,
    nodes: Mapping[str, int] | None,
    element: ElementKind,
) -> dict[str, RossElement]:
    """Elements of forces at rotative speeds."""
    if element not in _CLASSES:
        raise ValueError(f"element is {element!r}; allowed: {', '.join(map(repr, _CLASSES))}")
    line = _line(version)
    forces = {plane: force for plane, force in forces.items() if force.any()}
    rotor = model.on_own_supports
    where = {**rotor.nodes, **(nodes or {})}
    if missing := [plane for plane in forces if plane not in where]:
        raise ValueError(
            f"nodes: say at which node of the ROSS rotor {', '.join(missing)} is, nodes={{{missing[0]!r}: 14}}"
        )
    return {plane: _element(plane, where[plane], at, force, line, _CLASSES[element]) for plane, force in forces.items()}


def _element(plane: str, node: int, speeds: Float, force: Float, line: int, kind: str) -> RossElement:
    columns = {
        f"{letter}{axes}": force[:, power, row, column]
        for power, letter in enumerate("kcm")
        for axes, row, column in _AXES
    }
    needed = {name: values for name, values in columns.items() if name in ("kxx", "cxx") or values.any()}
    varies = any(np.ptp(values) > 0 for values in columns.values())
    table: dict[str, Any] = {name: values.tolist() if varies else float(values[0]) for name, values in needed.items()}
    if varies:
        table["speed" if line >= SPEED_FROM else "frequency"] = speeds.tolist()
    return RossElement(
        kind=kind,
        line=line,
        arguments={"n": int(node), **table, "tag": plane},
        between=_between(force, speeds, line) if varies else 0.0,
    )


def _between(force: Float, speeds: Float, line: int) -> float:
    """Error of ROSS's interpolation halfway between two speeds, over the largest coefficient of its kind.

    What is fitted is a polynomial of low degree in speed: a cubic spline through all rows stands for it. ROSS 2.x
    smooths by cubics, which hold what is quadratic; from 3.0 on it interpolates by pchip, which does not.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator, UnivariateSpline

    halfway = (speeds[1:] + speeds[:-1]) / 2
    columns = force.reshape(speeds.size, -1)
    interpolated = PchipInterpolator if line >= SPEED_FROM else UnivariateSpline
    found = np.stack([interpolated(speeds, column)(halfway) for column in columns.T], axis=-1)
    error = np.abs(found - CubicSpline(speeds, columns)(halfway)).max(axis=0).reshape(3, -1).max(axis=-1)
    largest = np.abs(force).max(axis=(0, 2, 3))
    return float(np.max(error[largest > 0] / largest[largest > 0]))
