"""What is wrong with a recording is found and said, and nothing is said of a good one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded import ATTRIBUTES, RATE, SETUP, notch, shaft_angle, volts, write_hdf5
from sentences import refuses

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.estimators.signals.spectral_lines import mains_hum
from rotorfit.lab.recordings.reduction.responses import recorded_tests


def codes(path: Path, channels: dict[str, Float], **said: float | str) -> dict[str, str]:
    """Messages of the findings by code."""
    record = rf.read_recording(write_hdf5(path / "run.h5", channels, {**ATTRIBUTES, **said}))
    return {finding.code: finding.message for finding in record.findings}


@pytest.mark.parametrize("angles", [(0.0, 90.0), (45.0, 135.0), (-45.0, 45.0)])
@pytest.mark.parametrize("whirl", [1, -1])
def test_nothing_is_said_of_a_good_recording(tmp_path: Path, whirl: int, angles: tuple[float, float]) -> None:
    said = {"probe_angle_deg_X": angles[0], "probe_angle_deg_Y": angles[1]}
    words = "forward" if whirl > 0 else "backward"
    assert codes(tmp_path, volts(whirl=whirl, angles=angles), whirl=words, **said) == {}
    assert codes(tmp_path, volts(whirl=whirl, angles=angles, noise=0.0), whirl=words, **said) == {}


def test_a_clipped_channel_is_named(tmp_path: Path) -> None:
    channels = volts()
    channels["disk_Y"] = np.minimum(channels["disk_Y"], -9.6)
    found = codes(tmp_path, channels)
    assert set(found) == {"channel-clipped"}
    assert "channel disk_Y is clipped at -9.600 V" in found["channel-clipped"]


def test_a_dead_channel_is_named(tmp_path: Path) -> None:
    channels = volts()
    channels["disk_X"] = np.full_like(channels["disk_X"], -0.4)
    assert "channel disk_X is dead" in codes(tmp_path, channels)["channel-dead"]


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_a_channel_that_stops_for_a_while_is_named_and_left_out(tmp_path: Path) -> None:
    channels = volts(8.0)
    begin, end = round(3.0 * RATE), round(6.2 * RATE)
    stopped = channels["disk_Y"].copy()
    stopped[begin:end] = stopped[begin]
    found = codes(tmp_path, {**channels, "disk_Y": stopped})
    assert set(found) == {"channel-stops"}
    (low, high) = found["channel-stops"].split(" on one count from ")[1].split(" s, and")[0].split(" to ")
    assert float(low) == pytest.approx(3.0, abs=0.05)
    assert float(high) == pytest.approx(6.2, abs=0.05)
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", {**channels, "disk_Y": stopped}, ATTRIBUTES))
    test = rf.responses([record])
    said = test.findings
    assert any("disk_Y left out: dead, interrupted or clipped" in finding.message for finding in said)
    assert not ((test.plane == "disk") & (test.direction == "y")).any()


def test_a_recording_given_twice_is_said(tmp_path: Path) -> None:
    files = [write_hdf5(tmp_path / f"{name}.h5", volts(8.0), ATTRIBUTES) for name in ("one", "two")]
    files.append(write_hdf5(tmp_path / "three.h5", volts(8.0, whirl=-1), {**ATTRIBUTES, "whirl": "backward"}))
    (test,) = recorded_tests([rf.read_recording(file) for file in files])
    said = test.findings
    (copy,) = [finding.message for finding in said if finding.code == "duplicate"]
    assert "Copies of recordings: two.h5 is one.h5, to the last digit." in copy


def test_a_coarse_card_that_sees_nothing_for_a_while_does_not_stop(tmp_path: Path) -> None:
    """Steps of an eighth of a volt, in a file of finer counts, swallow the motion at first."""
    channels = volts(8.0, noise=0.0)
    growing = np.linspace(0.0, 1.0, channels["disk_Y"].size)
    for name in ("disk_X", "disk_Y"):
        rest = channels[name] - channels[name].mean()
        channels[name] = np.round((channels[name].mean() + rest * growing) * 8) / 8
    assert "channel-stops" not in codes(tmp_path, channels)


def test_ac_coupling_and_range_are_said(tmp_path: Path) -> None:
    channels = volts()
    found = codes(tmp_path, {**channels, "disk_X": channels["disk_X"] + 10.0, "disk_Y": channels["disk_Y"] + 10.0})
    assert set(found) == {"ac-coupled"}
    assert "disk_X, disk_Y: no gap voltage" in found["ac-coupled"]
    found = codes(tmp_path, {**channels, "disk_X": channels["disk_X"] + 8.0})
    assert "disk_X: -2.6" in found["probe-range"]


def test_exchanged_probes_and_a_perturbator_that_turns_the_other_way_are_told_apart(tmp_path: Path) -> None:
    channels = volts()
    exchanged = {**channels, "disk_X": channels["disk_Y"], "disk_Y": channels["disk_X"]}
    assert set(codes(tmp_path, exchanged)) == {"probes-exchanged"}
    assert set(codes(tmp_path, channels, whirl="backward")) == {"whirl-reversed"}
    assert set(codes(tmp_path, volts(whirl=-1), whirl="forward")) == {"whirl-reversed"}
    both = {f"{plane}_{axis}": exchanged[f"disk_{axis}"] for plane in ("disk", "journal") for axis in "XY"}
    marks = {name: channels[name] for name in channels if name.startswith("key")}
    assert set(codes(tmp_path, {**both, **marks})) == {"rotation-sense"}


def clipped(channels: dict[str, Float]) -> dict[str, Float]:
    return {**channels, "disk_Y": np.clip(channels["disk_Y"], -10.2, -9.8)}


def crossed(channels: dict[str, Float]) -> dict[str, Float]:
    return {**channels, "disk_X": channels["disk_Y"], "disk_Y": channels["disk_X"]}


@pytest.mark.parametrize(("slip", "whirl"), [(clipped, "forward"), (crossed, "forward"), (dict, "backward")])
def test_the_lines_that_a_finding_gives_for_rig_toml_mend_it(
    tmp_path: Path, slip: Callable[[dict[str, Float]], dict[str, Float]], whirl: str
) -> None:
    path = write_hdf5(tmp_path / "run.h5", slip(volts()), {**ATTRIBUTES, "whirl": whirl})
    (error,) = [finding for finding in rf.read_recording(path).findings if finding.severity == "error"]
    _, _, line = error.message.partition('[[run]] and file = "run.h5": ')
    setup = tmp_path / "rig.toml"
    setup.write_text(f'[[run]]\nfile = "run.h5"\n{line}\n')
    mended = rf.read_recording(path, setup)
    assert {finding.code for finding in mended.findings} <= {"setup-contradicts-file"}  # which says whirl otherwise
    right = rf.read_recording(write_hdf5(tmp_path / "right.h5", volts()))
    assert repr(mended.force) == repr(right.force)  # NaN stands for what is not given
    for probe in mended.probes:
        (same,) = [one for one in right.probes if one.angle == probe.angle]
        seen, true = mended.displacement(probe, 0, 5000), right.displacement(same, 0, 5000)
        np.testing.assert_allclose(seen - seen.mean(), true - true.mean(), atol=1e-7)


def test_a_rig_turned_with_all_its_probes_is_the_same_rig(tmp_path: Path) -> None:
    """Probes and Keyphasor probes 30 degrees further round: readings and forces turn by as much."""
    path = write_hdf5(tmp_path / "run.h5", volts(), ATTRIBUTES)
    setup = tmp_path / "rig.toml"
    turned = SETUP.replace("angle_deg = 0.0", "angle_deg = 30.0").replace("angle_deg = 90.0", "angle_deg = 120.0")
    for mark in ("shaft", "perturbator"):
        turned = turned.replace(f'channel = "keyphasor_{mark}"', f'channel = "keyphasor_{mark}"\nangle_deg = 30.0')
    setup.write_text(turned)
    one, other = (rf.responses([rf.read_recording(path, given)]) for given in (None, setup))
    along = [test.select(test.direction == "x") for test in (one, other)]
    kappa = [test.force / test.response for test in along]
    np.testing.assert_allclose(kappa[1], kappa[0], rtol=0.04)  # circles but for the noise, most at the slow end
    assert np.angle(along[1].force[0] / along[0].force[0], deg=True) == pytest.approx(30.0)


@pytest.mark.parametrize("seconds", [4.0, 200.0])
@pytest.mark.parametrize("whirl", [1, -1])
def test_a_rotor_without_unbalance_that_is_swept_backward_has_its_probes_right(
    tmp_path: Path, whirl: int, seconds: float
) -> None:
    """A backward force passes once per turn, and nothing else turns with the shaft."""
    t = np.arange(round(seconds * RATE)) / RATE
    angle = 2 * np.pi * (5.0 * t + 20.0 / seconds * t**2)  # 5 to 45 turns a second, the shaft has 20
    size = 50e-6 / np.abs(1 - (angle.max() / angle[-1] * (5.0 + 40.0 / seconds * t) / 21.0) ** 2 + 0.1j)
    z = size * np.exp(1j * whirl * angle)
    channels = {"keyphasor_shaft": notch(shaft_angle(t)), "keyphasor_perturbator": notch(angle)}
    noise = np.random.default_rng(3).normal(size=(2, t.size))
    for axis, part, e in zip("XY", (z.real, z.imag), noise, strict=True):
        channels[f"disk_{axis}"] = -10.0 + 7870.0 * part + 3e-3 * e
    assert not {"probes-exchanged", "rotation-sense"} & set(
        codes(tmp_path, channels, whirl="forward" if whirl > 0 else "backward")
    )


def test_mains_hum_is_said_with_its_frequency(tmp_path: Path) -> None:
    channels = volts(16.0)
    t = np.arange(channels["disk_X"].size) / RATE
    hum = {name: v + 0.1 * np.cos(2 * np.pi * 50.0 * t) for name, v in channels.items() if name.startswith("disk")}
    found = codes(tmp_path, {**channels, **hum})
    assert set(found) == {"hum"}
    assert "50 Hz, seen in disk_X, disk_Y with up to 1" in found["hum"]


def test_hum_at_the_speed_of_the_shaft_is_said_not_to_be_told_apart(tmp_path: Path) -> None:
    """A shaft of 3000 rpm: its own motion stands at 50 Hz, with hum or without."""
    t = np.arange(round(4.0 * RATE)) / RATE
    turned = 2 * np.pi * 50.0 * t + 0.9
    channels = volts()
    z = 30e-6 * np.exp(1j * turned)
    channels |= {"disk_X": -10 + 7870 * z.real, "disk_Y": -10 + 7870 * z.imag, "keyphasor_shaft": notch(turned)}
    found = rf.read_recording(write_hdf5(tmp_path / "run.h5", channels, {**ATTRIBUTES, "speed_rpm": 3000.0})).findings
    said = {finding.code: finding.message for finding in found}
    assert "hum" not in said
    assert "the shaft turns at 50 Hz, where mains hum would stand too" in said["hum-on-order"]


def test_an_order_above_half_the_sampling_rate_is_named_where_it_folds_to(tmp_path: Path) -> None:
    """Sampled at 800 Hz, order 25 of a shaft at 20.3 Hz, 507.5 Hz, appears at 292.5 Hz."""
    rate, turning = 800.0, 20.3
    t = np.arange(8 * 800) / rate
    angle = 2 * np.pi * turning * t
    for size, expected in ((0.0, set()), (1e-6, {"aliasing"})):
        z = 30e-6 * np.exp(1j * angle) + size * np.exp(25j * angle)
        noise = 3e-3 * np.random.default_rng(1).normal(size=(2, t.size))
        channels = {"disk_X": -10 + 7870 * z.real + noise[0], "disk_Y": -10 + 7870 * z.imag + noise[1]}
        channels["keyphasor_shaft"] = notch(angle)
        found = codes(tmp_path, channels, sample_rate_hz=rate, speed_rpm=turning * 60)
        assert set(found) == expected
    assert "line at 292.50 Hz in disk_X, disk_Y is order 25" in found["aliasing"]


def test_missing_and_double_pulses_are_said_by_time_and_the_angle_holds(tmp_path: Path) -> None:
    channels = volts()
    t = np.arange(channels["disk_X"].size) / RATE
    key = channels["keyphasor_shaft"].copy()
    turn = np.floor(shaft_angle(t) / (2 * np.pi) + 0.1).astype(int)  # a notch well inside its own number
    for lost in (10, 30, 31):
        key[turn == lost] = -2.0
    for twice in (15, 22, 50, 60):
        late = t - t[np.flatnonzero(turn == twice)[0]]
        key[(late > 0.016) & (late < 0.018)] = -8.0
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", {**channels, "keyphasor_shaft": key}))
    found = {finding.code: finding.message for finding in record.findings}
    assert set(found) == {"pulses-missing", "pulses-double"}
    assert "3 pulses missing, after 0.4" in found["pulses-missing"]
    assert "4 edges that are no pulses left out, at 0.7" in found["pulses-double"]
    inner = np.linspace(0.2, 3.8, 500)
    turns = (record.shaft_angle().angle(inner) - shaft_angle(inner)) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns.mean()), atol=1e-3)


def test_pulses_that_disagree_with_the_speed_are_said(tmp_path: Path) -> None:
    channels = volts()
    t = np.arange(channels["disk_X"].size) / RATE
    found = codes(tmp_path, {**channels, "keyphasor_shaft": notch(4 * shaft_angle(t))})
    assert "the marks say 4800 rpm, file or setup 1200 rpm" in found["speed-disagrees"]


def test_a_channel_that_is_not_a_number_is_refused_with_its_time(tmp_path: Path) -> None:
    channels = volts()
    channels["disk_X"][1600] = np.nan
    with refuses(ValueError):
        codes(tmp_path, channels)


def test_channels_without_pulses_are_refused_by_name(tmp_path: Path) -> None:
    channels = volts()
    for signal in (np.full_like(channels["disk_X"], -2.0), channels["disk_X"]):
        with refuses(ValueError):
            codes(tmp_path, {**channels, "keyphasor_shaft": signal})


def test_blows_at_equal_times_are_no_hum_and_hum_is() -> None:
    """Blows 2.000 s apart have lines at all multiples of 0.5 Hz, 50 and 60 Hz among them."""
    rate, rng = 2000.0, np.random.default_rng(1)
    t = np.arange(int(24 * rate)) / rate
    since = t % 2.0
    ringing = np.exp(-8 * since) * np.sin(2 * np.pi * 55.0 * since)
    noise = 1e-3 * rng.normal(size=t.size)
    assert mains_hum(ringing + noise, rate) == []
    found = mains_hum(0.05 * np.sin(2 * np.pi * 50.0 * t) + noise, rate)
    assert [round(frequency) for frequency, _ in found] == [50]


def test_what_several_recordings_say_alike_is_told_once() -> None:
    from rotorfit.lab.data.findings import Finding, told_once

    def of(name: str, words: str, rows: tuple[int, ...] = ()) -> Finding:
        return Finding("warning", "hum", f"{name}: {words}", rows=rows)

    own = [
        of("a", "mains hum at 50 Hz"),
        of("b", "mains hum at 60 Hz"),
        of("a", "clipped", rows=(1,)),
        of("other", "x"),
    ]
    told = told_once([*own, of("c", "mains hum at 50 Hz")], ["a", "b", "c"])
    assert [finding.message for finding in told] == ["a, c: mains hum at 50 Hz", *(one.message for one in own[1:])]
    assert told[2].rows == (1,)
