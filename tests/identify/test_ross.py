"""Rotors of the ROSS package in and out: files of both of its lines, and rotors of the one that is installed."""

from __future__ import annotations

import json
import shlex
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from known_shaft import rig_matrices
from plain import plain_fit
from scipy.io import loadmat, savemat
from seal_rig import FLUID, floating_stator
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.lab.io.shafts import ross_rotor
from rotorfit.models import KnownStructure, eigenvalues

FILES = Path(__file__).parents[1] / "data" / "ross"
VERSIONS = ("2.3.0", "3.1.0")
PLANES = {"disk": 2, "oil": 4}


def answers(version):
    return json.loads((FILES / f"answers-{version}.json").read_text())


def from_file(version, **options):
    return KnownStructure.from_ross(FILES / f"shaft-{version}.mat", planes=PLANES, fluid="oil", **options)


def directional(H):
    """ROSS's receptance of (x, y) at each plane as that of z = x + jy at +w: forward forces, forward responses."""
    size = len(H) // 2
    H = H.reshape(size, 2, size, 2)
    force = np.array([1.0, -1j])
    return np.einsum("paqb,b,a->pq", H, force, np.array([1.0, 1j])) / 2


@pytest.fixture(scope="module")
def ross():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ROSS and what it imports
        import ross

    return ross


@pytest.fixture(scope="module")
def rotor(ross):
    """The rotor of the files, by whatever ROSS is installed."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("make_ross_files", FILES / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return make.rotor(fluid=True)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_saved_shaft_with_the_fluid_responds_as_ross_says(version):
    """Responses 1e-8 and eigenvalues of ROSS's own state matrix, which has x and y apart and six coordinates a node."""
    said = answers(version)
    model = from_file(version)
    theta = model.vector(said["fluid"])
    for line in said["responses"]:
        H = np.array(line["re"]) + 1j * np.array(line["im"])
        here = model.receptance(theta, line["frequency"], line["speed"])
        np.testing.assert_allclose(here, directional(H), rtol=1e-8)
    for case in said["eigenvalues"]:
        theirs = np.array(case["re"]) + 1j * np.array(case["im"])
        for s in eigenvalues(model, theta, case["speed"]):
            # Highest of its 30 complex coordinates: 1e6 rad/s, whose round-off in the state matrix is 1e-7 of that.
            assert np.abs(theirs - s).min() < 1e-8 * abs(s) + 1e-3 * (abs(s) > 1e4)


def test_both_lines_save_the_same_shaft():
    first, second = (from_file(version).shaft.matrices for version in VERSIONS)
    for kind in "MCGK":
        mine, other = getattr(first, kind), getattr(second, kind)
        np.testing.assert_allclose(mine, other, atol=1e-12 * np.abs(mine).max())


def test_a_rotor_gives_up_its_fluid_by_tag(rotor):
    made = KnownStructure.from_ross(rotor, planes={"disk": "disk"}, fluid="oil")
    assert made.planes == ("disk", "oil")
    assert made.fluid == ("oil",)
    saved = from_file("2.3.0")
    for kind in "MCGK":
        mine, other = getattr(made.shaft.matrices, kind), getattr(saved.shaft.matrices, kind)
        np.testing.assert_allclose(mine, other, atol=1e-12 * np.abs(mine).max())


def test_a_support_taken_out_comes_back_by_its_parameters(rotor):
    model = KnownStructure.from_ross(rotor, planes={"disk": 2}, fluid="oil", supports="left")
    assert model.parameter_names == ("Ks", "Ds", "K0", "D", "lam", "Mf")
    said = answers("2.3.0")["fluid"]
    w = np.array([60.0, -250.0, 700.0])
    at = [model.planes.index(plane) for plane in ("disk", "oil")]
    mine = model.receptance(model.vector({**said, "Ks": 3e6, "Ds": 50.0}), w, 400.0)[:, at][:, :, at]
    np.testing.assert_allclose(mine, from_file("2.3.0").receptance(list(said.values()), w, 400.0), rtol=1e-8)


