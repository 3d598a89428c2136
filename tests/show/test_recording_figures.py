"""Figures of a recording show the motion it was made of; spectra and vectors against what is known of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn import faults_of
from recorded import RATE, perturbator_angle, shaft_angle, volts, write_hdf5
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.estimators.signals.tracking import order_vectors
from rotorfit.lab.recordings.angle_track import Marks, speeds
from rotorfit.lab.recordings.reduction.reductions import swept_vectors
from rotorfit.lab.recordings.views import OrderVectors, cascade, centreline, spectrum, stretch, vectors_over_time

FIGURES = ("timebase", "orbit", "centreline", "bode", "polar", "full_spectrum", "cascade", "speed")


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> rf.Recording:
    return rf.read_recording(write_hdf5(tmp_path_factory.mktemp("record") / "run.h5", volts(noise=1e-3)))


def marks_of(record: rf.Recording) -> Marks:
    return Marks(shaft=record.shaft_angle(), perturbator=record.perturbator_angle(), whirl=1)


def test_a_circle_of_radius_a_has_amplitude_a_at_its_side() -> None:
    t = np.arange(4096) / 1024.0
    z = 30e-6 * np.exp(2j * np.pi * 60.0 * t) + 7e-6 * np.exp(-2j * np.pi * 25.0 * t) + 1e-3
    frequency, amplitude = full_spectrum(z, 1024.0)
    at = dict(zip(frequency.tolist(), amplitude.tolist(), strict=True))
    assert at[60.0] == pytest.approx(30e-6, rel=1e-9)
    assert at[-25.0] == pytest.approx(7e-6, rel=1e-9)
    assert at[-60.0] < 1e-12
    assert at[0.0] < 1e-12


def test_window_vectors_tell_two_marks_apart_and_refuse_where_they_cannot() -> None:
    t = np.arange(2000) / 2000.0
    first, second = 2 * np.pi * 20.0 * t, 2 * np.pi * 26.3 * t + 0.4
    z = 3.0 + 2.0 * np.exp(1j * first) + 0.5j * np.exp(-2j * first) + (1 - 1j) * np.exp(-1j * second)
    found = order_vectors(z, [first, second], 2)
    np.testing.assert_allclose(found, [[0.5j, 0, 3, 2, 0], [0, 1 - 1j, 0, 0, 0]], atol=1e-9)
    close = order_vectors(z, [first, first * 1.01 + 1.0], 2)
    assert np.isfinite(close[0]).all()
    assert np.isnan(close[1]).all()


def test_vectors_over_the_recording_are_those_of_the_motion(record: rf.Recording) -> None:
    found = vectors_over_time(record, marks_of(record), "shaft", windows=40)
    x, y = found.phasors[[plane == "disk" for plane, _ in found.probes]]  # along x and along y
    good = np.isfinite(x)
    assert good.sum() > 20
    # the mark is at 40 turns a second a few degrees late: exp(j 0.5) about the angle from the mark
    expected = 30e-6 * np.exp(0.5j)
    assert np.abs((x + 1j * y)[good] / 2 - expected).max() < 2e-6  # the sweep leaks into windows of eight turns
    assert np.abs((x - 1j * y)[good] / 2).max() < 1e-6
    with refuses(ValueError):
        vectors_over_time(record, marks_of(record), "gear")


def test_filtered_orbits_are_the_parts_of_the_motion(record: rf.Recording) -> None:
    part = stretch(record, marks_of(record), "disk", 1.2, 6.0)
    once = 30e-6 * np.exp(1j * (shaft_angle(part.t) + 0.5))
    forced = 50e-6 * np.exp(1j * (perturbator_angle(part.t) - 0.3))
    assert np.abs(part.filtered["shaft"] - once).max() < 2e-6
    assert np.abs(part.filtered["perturbator"] - forced).max() < 4e-6  # 17 to 23 Hz within the window
    turns = (shaft_angle(part.dots["shaft"]) + 0.01) / (2 * np.pi)
    np.testing.assert_allclose(turns % 1, 0.0, atol=0.01)


def test_centreline_follows_the_gap_voltage(tmp_path: Path) -> None:
    channels = volts(noise=1e-3)
    t = np.arange(channels["disk_X"].size) / RATE
    channels["disk_X"] = channels["disk_X"] + 7870 * 10e-6 * t
    channels["disk_Y"] = channels["disk_Y"] - 7870 * 5e-6 * t
    moving = rf.read_recording(write_hdf5(tmp_path / "run.h5", channels))
    line = centreline(moving, marks_of(moving), "disk", windows=20)
    np.testing.assert_allclose(line.z, (10e-6 - 5e-6j) * (line.t - line.t[0]), atol=1.5e-6)
    for name in ("disk_X", "disk_Y"):
        channels[name] = channels[name] - channels[name].mean()
    coupled = rf.read_recording(write_hdf5(tmp_path / "ac.h5", channels))
    with refuses(ValueError):
        coupled.plot.centreline()


def test_the_clearance_stands_about_the_centre_that_the_gap_voltages_give(tmp_path: Path) -> None:
    """The shaft sits 40 um to the right of the bearing's centre and 30 um above it; the probes read -10 V there."""
    path = write_hdf5(tmp_path / "run.h5", volts(noise=1e-3))
    toml = tmp_path / "rig.toml"
    text = "[clearance_um]\ndisk = 150.0\n"
    for channel, angle, away in (("disk_X", 0.0, 40e-6), ("disk_Y", 90.0, 30e-6)):
        centre = rf.read_recording(path).gap_voltage(channel) - 7870 * away
        text += f'[[probe]]\nplane = "disk"\nchannel = "{channel}"\nangle_deg = {angle}\ncentre_V = {centre!r}\n'
    toml.write_text(text, encoding="utf-8")
    record = rf.read_recording(path, toml)
    circle = stretch(record, marks_of(record), "disk", None, 4.0).clearance
    assert circle is not None
    assert (circle.radius, circle.known) == (pytest.approx(150e-6), True)
    assert circle.centre == pytest.approx(-40e-6 - 30e-6j, rel=1e-9)
    line = centreline(record, marks_of(record), "disk", windows=20)
    assert line.clearance is not None
    assert np.abs(line.z - line.clearance.centre - (40e-6 + 30e-6j)).max() < 1.5e-6  # as the centreline above
    unknown = stretch(rf.read_recording(path), marks_of(record), "disk", None, 4.0, clearance=100e-6).clearance
    assert unknown is not None
    assert (unknown.radius, unknown.centre, unknown.known) == (100e-6, 0j, False)
    for figure in (record.plot.orbit(), record.plot.centreline(unit="mil")):
        circles = [line for axis in figure.axes for line in axis.lines if line.get_label() == "clearance"]
        assert len(circles) == 1
    toml.write_text(text.replace("disk = 150", "dsk = 150"), encoding="utf-8")
    with refuses(ValueError):
        rf.read_recording(path, toml)


