"""Simulate experiments on a virtual rig, by integration of the nonlinear equation of motion in time."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.chance import Seed, chance
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S, in_rad_s
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import RingDownTest
from rotorfit.lab.kinds.static_test import StaticTest
from rotorfit.lab.simulation import forcing
from rotorfit.lab.simulation.rig import VirtualRig
from rotorfit.models import RotorModel


class ExperimentOptions(TypedDict, total=False):
    """Options of :func:`rotorfit.simulate` for one kind of experiment or another."""

    speed_rpm: ArrayLike  # rotative speeds
    speed: ArrayLike  # the same in rad/s
    frequency_rpm: ArrayLike  # frequencies of the force or the imposed orbit, negative backward
    frequency: ArrayLike  # the same in rad/s
    frequency_hz: ArrayLike  # the same in Hz
    force: complex | Sequence[complex] | None  # N, with its phase
    unbalance: complex | Sequence[complex] | Mapping[str, float] | None  # m r, kg m, with its phase
    planes: str | Sequence[str] | None  # planes that are forced, all by default
    order: forcing.LineOrder  # in which a sweep goes through its frequencies
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
    speed: ArrayLike  # the same in rad/s
    frequency_rpm: ArrayLike  # frequencies of dwells, one after the other
    frequency: ArrayLike  # the same in rad/s
    frequency_hz: ArrayLike  # the same in Hz
    sweep_rpm: tuple[float, float]  # first and last frequency of a sweep
    sweep_hz: tuple[float, float]  # the same in Hz
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


def options_of(kind: str, kinds: Mapping[str, Callable[..., Any]]) -> dict[str, bool]:
    """Options of a kind of experiment, and whether it needs them."""
    parameters = inspect.signature(kinds[kind]).parameters
    return {name: p.default is p.empty for name, p in parameters.items() if name != "rig"}


def checked_options(kind: str, given: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """The options of a kind of experiment, speeds and frequencies in rpm; those that it does not have, or lacks, are
    refused."""
    allowed, options = options_of(kind, kinds), dict(given)
    for name in [one.removesuffix("_rpm") for one in allowed if one.endswith("_rpm")]:
        if name in options or f"{name}_hz" in options:
            found = {unit: options.pop(f"{name}_{unit}", None) for unit in ("rpm", "hz")}
            turning = in_rad_s(name, options.pop(name, None), **found)
            options[f"{name}_rpm"] = np.multiply(turning, RPM_PER_RAD_S)
    unknown = [name for name in options if name not in allowed]
    missing = [name for name, needed in allowed.items() if needed and name not in options]
    wrong = [f"does not know {', '.join(unknown)}"] if unknown else []
    wrong += [f"needs {', '.join(missing)}"] if missing else []
    if wrong:
        raise TypeError(f"simulation of kind {kind} {' and '.join(wrong)}; its options are {', '.join(allowed)}")
    return options


SIMULATED: Mapping[str, Callable[..., Experiment]] = {
    "perturbation": forcing.perturbation,
    "squeeze-film": forcing.squeeze_film,
    "synchronous": forcing.synchronous,
    "displacement": forcing.displacement,
    "static-load": forcing.static_load,
    "impulse": forcing.impulse,
}
"""Kinds of experiments by name: functions of a :class:`~rotorfit.lab.simulation.rig.VirtualRig` and its options."""
_ROTATING = ("perturbation", "squeeze-film", "synchronous")
"""Those whose responses the phasor equations give."""


@overload
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: Literal["perturbation", "squeeze-film", "synchronous"] = ...,
    *,
    noise: float = ...,
    rng: Seed = ...,
    seed: Seed = ...,
    tolerance: float = ...,
    exact: bool = ...,
    **options: Unpack[ExperimentOptions],
) -> PerturbationTest: ...
@overload
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: Literal["displacement"],
    *,
    noise: float = ...,
    rng: Seed = ...,
    seed: Seed = ...,
    tolerance: float = ...,
    exact: bool = ...,
    **options: Unpack[ExperimentOptions],
) -> DisplacementTest: ...
@overload
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: Literal["static-load"],
    *,
    noise: float = ...,
    rng: Seed = ...,
    seed: Seed = ...,
    tolerance: float = ...,
    exact: bool = ...,
    **options: Unpack[ExperimentOptions],
) -> StaticTest: ...
@overload
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: Literal["impulse"],
    *,
    noise: float = ...,
    rng: Seed = ...,
    seed: Seed = ...,
    tolerance: float = ...,
    exact: bool = ...,
    **options: Unpack[ExperimentOptions],
) -> RingDownTest: ...
@overload
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: str,
    *,
    noise: float = ...,
    rng: Seed = ...,
    seed: Seed = ...,
    tolerance: float = ...,
    exact: bool = ...,
    **options: Unpack[ExperimentOptions],
) -> Experiment: ...
def simulate(
    model: RotorModel,
    params: Mapping[str, float],
    kind: str = "perturbation",
    *,
    noise: float = 0.01,
    rng: Seed = None,
    seed: Seed = None,
    tolerance: float = 1e-6,
    exact: bool = False,
    **options: Unpack[ExperimentOptions],
) -> Experiment:
    """Test a virtual rig: integrate its nonlinear equation of motion in time, read probes, add noise.

    Nothing of the phasor equations that fits solve is used: steady states are waited for and measured by least squares
    over whole periods. With noise the experiment carries its standard deviation, without it leaves it unknown.

    ``rf.simulate(model, params, speed_rpm=1000, frequency_rpm=np.linspace(100, 3000, 60), force=2.0)`` is a
    perturbation test; ``force=[0.5, 1, 2, 4]`` an amplitude sweep, ``load=-3j`` makes it one about an off-centre
    equilibrium. ``speed`` and ``frequency`` are in rad/s, ``frequency_hz`` in Hz. Options of the kinds:

    - ``perturbation``: speed_rpm, frequency_rpm, force or unbalance, planes, order, load, load_plane
    - ``squeeze-film``: frequency_rpm, force or unbalance, planes
    - ``synchronous``: speed_rpm, unbalance, residual, planes, kept
    - ``displacement``: speed_rpm, frequency_rpm, amplitude_um, plane
    - ``static-load``: speed_rpm, load, load_deg, plane
    - ``impulse``: speed_rpm, impulse, load, impulse_deg, load_deg, plane, duration, sampling_hz

    They are described at :func:`rotorfit.lab.simulation.forcing.perturbation` and its neighbours.

    With ``exact=True`` linear rotors are not integrated, which takes milliseconds in place of seconds.

    Recordings of raw signals, in volts with noise, run-out and Keyphasors: :func:`rotorfit.simulate_recordings`.

    Args:
        model: the rotor.
        params: its true parameters, SI units.
        kind: a name above.
        noise: standard deviation of real and imaginary part of a reading over the rms reading in its run and channel;
            of a ring-down record over its rms vibration.
        rng: of the noise, a generator or its seed, 0 by default.
        seed: the same.
        tolerance: of the integration, as a fraction of the motion.
        exact: responses of a linear rotor to rotating forces by the phasor equations, in milliseconds: to plan and to
            teach with. A fit solves the same equations, so that it tests no more than the noise.
        options: speeds, forces and so on of the kind.

    Returns:
        an experiment for :func:`rotorfit.fit`: ``PerturbationTest``, ``DisplacementTest``, ``StaticTest`` or
        ``RingDownTest``.

    Raises:
        ValueError: unknown kind, a rotor that is unstable at the speed, impossible forces or noise.
        TypeError: options that the kind does not have, or lacks.
        KeyError: unknown or missing parameters or planes.
        IntegrationError: the journal touches the wall, or the motion does not settle.

    Example:
        >>> test = rf.simulate(
        ...     rf.models.OneMode(), {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4},
        ...     "perturbation", speed_rpm=1500, frequency_rpm=[-800, -400, 400, 800], force=5.0, seed=1,
        ... )
        >>> sorted({int(w) for w in test.frequency})  # rad/s
        [-83, -41, 41, 83]
    """
    if kind not in SIMULATED:
        raise ValueError(unknown_name("kind of experiment", kind, SIMULATED))
    if not (np.isfinite(noise) and noise >= 0 and 0 < tolerance < 1e-2):
        raise ValueError(f"noise must be zero or positive and tolerance within (0, 0.01), got {noise} and {tolerance}")
    settings = checked_options(kind, options, SIMULATED)
    if exact and (kind not in _ROTATING or model.eccentricity_dependent or settings.get("load")):
        raise ValueError(
            f"exact=True is for linear rotors without a load, of the kinds {', '.join(_ROTATING)}; leave it out to "
            "integrate the motion in time"
        )
    rig = VirtualRig(
        model=model,
        theta=model.vector(params),
        noise=float(noise),
        tolerance=tolerance,
        exact=exact,
        rng=np.random.default_rng(chance(rng, seed, 0)),
    )
    return SIMULATED[kind](rig, **settings)
