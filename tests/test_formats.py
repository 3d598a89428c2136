"""Universal, netCDF and MAT files: round trips to the last digit of the format, and files that others wrote."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from any_test import PLAIN_NAMES, imposed_orbits, rigs, same
from hypothesis import HealthCheck, given, settings
from numpy.typing import NDArray
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.cli import main as cli
from rotorfit.data.experiments import DisplacementTest, Experiment, PerturbationTest, perturbation_test
from rotorfit.models import OneMode, Overhung, WhirlWhip

UFF_RTOL = 1.1e-11
"""Twelve digits round to 5e-12 of a number; a response is FRF times force, so two such errors meet."""

RPM = np.pi / 30
Complex = NDArray[np.complexfloating[Any, Any]]


def round_trip(test: Experiment, path: Path) -> Experiment:
    """Write and read again, by the suffix of the path."""
    rf.write(test, path)
    return rf.read(path, difference=False)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the examples of hypothesis may share."""
    return tmp_path_factory.mktemp("formats")


few = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])


# ---- round trips ------------------------------------------------------------------------------


@few
@given(test=rigs())
def test_netcdf_keeps_every_bit_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.nc"), test, rtol=0)


@few
@given(test=rigs())
def test_mat_keeps_every_bit_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.mat"), test, rtol=0)


@few
@given(test=rigs(PLAIN_NAMES, text_attributes=False))
def test_uff_keeps_twelve_digits_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.uff"), test, rtol=UFF_RTOL)


@settings(max_examples=15, deadline=None)
@given(test=imposed_orbits())
def test_imposed_orbits_keep_every_bit(place: Path, test: DisplacementTest) -> None:
    for suffix in (".nc", ".mat"):
        same(round_trip(test, place / f"orbit{suffix}"), test, rtol=0)


@pytest.mark.parametrize("suffix", [".csv", ".uff", ".unv", ".nc", ".mat"])
@pytest.mark.parametrize("name", ["rig_open", "two_disk"])
def test_bundled_rigs_through_every_format(tmp_path: Path, name: str, suffix: str) -> None:
    test = rf.read(rf.datasets.path(f"{name}.csv"), difference=False)
    same(
        round_trip(test, tmp_path / f"t{suffix}"), test, rtol={".nc": 0, ".mat": 0, ".csv": 1e-13}.get(suffix, UFF_RTOL)
    )


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat"])
def test_a_fit_does_not_see_the_format(tmp_path: Path, suffix: str) -> None:
    rig = rf.datasets.rig_open()
    start = rf.closed_form(WhirlWhip(), rig, known={"K3": 6000.0})
    again = rf.closed_form(WhirlWhip(), round_trip(rig, tmp_path / f"rig{suffix}"), known={"K3": 6000.0})
    for name, parameter in start.params.items():
        assert again.params[name].value == pytest.approx(parameter.value, rel=1e-8)


def test_several_speeds_noise_phases_and_attributes_survive(tmp_path: Path) -> None:
    model = WhirlWhip()
    theta = model.vector(TYPICAL["whirl-whip"])
    w = covering_frequencies(model, theta, (100.0, 200.0), 20)
    test = circular_test(model, theta, speeds=(100.0, 200.0), frequency=w, noise=0.01, sigma_known=True)
    values = {name: getattr(test, name) for name in test._columns()}
    values["force"] = test.force * np.exp(1j * np.linspace(-3, 3, len(test)))
    values["sigma"] = np.where(np.arange(len(test)) % 3 == 0, np.nan, test.sigma)
    oil = np.where(np.arange(len(test)) % 5 == 0, np.nan, 40 + np.arange(len(test)) / 7)
    test = PerturbationTest(**values, attributes={"oil_C": oil, "pressure, bar": oil / 20}, source="made")
    for suffix in (".csv", ".uff", ".nc", ".mat"):
        again = round_trip(test, tmp_path / f"t{suffix}")
        same(again, test, rtol=UFF_RTOL)
        assert again.source == f"t{suffix}"


