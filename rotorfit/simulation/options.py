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
    """Options of :func:`rotorfit.simulate` for one kind of experiment or another."""

    speed_rpm: ArrayLike  # rotative speeds
    frequency_rpm: ArrayLike  # frequencies of the force or the imposed orbit, negative backward
    force: complex | Sequence[complex] | None  # N, with its phase
    unbalance: complex | Sequence[complex] | Mapping[str, float] | None  # m r, kg m, with its phase
    planes: str | Sequence[str] | None  # planes that are forced, all by default
    order: LineOrder  # in which a sweep goes through its frequencies
    kept: bool  # whether trial weights stay in, after a run without one, in place of weights at 0 and 180 degrees
    residual: Mapping[str, complex] | None  # unbalance of the rotor itself, kg m, by plane
    amplitude_um: ArrayLike  # radius of an imposed orbit
    load: ArrayLike  # constant load, N
    load_plane: str | None  # where it acts
    load_deg: float  # its direction from x towards y
    impulse: float  # momentum of a blow, N s
    impulse_deg: float  # its direction from x towards y
    plane: str | None  # where a load, a blow or an orbit acts, by default at the journal
    duration: float | None  # length of a record, s
    sampling_hz: float | None  # how often it is sampled


class RecordingOptions(TypedDict, total=False):
    """Options of :func:`rotorfit.simulate_recordings` for one kind of test or another."""

    speed_rpm: ArrayLike  # rotative speeds; first and last of a start-up
    frequency_rpm: ArrayLike  # frequencies of dwells, one after the other
    sweep_rpm: tuple[float, float]  # first and last frequency of a sweep
    duration: float  # of a sweep, a dwell or a record, s
    unbalance: float  # of the perturbator or of the calibration weight, kg m
    force: float  # amplitude of a measured force, N
    planes: str | Sequence[str] | None  # where the rotor is forced
    directions: Sequence[str]  # how it is forced: ``forward``, ``backward``, or along ``x`` or ``y``
    mark: bool  # whether the perturbator has a mark of its own
    hole_zero_deg: float  # place of the hole called zero
    hole_deg: Sequence[float]  # places of the weight from there
    reference: bool  # whether there is a run without a weight as well
    impulse: float  # momentum of a blow, N s
    blows: int  # how many there are
    apart: float  # s between them
    plane: str | None  # where a load or a blow acts, by default at the journal
    load: ArrayLike  # constant load, N
    load_deg: float  # its direction from x towards y


def check_options(kind: str, options: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> None:
    """Refuse options that a kind of experiment does not have, or lacks."""
    allowed = {name: p for name, p in inspect.signature(kinds[kind]).parameters.items() if name != "rig"}
    unknown = [name for name in options if name not in allowed]
    missing = [name for name, p in allowed.items() if p.default is p.empty and name not in options]
    if unknown or missing:
        wrong = [f"does not know {', '.join(unknown)}"] * bool(unknown) + [f"needs {', '.join(missing)}"] * bool(
            missing
        )
        raise TypeError(f"simulation of kind {kind} {' and '.join(wrong)}; its options are {', '.join(allowed)}")
