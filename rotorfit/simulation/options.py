"""Options of simulated experiments and recordings: their names and types, and the refusal of others.

Each kind takes some of them; what they do is said at the function of the kind.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict

from numpy.typing import ArrayLike

from rotorfit.simulation.forcing import LineOrder


class ExperimentOptions(TypedDict, total=False):
    """What :func:`rotorfit.simulate` takes for one kind of experiment or another.

    Attributes:
        speed_rpm, frequency_rpm: rotative speeds; frequencies of the force or the imposed orbit, negative backward.
        force, unbalance: force, N, or m r, kg m, with its phase; several are levels of an amplitude sweep.
        planes: planes that are forced, all by default.
        order: in which a sweep goes through its frequencies.
        residual: unbalance of the rotor itself, kg m, by plane.
        amplitude_um: radius of an imposed orbit.
        load, load_plane, load_deg: constant load, N, where it acts, and its direction from x towards y.
        impulse, impulse_deg: momentum of a blow, N s, and its direction.
        plane: where a load, a blow or an orbit acts, by default at the journal.
        duration, sampling_hz: length of a record, s, and how often it is sampled.
    """

    speed_rpm: ArrayLike
    frequency_rpm: ArrayLike
    force: complex | Sequence[complex] | None
    unbalance: complex | Sequence[complex] | Mapping[str, float] | None
    planes: str | Sequence[str] | None
    order: LineOrder
    residual: Mapping[str, complex] | None
    amplitude_um: ArrayLike
    load: ArrayLike
    load_plane: str | None
    load_deg: float
    impulse: float
    impulse_deg: float
    plane: str | None
    duration: float | None
    sampling_hz: float | None


class RecordingOptions(TypedDict, total=False):
    """What :func:`rotorfit.simulate_recordings` takes for one kind of test or another.

    Attributes:
        speed_rpm: rotative speeds; first and last of a start-up.
        frequency_rpm: frequencies of dwells, one after the other.
        sweep_rpm: first and last frequency of a sweep.
        duration: of a sweep, a dwell or a record, s.
        unbalance: of the perturbator or of the calibration weight, kg m.
        force: amplitude of a measured force, N.
        planes, directions: where the rotor is forced, and how: ``forward``, ``backward``, or along ``x`` or ``y``.
        mark: whether the perturbator has a mark of its own.
        hole_zero_deg, hole_deg: place of the hole called zero, and places of the weight from there.
        reference: whether there is a run without a weight as well.
        impulse, blows, apart: momentum of a blow, N s, how many there are, and s between them.
        plane: where a load or a blow acts, by default at the journal.
        load, load_deg: constant load, N, and its direction from x towards y.
    """

    speed_rpm: ArrayLike
    frequency_rpm: ArrayLike
    sweep_rpm: tuple[float, float]
    duration: float
    unbalance: float
    force: float
    planes: str | Sequence[str] | None
    directions: Sequence[str]
    mark: bool
    hole_zero_deg: float
    hole_deg: Sequence[float]
    reference: bool
    impulse: float
    blows: int
    apart: float
    plane: str | None
    load: ArrayLike
    load_deg: float


def check_options(kind: str, options: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> None:
    """Refuse options that a kind of experiment does not have, or lacks.

    Args:
        kind: a key of ``kinds``.
        options: those given.
        kinds: functions of a virtual rig and their options.

    Raises:
        TypeError: names them and the kind's options.
    """
    allowed = {name: p for name, p in inspect.signature(kinds[kind]).parameters.items() if name != "rig"}
    unknown = [name for name in options if name not in allowed]
    missing = [name for name, p in allowed.items() if p.default is p.empty and name not in options]
    if unknown or missing:
        wrong = [f"does not know {', '.join(unknown)}"] * bool(unknown) + [f"needs {', '.join(missing)}"] * bool(
            missing
        )
        raise TypeError(f"simulation of kind {kind} {' and '.join(wrong)}; its options are {', '.join(allowed)}")
