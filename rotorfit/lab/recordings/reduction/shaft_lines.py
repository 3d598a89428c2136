"""From recordings of a perturbed shaft that is not round to its spectral lines: lateral motion, images and twist.

Each line is the answer to a drive of its own, made of the force f and the shaft's angle theta: f for the line at w,
``conj(f) exp(2j theta)`` for the image at 2 Om - w, ``f exp(-j n theta)`` for the twist at w - n Om. Local fits of the
spectra (:mod:`rotorfit.estimators.signals.local_response`) take all drives of a signal at once, so that lines that
cross at different times of a sweep do not disturb each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.signals.local_response import SMOOTH_DEGREE, RecordSpectra, local_response
from rotorfit.estimators.signals.start_up_lines import StartUp, start_up_lines
from rotorfit.lab.kinds.line_test import LineTest
from rotorfit.lab.recordings.recording import Recording, named_apart
from rotorfit.lab.recordings.reduction.reduced_record import reduce_record
from rotorfit.lab.recordings.reduction.response_lines import time_at
from rotorfit.lab.recordings.signals import said_of, source_of
from rotorfit.models.shafts.combination_lines import LATERAL, TWIST, Order

_OF_SUPPORTS: dict[str, Order] = {"-w": (-1, -2), "w-2Om": (1, -2)}
"""Lines that supports which differ in two directions make, with their orders (m, n) in turning coordinates."""
_ORDERS = range(-4, 5)
"""Orders of the shaft taken out of every signal: run-out, unbalance, sag."""
_LARGEST_ERROR_RATIO = 10.0
"""Times the median error beyond which a reading is left out, in bands that the drive hardly reached."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Swept:
    """A recording with its angles: what the drives are made of."""

    record: Recording  # the recording
    plane: str  # of probes and force
    time: Float  # s
    force: ComplexArray  # complex force, N
    turn: ComplexArray  # ``exp(j theta)``
    speed: float  # mean rotative speed, rad/s
    speeds: Float  # rotative speed, rad/s, at each time
    rates: Float  # signed w, rad/s, at each time
    low: float  # lowest signed w of the sweep, rad/s
    high: float  # highest signed w of the sweep, rad/s
    mr: float  # unbalance, kg m
    angle_error: float  # standard error of the perturbator's angle over its speed, s
    freedom: float  # values that the perturbator's angle follows independently over the sweep


def shaft_lines(
    records: Recording | Sequence[Recording], *, runout_um: float | None = None, supports: bool = False
) -> LineTest:
    """Spectral lines of swept perturbation tests, start-ups and shutdowns of a shaft that is not round.

    Args:
        records: recordings of one rig with the motion of one plane in x and y: swept perturbation tests with the marks
            of shaft and perturbator and as far as measured the twist, start-ups and shutdowns with the shaft's mark.
        runout_um: plausible size of the run-out of the shaft at 1x and 2x, micrometres 0-peak. In perturbation tests it
            becomes the error of the lines 1x and 2x, which tell eccentricity and side load; by default these are left
            out. Over the speeds of a start-up run-out is separated, see ``AnisotropicShaft(runout=True)``.
        supports: whether to find the lines ``-w`` and ``w-2Om`` of perturbation tests too, which supports that differ
            in two directions make; for :class:`rotorfit.models.TurningOnSupports`, the twist then left out.

    Returns:
        lines ``w`` and ``2Om-w`` of the motion, ``w-Om``, ``w-2Om`` and ``2w-2Om`` of the twist, and of start-ups
        ``1x`` and ``2x`` at steady speeds, with their noise.

    Raises:
        ValueError: a recording without what this needs; the message says what.
    """
    several = named_apart(records)
    weights: dict[complex, str] = {}
    for record in filter(_is_start_up, several):  # different weights are different eccentricities
        force = record.force
        weights.setdefault(0.0 if force is None else force.mr * complex(np.exp(1j * force.angle)), record.name)
    if len(weights) > 1:
        one, other, *_ = weights.values()
        raise ValueError(f"{one} and {other} are start-ups with different weights, so with eccentricities of their own")
    if runout_um is not None and not (np.isfinite(runout_um) and runout_um >= 0):
        raise ValueError(f"runout_um is the size of the run-out, zero or more, not {runout_um}")
    parts: list[dict[str, NDArray[Any]]] = []
    counts = []
    for record in several:
        record.need_displacements("a shaft that is not round")
        if record.attributes.keys() != several[0].attributes.keys():
            raise ValueError(
                f"{record.name} has the attributes {', '.join(record.attributes) or 'none'}, {several[0].name} has "
                f"{', '.join(several[0].attributes) or 'none'}: give all recordings the same"
            )
        own = _start_up(record) if _is_start_up(record) else _lines_of(record, runout_um, supports)
        counts.append(sum(part["run"].size for part in own))
        parts += own
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    said = [{**record.attributes, **({} if runout_um is None else {"runout_um": runout_um})} for record in several]
    attributes = {name: np.repeat([each[name] for each in said], counts) for name in said[0]}
    findings = tuple(found for record in several for found in record.findings)
    return LineTest(source=source_of(several), findings=findings, attributes=attributes, **columns)