def test_text_attributes_are_refused_by_uff_only(tmp_path: Path) -> None:
    test = perturbation_test(
        run=["a"], speed=1.0, frequency=2.0, force_plane=["p"], force=1.0, plane=["p"], direction=["x"],
        response=1e-6, attributes={"oil": "VG 32"},
    )  # fmt: skip
    with pytest.raises(ValueError, match="numeric attributes only; drop oil, or use netCDF"):
        rf.write(test, tmp_path / "t.uff")
    assert list(tmp_path.iterdir()) == []
    same(round_trip(test, tmp_path / "t.nc"), test, rtol=0)


# ---- universal files as an analyser writes them -------------------------------------------------

W = 2 * np.pi * np.linspace(1.0, 40.0, 14)
SPEED = 150.0
MODE = TYPICAL["one-mode"]


def real_receptance(w: NDArray[np.float64]) -> Complex:
    """Receptance of the one-mode rig in x and y, shape ``(N, 2, 2)``: the real form of eq. (13), inverted."""
    p = MODE
    turn = p["lam"] * SPEED
    kxy, cxy = p["D"] * turn, 2 * p["Mf"] * turn
    direct = p["K"] + p["K0"] - p["Mf"] * turn**2 + 1j * w * (p["D"] + p["Ds"]) - (p["M"] + p["Mf"]) * w**2
    cross = kxy + 1j * w * cxy
    return np.linalg.inv(np.moveaxis(np.array([[direct, cross], [-cross, direct]]), -1, 0))


def analyser(values: Complex, response: int, reference: int, **changes: Any) -> dict[str, Any]:
    """One FRF in the way of a two-channel analyser: receptance in m/N over Hz, speed on the z axis."""
    return {
        "type": 58, "func_type": 4, "id1": "journal run", "rsp_node": 7, "rsp_dir": response, "ref_node": 7,
        "ref_dir": reference, "x": W / (2 * np.pi), "data": values, "binary": 0,
        "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 13,
        "z_axis_spec_data_type": 19, "z_axis_value": SPEED / RPM, "z_axis_axis_units_lab": "rpm",
    } | changes  # fmt: skip


def shaker_test(change: Callable[[dict[str, Any], int, int], dict[str, Any]] | None = None) -> list[dict[str, Any]]:
    h = real_receptance(W)
    records = [analyser(h[:, i - 1, j - 1], i, j) for j in (1, 2) for i in (1, 2)]
    return records if change is None else [change(r, r["rsp_dir"], r["ref_dir"]) for r in records]


def written(path: Path, records: list[dict[str, Any]]) -> Path:
    import pyuff

    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(records, mode="add")
    return path


def assert_one_mode(test: Experiment, rtol: float = 5e-5) -> None:
    """Both directions of whirl answer like the model, as far as the six digits of abscissa and z axis let them.

    The rounding, 5e-6 at most, enlarged by d(log H)/d(log w), which is twice the quality factor (5) at most.
    """
    assert isinstance(test, PerturbationTest)
    model = OneMode()
    expected = model.receptance(model.vector(MODE), test.frequency, np.full(len(test), SPEED))[:, 0, 0]
    backward = test.frequency < 0
    assert backward.any()
    assert (~backward).any()
    np.testing.assert_allclose(test.speed, SPEED, rtol=1e-5)
    x = np.where(backward, expected.conj(), expected)
    y = np.where(backward, 1j, -1j) * x
    np.testing.assert_allclose(test.response / test.force, np.where(test.direction == "x", x, y), rtol=rtol)


def test_receptances_of_an_analyser(tmp_path: Path) -> None:
    test = rf.read(written(tmp_path / "t.uff", shaker_test()))
    assert test.planes == ("7",)
    assert len(test.runs) == 2
    assert_one_mode(test)


