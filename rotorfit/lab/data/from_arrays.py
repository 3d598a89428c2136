"""Perturbation tests from arrays and numbers, as scripts have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Records, Text
from rotorfit.base.units import in_rad_s
from rotorfit.lab.data.experiments import PerturbationTest, records


def perturbation_test(
    *,
    run: Sequence[str] | Text,
    speed: Any = None,
    frequency: Any = None,
    force_plane: Sequence[str] | Text,
    force: Any,
    plane: Sequence[str] | Text,
    direction: Sequence[str] | Text,
    response: Any,
    sigma: Any = np.nan,
    force_direction: str | Sequence[str] | Text = "circular",
    speed_rpm: Any = None,
    frequency_rpm: Any = None,
    frequency_hz: Any = None,
    force_angle: Any = None,
    further_forces: Sequence[tuple[tuple[Any, ...], ...]] | Records = (),
    attributes: Mapping[str, Any] | None = None,
    source: str = "",
) -> PerturbationTest:
    """Build a :class:`PerturbationTest` from arrays or scalars, scalars spread over all rows.

    A reading under several forces at once is written once for each: rows that agree in run, speed, frequency, plane,
    direction and response, with different planes of the force.

    Args:
        run, speed, frequency, force_plane, force, plane, direction, response, sigma, force_direction: SI units, shape
            ``(R,)`` or scalar, see :class:`PerturbationTest`.
        speed_rpm, frequency_rpm, frequency_hz: speed and frequency in other units.
        force_angle: angles at which circular forces point at t = 0, from x towards y, forward and backward alike, rad;
            ``force`` is then their size. It goes with readings z: ``z = H(w) F exp(j force_angle)`` at signed w. Left
            out, ``force`` is ``F exp(j delta)`` of eq. (2), whose delta is minus that angle where w < 0.
        further_forces: pairs (plane, N), or (plane, N, direction), of each row, in place of rows written once for each
            force; without a direction it is that of ``force``.
        attributes: further columns by name.
        source: where the data came from, for messages.

    Raises:
        ValueError: columns of unequal length, an unknown direction, or a reading that contradicts itself.

    Example:
        >>> test = rf.perturbation_test(
        ...     run="fwd", speed=150.0, frequency=[40.0, 80.0], force_plane="journal", force=5.0,
        ...     plane="journal", direction="z", response=[2e-4 - 1e-4j, 1e-4 - 1e-4j], sigma=1e-7,
        ... )
        >>> len(test), test.planes
        (2, ('journal',))
    """
    speed = in_rad_s("speed", speed, rpm=speed_rpm)
    frequency = in_rad_s("frequency", frequency, rpm=frequency_rpm, hz=frequency_hz)
    given = {
        "run": (run, str),
        "speed": (speed, float),
        "frequency": (frequency, float),
        "force_plane": (force_plane, str),
        "force": (force, complex),
        "plane": (plane, str),
        "direction": (direction, str),
        "response": (response, complex),
        "sigma": (sigma, float),
        "force_direction": (force_direction, str),
    }
    if force_angle is not None:
        given["force"] = (_phasor(force, force_angle, frequency, force_direction), complex)
    columns = {name: _column(name, values, kind) for name, (values, kind) in given.items()}
    lengths = {name: column.shape for name, column in columns.items() if column.size != 1}
    if len(set(lengths.values())) > 1 or any(len(shape) > 1 for shape in lengths.values()):
        listed = ", ".join(f"{name} {' x '.join(map(str, shape))}" for name, shape in lengths.items())
        raise ValueError(f"{source or 'the test'}: columns must be single values or lists of one length; got {listed}")
    shape = np.broadcast_shapes((1,), *[column.shape for column in columns.values()])
    spread: dict[str, Any] = {name: np.broadcast_to(column, shape).copy() for name, column in columns.items()}
    from rotorfit.lab.data.several_forces import gathered

    rows = zip(further_forces, spread["force_direction"].tolist(), strict=True) if len(further_forces) else ()
    further = records(tuple((at, F, *(rest or [axis])) for at, F, *rest in acting) for acting, axis in rows)
    test = PerturbationTest(
        **spread,
        attributes={name: np.broadcast_to(np.asarray(v), shape).copy() for name, v in (attributes or {}).items()},
        source=source,
        further_forces=further,
    )
    return test if len(further_forces) else gathered(test)


def _phasor(size: Any, angle: Any, frequency: Any, along: Any) -> ComplexArray:
    """``F exp(j delta)`` of forces that point at an angle at t = 0."""
    if np.any(np.asarray(along) != "circular"):
        raise ValueError("force_angle is the angle of a circular force; along an axis give the phasor as force")
    if np.iscomplexobj(size):
        raise ValueError("force_angle goes with the size of the force; force is complex and has an angle already")
    turn = np.where(np.asarray(frequency, dtype=float) < 0, -1j, 1j)
    return np.asarray(np.asarray(size, dtype=float) * np.exp(turn * np.asarray(angle, dtype=float)))


def _column(name: str, values: Any, kind: type) -> NDArray[Any]:
    try:
        return np.asarray(values, dtype=kind)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} must be numbers in SI units, one for each reading: {error}") from error
