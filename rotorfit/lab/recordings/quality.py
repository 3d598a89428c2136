"""Faults of the channels of a recording that show before anything is estimated from them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.signals.spectral_lines import Turning, folded_orders, mains_hum
from rotorfit.lab.data.findings import NO_COPIES, Finding, listed
from rotorfit.lab.recordings.angle_track import AngleTrack
from rotorfit.lab.recordings.channel_statistics import CLIPPED_STRETCHES, ChannelStatistics
from rotorfit.lab.recordings.rig.setup import Probe
from rotorfit.lab.recordings.signals import Signals

_SAMPLES_CHECKED = 1 << 19
"""Samples of a long recording that the slower checks look at, spread over it in pieces."""
_USUAL_RANGE = (-18.0, -2.0)
"""Linear range of an eddy-current probe on -24 V, V, taken where the setup gives none."""
_EDDY_CURRENT_SENSITIVITIES, _SENSITIVITIES = (2e3, 4e4), (1e2, 2e6)
"""Sensitivities, V/m, of eddy-current probes on -24 V and of any displacement probes."""


def probe_findings(record: Signals, found: Mapping[str, ChannelStatistics]) -> Iterator[Finding]:
    """Clipped, dead, interrupted, AC-coupled and out-of-range probes."""
    if not record.probes:
        words = (
            f"{record.name}: none of its channels ({listed(tuple(record.raw.channels))}) is known as a probe: name the "
            "probes in [[probe]] of the setup."
        )
        yield Finding("error", "no-probes", words)
    coupled = []
    for probe in record.probes:
        each, where = found[probe.channel], f"{record.name}, channel {probe.channel}"
        largest = _largest(found, each.unit)
        if _dead(each, largest):
            words = (
                f"{where} is dead: it stays at {each.mean:.3f} {each.unit} and moves by "
                f"{significant(each.deviation, 2)} {each.unit} rms, the others by up to {significant(largest, 3)}. "
                "Leave its plane out or repair the probe. "
                f"{_to_copy(record, 'leave_out', [probe.channel])}"
            )
            yield Finding("error", "channel-dead", words)
            continue
        if each.still:
            yield _stops(each, where, _to_copy(record, "leave_out", [probe.channel]))
        if each.clipped:
            yield _clips(each, where, _to_copy(record, "leave_out", [probe.channel]))
        highest_voltage = 50.0  # no probe or input card gives so many volts
        if not probe.unit and max(abs(each.low), abs(each.high)) > highest_voltage:
            words = (
                f"{where}: {each.low:.6g} to {each.high:.6g} V are no voltages of a probe: counts, or millivolts? Say "
                f'volts_per_count in [[channel]] name = "{probe.channel}", or unit = "um" in [[probe]] of a motion.'
            )
            yield Finding("error", "channel-scale", words)
            continue
        if probe.derivative:  # no gap, and of any size
            continue
        yield from _sensitivity(probe, each, where)
        if each.without_gap:
            coupled.append(probe.channel)
        elif not (each.clipped or probe.unit):
            yield from _out_of_range(probe, each, where)
    if coupled:
        words = (
            f"{record.name}: {listed(coupled)}: no gap voltage (mean near zero): AC-coupled? There is no shaft "
            "centreline and no eccentricity, and whether the probe is in its linear range cannot be seen."
        )
        yield Finding("note", "ac-coupled", words)


def _stops(each: ChannelStatistics, where: str, undo: str) -> Finding:
    when = listed([f"{low:.2f} to {high:.2f} s" for low, high in each.still])
    words = (
        f"{where} stays on one count from {when}, and carries noise before or after: a loose cable, or samples that "
        "were lost and held or filled. Measure again, cut these times out of the file, or leave the probe out. "
        f"{undo}"
    )
    return Finding("error", "channel-stops", words)


def _clips(each: ChannelStatistics, where: str, undo: str) -> Finding:
    ends = ((each.low, each.flat_low, each.at_low), (each.high, each.flat_high, each.at_high))
    limit = " and ".join(f"{value:.3f} {each.unit}" for value, flat, _ in ends if flat >= CLIPPED_STRETCHES)
    share = sum(at for _, flat, at in ends if flat >= CLIPPED_STRETCHES)
    words = (
        f"{where} is clipped at {limit} ({share:.1%} of the samples): amplitudes there are too small. Set the input "
        "range wider and measure again, or leave the probe out. "
        f"{undo}"
    )
    return Finding("error", "channel-clipped", words)


def _sensitivity(probe: Probe, each: ChannelStatistics, where: str) -> Iterator[Finding]:
    """A sensitivity, or the unit of a motion, that was written in another unit."""
    low, high = _EDDY_CURRENT_SENSITIVITIES if _USUAL_RANGE[0] <= each.mean <= _USUAL_RANGE[1] else _SENSITIVITIES
    said = abs(float(probe.sensitivity or 0.0))
    moves = (each.high - each.low) / max(said, 1e-9)  # m, peak to peak
    largest_motion = 0.01  # no shaft moves so far within its bearings, m, peak to peak
    words = ""
    if probe.unit and moves > largest_motion:
        words = f"the shaft would move by {significant(moves * 1e3, 3)} mm in {probe.unit}. Is its unit right?"
    elif not probe.unit and not low <= said <= high:
        words = (
            f"{significant(said / 1e3, 3)} V/mm is no usual sensitivity of a probe, {low / 1e3:g} to {high / 1e3:g} "
            f"V/mm; the shaft would move by {significant(moves * 1e6, 3)} µm. Is its unit right?"
        )
    if words:
        yield Finding("warning", "probe-sensitivity", f"{where}: {words}")


def _largest(found: Mapping[str, ChannelStatistics], unit: str) -> float:
    """Largest scatter of the channels in a unit."""
    return max((each.deviation for each in found.values() if each.unit == unit), default=0.0)


def _dead(each: ChannelStatistics, largest: float) -> bool:
    """Whether a channel stands still, or carries noise alone where others move."""
    white_share = 0.5  # of a deviation, between neighbours: white noise has 1, motion sampled ten times a period 0.3
    noise_alone = each.noise > white_share * each.deviation and not each.idle
    smallest_deviation = 1e-5  # no probe is so quiet, V rms
    return each.deviation <= max(each.step, smallest_deviation if each.unit == "V" else 0.0) or (
        noise_alone and each.deviation < 0.01 * largest
    )


def spoiled(found: Mapping[str, ChannelStatistics]) -> tuple[str, ...]:
    """Channels of probes that are dead, interrupted or clipped, so that no response can be had of them."""
    lost = {name: each.clipped or each.still or _dead(each, _largest(found, each.unit)) for name, each in found.items()}
    return tuple(name for name, spoils in lost.items() if spoils)


def copied_recordings(records: Sequence[Signals]) -> Iterator[Finding]:
    """Recordings whose first and last samples one before them has, channel by channel."""
    seen: dict[tuple[object, ...], Signals] = {}
    copies = []
    ends_length = 4096  # samples at either end of a recording by which copies are known
    for record in records:
        ends = ((0, ends_length), (max(record.size - ends_length, 0), record.size))
        parts = [record.channel(p.channel, *end).tobytes() for p in record.probes for end in ends]
        key = (record.size, *parts)
        first = seen.setdefault(key, record)
        if first is not record:
            name = first.path.name
            copies.append(f"{name} given twice" if first.path == record.path else f"{record.path.name} is {name}")
    if copies:
        text = f"Copies of recordings: {listed(copies)}, to the last digit. {NO_COPIES}"
        yield Finding("warning", "duplicate", text)


def _out_of_range(probe: Probe, each: ChannelStatistics, where: str) -> Iterator[Finding]:
    low, high = probe.linear_range or _USUAL_RANGE
    said = "the setup's" if probe.linear_range else "the usual"
    positive = each.mean > 0 and probe.linear_range is None  # conditioned to it: the usual range says nothing
    if not positive and (each.low < low or each.high > high):
        words = (
            f"{where}: {each.low:.2f} to {each.high:.2f} V leaves {said} linear range, {low:g} to {high:g} V: there "
            "the probe reads wrong amplitudes. Say linear_range_V in [[probe]] where another range holds."
        )
        yield Finding("warning", "probe-range", words)


def direction_findings(record: Signals, shaft: AngleTrack | None, perturbator: AngleTrack | None) -> Iterator[Finding]:
    """Probes that are exchanged and a perturbator that turns the other way, by what turns with which mark."""
    whirl = 0 if record.force is None or record.force.measured else record.force.whirl
    backward, opposite, judged = [], [], []
    pieces = _pieces(record)
    beside = perturbator if record.force is not None else None
    turning = [_turning(record, shaft, pieces, beside), _turning(record, perturbator if whirl else None, pieces)]
    for plane in record.pairs if any(turning) else ():
        motion = [record.motion(plane, *piece) for piece in pieces]
        reversed_shaft = _reversed(motion, turning[0], 1)
        against = _reversed(motion, turning[1], whirl)
        if reversed_shaft:
            backward.append(plane)
        elif against is not None:
            judged.append(plane)
            opposite += [plane] if against else []
    if backward and len(backward) == len(record.pairs) > 1:
        words = (
            f"{record.name}: once-per-turn motion is mostly backward in every plane: the shaft turns the other way "
            f"than rotation says ({'ccw' if record.rig.rotation > 0 else 'cw'}), or all its probes are exchanged. "
            f"{_to_copy(record, 'rotation', 'cw' if record.rig.rotation > 0 else 'ccw')}"
        )
        yield Finding("error", "rotation-sense", words)
    elif backward:
        probes = [probe.channel for probe in record.probes if probe.plane == backward[0]][:2]
        words = (
            f"{record.name}: once-per-turn motion is mostly backward in {listed(backward)}: are its two probes "
            "exchanged, or is their angle_deg wrong? "
            f"{_to_copy(record, 'exchanged', probes)}"
        )
        yield Finding("error", "probes-exchanged", words)
    if opposite and len(opposite) * 2 > len(judged):
        said = "forward" if whirl > 0 else "backward"
        words = (
            f"{record.name}: the response in {listed(opposite)} turns against the perturbation, said to be {said}, "
            "while the once-per-turn motion is forward: the perturbator turns the other way than whirl says. "
            f"{_to_copy(record, 'force.whirl', 'backward' if whirl > 0 else 'forward')}"
        )
        yield Finding("error", "whirl-reversed", words)


def _to_copy(record: Signals, key: str, value: str | list[str]) -> str:
    """The lines of a setup that mend one recording; TOML writes texts as JSON does."""
    file, said = (json.dumps(each, ensure_ascii=False) for each in (record.path.name, value))
    return f"To correct it, say so in rig.toml, below [[run]] and file = {file}: {key} = {said}"


def _pieces(record: Signals) -> list[tuple[int, int]]:
    """First sample of each piece that is looked at, and the one after its last."""
    pieces = 8  # of a long recording
    length = record.size if record.size <= _SAMPLES_CHECKED else _SAMPLES_CHECKED // pieces
    starts = sorted(set(np.linspace(0, record.size - length, pieces).astype(int).tolist()))
    return [(start, start + length) for start in starts]


def _turning(
    record: Signals, angle: AngleTrack | None, pieces: Sequence[tuple[int, int]], other: AngleTrack | None = None
) -> list[tuple[int, Bool, Turning]]:
    """Number of each piece in which a mark was seen, the samples there, and how the mark turns. Where another mark
    turns nearly as fast, what is seen may be due to that one: there nothing is concluded."""
    if angle is None:
        return []
    found = []
    for number, (start, stop) in enumerate(pieces):
        t = np.arange(start, stop) / record.sample_rate
        inside = (t >= angle.begin) & (t <= angle.end)
        if inside.sum() >= 64:
            own, apart = t[inside], np.ones(np.count_nonzero(inside), dtype=bool)
            if other is not None:
                speed, beside = angle.speed(own), other.speed(np.clip(own, other.begin, other.end))
                apart = np.abs(np.abs(beside) - speed) > Turning.RESOLVED * speed
            found.append((number, inside, Turning.of(angle.angle(own), apart)))
    return found


def _reversed(
    motion: Sequence[ComplexArray], turning: Sequence[tuple[int, Bool, Turning]], direction: int
) -> bool | None:
    """True if motion at a mark's frequency is mostly against the direction; None where it is too small to say."""
    with_it = against = total = 0.0
    for number, inside, turns in turning:
        z = motion[number][inside]
        forward, backward = turns.power(z)
        if np.isfinite(forward):
            with_it += forward if direction > 0 else backward
            against += backward if direction > 0 else forward
            total += float(np.mean(np.abs(z) ** 2))
    one_sided_power_ratio = 4.0  # from which a motion counts as mostly in one direction: twice the amplitude
    too_small = max(with_it, against) < 0.01 * total or total == 0.0
    return None if too_small else against > one_sided_power_ratio * with_it


