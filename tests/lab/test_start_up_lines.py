"""Lines 1x and 2x of start-ups of a heavy shaft that is not round, from volts of the shaft integrated in time."""

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses
from shaft_setups import PERTURBED, PROBES

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.estimators.signals.start_up_lines import StartUp, start_up_lines
from rotorfit.lab.simulation.shaft import Acquisition, Perturbation, RunUp, record_shaft, shaft_motion

SHAFT = rf.models.AnisotropicShaft(torsion=None)
TRUTH = {
    "M": 1.0, "D": 20.0, "K": 4e4, **SHAFT.components(2000.0, 0.6), "ec": 6e-6, "es": 3e-6, "Px": 0.0, "Py": -9.81,
}  # fmt: skip
CRITICAL = 200.0
RUNOUT = 8e-6 + 3e-6j


@pytest.fixture(scope="module")
def start_up(tmp_path_factory):
    """Eight seconds from 40 to 260 rad/s, through half the critical speed and through it."""
    folder = tmp_path_factory.mktemp("start-up")
    (folder / "rig.toml").write_text(PROBES)
    acquisition = Acquisition(sample_rate=1600.0, runout=RUNOUT)
    record_shaft(
        folder / "up.h5", SHAFT, TRUTH, RunUp(first=40.0, last=260.0, duration=8.0), 8.0, acquisition=acquisition
    )
    return folder


@pytest.fixture(scope="module")
def lines(start_up):
    return rf.shaft_lines(rf.read_recording(start_up / "up.h5", start_up / "rig.toml"))


def steady(rows, order):
    """What the shaft does at steady speeds, with its run-out."""
    clean = SHAFT.lines(SHAFT.vector(TRUTH), "z", order, 0.0, rows.speed, 0.0)
    return clean + (RUNOUT if order == (0, 0) else 0.0)


@pytest.mark.parametrize(("line", "order"), [("1x", (0, 0)), ("2x", (0, 1))])
def test_lines_of_a_start_up_are_those_of_steady_speeds(lines, line, order):
    rows = lines.select(lines.line == line)
    pulls = np.abs(rows.response - steady(rows, order)) / rows.sigma
    # Rayleigh: the greatest of some fifty is below 4.5 but for one record in 500; rms sqrt(2) to 15 %.
    assert pulls.max() < 4.5
    assert 1.0 < np.sqrt(np.mean(pulls**2)) < 1.9


def test_a_heavy_shaft_runs_at_2x_most_at_half_its_critical_speed(lines):
    rows = lines.select(lines.line == "2x")
    top = int(np.argmax(np.abs(rows.response)))
    near = np.sort(np.abs(rows.speed - CRITICAL / 2))[1]
    assert abs(rows.speed[top] - CRITICAL / 2) <= near + TRUTH["D"] / 4  # half the half-width of the resonance
    assert np.abs(rows.response[top]) == pytest.approx(np.abs(steady(rows, (0, 1))[top]), abs=4.5 * rows.sigma[top])


def test_a_start_up_alone_gives_the_anisotropy_for_a_known_mass(lines):
    fit = plain_fit(rf.models.AnisotropicShaft(torsion=None, runout=True), lines, known={"M": 1.0})
    assert fit.success
    assert 0.6 < fit.redchi < 1.5
    truth = TRUTH | {"R1c": RUNOUT.real, "R1s": RUNOUT.imag, "R2c": 0.0, "R2s": 0.0}
    for name, parameter in fit.params.items():
        if parameter.vary:
            assert abs(parameter.value - truth[name]) < 4 * parameter.stderr, name
    shape = fit.turning_anisotropy()
    assert shape.dK.stderr < 0.01 * shape.dK.value
    # Without its mass everything is known but for a factor.
    assert not plain_fit(rf.models.AnisotropicShaft(torsion=None, runout=True), lines).params["K"].resolved
    assert [axis.get_xlabel() for axis in fit.plot.lines().axes] == ["rotative speed, rpm"] * 4


