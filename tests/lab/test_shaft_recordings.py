"""From volts to the parameters of a shaft that is not round: recordings of the virtual shaft, read and fitted."""

import html

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses
from shaft_setups import TWISTED

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.simulation.shaft import Acquisition, Crack, Perturbation, record_shaft

SPEED = 120.0
SHAFT = rf.models.AnisotropicShaft()
TRUTH = {
    "M": 1.0, "D": 14.0, "K": 4e4, **SHAFT.components(2000.0, 0.6), "ec": 6e-5, "es": 0.0, "Px": 0.0, "Py": -8.0,
    "J": 2e-4, "nu_t": 340.0, "zeta_t": 0.01,
}  # fmt: skip


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(TWISTED)
    return path


@pytest.fixture(scope="module")
def backward(tmp_path_factory):
    path = tmp_path_factory.mktemp("records") / "backward.h5"
    sweep = Perturbation(mr=3e-5, first=20.0, last=320.0, heavy_spot=0.3)
    return record_shaft(
        path, SHAFT, TRUTH, SPEED, 15.0, perturbation=sweep, acquisition=Acquisition(sample_rate=2000.0)
    )


@pytest.mark.slow
def test_a_backward_sweep_gives_the_shaft_and_its_twist_from_volts(backward, setup):
    test = rf.shaft_lines(rf.read_recording(backward, setup))
    fit = plain_fit(SHAFT, test, known={"J": 2e-4})
    limits = {"M": 0.005, "K": 0.005, "D": 0.02, "nu_t": 0.004, "zeta_t": 0.1}  # those of the issue
    for name, limit in limits.items():
        found = fit.params[name]
        assert found.value == pytest.approx(TRUTH[name], rel=limit), name
        assert abs(found.value - TRUTH[name]) < 4 * found.stderr, name
    shape = fit.turning_anisotropy()
    assert shape.dK.value == pytest.approx(2000.0, rel=0.03)
    assert abs(shape.dK.value - 2000.0) < 4 * shape.dK.stderr
    assert np.degrees(shape.angle.value) == pytest.approx(np.degrees(0.6), abs=2.0)
    # Noise of lines from local fits with few degrees of freedom, pulses' jitter shared among them: within a factor.
    assert 0.4 < fit.redchi < 1.5


def test_the_twist_at_twice_the_frequency_tells_the_inertia(backward, setup):
    """Its torque is that of the motion itself, so that neither 1x nor a known J is needed."""
    test = rf.shaft_lines(rf.read_recording(backward, setup))
    rows = test.select(test.line == "2w-2Om")
    truth = SHAFT.lines(SHAFT.vector(TRUTH), "twist", (2, 0), rows.frequency, SPEED, rows.force)
    pulls = np.abs(rows.response - truth) / rows.sigma
    assert (np.abs(truth) / rows.sigma).max() > 10  # it is there
    # Rayleigh with an rms of sqrt(2): of some forty the greatest is below 4 but for one record in a hundred
    assert pulls.max() < 4.5
    assert 1.0 < np.sqrt(np.mean(pulls**2)) < 1.9
    found = plain_fit(SHAFT, test).params["J"]
    assert found.resolved
    assert abs(found.value - TRUTH["J"]) < 4 * found.stderr
    assert found.stderr < 0.05 * TRUTH["J"]


def test_1x_and_2x_tell_what_else_is_left_open(backward, setup):
    test = rf.shaft_lines(rf.read_recording(backward, setup), runout_um=0.2)
    fit = plain_fit(SHAFT, test)
    for name in ("ec", "es", "Px", "Py", "J"):
        found = fit.params[name]
        assert found.resolved
        assert abs(found.value - TRUTH[name]) < 4 * found.stderr, name
    assert fit.params["J"].value == pytest.approx(2e-4, rel=0.05)


@pytest.mark.slow
def test_a_record_without_perturbation_and_with_a_crack_breathes(tmp_path, setup):
    heavy = TRUTH | {"dK_cos": 0.0, "dK_sin": 0.0, "ec": 0.0, "Py": -40.0}
    lines = {}
    for name, crack in (("sound", None), ("cracked", Crack(stiffness=4000.0))):
        path = record_shaft(tmp_path / f"{name}.h5", SHAFT, heavy, SPEED, 4.0, crack=crack)
        z = rf.read_recording(path, _without_perturbator(tmp_path)).motion("disk")[6400:]  # transients over
        time = np.arange(z.size) / 3200.0
        lines[name] = [abs(np.mean(z * np.exp(-1j * k * SPEED * time))) for k in (1, 2, 3)]
    assert max(lines["sound"]) < 1e-7
    # A crack that opens and closes makes 1x, 2x and 3x; one that is always open would make 2x alone.
    assert min(lines["cracked"]) > 2e-6


def _without_perturbator(folder):
    path = folder / "plain.toml"
    path.write_text(TWISTED.replace('[perturbator]\nchannel = "keyphasor_perturbator"\n', ""))
    return path


def test_recordings_without_what_lines_need_are_refused_in_words(tmp_path, backward, setup):
    alone = record_shaft(tmp_path / "alone.h5", SHAFT, TRUTH, SPEED, 1.0)
    plain = rf.read_recording(alone, _without_perturbator(tmp_path))
    with refuses(ValueError):
        rf.shaft_lines(plain)
    with refuses(ValueError):
        rf.shaft_lines([])
    with refuses(ValueError):
        rf.shaft_lines(rf.read_recording(backward, setup), runout_um=-1.0)
    one = TWISTED.replace('[[probe]]\nplane = "disk"\nchannel = "disk_Y"\nangle_deg = 90.0\n', "")
    (tmp_path / "one.toml").write_text(one)
    with refuses(ValueError):
        rf.shaft_lines(rf.read_recording(backward, tmp_path / "one.toml"))


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_the_command_line_goes_from_volts_to_the_anisotropy(backward, setup, tmp_path, capsys):
    words = ["fit", str(backward), "--setup", str(setup), "--model", "anisotropic-shaft"]
    assert main([*words, "--known", "J=2e-4", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "no closed form: combination lines have none" in said
    assert "turning anisotropy: dK = 200" in said
    assert rf.load_fit(tmp_path / "out" / "fit.json").params["J"].value == 2e-4
    assert main([*words, "--runout-um", "0.2", "--quiet", "--out", str(tmp_path / "more")]) == 0
    page = (tmp_path / "more" / "report.html").read_text()
    assert "fit backward.h5 --setup rig.toml --model anisotropic-shaft --runout-um 0.2" in page
    assert "runout_um=0.2)" in page
    assert "amplitudes of the shaft's combination lines" in html.unescape(page)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--runout-um", "-1"], "--runout-um"),
        (["--known", "nu=3"], "unknown parameter of anisotropic-shaft 'nu'"),
        (["--planes", "rotor"], "has the plane disk, anisotropic-shaft has rotor"),
        (["--planes", "a,b"], "anisotropic-shaft has 1 plane"),
    ],
)
def test_awkward_words_of_the_command_line_are_refused_in_a_sentence(backward, setup, more, sentence, capsys):
    try:
        code = main(["fit", str(backward), "--setup", str(setup), "--model", "anisotropic-shaft", *more])
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    assert sentence in capsys.readouterr().err