def hum_findings(record: Signals, shaft: AngleTrack | None) -> Iterator[Finding]:
    """Mains hum in the probes, and where the shaft's own speed lies on it so that nobody could tell."""
    size = min(record.size, _SAMPLES_CHECKED)
    span = np.linspace(0, size / record.sample_rate, 50)
    speeds = shaft.speed(span) / (2 * np.pi) if shaft is not None else np.zeros(0)
    speeds, margin = speeds[speeds > 0], 3 * record.sample_rate / size
    lines: dict[float, list[tuple[str, float]]] = {}
    hidden: dict[float, list[str]] = {}
    forced: set[int] = set()
    driven, reach, least = (
        _driven_lines(record, size),
        3,
        0.05,
    )  # lines beside, and the share from which a line is driven
    for probe in record.probes:
        for frequency, amplitude in mains_hum(record.displacement(probe, 0, size), record.sample_rate):
            at = round(frequency * size / record.sample_rate)
            if driven[max(at - reach, 0) : at + reach + 1].max() > least:
                forced.add(round(frequency))
                continue
            orders = np.round(frequency / speeds)
            near = (np.abs(frequency - orders * speeds) < margin) & (orders <= 10)
            if not near.any():
                lines.setdefault(round(frequency, 1), []).append((probe.channel, amplitude))
            elif near.all() and (orders == 1).all():
                hidden.setdefault(float(round(frequency)), []).append(probe.channel)
    for frequency, channels in sorted(hidden.items()):
        words = (
            f"{record.name}: the shaft turns at {frequency:g} Hz, where mains hum would stand too: what of the 1x in "
            f"{listed(channels)} is hum cannot be decided. Record at another speed, or with the shaft at rest."
        )
        yield Finding("note", "hum-on-order", words)
    if forced:
        words = (
            f"{record.name}: the measured force drives {listed([str(hz) for hz in sorted(forced)])} Hz, where mains "
            "hum would stand too: what of the motion there is hum cannot be decided."
        )
        yield Finding("note", "hum-on-force", words)
    for frequency, seen in sorted(lines.items()):
        worst = max(amplitude for _, amplitude in seen)
        words = (
            f"{record.name}: mains hum at {frequency:g} Hz, seen in {listed([name for name, _ in seen])} with up to "
            f"{significant(abs(worst) * 1e6, 3)} µm: lines of the response at that frequency are spoiled."
        )
        yield Finding("warning", "hum", words)