# ---- files of other kinds ------------------------------------------------------------------------------


def test_the_same_matrices_as_npz_and_as_tables(tmp_path):
    content = loadmat(FILES / "shaft-2.3.0.mat")
    matrices = {name: content[name] for name in ("M", "C", "G", "K", "nodes")}
    np.savez(tmp_path / "shaft.npz", **matrices)
    (tmp_path / "shaft").mkdir()
    for name, matrix in matrices.items():
        np.savetxt(tmp_path / "shaft" / f"{name}.csv", matrix, delimiter=";")
    expected = from_file("2.3.0").shaft.matrices
    for path in (tmp_path / "shaft.npz", tmp_path / "shaft"):
        found = KnownStructure.from_ross(path, planes=PLANES, fluid="oil").shaft.matrices
        for kind in "MCGK":
            np.testing.assert_array_equal(getattr(found, kind), getattr(expected, kind))


def saved(tmp_path, **changes):
    content = {name: value for name, value in loadmat(FILES / "shaft-2.3.0.mat").items() if name[0] != "_"}
    savemat(tmp_path / "shaft.mat", {k: v for k, v in {**content, **changes}.items() if v is not None})
    return tmp_path / "shaft.mat"


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"M": None, "K": None, "data": np.eye(3)}, {}),
        ({"nodes": None}, {}),
        ({"nodes": np.arange(7.0)}, {}),
        ({"nodes": np.arange(5.0) * 150}, {}),
        ({"K": np.array(["a"])}, {}),
        ({"K": np.eye(24)}, {}),
        ({"M": np.full((30, 30), np.nan)}, {}),
        ({}, {"fluid": "Bearing 1"}),
        ({}, {"planes": {"disk": 2, "oil": 14}}),
        ({}, {"planes": {"disk": 2, "oil": "spring"}}),
        ({"nodes": np.arange(4.0)}, {}),
    ],
)
def test_files_that_are_no_shaft(tmp_path, changes, options):
    with refuses(ValueError):
        KnownStructure.from_ross(saved(tmp_path, **changes), **{"planes": PLANES, "fluid": "oil", **options})


