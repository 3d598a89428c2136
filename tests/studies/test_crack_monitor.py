"""dK/K of dated tests: a shaft that cracks is found, a sound one left alone."""

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.models.shafts.combination_lines import line_order

SHAFT = rf.models.AnisotropicShaft(torsion=None)
OPEN = {"ec": 0.0, "es": 0.0, "Px": 0.0, "Py": 0.0}
W = -np.linspace(40.0, 310.0, 30)


def dated_fit(day, dK, rng):
    """Fit of one day's lateral lines, dK as it is that day but for what mounting changes."""
    theta = SHAFT.vector({"M": 1.0, "D": 14.0, "K": 4e4} | SHAFT.components(dK * (1 + 0.01 * rng.normal()), 0.6) | OPEN)
    parts = {}
    for name in ("w", "2Om-w"):
        clean = SHAFT.lines(theta, "z", line_order("z", name), W, 120.0, 3e-5 * W**2)
        parts[name] = clean + 2e-7 * (rng.normal(size=W.size) + 1j * rng.normal(size=W.size))
    count = 2 * W.size
    test = rf.LineTest(
        run=np.full(count, "a"),
        speed=np.full(count, 120.0),
        frequency=np.tile(W, 2),
        force_plane=np.full(count, "disk"),
        force=np.tile(3e-5 * W**2 + 0j, 2),
        plane=np.full(count, "disk"),
        direction=np.full(count, "z"),
        line=np.repeat(list(parts), W.size),
        response=np.concatenate(list(parts.values())),
        sigma=np.full(count, 2e-7),
        attributes={"date": np.full(count, f"2026-03-{day:02d}")},
        source=f"day{day}.h5",
    )
    return plain_fit(SHAFT, test, known=OPEN)


def test_a_crack_that_grows_is_found_between_its_dates():
    rng = np.random.default_rng(8)
    fits = [dated_fit(day, 800.0 if day < 7 else 1000.0, rng) for day in range(1, 13)]
    found = rf.trend([rf.dated_anisotropy(fit) for fit in fits])
    assert found.changed
    assert found.places[0].dates[found.places[0].change.index] == "2026-03-07"
    assert "a turning anisotropy that grows is what a propagating crack makes" in str(found)
    assert found.places[0].change.after[0] == pytest.approx(1000.0 / 4e4, rel=0.03)


def test_a_sound_shaft_is_left_alone():
    rng = np.random.default_rng(9)
    fits = [dated_fit(day, 800.0, rng) for day in range(1, 13)]
    assert not rf.trend([rf.dated_anisotropy(fit) for fit in fits]).changed


def test_saved_fits_are_followed_from_the_command_line(tmp_path, capsys):
    rng, files = np.random.default_rng(10), []
    for day in range(1, 9):
        files.append(tmp_path / f"day{day}.json")
        dated_fit(day, 800.0 if day < 5 else 1200.0, rng).save(files[-1])
    assert main(["trend", *map(str, files), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "turning anisotropy" in said
    assert (tmp_path / "out" / "trend.png").is_file()


def test_fits_without_an_anisotropy_are_refused_in_words():
    lateral = rf.models.AnisotropicShaft(torsion=None)
    test = rf.perturbation_test(
        run="a", speed=120.0, frequency=W, force_plane="disk", force=1.0, plane="disk", direction="z",
        response=1 / (4e4 + 14j * W - W**2), sigma=1e-9,
    )  # fmt: skip
    with refuses(ValueError):
        rf.dated_anisotropy(plain_fit(lateral, test, known=OPEN))
    mode = plain_fit(rf.models.OneMode(planes=("disk",)), test, known={"K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0})
    with refuses(ValueError):
        rf.dated_anisotropy(mode)
