"""Universal files that an analyser wrote: units, directions, references, labels, and what makes no test."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyser_files import MODE, RPM, SPEED, W, analyser, shaker_test, written
from sentences import refuses, warns
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.lab.data.experiments import Experiment, PerturbationTest
from rotorfit.models import OneMode, Overhung


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
    with warns(UserWarning):
        assert_one_mode(rf.read(path))


def test_unknown_unit_labels_are_told(tmp_path: Path) -> None:
    path = written(tmp_path / "t.uff", shaker_test(lambda r, *_: r | {"ordinate_axis_units_lab": "furlong"}))
    with warns(UserWarning):
        assert_one_mode(rf.read(path))


def without(axis: int) -> list[dict[str, Any]]:
    return [record for record in shaker_test() if record["ref_dir"] != axis]


@pytest.mark.parametrize(
    "records",
    [
        shaker_test(lambda r, *_: r | {"z_axis_spec_data_type": 0, "z_axis_axis_units_lab": "NONE"}),
        shaker_test(lambda r, *_: r | {"ordinate_spec_data_type": 15}),
        shaker_test(lambda r, *_: r | {"func_type": 1, "data": r["data"].real}),
        shaker_test(lambda r, *_: r | {"abscissa_spec_data_type": 17}),
        shaker_test(lambda r, i, j: r | {"x": r["x"] * j}),
        [{"type": 15, "node_nums": [1], "def_cs": [0], "disp_cs": [0], "color": [1], "x": [0.0], "y": [0.0],
           "z": [0.0]}],
    ],
)  # fmt: skip
def test_universal_files_that_do_not_make_a_test(tmp_path: Path, records: list[dict[str, Any]]) -> None:
    with refuses(ValueError) as error:
        rf.read(written(tmp_path / "t.uff", records))
    assert str(error.value).startswith("t.uff")