def _lines_of(record: Recording, runout_um: float | None, supports: bool) -> list[dict[str, NDArray[Any]]]:
    swept = _swept(record)
    motion = record.motion(swept.plane)
    if not np.iscomplexobj(motion):
        raise ValueError(f"{record.name}: {swept.plane} has one probe; lines and images need motion in x and in y")
    f, turn = swept.force, swept.turn
    drives = {"w": f, "2Om-w": f.conj() * turn**2}
    found = _fit(swept, motion, "z", drives | ({"-w": f.conj(), "w-2Om": f / turn**2} if supports else {}))
    if runout_um is not None:
        found += [_steady(swept, motion, name, runout_um * 1e-6) for name in ("1x", "2x")]
    if record.rig.twist is not None and not supports:
        spectrum, w = np.fft.fft(motion), 2 * np.pi * np.fft.fftfreq(motion.size, swept.time[1] - swept.time[0])
        whirl = np.fft.ifft(np.where((w >= swept.low) & (w <= swept.high), spectrum, 0.0))  # the motion at w alone
        drives = {"w-Om": f / turn, "w-2Om": f / turn**2, "2w-2Om": whirl**2 / turn**2}
        # phi = Re(Phi exp(j nu t)) has half of Phi at +nu.
        found += _fit(swept, 2.0 * record.twist, "twist", drives, found[0])
    return _with_angle_errors(swept, found)


def _is_start_up(record: Recording) -> bool:
    """True if nothing but the shaft itself drives a recording, and its speed changes."""
    if record.rig.perturbator is not None or (record.force is not None and record.force.measured):
        return False
    speed = record.shaft_angle().speeds(1001)
    start_up_speed_ratio = 1.2  # highest speed over the lowest from which it is one
    return bool(speed.max() > start_up_speed_ratio * speed.min())


def _start_up(record: Recording) -> list[dict[str, NDArray[Any]]]:
    """Lines 1x and 2x against speed."""
    plane = record.planes[0] if record.force is None else record.force.plane
    if record.force is None and len(record.planes) > 1:
        raise ValueError(
            f"{record.name} has the planes {', '.join(record.planes)}; name that of the disk as plane in [force]"
        )
    if plane not in record.pairs:
        raise ValueError(f"{record.name}: {plane} has one probe; 1x and 2x of a start-up need motion in x and in y")
    shaft = record.shaft_angle()
    reduced = reduce_record(record, shaft, 1)
    run = StartUp(
        rate=reduced.rate,
        angle=reduced.drive_angle,
        speed=reduced.drive_speed,
        acceleration=shaft.acceleration(reduced.time),
        motion=reduced.motion[plane],
    )
    with said_of(record.name):
        lines = start_up_lines(run)
    parts = []
    for order, found in lines.items():
        known = found.sigma[0, 0] <= _LARGEST_ERROR_RATIO * np.median(found.sigma)
        speed, response, sigma = (x[known] for x in (found.frequency / order, found.response[0, 0], found.sigma[0, 0]))
        turned = order * np.abs(response) * shaft.stderr(time_at(reduced, speed))
        none, place = np.zeros(speed.size), (record.name, plane, speed, "z", f"{order}x")
        parts.append(_columns(place, none, none.astype(complex), response, np.hypot(sigma, turned)))
    return parts