def test_a_start_up_and_a_perturbation_sweep_are_fitted_together(start_up, lines):
    sweep = Perturbation(mr=3e-5, first=150.0, last=250.0)
    record_shaft(
        start_up / "sweep.h5", SHAFT, TRUTH, 60.0, 4.0, perturbation=sweep, acquisition=Acquisition(sample_rate=1600.0)
    )
    (start_up / "perturbed.toml").write_text(PERTURBED)
    swept = rf.shaft_lines(rf.read_recording(start_up / "sweep.h5", start_up / "perturbed.toml"))
    alone = plain_fit(SHAFT, swept, known=dict.fromkeys(("ec", "es", "Px", "Py"), 0.0))
    both = plain_fit(rf.models.AnisotropicShaft(torsion=None, runout=True), [swept, lines])
    for name in ("M", "D", "K", "dK_cos", "dK_sin", "ec", "es", "Px", "Py"):
        assert abs(both.params[name].value - TRUTH[name]) < 4 * both.params[name].stderr, name
    assert both.turning_anisotropy().dK.stderr < alone.turning_anisotropy().dK.stderr


@pytest.mark.usefixtures("sketched")
def test_the_command_line_takes_a_start_up(start_up, capsys):
    words = ["fit", str(start_up / "up.h5"), "--setup", str(start_up / "rig.toml"), "--model", "anisotropic-shaft"]
    assert main([*words, "--known", "M=1", "--out", str(start_up / "out")]) == 0
    said = capsys.readouterr().out
    assert "turning anisotropy: dK = " in said
    assert "R1c" in said


def test_a_shutdown_without_noise_comes_back_through_lines_as_it_went_in():
    """Nothing of the way from volts is in this: motion from the integrator, the angle as it was."""
    run = RunUp(first=240.0, last=60.0, duration=6.0)
    time = np.arange(6000) / 1000.0
    motion = shaft_motion(SHAFT, TRUTH, run, time, start=settled(run.first), tolerance=1e-9)
    found = start_up_lines(
        StartUp(
            rate=1000.0,
            angle=run.angle(time),
            speed=run.speed(time),
            acceleration=run.acceleration(time),
            motion=motion.z - motion.z.mean(),
        )
    )
    for order, place in ((1, (0, 0)), (2, (0, 1))):
        truth = SHAFT.lines(SHAFT.vector(TRUTH), "z", place, 0.0, found[order].frequency / order, 0.0)
        # Sampling at 1 kHz takes forces as constant over a step that is 0.24 rad at the most.
        assert np.abs(found[order].response[0, 0] - truth).max() < 2e-3 * np.abs(truth).max()


def settled(speed):
    theta = SHAFT.vector(TRUTH)
    orders = {(0, 0): speed, (0, -1): 0.0, (0, 1): 2 * speed}
    z = {order: complex(SHAFT.lines(theta, "z", order, 0.0, speed, 0.0)) for order in orders}
    return sum(z.values()), sum(1j * rate * z[order] for order, rate in orders.items()), 0.0, 0.0


def test_start_ups_that_cannot_be_used_are_refused_in_words(start_up):
    one = PROBES.replace('[[probe]]\nplane = "disk"\nchannel = "disk_Y"\nangle_deg = 90.0\n', "")
    (start_up / "one.toml").write_text(one)
    with refuses(ValueError):
        rf.shaft_lines(rf.read_recording(start_up / "up.h5", start_up / "one.toml"))
    two = PROBES.replace('plane = "disk"\nchannel = "disk_Y"', 'plane = "rotor"\nchannel = "disk_Y"')
    (start_up / "two.toml").write_text(two)
    with refuses(ValueError):
        rf.shaft_lines(rf.read_recording(start_up / "up.h5", start_up / "two.toml"))
    records = []
    for grams in (1e-5, 2e-5):
        path = start_up / f"weight-{grams:g}.toml"
        path.write_text(PROBES + f'[force]\nplane = "disk"\nmr_kg_m = {grams}\nangle_deg = 0.0\nwhirl = "forward"\n')
        records.append(rf.read_recording(start_up / "up.h5", path))
    with refuses(ValueError):
        rf.shaft_lines(records)