def test_files_of_something_else(tmp_path):
    (tmp_path / "cut.mat").write_bytes((FILES / "shaft-2.3.0.mat").read_bytes()[:3000])
    (tmp_path / "not.npz").write_text("M,K")
    (tmp_path / "shaft.xlsx").write_text("")
    (tmp_path / "study.toml").write_text("files = []\n")
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "M.csv").write_text("1,2\n3\n")
    for name, message in (
        ("cut.mat", "cut.mat is not a readable MAT file"),
        ("not.npz", "not.npz is not a readable npz file"),
        ("shaft.xlsx", "matrices of a shaft come as"),
        ("study.toml", "not a rotor saved by ROSS: it has no 'parameters'"),
        ("table", "M.csv: rows have 1 and 2 numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            KnownStructure.from_ross(tmp_path / name, planes=PLANES)
    with pytest.raises(FileNotFoundError):
        KnownStructure.from_ross(tmp_path / "none.mat", planes=PLANES)
    with refuses(ValueError):
        KnownStructure.from_ross({}, planes=PLANES)


# ---- rotors --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_saved_rotors_are_read_by_either_line_of_ross(ross, version, tmp_path, capfd):
    """A table's 'frequency' means the speed in the one, that of the whirl in the other: K at 300 rad/s is the same."""
    path = FILES / f"rotor-{version}.toml"
    model = KnownStructure.from_ross(path, planes={"disk": 2}, fluid="oil")
    K = from_file(version).shaft.matrices.K
    np.testing.assert_allclose(model.shaft.matrices.K, K, atol=1e-12 * np.abs(K).max())
    content = tomllib.loads(path.read_text())
    if version[0] == "3":  # what JSON has beside, as null
        content["parameters"]["modal_damping_ratio"] = None
        for part in content.values():
            if "kxx" in part:
                part.setdefault("frequency", None)
                part.setdefault("radial_clearance", None)
    (tmp_path / "rotor.json").write_text(json.dumps(content))
    again = ross_rotor._load_rotor(tmp_path / "rotor.json")
    fluid = answers(version)["fluid"]
    (oil,) = [e for e in again.bearing_elements if e.tag == "oil"]
    assert oil.K(300.0)[0, 1] == pytest.approx(fluid["D"] * fluid["lam"] * 300.0, rel=1e-9)
    assert capfd.readouterr().out == ""  # compiled code of packages that ROSS imports prints
    content["ross_version"] = "nightly"
    (tmp_path / "rotor.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"saved by ROSS nightly.*save_mat"):
        ross_rotor._load_rotor(tmp_path / "rotor.json")


def test_what_the_other_line_does_not_have_is_refused():
    content = {"parameters": {"alpha": 0.0}, "BearingElement_a": {"frequency": [0.0, 1.0], "speed": [0.0, 1.0]}}
    with refuses(ValueError):
        ross_rotor._in_line(content, 3, 2)
    with refuses(ValueError):
        ross_rotor._in_line({"parameters": {"alpha": 0.1}}, 3, 2)


def test_a_fluid_left_in_a_file_is_refused(tmp_path):
    """Its damping, or its cross-coupling where the matrices were saved at a speed, would be fitted a second time."""
    shaft = loadmat(FILES / "shaft-2.3.0.mat")
    at = [6 * PLANES["oil"], 6 * PLANES["oil"] + 1]
    damped, coupled = shaft["C"].copy(), shaft["K"].copy()
    damped[at, at] += 600.0
    coupled[np.ix_(at, at)] += np.array([[0.0, 8e4], [-8e4, 0.0]])
    for changes in ({"C": damped}, {"K": coupled}):
        path = saved(tmp_path, **changes)
        with refuses(ValueError):
            KnownStructure.from_ross(path, planes=PLANES, fluid="oil")


def test_the_rig_assembled_by_ross_is_the_one_behind_the_data(ross):
    """Matrices of another assembly of the same beam theory, and the fit of the bundled data."""
    truth = rf.datasets.truth("rig_open")["params"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        steel = ross.Material(name="steel", rho=7810, E=2.11e11, G_s=8.12e10)
        length = truth["L"] / truth["nel"]
        elements = [ross.ShaftElement(L=length, idl=0, odl=truth["d"], material=steel) for _ in range(truth["nel"])]
        disks = [
            ross.DiskElement(n=truth["n_disk"], m=truth["m_disk"], Id=4e-4, Ip=7.5e-4, tag="disk"),
            ross.DiskElement(n=truth["n_brg"], m=truth["m_jrn"], Id=2e-5, Ip=3e-5, tag="journal"),
        ]
        bearings = [
            ross.BearingElement(n=0, kxx=5e7, cxx=0.0),
            ross.BearingElement(n=truth["n_brg"], kxx=truth["K3"], cxx=0.0),
        ]
        model = KnownStructure.from_ross(
            ross.Rotor(elements, disks, bearings),
            planes={"disk": "disk", "journal": "journal"},
            fluid="journal",
            damping="disk",
        )
    M, G, K = rig_matrices()
    for mine, theirs in ((M, model.shaft.matrices.M), (-1j * G, model.shaft.matrices.G), (K, model.shaft.matrices.K)):
        np.testing.assert_allclose(theirs, mine, atol=1e-12 * np.abs(mine).max())
    fit = plain_fit(model, rf.datasets.rig_open())
    assert 0.9 < fit.redchi < 1.1
    assert fit.params["K0"].value == pytest.approx(10000, rel=0.02)


@pytest.mark.parametrize(
    "options",
    [
        {"fluid": "Bearing 1"},
        {"fluid": "disk", "planes": {"d": 2}},
        {"planes": {"disk": "Disk 7"}},
        {},
        {"fluid": "j", "planes": {"j": 4}, "speed": 100.0},
    ],
)
def test_rotors_that_cannot_be_taken(rotor, options):
    with refuses(ValueError):
        KnownStructure.from_ross(rotor, **{"planes": {"disk": 2}, **options})


@pytest.mark.parametrize("coefficients", [{"kxx": 3e6, "kyy": 2e6}, {"kxx": 3e6, "kyy": 3e6, "kxy": 4e5, "kyx": -3e5}])
def test_a_bearing_that_differs_in_x_and_y_is_named(ross, rotor, coefficients):
    odd = ross.BearingElement(n=0, **coefficients, cxx=0.0, tag="feet")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        changed = ross.Rotor(rotor.shaft_elements, rotor.disk_elements, [odd])
    with refuses(ValueError):
        KnownStructure.from_ross(changed, planes={"disk": 2})
    model = rf.models.Orthotropic(KnownStructure.from_ross(changed, planes={"disk": 2}, supports="feet"), at="feet")
    assert model.parameter_names == ("Ks", "Ds", "dKs", "dDs", "angle_s")


def test_coordinates_that_a_file_does_not_say_are_given(tmp_path):
    path = saved(tmp_path, nodes=None)
    model = KnownStructure.from_ross(path, planes=PLANES, dofs=rf.models.ROSS_6)
    np.testing.assert_array_equal(model.shaft.matrices.K, from_file("2.3.0").shaft.matrices.K)


# ---- on the command line ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Responses of the shaft with ROSS's fluid, two speeds, 1 % noise."""
    model = from_file("2.3.0")
    theta = model.vector(answers("2.3.0")["fluid"])
    half = np.linspace(20.0, 600.0, 20)
    w = np.r_[-half[::-1], half]
    rng = np.random.default_rng(1)
    rows = []
    for speed in (150.0, 300.0):
        H = 10.0 * model.receptance(theta, w, speed)
        for i, plane in enumerate(model.planes):
            z = H[:, i, 1]
            sigma = 0.01 * np.sqrt(np.mean(np.abs(z) ** 2))
            z = z + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
            rows.append({"plane": plane, "response": z, "sigma": sigma, "speed": speed, "frequency": w})
    columns = {name: np.concatenate([np.broadcast_to(row[name], w.shape) for row in rows]) for name in rows[0]}
    test = rf.perturbation_test(**columns, run="a", force_plane="oil", force=10.0, direction="z")
    folder = tmp_path_factory.mktemp("rig")
    rf.write(test, folder / "rig.csv")
    (folder / "shaft.mat").write_bytes((FILES / "shaft-2.3.0.mat").read_bytes())
    (folder / "study.toml").write_text(
        'files = ["rig.csv"]\nstructure = "shaft.mat"\nplanes = {disk = 2, oil = 4}\nfluid = ["oil"]\n'
    )
    return folder


def code_of(words):
    try:
        return cli.main(words)
    except SystemExit as stop:
        return stop.code


def test_the_report_says_how_to_make_a_fit_of_a_file_s_shaft_again(rig, capsys):
    from rotorfit.show.report.material import ReportInput
    from rotorfit.show.report.reproduce import _calls, _command

    model = rf.models.KnownStructure.from_ross(rig / "shaft.mat", planes={"disk": 2, "oil": 4}, fluid="oil")
    fit = plain_fit(model, rf.read(rig / "rig.csv"))
    material = ReportInput(fit=fit)
    words = shlex.split(_command(material))
    assert words[4:10] == ["--structure", str(rig / "shaft.mat"), "--planes", "disk=2,oil=4", "--fluid", "oil"]
    assert any(f"KnownStructure.from_ross('{rig / 'shaft.mat'}', planes=" in line for line in _calls(material))
    words = [str(rig / word) if word == "rig.csv" else word for word in words[1:-2]]
    assert cli.main([*words, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)["parameters"]
    assert again["D"]["value"] == pytest.approx(fit.params["D"].value, rel=1e-9)


def test_a_shaft_on_the_command_line_and_in_a_study(rig, capsys):
    shaft = ["--structure", str(rig / "shaft.mat"), "--planes", "disk=2,oil=4", "--fluid", "oil"]
    found = []
    for words in (["fit", str(rig / "rig.csv"), *shaft], ["run", str(rig / "study.toml")]):
        assert cli.main([*words, "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["parameters"])
    assert found[0] == found[1]
    for name, value in answers("2.3.0")["fluid"].items():
        assert abs(found[0][name]["value"] - value) < 4 * found[0][name]["stderr"], name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--structure", "shaft.mat", "--planes", "disk,oil"], "planes: with structure each plane has its node"),
        (["--structure", "shaft.mat", "--planes", "disk=2,disk=4"], "NAME=NODE"),
        (["--structure", "shaft.mat", "--planes", "disk=2,oil=40"], "nodes 0 to 4"),
        (["--structure", "rig.csv", "--planes", "disk=2,oil=4"], "matrices of a shaft come as"),
        (["--structure", "shaft.mat", "--model", "one-mode"], "makes the model known-structure, not one-mode"),
        (["--model", "one-mode", "--fluid", "oil"], "fluid: only for a shaft from a file"),
        (["--model", "known-structure"], "structure names its matrices"),
        ([], "--model is missing"),
    ],
)
def test_words_that_make_no_shaft(rig, capsys, monkeypatch, words, message):
    monkeypatch.chdir(rig)
    assert code_of(["fit", "rig.csv", *words]) == 2
    assert message in capsys.readouterr().err


# ---- back into ROSS --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit(rig):
    return plain_fit(from_file("2.3.0"), rf.read(rig / "rig.csv"))


def test_a_rotor_with_the_fitted_element_is_the_fitted_rotor(ross, rotor, fit, tmp_path):
    """ROSS's responses are the fit's to 1e-8, its eigenvalues cross the axis at the fit's threshold to 1e-6."""
    from scipy.optimize import brentq

    onset = fit.threshold_speed().value
    speeds = np.linspace(0.0, 1.5 * onset, 7)
    element = fit.to_ross(speeds)["oil"]
    assert element.line == int(ross.__version__.partition(".")[0])
    element.save(tmp_path / "oil.toml")
    element.save(tmp_path / "oil.json")
    others = [e for e in rotor.bearing_elements if e.tag != "oil"]
    for made in (
        element.build(),
        ross.BearingElement.load(tmp_path / "oil.toml"),
        ross.BearingElement.load(tmp_path / "oil.json"),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            whole = ross.Rotor(rotor.shaft_elements, rotor.disk_elements, [*others, made])
        at = [6 * node + axis for node in (2, 4) for axis in (0, 1)]
        for frequency in (60.0, 250.0, 700.0):
            H = whole.transfer_matrix(speed=speeds[2], frequency=frequency)[np.ix_(at, at)]
            mine = fit.model.receptance(fit.theta(), frequency, speeds[2])
            np.testing.assert_allclose(directional(H), mine, rtol=1e-8)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        put = fit.to_ross_rotor(rotor, speeds)
    H = put.transfer_matrix(speed=speeds[2], frequency=250.0)[np.ix_(at, at)]
    np.testing.assert_allclose(directional(H), fit.model.receptance(fit.theta(), 250.0, speeds[2]), rtol=1e-8)
    assert len(put.bearing_elements) == len(rotor.bearing_elements)  # the oil film in place of the rotor's own
    with refuses(TypeError):
        fit.to_ross_rotor("rotor.toml", speeds)
    with refuses(ValueError):
        fit.to_ross_rotor(rotor, speeds, nodes={"oil": 99})

    def growth(speed):
        s = np.linalg.eigvals(whole.A(speed=speed, frequency=speed))
        return s[np.abs(s.imag) < 5 * onset].real[np.abs(s[np.abs(s.imag) < 5 * onset]) > 1.0].max()

    assert brentq(growth, 0.9 * onset, 1.1 * onset, rtol=1e-10) == pytest.approx(onset, rel=1e-6)


def test_what_the_table_is_called_belongs_to_the_line_of_ross(fit):
    speeds = np.linspace(0.0, 600.0, 7)
    older, newer = (fit.to_ross(speeds, version=version)["oil"] for version in ("2.3", "3.1"))
    assert "frequency" in older.arguments
    assert "speed" in newer.arguments
    assert {"frequency", "speed"} & set(older.arguments) == {"frequency"}
    assert "Not for ROSS 3.x or later" in str(older)
    p = {name: fit.params[name].value for name in fit.params}
    at = newer.arguments
    np.testing.assert_allclose(at["cxy"], 2 * p["lam"] * np.array(at["speed"]) * p["Mf"], rtol=1e-12)
    np.testing.assert_allclose(at["kxx"], p["K0"] - p["Mf"] * (p["lam"] * np.array(at["speed"])) ** 2, rtol=1e-12)
    # Halfway between two speeds ROSS 3.x misses what is quadratic; the finer the table the less.
    finer = fit.to_ross(np.linspace(0.0, 600.0, 61), version="3.1")["oil"]
    assert older.between < 1e-12
    assert finer.between < newer.between / 10 < 0.1


def test_an_element_holds_the_coefficients_that_tables_print():
    """Of a fluid whose damping falls by 30 % when the speed doubles, which the fit finds."""
    model, fixed = rf.models.OneMode(), {"K": 8e3, "Ds": 8.0}
    true, slow, fast = {"M": 1.2, **fixed, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}, 1000.0, 1800.0
    rpm = [*range(-3000, 0, 120), *range(120, 3001, 120)]
    tests = [
        rf.simulate(model, {**true, "D": d}, speed_rpm=v, frequency_rpm=rpm, force=5.0, noise=0.005, seed=int(v))
        for v, d in ((slow, 489.0), (fast, 411.0))
    ]
    fit = rf.fit(model, tests, known=fixed)
    assert fit.causes["speed[D]"].found
    speeds = np.array([0.5, 1.0, 1.3, 1.6, 1.8]) * slow * np.pi / 30
    table = fit.to_ross(speeds, version="3.1", nodes={"journal": 3})["journal"].arguments
    for row, speed in enumerate(table["speed"]):
        for name in ("Kxx", "Kxy", "Cxx", "Cxy", "Mxx"):
            found = table.get(name.lower(), [0.0] * len(table["speed"]))[row]
            assert found == pytest.approx(fit.coefficients(speed)[name].value, rel=1e-12)
    assert table["cxx"][0] > 1.2 * table["cxx"][-1]


def test_supports_become_elements_of_their_own():
    model = from_file("2.3.0", damping="disk")
    odd = rf.models.Orthotropic(KnownStructure.from_ross(FILES / "shaft-2.3.0.mat", planes=PLANES, supports="oil"))
    from rotorfit.lab.io.shafts.ross_elements import ross_elements

    common = {"speeds": [0, 1, 2, 3, 4], "version": 3, "nodes": None, "element": "seal", "eccentricity": 0.0}
    fluid = model.vector({"Ds": 4.0, "K0": 1e4, "D": 5.0, "lam": 0.4, "Mf": 0.1})
    both = ross_elements(model, lambda speed: fluid, **common)
    assert both["disk"].arguments == {"n": 2, "kxx": 0.0, "cxx": 4.0, "cyy": 4.0, "tag": "disk"}
    assert both["oil"].kind == "SealElement"
    theta = odd.vector({"Ks": 1e5, "Ds": 20.0, "dKs": 2e4, "dDs": 4.0})
    support = ross_elements(odd, lambda speed: theta, **common)["oil"].arguments
    assert support == {"n": 4, "kxx": 1.1e5, "kyy": 0.9e5, "cxx": 22.0, "cyy": 18.0, "tag": "oil"}


@pytest.mark.parametrize(
    ("speeds", "options"),
    [
        ([0, 1, 2, 3], {}),
        ([0, 1, 2, 3, np.nan], {}),
        ([-1, 0, 1, 2, 3], {}),
        ([0, 1, 2, 3, 4], {"version": "latest"}),
        ([0, 1, 2, 3, 4], {"element": "disk"}),
    ],
)
def test_elements_that_cannot_be(fit, speeds, options):
    with refuses(ValueError):
        fit.to_ross(speeds, **{"version": "3.1", **options})


def test_an_element_is_built_by_its_own_line_alone(fit, ross, tmp_path):
    other = "2.3" if ross.__version__[0] == "3" else "3.1"
    with pytest.raises(ValueError, match=f"for ROSS {other[0]}.x, and ROSS is of version"):
        fit.to_ross([0, 100, 200, 300, 400], version=other)["oil"].build()
    with refuses(ValueError):
        fit.to_ross([0, 100, 200, 300, 400])["oil"].save(tmp_path / "oil.csv")


@pytest.fixture(scope="module")
def by_speed_and_pressure():
    """A seal on a floating stator at three speeds and two pressures, each with coefficients of its own."""
    tables = [
        floating_stator(speeds_rpm=(1500.0, 3000.0, 4500.0), mass=0.0, exact=True, frequency_hz=np.linspace(20, 200, 9))
        .assign(P_bar=bar, amplitude_um=lambda own, bar=bar: own["amplitude_um"] * 30.0 / bar)
        .assign(run=lambda own, bar=bar: own["run"] + f" {bar:g}")
        for bar in (15.0, 30.0)
    ]
    names = [kind + row + column for kind in "KDM" for row in "xy" for column in "xy"]
    test = rf.read(pd.concat(tables))
    model = rf.models.Anisotropic(("stator",))
    return [
        plain_fit(model, test, per=dict.fromkeys(names, "speed_rpm+P_bar")),
        plain_fit(model, rf.read(tables[1]), per=dict.fromkeys(names, "speed_rpm")),
    ]


@pytest.mark.parametrize("version", ["2.3", "3.1"])
def test_one_table_over_the_speeds_that_were_fitted_one_by_one(by_speed_and_pressure, version):
    """Rows at the tested speeds are the truth of the simulation; older lines of ROSS get rows between."""
    both, one = by_speed_and_pressure
    rpm = np.array([1500.0, 3000.0, 4500.0])
    options = {"version": version, "nodes": {"stator": 0}}
    tables = [
        (one.to_ross(**options), 1.0),
        (one.to_ross(speed_rpm=rpm, **options), 1.0),
        (both.to_ross(at={"P_bar": 15}, **options), 0.5),
        (both.to_ross(at={"P_bar": 30}, **options), 1.0),
    ]
    for found, share in tables:
        table = found["stator"].arguments
        speeds = np.array(table["speed" if version == "3.1" else "frequency"])
        assert speeds.size == (3 if version == "3.1" else 5)
        for v in rpm:
            row = int(np.abs(speeds - v * np.pi / 30).argmin())
            assert speeds[row] == pytest.approx(v * np.pi / 30)
            for name in ("Kxx", "Kxy", "Kyx", "Kyy", "Dxx", "Dyx"):
                own = table[name.lower().replace("d", "c")][row]
                assert own == pytest.approx(share * FLUID(v)[name], rel=1e-6)


def test_a_table_of_several_conditions_of_a_speed_asks_for_one(by_speed_and_pressure):
    both, one = by_speed_and_pressure
    several = both.to_ross(at=[{"P_bar": 15}, {"P_bar": 30}], version="3.1", nodes={"stator": 0})
    assert list(several) == ["stator P_bar=15", "stator P_bar=30"]
    assert [found.arguments["tag"] for found in several.values()] == list(several)
    low, high = (np.array(found.arguments["kxy"]) for found in several.values())
    np.testing.assert_allclose(low, 0.5 * high, rtol=1e-6)
    frame = both.coefficient_table().for_ross()
    assert frame["speed"].tolist() == pytest.approx(np.tile([1500.0, 3000.0, 4500.0], 2) * np.pi / 30)
    assert frame["kxy"].tolist() == pytest.approx([*low, *high])
    with refuses(ValueError):
        both.to_ross(version="3.1", nodes={"stator": 0})
    with refuses(ValueError):
        one.to_ross(speed_rpm=[1500, 2000], version="3.1", nodes={"stator": 0})