def _driven_lines(record: Signals, size: int) -> Float:
    """Spectrum of a measured force over its highest line: hum in its own channels is small there, the lines of a
    multisine at whole hertz are not; zero without one."""
    if record.force is None or not record.force.measured:
        return np.zeros(size // 2 + 1)
    force = record.force_signal(0, size)
    window = np.hanning(force.size)
    parts = np.stack([force.real, force.imag])
    spectrum = np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window)).max(axis=0)
    return np.asarray(spectrum / max(float(spectrum.max()), 1e-300))


def folding_findings(record: Signals, shaft: AngleTrack) -> Iterator[Finding]:
    """Orders of a steady shaft above half the sampling rate that appear at another frequency."""
    size = min(record.size, _SAMPLES_CHECKED)
    speeds = np.abs(shaft.speed(np.linspace(shaft.begin, min(size / record.sample_rate, shaft.end), 50))) / (2 * np.pi)
    turning, spread = float(speeds.mean()), float(np.ptp(speeds)) / 2
    if turning <= 0 or spread > 1e-3 * turning or 60 * turning < record.sample_rate / 2:
        return
    seen: dict[int, list[tuple[str, float]]] = {}
    for probe in record.probes:
        motion = record.displacement(probe, 0, size)
        for order, frequency, _ in folded_orders(motion, record.sample_rate, turning, spread):
            seen.setdefault(order, []).append((probe.channel, frequency))
    for order, lines in seen.items():
        words = (
            f"{record.name}: the line at {lines[0][1]:.2f} Hz in {listed([name for name, _ in lines])} is order "
            f"{order} of the shaft ({order * turning:.1f} Hz) folded by sampling at {record.sample_rate:g} Hz: use an "
            "anti-aliasing filter or sample faster."
        )
        yield Finding("warning", "aliasing", words)