def test_they_give_the_parameters(tmp_path: Path) -> None:
    test = rf.read(written(tmp_path / "t.uff", shaker_test()))
    fit = rf.closed_form(OneMode(planes=("7",)), test, known={"K": MODE["K"], "Ds": MODE["Ds"]})
    for name in ("M", "K0", "D", "lam"):
        assert fit.params[name].value == pytest.approx(MODE[name], rel=1e-3)  # six digits of frequency and speed


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # pyuff forgets one where it writes binary data
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize(
    ("kind", "derivative", "label", "scale"),
    [(8, 0, "m", 1.0), (8, 0, "mm", 1e3), (8, 0, "mil", 1 / 25.4e-6), (11, 1, "m/s", 1.0), (11, 1, "(mm/s)", 1e3),
     (12, 2, "m/s^2", 1.0), (12, 2, "g", 1 / 9.80665), (12, 2, "NONE", 1.0)],
)  # fmt: skip
def test_mobility_and_accelerance_become_receptance(
    tmp_path: Path, binary: int, kind: int, derivative: int, label: str, scale: float
) -> None:
    def change(record: dict[str, Any], *_: int) -> dict[str, Any]:
        data = record["data"] * (1j * W) ** derivative * scale
        return record | {
            "data": data, "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": label, "binary": binary,
        }  # fmt: skip

    assert_one_mode(rf.read(written(tmp_path / "t.unv", shaker_test(change))))


@pytest.mark.parametrize(
    ("change", "speed"),
    [
        ({"orddenom_axis_units_lab": "lbf"}, None),
        ({"abscissa_spec_data_type": 19}, None),
        ({"abscissa_axis_units_lab": "rad/s"}, None),
        ({"z_axis_spec_data_type": 18, "z_axis_axis_units_lab": "Hz", "z_axis_value": SPEED / (2 * np.pi)}, None),
        ({"z_axis_spec_data_type": 0, "z_axis_axis_units_lab": "NONE", "z_axis_value": 0.0}, SPEED),
    ],
)
def test_units_of_the_other_axes(tmp_path: Path, change: dict[str, Any], speed: float | None) -> None:
    def apply(record: dict[str, Any], *_: int) -> dict[str, Any]:
        factors = {"lbf": 4.4482216152605, "rad/s": 2 * np.pi}
        data = record["data"] * factors.get(change.get("orddenom_axis_units_lab", ""), 1.0)
        x = record["x"] * factors.get(change.get("abscissa_axis_units_lab", ""), 1.0)
        if change.get("abscissa_spec_data_type") == 19:
            x = x * 60
        return record | change | {"data": data, "x": x}

    assert_one_mode(rf.read(written(tmp_path / "t.uff", shaker_test(apply)), speed=speed))