def _swept(record: Recording) -> _Swept:
    """Angles and force of a recording."""
    force, perturbator = record.force, record.perturbator_angle()
    if force is None or force.measured or perturbator is None:
        raise ValueError(
            f"{record.name}: combination lines need a perturbator with a mark: name its channel in [perturbator], and "
            "its unbalance mr_kg_m and whirl in [force]; or a start-up, whose speed changes"
        )
    time = np.arange(record.size) / record.sample_rate
    shaft = record.shaft_angle()
    rate, d = perturbator.speed(time), force.whirl
    theta = shaft.angle(time)
    turn = np.exp(1j * d * (perturbator.angle(time) + force.angle))
    low, high = float(rate.min()), float(rate.max())
    margin_share = 0.02  # share of the swept band at each end in which the force is not yet fully there
    margin = margin_share * (high - low)
    ends = sorted((d * (low + margin), d * (high - margin)))
    return _Swept(
        record=record,
        plane=force.plane,
        time=time,
        force=force.mr * (rate**2 - 1j * d * perturbator.acceleration(time)) * turn,
        turn=np.exp(1j * theta),
        speed=float(theta[-1] - theta[0]) / float(time[-1] - time[0]),
        speeds=np.gradient(theta) * record.sample_rate,
        rates=d * rate,
        low=ends[0],
        high=ends[1],
        mr=force.mr,
        angle_error=perturbator.jitter * float(np.sqrt(perturbator.share)),
        freedom=perturbator.share * perturbator.count,
    )


def _spectrum(signal: ComplexArray | Float) -> ComplexArray:
    return np.asarray(np.fft.fftshift(np.fft.fft(signal)) / signal.size)


def _frequencies(record: Recording) -> Float:
    return np.asarray(2 * np.pi * np.fft.fftshift(np.fft.fftfreq(record.size, 1 / record.sample_rate)))


def _order_of(direction: str, name: str) -> Order:
    """What a line's frequency is of w and of the rotative speed."""
    m, n = (TWIST if direction == "twist" else LATERAL | _OF_SUPPORTS)[name]
    return m, n - m + (direction != "twist")


def _ends(direction: str, name: str, swept: _Swept) -> tuple[float, float]:
    """Lowest and highest frequency that a line passes through."""
    m, shift = _order_of(direction, name)
    low, high = sorted(m * end + shift * swept.speed for end in (swept.low, swept.high))
    return low, high


def _fit(
    swept: _Swept,
    signal: ComplexArray | Float,
    direction: str,
    drives: Mapping[str, ComplexArray],
    main: Mapping[str, NDArray[Any]] | None = None,
) -> list[dict[str, NDArray[Any]]]:
    """Lines of a signal, each with the drives that pass through its band.

    The drive of the twist at 2(w - Om) is the square of the motion at w, whose line is ``main``.
    """
    w = _frequencies(swept.record)
    output = _spectrum(signal)
    spectra = {name: (_ends(direction, name, swept), _spectrum(d)) for name, d in drives.items()}
    if not np.iscomplexobj(signal):  # every line of a real signal has a twin at minus its frequency
        for k, ((low, high), d) in list(spectra.items()):
            mirrored = np.fft.fftshift(np.roll(np.fft.ifftshift(d)[::-1], 1)).conj()  # that of the conjugate
            spectra[f"-{k}"] = (-high, -low), mirrored
    orders = np.array([_spectrum(swept.turn**k) for k in _ORDERS])
    found = []
    for name in drives:
        (low, high), own = spectra[name]
        others = [drive for k, ((a, b), drive) in spectra.items() if k != name and max(low, a) < min(high, b)]
        spectrum = RecordSpectra(frequency=w, outputs=output[None], forces=np.array([own, *others]), others=orders)
        response = local_response([spectrum], low, high)
        parts = (response.frequency, response.response[0, 0], response.sigma[0, 0])
        if name == "2w-2Om" and main is not None:
            found.append(_square_rows(swept, main, *parts))
        else:
            found.append(_rows(swept, direction, name, *parts, response.width / (SMOOTH_DEGREE + 1)))
    return found


def _square_rows(
    swept: _Swept, main: Mapping[str, NDArray[Any]], nu: Float, response: ComplexArray, sigma: Float
) -> dict[str, NDArray[Any]]:
    """Rows of the twist at 2(w - Om), its answer to the square of the motion at w taken to that of the force."""
    from scipy.interpolate import CubicSpline

    order = np.argsort(main["frequency"])
    w, at = nu / 2 + swept.speed, main["frequency"][order]
    inside = (w >= at[0]) & (w <= at[-1])
    w, response, sigma = w[inside], response[inside], sigma[inside]
    stiffness = CubicSpline(at, (main["force"] / main["response"])[order])(w)  # smooth where the motion resonates
    error = np.interp(w, at, (main["sigma"] / np.abs(main["response"]))[order])
    force = np.asarray(swept.mr * w**2, dtype=complex)
    motion = force / stiffness
    spread = np.hypot(sigma * np.abs(motion) ** 2, 2 * np.abs(response * motion**2) * error)
    known = spread <= _LARGEST_ERROR_RATIO * np.median(spread)
    place = (swept.record.name, swept.plane, swept.speed, "twist", "2w-2Om")
    return _columns(place, w[known], force[known], (response * motion**2)[known], spread[known])