def speed_findings(record: Signals, shaft: AngleTrack) -> Iterator[Finding]:
    """A shaft whose marks do not come at the speed that file or setup say."""
    speeds, said = shaft.speeds(), abs(record.speed or 0.0)
    middle = float(np.median(speeds))
    if said and np.ptp(speeds) < 0.05 * abs(middle) and abs(middle - said) > 0.03 * said:
        marks, given = middle * RPM_PER_RAD_S, said * RPM_PER_RAD_S
        other_count = not 0.7 < middle / said < 1.4  # beyond what a machine runs off its speed
        words = (
            f"{record.name}: the marks say {significant(marks, 4)} rpm, file or setup {significant(given, 4)} rpm: "
            f"{_other_count(record, shaft, middle, said)}"
        )
        yield Finding("error" if other_count else "warning", "speed-disagrees", words)


def _other_count(record: Signals, shaft: AngleTrack, middle: float, said: float) -> str:
    """Why the marks may come more or less often than the speed that is said makes them."""
    count, rate = shaft.pulses_per_turn, record.sample_rate
    passing = count * said / (2 * np.pi)  # Hz
    folded = abs(passing - rate * round(passing / rate)) * 2 * np.pi / count
    if passing > rate / 2:
        seen = ", and what is seen are aliases" if abs(folded - middle) < 0.05 * middle else ""
        return (
            f"{count} pulses a turn pass at {passing:.0f} Hz there, above half the sampling rate ({rate:g} Hz){seen}. "
            "Sample faster, or record a mark that passes once a turn."
        )
    ratio = middle / said
    if count == 1 and ratio > 1.5 and abs(ratio - round(ratio)) < 0.03 * ratio:
        return f"has the wheel {round(ratio)} marks a turn? Say pulses_per_turn = {round(ratio)} in [shaft]."
    return (
        f"is pulses_per_turn right ({count}), and the sampling rate ({rate:g} Hz)? Of more than half as many pulses a "
        "second as samples, only aliases are seen."
    )