def test_cascade_follows_the_perturbation(record: rf.Recording) -> None:
    found = cascade(record, marks_of(record), "disk", spectra=20)
    assert found.over == "perturbation"
    np.testing.assert_allclose(np.diff(found.position), np.ptp(found.position) / 19, rtol=0.05)
    step = float(np.diff(found.frequency[:2])[0])
    away = np.abs(found.frequency - 20.0) > 5.0  # beside the shaft's own line
    for row, w in zip(found.amplitude, found.perturbation / (2 * np.pi), strict=True):
        if abs(w - 20.0) > 8.0:
            peak = found.frequency[away][np.argmax(row[away])]
            assert abs(peak - w) < 2 * step + 1.0
    by_time = cascade(record, marks_of(record), "disk", over="time", spectra=5)
    assert by_time.position[0] < by_time.position[-1] <= record.duration
    with refuses(ValueError):
        cascade(record, marks_of(record), "disk", over="load")


def test_a_cascade_of_one_direction_is_what_its_probe_shows(record: rf.Recording) -> None:
    """Circles of 30 um at 1x: y has their size, at positive frequencies only, and an image where it would fold."""
    y = cascade(record, marks_of(record), "disk", spectra=5, direction="y")
    assert y.frequency.min() == 0
    once = np.abs(y.frequency - y.shaft.mean() / (2 * np.pi)) < 1.0
    assert y.amplitude[:, once].max() == pytest.approx(30e-6, rel=0.02)  # by the window's points
    (axis,) = record.plot.cascade(direction="y", lines={"w − 1x": (1, -1)}, unit="mil_pp").axes
    words = [text.get_text() for text in axis.texts]
    assert "w − 1x" in words
    assert "−1x" not in words
    assert any(text.endswith("mil pp") for text in words)
    assert axis.get_xlim()[0] == 0
    tops = [record.plot.timebase(unit=u).axes[0].get_lines()[0].get_ydata().max() for u in ("mil_pp", "mil")]
    assert tops[0] == pytest.approx(tops[1])  # positions are not counted peak to peak
    with refuses(ValueError):
        record.plot.cascade(direction="z")