def test_units_of_dataset_164(tmp_path: Path) -> None:
    records = shaker_test(lambda record, *_: record | {"data": record["data"] * 1e3})
    units = {
        "type": 164, "units_code": 5, "units_description": "mm-N", "temp_mode": 1,
        "length": 1e3, "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip
    assert_one_mode(rf.read(written(tmp_path / "t.uff", [units, *records])))


def test_inverted_directions_turn_the_sign(tmp_path: Path) -> None:
    """A probe that looks from the other side is direction -1, and its FRF is negative."""
    records = shaker_test(lambda r, i, j: r | ({"rsp_dir": -i, "data": -r["data"]} if i == 1 else {}))
    assert_one_mode(rf.read(written(tmp_path / "t.uff", records)))
    records = shaker_test(lambda r, i, j: r | ({"ref_dir": -j, "data": -r["data"]} if j == 2 else {}))
    assert_one_mode(rf.read(written(tmp_path / "t.uff", records)))


def test_evenly_spaced_abscissae(tmp_path: Path) -> None:
    records = shaker_test(lambda record, *_: record | {"abscissa_spacing": 1})
    assert_one_mode(rf.read(written(tmp_path / "t.uff", records)), rtol=5e-4)  # the error of the step adds up


def test_remarks_that_differ_between_the_forces_part_nothing(tmp_path: Path) -> None:
    records = shaker_test(lambda r, i, j: r | {"id2": f"Test {i}{j}"})
    assert_one_mode(rf.read(written(tmp_path / "t.uff", records)))


def test_repeated_measurements_stay(tmp_path: Path) -> None:
    test = rf.read(written(tmp_path / "t.uff", [*shaker_test(), *shaker_test()]))
    assert len(test) == 2 * 4 * W.size
    assert_one_mode(test)


def test_several_speeds_nodes_and_names(tmp_path: Path) -> None:
    names = {7: "journal", 9: "disk"}
    records = [
        record | {"rsp_node": node, "rsp_ent_name": names[node], "ref_ent_name": "journal", "z_axis_value": rpm}
        for rpm in (1000.0, 2000.0)
        for node in names
        for record in shaker_test()
    ]
    test = rf.read(written(tmp_path / "t.uff", records))
    assert isinstance(test, PerturbationTest)
    assert test.planes == ("journal", "disk")
    assert test.force_planes == ("journal",)
    np.testing.assert_allclose(np.unique(test.speed), np.array([1000.0, 2000.0]) * RPM, rtol=1e-12)


def test_rotations_become_slopes(tmp_path: Path) -> None:
    """dx/ds is the rotation about y, dy/ds minus the one about x: phi = theta_y - j theta_x."""
    model = Overhung()
    theta = model.vector(TYPICAL["overhung"])
    forward, backward = (
        model.receptance(theta, w, np.full(W.size, SPEED))[:, :, 0] for w in (W, -W)
    )  # z and phi to a lateral force, complex coordinates
    x = (forward + backward.conj()) / 2  # Fx = cos(wt) is half a forward and half a backward force
    y = (forward - backward.conj()) / 2j
    along_x = {1: x[:, 0], 2: y[:, 0], 5: x[:, 1], 4: -y[:, 1]}
    # a force along y is the one along x turned by 90 degrees: x' = -y, y' = x
    along_y = {1: -y[:, 0], 2: x[:, 0], 5: -y[:, 1], 4: -x[:, 1]}
    records = [analyser(v, i, 1) for i, v in along_x.items()] + [analyser(v, i, 2) for i, v in along_y.items()]
    test = rf.read(written(tmp_path / "t.uff", records))
    assert isinstance(test, PerturbationTest)
    assert set(test.direction.tolist()) == {"x", "y", "rx", "ry"}
    fit = rf.closed_form(Overhung(planes=("7",)), test, known={})
    for name in ("M", "k11", "k12", "k22", "It", "Ip"):
        assert fit.params[name].value == pytest.approx(TYPICAL["overhung"][name], rel=1e-3)


@pytest.mark.parametrize("axis", [1, 2])
def test_a_reference_along_one_axis_is_a_force_that_does_not_turn(tmp_path: Path, axis: int) -> None:
    records = [record for record in shaker_test() if record["ref_dir"] == axis]
    test = rf.read(written(tmp_path / "t.uff", records))
    assert isinstance(test, PerturbationTest)
    assert test.forces == (f"7 along {'xy'[axis - 1]}",)
    assert (test.frequency > 0).all()
    both = rf.fit(OneMode(planes=("7",)), rf.read(written(tmp_path / "b.uff", shaker_test())), known={"K": 0, "Ds": 0})
    fit = rf.fit(OneMode(planes=("7",)), test, known={"K": 0, "Ds": 0})
    for name in ("K0", "D", "lam"):  # the abscissa of the files has six digits
        assert fit.params[name].value == pytest.approx(both.params[name].value, rel=1e-4)


def test_the_command_line_warns_once_and_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axial = [analyser(W + 0j, 3, axis) for axis in (1, 2, 1, 2, 1)]
    path = written(tmp_path / "t.uff", [*shaker_test(), *axial])
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.main(["info", str(path)]) == 0
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert told[0].startswith("rotorfit: t.uff: left out, not lateral")
    assert told[0].endswith("and 2 more")


def test_axial_directions_are_left_out_with_a_warning(tmp_path: Path) -> None:
    path = written(tmp_path / "t.uff", [*shaker_test(), analyser(W + 0j, 3, 1)])
    with pytest.warns(UserWarning, match=r"left out, not lateral .*: FRF 7:3 over 7:1"):
        assert_one_mode(rf.read(path))


def test_unknown_unit_labels_are_told(tmp_path: Path) -> None:
    path = written(tmp_path / "t.uff", shaker_test(lambda r, *_: r | {"ordinate_axis_units_lab": "furlong"}))
    with pytest.warns(UserWarning, match="unit 'furlong' is not known"):
        assert_one_mode(rf.read(path))


def without(axis: int) -> list[dict[str, Any]]:
    return [record for record in shaker_test() if record["ref_dir"] != axis]


@pytest.mark.parametrize(
    ("records", "message"),
    [
        (shaker_test(lambda r, *_: r | {"z_axis_spec_data_type": 0, "z_axis_axis_units_lab": "NONE"}),
         "no rotative speed on the z axis"),
        (shaker_test(lambda r, *_: r | {"ordinate_spec_data_type": 15}), "needed is displacement"),
        (shaker_test(lambda r, *_: r | {"func_type": 1, "data": r["data"].real}), "no frequency response"),
        (shaker_test(lambda r, *_: r | {"abscissa_spec_data_type": 17}), "needed is frequency"),
        (shaker_test(lambda r, i, j: r | {"x": r["x"] * j}), "different frequency lines"),
        ([{"type": 15, "node_nums": [1], "def_cs": [0], "disp_cs": [0], "color": [1], "x": [0.0], "y": [0.0],
           "z": [0.0]}], "dataset 58"),
    ],
)  # fmt: skip
def test_universal_files_that_do_not_make_a_test(tmp_path: Path, records: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        rf.read(written(tmp_path / "t.uff", records))
    assert str(error.value).startswith("t.uff")


# ---- netCDF and MAT as others write them ----------------------------------------------------------


def columns_by_hand() -> dict[str, Any]:
    model = OneMode()
    w = np.concatenate([-W[::-1], W])
    response = 2.0 * model.receptance(model.vector(MODE), w, np.full(w.size, SPEED))[:, 0, 0]
    return {
        "run": ["bwd"] * W.size + ["fwd"] * W.size, "speed": SPEED, "frequency": w, "force_plane": ["journal"] * w.size,
        "force": 2.0, "plane": ["journal"] * w.size, "direction": ["z"] * w.size, "response": response,
    }  # fmt: skip


def assert_by_hand(test: Experiment, rtol: float = 1e-14) -> None:
    columns = columns_by_hand()
    assert isinstance(test, PerturbationTest)
    assert np.isnan(test.sigma).all()
    for name, values in columns.items():
        if isinstance(values, list):
            assert getattr(test, name).tolist() == values
        else:
            np.testing.assert_allclose(getattr(test, name), np.broadcast_to(values, len(test)), rtol=rtol)


def dataset(**units: str) -> Any:
    """The columns by hand as an xarray data set, in other units where asked."""
    import xarray as xr

    from rotorfit.units import units_of

    factors = units_of("frequency", "displacement", "force")
    columns = columns_by_hand()
    columns["response_real"], columns["response_imag"] = columns["response"].real, columns["response"].imag
    columns["force_real"], columns["force_imag"] = columns["force"], 0.0
    del columns["response"], columns["force"]
    variables: dict[str, Any] = {}
    for name, values in columns.items():
        unit = units.get(name.removesuffix("_real").removesuffix("_imag"))
        array = np.asarray(values) if unit is None else np.asarray(values) / factors[unit.lower().replace("/", "_")]
        variables[name] = (("row",) if array.ndim else (), array, {} if unit is None else {"units": unit})
    return xr.Dataset(variables)


def test_netcdf_by_hand(tmp_path: Path) -> None:
    content = dataset()
    content["oil_C"] = ("row", np.linspace(30, 40, content.sizes["row"]))
    content["rig"] = "seal 3"
    content["calibration"] = (("a", "b"), np.eye(3))
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    test = rf.read(tmp_path / "t.nc")
    assert_by_hand(test)
    assert list(test.attributes) == ["oil_C", "rig"]
    assert set(test.attribute("rig").tolist()) == {"seal 3"}
    assert test.attribute("oil_C")[-1] == 40


def test_classic_netcdf(tmp_path: Path) -> None:
    dataset().to_netcdf(tmp_path / "t.nc", engine="scipy")
    assert (tmp_path / "t.nc").read_bytes()[:3] == b"CDF"
    assert_by_hand(rf.read(tmp_path / "t.nc"))


def test_netcdf_in_other_units(tmp_path: Path) -> None:
    dataset(speed="rpm", frequency="Hz", response="um_pp", force="lbf").to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    assert_by_hand(rf.read(tmp_path / "t.nc"))
    content = dataset(response="um")
    content["response_imag"].attrs["units"] = "thou"
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"t\.nc: variable 'response_imag': unknown unit 'thou'"):
        rf.read(tmp_path / "t.nc")


def test_static_loads_by_hand_in_other_units(tmp_path: Path) -> None:
    import xarray as xr

    def parts(name: str, values: Complex, unit: str) -> dict[str, Any]:
        both = {f"{name}_real": values.real, f"{name}_imag": values.imag}
        return {key: ("load", column, {"units": unit}) for key, column in both.items()}

    load, moved = np.array([10.0 + 5j, 20.0 - 3j]), np.array([12.0 + 1j, 24.0 - 2j])
    content = xr.Dataset(
        {"run": "a", "speed": ((), 3000.0, {"units": "rpm"}), "load_plane": "seal", "plane": "seal"}
        | parts("load", load, "lbf")
        | parts("displacement", moved, "um"),
        attrs={"kind": "StaticTest"},
    )
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    test = rf.read(tmp_path / "t.nc")
    assert type(test).__name__ == "StaticTest"
    np.testing.assert_allclose(test.speed, 100 * np.pi)
    np.testing.assert_allclose(getattr(test, "load"), load * 4.4482216152605)  # noqa: B009
    np.testing.assert_allclose(getattr(test, "displacement"), moved * 1e-6)  # noqa: B009
    table = xr.Dataset({"run": "a", "kxx": ("row", [1.0], {"units": "MN/m"})}, attrs={"kind": "CoefficientTable"})
    table.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"t\.nc: variable 'kxx' is in 'MN/m'; needed is 'N/m'"):
        rf.read(tmp_path / "t.nc")