def setting_findings(record: Signals) -> Iterator[Finding]:
    """A sampling rate and an unbalance that were written in another unit."""
    lowest_rate = 100.0  # sampling rate, Hz, at which no turning shaft is recorded
    if record.sample_rate < lowest_rate:
        words = (
            f"{record.name}: {significant(record.sample_rate, 4)} Hz is no sampling rate for a turning shaft: "
            "are the times in ms?"
        )
        yield Finding("error", "sampling-slow", words)
    force = record.force
    largest_unbalance = 1.0  # of any trial weight, kg m: a rotor of 50 t, balanced to G 2.5 at 3000 rpm, has 0.4
    if force is not None and force.mr > largest_unbalance:
        words = (
            f"{record.name}: an unbalance of {force.mr:g} kg m is that of no trial weight: is its unit right (mr_kg_m, "
            "mr_g_mm)?"
        )
        yield Finding("error", "unbalance-large", words)


def mark_findings(record: Signals, shaft: AngleTrack, perturbator: AngleTrack) -> Iterator[Finding]:
    """Marks that are exchanged: the shaft's speed sweeps while the perturbator's is steady."""
    sweeps, steady = (np.ptp(angle.speeds()) / np.abs(angle.speeds()).mean() for angle in (shaft, perturbator))
    swept_range, steady_range = 0.2, 0.02  # of a speed over its mean
    if sweeps > swept_range and steady < steady_range:
        turning = float(np.mean(perturbator.speeds()))
        given = record.speed is not None and abs(turning - abs(record.speed)) < 0.03 * abs(record.speed)
        rig = record.rig
        marks = [str(mark.channel) for mark in (rig.shaft, rig.perturbator) if mark is not None]
        words = (
            f"{record.name}: the shaft's mark sweeps and the perturbator's is steady: are the channels of [shaft] and "
            f"[perturbator] exchanged? {_to_copy(record, 'exchanged', marks)}"
        )
        yield Finding("error" if given else "warning", "marks-exchanged", words)