def _rows(
    swept: _Swept, direction: str, name: str, nu: Float, response: ComplexArray, sigma: Float, width: Float
) -> dict[str, NDArray[Any]]:
    """Rows of a line, its answer to a unit drive taken to the force at w; w and the speed are those while it was at a
    frequency, of the whole record where that was passed in less than a sample."""
    m, shift = _order_of(direction, name)
    passed = m * swept.rates + shift * swept.speeds
    order = np.argsort(passed, kind="stable")
    low, high = (np.searchsorted(passed[order], nu + side * width / 2) for side in (-1, 1))
    sums = np.concatenate([[0.0], np.cumsum((swept.speeds - swept.speed)[order])])
    speed = swept.speed + (sums[high] - sums[low]) / np.maximum(high - low, 1)
    w = (nu - shift * speed) / m
    force = np.asarray(swept.mr * w**2, dtype=complex)  # its angles are in the drives
    response, sigma = response * force, sigma * np.abs(force)
    known = sigma <= _LARGEST_ERROR_RATIO * np.median(sigma)
    place = (swept.record.name, swept.plane, speed[known], direction, name)
    return _columns(place, w[known], force[known], response[known], sigma[known])


def _columns(
    place: tuple[str, str, Float | float, str, str], w: Float, force: ComplexArray, response: ComplexArray, sigma: Float
) -> dict[str, NDArray[Any]]:
    """Columns of a line test: ``place`` is run, plane of probes and force, speed, direction and line."""
    run, plane, speed, direction, line = (np.broadcast_to(values, w.shape) for values in place)
    return {
        "run": run,
        "speed": speed,
        "frequency": w,
        "force_plane": plane,
        "force": force,
        "plane": plane,
        "direction": direction,
        "line": line,
        "response": response,
        "sigma": sigma,
    }


def _with_angle_errors(swept: _Swept, parts: list[dict[str, NDArray[Any]]]) -> list[dict[str, NDArray[Any]]]:
    """Readings with the error of the perturbator's angle in their noise.

    Pulses scatter, so the smooth angle is off, by the same amount on all lines that the sweep passes while it stays so.
    Readings that share an error s of phase are given the extra variance ``n s^2`` each, n being how many of them count:
    together they then know no more than the angle does.
    """
    w = np.abs(np.concatenate([part["frequency"] for part in parts]))
    size = np.abs(np.concatenate([part["response"] for part in parts]))
    sigma = np.concatenate([part["sigma"] for part in parts])
    phase = (swept.angle_error * w) ** 2
    weight = 1 / ((sigma / np.maximum(size, 1e-300)) ** 2 + np.maximum(phase, 1e-300))
    width = (swept.high - swept.low) / max(swept.freedom, 1.0)
    together = (np.abs(w[:, None] - w) < width / 2) & (w > 0)
    sharing = (together @ weight) ** 2 / np.maximum(together @ weight**2, 1e-300)
    wider = np.split(np.hypot(sigma, np.sqrt(sharing * phase) * size), np.cumsum([len(p["run"]) for p in parts])[:-1])
    return [{**part, "sigma": own} for part, own in zip(parts, wider, strict=True)]


def _steady(swept: _Swept, motion: ComplexArray, name: str, runout: float) -> dict[str, NDArray[Any]]:
    """A line that is locked to the shaft, over the whole record; its noise is that of the spectrum around it."""
    order = {"1x": 1, "2x": 2}[name]
    basis = swept.turn ** np.array(_ORDERS)[:, None]
    amplitude = np.linalg.lstsq(basis.T, motion, rcond=None)[0][list(_ORDERS).index(order)]
    w = _frequencies(swept.record)
    at = int(np.searchsorted(w, order * swept.speed))
    beside = 40  # spectral lines to each side of an order that tell its noise
    near = np.abs(_spectrum(motion))[[*range(at - beside, at - 4), *range(at + 5, at + beside + 1)]]
    sigma = float(np.hypot(np.median(near) / np.sqrt(2 * np.log(2)), runout / np.sqrt(2)))
    none = np.zeros(1)
    place = (swept.record.name, swept.plane, swept.speed, "z", name)
    return _columns(place, none, none.astype(complex), np.array([amplitude]), np.array([sigma]))
