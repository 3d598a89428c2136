"""A probe whose channel comes late: found by the check of the vectors, and put right by the setup."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import h5py
import numpy as np
import pytest
from plain import plain_fit
from recorded import write_hdf5
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.signals.late_channels import on_time

TRUTH = rf.datasets.truth("volts")["params"]
KNOWN = {name: TRUTH[name] for name in ("K3", "Ds", "sigma")}
THINNED, LATE = 5, 7  # samples of the quick recording for one of the slow, and by how many of them journal_Y is late
QUICK = 32_000.0
NOISE = 3e-3  # V


@cache
def quick() -> tuple[Path, ...]:
    """Two sweeps at five times the sampling rate that is to be seen: exactly late channels can be taken from them."""
    return tuple(
        rf.simulate_recordings(
            rf.models.WhirlWhip(), TRUTH, mkdtemp(), planes="journal", speed_rpm=1500.0, duration=8.0, seed=4,
            instruments=rf.Instruments(sample_rate=QUICK, noise=NOISE),
        )
    )  # fmt: skip


def recorded(folder: Path, late: int) -> list[Path]:
    """The sweeps with every fifth sample, those of journal_Y taken so many samples earlier."""
    paths = []
    for source in quick():
        with h5py.File(source) as file:
            attributes = dict(file.attrs) | {"sample_rate_hz": QUICK / THINNED}
            channels = {}
            for name, data in file.items():
                volts = data[:] * data.attrs.get("volts_per_count", 1.0)
                begin = 2 * THINNED + (-late if name == "journal_Y" else 0)
                channels[name] = volts[begin::THINNED][: data.size // THINNED - 4]
        paths.append(write_hdf5(folder / source.name, channels, attributes))
    return paths


def vectors(paths: list[Path], setup: str = "") -> rf.PerturbationTest:
    given = paths[0].parent / "rig.toml"
    given.write_text(setup, encoding="utf-8")
    test = rf.responses([rf.read_recording(path, given) for path in paths])
    assert isinstance(test, rf.PerturbationTest)
    return test


PROBES = "".join(
    f'[[probe]]\nplane = "{plane}"\nchannel = "{plane}_{axis}"\nangle_deg = {angle}\n'
    for plane in ("disk", "journal")
    for axis, angle in (("X", 0.0), ("Y", 90.0))
)
"""The last one is journal_Y, so that what follows in a setup is said of it."""


def test_a_late_channel_is_named_with_its_delay_and_put_right_by_the_setup(tmp_path: Path) -> None:
    delay = LATE / QUICK
    late = recorded(tmp_path, LATE)
    told = {finding.code: finding.message for finding in rf.check(vectors(late, PROBES))}["probe-delay"]
    assert f"if x is right, delays, journal.y = {delay:.3g} s" in told
    assert "delay_s of the probe in rig.toml" in told
    right = vectors(late, f"{PROBES}delay_us = {delay * 1e6}\n")
    assert "probe-delay" not in [finding.code for finding in rf.check(right)]
    fits = [plain_fit(rf.models.WhirlWhip(), test, known=KNOWN) for test in (vectors(late, PROBES), right)]
    astray, found = ([(fit.params[n].value - TRUTH[n]) / fit.params[n].stderr for n in ("D", "lam")] for fit in fits)
    assert np.abs(found).max() < 4  # normal: a chance of 1e-4
    assert np.abs(astray).max() > 10
    assert fits[1].redchi < 1.2


def test_a_late_channel_reads_as_one_on_time(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    right, late = recorded(tmp_path / "a", 0), recorded(tmp_path / "b", LATE)
    (tmp_path / "rig.toml").write_text(f"{PROBES}delay_s = {LATE / QUICK}\n", encoding="utf-8")
    for path, other in zip(right, late, strict=True):
        exact, given, put_right = (
            rf.read_recording(path, *setup)
            for path, setup in ((path, ()), (other, ()), (other, (tmp_path / "rig.toml",)))
        )
        rest = [record.channel("journal_Y") - exact.channel("journal_Y") for record in (given, put_right)]
        noise = 1.2 * np.sqrt(2) * NOISE  # that of other samples, and of counting
        assert rest[1][50:-50].std() < noise < rest[0][50:-50].std()
        for name in ("journal_X", "keyphasor_shaft"):
            np.testing.assert_array_equal(put_right.channel(name), exact.channel(name))
        assert np.abs(put_right.motion("journal") - exact.motion("journal"))[50:-50].std() < 2 * NOISE / 7870


@pytest.mark.parametrize("late", [0.3, -0.5, 2.75, -40.2, 17.0])
def test_samples_between_samples(late: float) -> None:
    """A cosine at 0.42 of the sampling rate, read in one piece and in several."""
    size = 1000
    clean = np.cos(2 * np.pi * 0.42 * np.arange(size) + 0.3)
    signal = np.cos(2 * np.pi * 0.42 * (np.arange(size) - late) + 0.3)
    parts = [on_time(lambda a, b: signal[a:b], n, min(n + 77, size), size, late) for n in range(0, size, 77)]
    assert np.abs(np.concatenate(parts) - clean)[80:-80].max() < 1e-4
    np.testing.assert_array_equal(np.concatenate(parts), on_time(lambda a, b: signal[a:b], 0, size, size, late))


@pytest.mark.parametrize(
    "said",
    [
        "delay_s = 0.2",
        "[perturbator]\nclock_ppm = 1e5",
        "delay_us = nan",
        "delay_s = 1e-4\ndelay_us = 100.0",
        "delay = 1e-4",
    ],
)
def test_a_delay_that_cannot_be_is_refused(tmp_path: Path, said: str) -> None:
    with refuses(ValueError):
        vectors(recorded(tmp_path, 0), f"{PROBES}{said}\n")


def test_the_template_offers_a_delay(tmp_path: Path) -> None:
    from rotorfit.lab.recordings.rig.template import template

    path = recorded(tmp_path, 0)[0]
    text = template(path)
    assert "# delay_us = 0.0" in text
    assert vectors([path], text.replace("# delay_us = 0.0", "delay_us = 10.0")).planes == ("disk", "journal")


def test_marks_of_a_clock_of_their_own_are_named_and_put_right_by_the_setup(tmp_path: Path) -> None:
    """A clock 20 ppm fast takes sample k at the time k/(1 + 2e-5) of that of the probes."""
    fast, paths = 2e-5, []
    for source in quick():
        with h5py.File(source) as file:
            volts = {name: data[:] * data.attrs.get("volts_per_count", 1.0) for name, data in file.items()}
            attributes = dict(file.attrs) | {"sample_rate_hz": QUICK / THINNED}
        at = np.arange(next(iter(volts.values())).size // THINNED - 1) * float(THINNED)
        channels = {
            name: np.interp(at / (1 + fast), np.arange(own.size), own) if "keyphasor" in name else own[at.astype(int)]
            for name, own in volts.items()
        }
        paths.append(write_hdf5(tmp_path / source.name, channels, attributes))
    fit = rf.fit(rf.models.WhirlWhip(), vectors(paths), known=KNOWN)
    assert [cause.name for cause in fit.causes.found] == ["clock"]
    assert "clock_ppm" in fit.causes["clock"].remedy
    assert -2 * fit.causes["clock"].value / 8.0 == pytest.approx(fast, rel=0.2)  # grows over the eight seconds
    told = vectors(paths, "[shaft]\nclock_ppm = 20.0\n[perturbator]\nclock_ppm = 20.0\n")
    right = rf.fit(rf.models.WhirlWhip(), told, known=KNOWN)
    assert not right.causes.found
    for one in (fit, right):
        for name in ("D", "lam", "K0", "Mf"):
            assert abs(one.params[name].value - TRUTH[name]) < 4 * one.params[name].stderr, name