def test_mat_by_hand(tmp_path: Path) -> None:
    from scipy.io import savemat

    columns = columns_by_hand()
    cells = {name: np.array(v, dtype=object) for name, v in columns.items() if isinstance(v, list)}
    savemat(tmp_path / "t.mat", columns | cells | {"oil_C": 41.5, "psi": np.eye(3)})
    test = rf.read(tmp_path / "t.mat")
    assert_by_hand(test)
    assert list(test.attributes) == ["oil_C"]
    assert set(test.attribute("oil_C").tolist()) == {41.5}
    savemat(tmp_path / "t.mat", columns)  # lists of names as a character matrix, filled up with blanks
    assert_by_hand(rf.read(tmp_path / "t.mat"))


@pytest.mark.parametrize("suffix", [".nc", ".mat"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"response": None}, "missing columns: response"),
        ({"plane": None, "run": None}, "missing columns: run, plane"),
        ({"frequency": "fast"}, "column 'frequency' should be a list of numbers"),
        ({"frequency": W}, "unequal length"),
        ({"direction": ["q"] * 2 * W.size}, "direction .'q'. unknown"),
        ({"kind": "BalancingTest"}, "unknown kind of experiment 'BalancingTest'"),
    ],
)
def test_incomplete_files_are_refused(tmp_path: Path, suffix: str, change: dict[str, Any], message: str) -> None:
    columns = {name: v for name, v in (columns_by_hand() | change).items() if v is not None}
    path = tmp_path / f"t{suffix}"
    if suffix == ".mat":
        from scipy.io import savemat

        savemat(path, columns)
    else:
        import xarray as xr

        parts = {k: v for name, values in columns.items() for k, v in real_parts(name, values)}
        kind = {"kind": parts.pop("kind")} if "kind" in parts else {}
        arrays = {name: np.asarray(values) for name, values in parts.items()}
        variables = {name: ((f"n{v.size}",) if v.ndim else (), v) for name, v in arrays.items()}
        xr.Dataset(variables, attrs=kind).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(ValueError, match=message) as error:
        rf.read(path)
    assert str(error.value).startswith(f"t{suffix}: ")