def test_speeds_are_those_of_the_marks(record: rf.Recording) -> None:
    shaft, perturbator = speeds(marks_of(record))
    np.testing.assert_allclose(shaft.speed, 40 * np.pi, rtol=1e-3)
    np.testing.assert_allclose(perturbator.speed, 2 * np.pi * (5 + 10 * perturbator.t), rtol=0.01)
    np.testing.assert_allclose(perturbator.raw_speed, 2 * np.pi * (5 + 10 * perturbator.raw_t), rtol=0.02)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_drawn_and_can_be_read(record: rf.Recording, name: str) -> None:
    assert faults_of(getattr(record.plot, name)()) == []


def test_a_first_look_at_a_recording_is_its_timebase(record: rf.Recording) -> None:
    assert record.plot().get_suptitle() == record.plot.timebase().get_suptitle()


def test_figures_of_less_are_drawn_or_refused_in_words(tmp_path: Path) -> None:
    alone = rf.read_recording(write_hdf5(tmp_path / "run.h5", {"disk_X": volts()["disk_X"]}))
    for name in ("timebase", "full_spectrum", "cascade"):
        getattr(alone.plot, name)().savefig(tmp_path / "figure.png")
    for name, words in (
        ("orbit", "no plane has two probes"),
        ("centreline", "no plane has two probes"),
        ("speed", "no phase reference"),
        ("bode", "no phase reference of the shaft"), ("polar", "no phase reference of the shaft"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            getattr(alone.plot, name)()
    with refuses(ValueError):
        alone.plot.timebase("jornal")


def test_one_probe_reads_its_amplitude_in_the_full_spectrum(tmp_path: Path) -> None:
    """A motion of 50 um along one probe is a line of 50 um at both signs, not two of 25."""
    t = np.arange(3200) / RATE
    alone = rf.read_recording(write_hdf5(tmp_path / "run.h5", {"disk_X": -10 + 7870 * 50e-6 * np.cos(200 * np.pi * t)}))
    frequency, amplitude = spectrum(alone, "disk", 0.0, None)
    assert amplitude[np.abs(frequency) == 100.0] == pytest.approx([50e-6, 50e-6], rel=1e-3)


def test_vectors_of_a_sweep_pass_the_orders_of_the_shaft_smoothly() -> None:
    """At 2x windows mix the shaft's own second order in; the vectors that a fit gets do not."""
    record = rf.read_recording(rf.datasets.path("volts_journal-fwd.h5"))
    swept = swept_vectors(record)
    assert swept is not None
    windows = vectors_over_time(record, marks_of(record), "perturbator")

    def wiggle(vectors: OrderVectors) -> float:
        rpm = np.abs(vectors.speed) * 30 / np.pi
        near = (np.abs(rpm - 3000) < 400) & np.isfinite(vectors.phasors).all(axis=0)
        amplitude = np.abs(vectors.phasors[2, near])
        smooth = np.polyval(np.polyfit(rpm[near] - 3000, amplitude, 2), rpm[near] - 3000)
        return float(np.abs(amplitude / smooth - 1).max())

    assert wiggle(swept) < 0.01
    assert wiggle(windows) > 0.02