def real_parts(name: str, values: Any) -> Iterator[tuple[str, Any]]:
    if np.iscomplexobj(values):
        yield f"{name}_real", values.real
        yield f"{name}_imag", values.imag
    else:
        yield name, values


# ---- broken files -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat", ".csv"])
@pytest.mark.parametrize("content", [b"", b"\x00\x01\xff junk", b"-1\n 58\n", b"CDF\x01", b"\x89HDF\r\n\x1a\n"])
def test_junk_is_refused_in_words(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"t{suffix}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"^t\{suffix}[ :].+") as error:
        rf.read(path)
    assert len(str(error.value).split()) > 4


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat"])
@pytest.mark.filterwarnings("ignore")  # what libraries say about a file cut short is not ours
def test_files_cut_short_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    rf.write(rf.datasets.two_disk(), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for size in [*range(0, 200, 20), *rng.integers(200, len(whole) - 100, 25).tolist()]:
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=rf"^t\{suffix}[ :,].+"):
            rf.read(path)


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.filterwarnings("ignore")  # unknown units and directions that the damage made
def test_damaged_universal_files_are_read_or_refused_in_words(tmp_path: Path, own: bool) -> None:
    path = tmp_path / "t.uff"
    if own:
        rf.write(rf.datasets.two_disk().select(np.arange(0, 960, 12)), path)
    else:
        written(path, shaker_test())
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for _ in range(80):
        content = bytearray(whole)
        for at in rng.integers(len(whole) - 50, size=rng.integers(1, 6)).tolist():
            if rng.random() < 0.5:
                content[at] = rng.integers(256)
            else:
                del content[at : at + int(rng.integers(1, 40))]
        path.write_bytes(content)
        try:
            rf.check(rf.read(path))
        except ValueError as error:
            refusal = str(error)
            assert refusal.startswith("t.uff"), refusal
            assert len(refusal.split()) > 4


def test_a_file_that_is_no_netcdf_says_so_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "t.nc").write_bytes(b"junk")
    words = [sys.executable, "-m", "rotorfit", "info", str(tmp_path / "t.nc")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("rotorfit: t.nc is not a readable netCDF file")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("suffix", [".csv", ".uff", ".nc", ".mat"])
def test_missing_files_and_folders(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(FileNotFoundError):
        rf.read(tmp_path / f"absent{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(OSError, match="folder"):
        rf.read(tmp_path / f"folder{suffix}")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "t.uff"
    rf.write(rf.datasets.two_disk(), path)
    before = path.read_bytes()
    broken = rf.datasets.two_disk().select(np.arange(4))
    assert isinstance(broken, PerturbationTest)
    broken.response[1] = np.nan
    with pytest.raises(ValueError, match="response is not finite everywhere"):
        rf.write(broken, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["t.uff"]


def test_mat_of_version_73_is_named(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "t.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["speed"] = 1.0
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(header + path.read_bytes()[len(header) :])
    with pytest.raises(ValueError, match=r"version 7\.3; save it with save"):
        rf.read(path)
