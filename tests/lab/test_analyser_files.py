"""Universal files that an analyser wrote: units, directions, references, labels, and what makes no test."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyser_files import MODE, RPM, SPEED, W, analyser, shaker_test, written
from plain import plain_fit
from sentences import refuses, warns
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.files import read
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
@pytest.mark.filterwarnings(r"ignore:.*no unit is said:UserWarning")  # one label is NONE
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
    unsaid = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
    records = shaker_test(lambda record, *_: record | unsaid | {"data": record["data"] * 1e3})
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
    again = shaker_test(lambda record, *_: record | {"data": record["data"] * (1 + 1e-6)})
    test = rf.read(written(tmp_path / "t.uff", [*shaker_test(), *again]))
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
    both = plain_fit(
        OneMode(planes=("7",)), rf.read(written(tmp_path / "b.uff", shaker_test())), known={"K": 0, "Ds": 0}
    )
    fit = plain_fit(OneMode(planes=("7",)), test, known={"K": 0, "Ds": 0})
    for name in ("K0", "D", "lam"):  # the abscissa of the files has six digits
        assert fit.params[name].value == pytest.approx(both.params[name].value, rel=1e-4)


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


# ---- dialects of other programs ----------------------------------------------------------------------------------


def text(records: list[dict[str, Any]], change: Callable[[list[str]], list[str]]) -> str:
    """A file in ASCII, made here: each record's lines after a change of them."""
    lines: list[str] = []
    for record in records:
        own = [
            *(str(record.get(f"id{i}", "NONE")) for i in range(1, 6)),
            f"    4         0    0         0 {'NONE':10s}{record['rsp_node']:10d}{record['rsp_dir']:4d} "
            f"{'NONE':10s}{record['ref_node']:10d}{record['ref_dir']:4d}",
            f"{5:10d}{W.size:10d}{1:10d}{W[0] / (2 * np.pi):13.5E}{(W[1] - W[0]) / (2 * np.pi):13.5E}"
            f"{SPEED / RPM:13.5E}",
        ]
        labels = (18, "Frequency", "Hz"), (8, "Response", "m"), (13, "Force", "N"), (19, "Speed", "rpm")
        own += [f"{kind:10d}    0    0    0 {word:20s} {unit:20s}" for kind, word, unit in labels]
        pairs = np.column_stack([record["data"].real, record["data"].imag]).ravel()
        own += ["".join(f"{v:13.5E}" for v in pairs[i : i + 6]) for i in range(0, pairs.size, 6)]
        lines += ["    -1", "    58", *change(own), "    -1"]
    return "\n".join(lines) + "\n"


def named(own: list[str], response: str, reference: str) -> list[str]:
    """The record with entity names written whole, however long."""
    line = own[5]
    own[5] = f"{line[:31]}{response}{line[41:56]}{reference}{line[66:]}"
    return own


DIALECTS: dict[str, Callable[[list[str]], list[str]]] = {
    "the last line filled up with zeros": lambda own: [*own[:-1], own[-1] + f"{0.0:13.5E}" * 2],
    "a further line of zeros": lambda own: [*own, f"{0.0:13.5E}" * 6],
    "exponents of three digits": lambda own: own[:11] + [re.sub(r"E([+-])", r"E\g<1>0", line) for line in own[11:]],
    "exponents with a D": lambda own: own[:11] + [line.replace("E", "D") for line in own[11:]],
    "exponents without an E": lambda own: own[:11] + [re.sub(r"E([+-])", r"\g<1>0", line) for line in own[11:]],
    "a wide record 7": lambda own: [*own[:6], re.sub(r"E([+-])", r"E\g<1>0", own[6]), *own[7:]],
    "long names": lambda own: named(own, "PF-J-0301x+ disp", "Shaker 12 at journal"),
    "a long name that ends in digits": lambda own: named(own, "Bearing_2001", "NONE      "),
    "blanks behind the lines": lambda own: [line + "   " for line in own],
    "numbers in lines of their own": lambda own: own[:11] + " ".join(own[11:]).split(),
}


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_dialects_of_the_format_are_read(tmp_path: Path, dialect: str, end: str) -> None:
    written = text(shaker_test(), lambda own: DIALECTS[dialect](list(own))).replace("\n", end)
    (tmp_path / "t.uff").write_bytes(written.encode())
    test = rf.read(tmp_path / "t.uff")
    assert len(test) == 4 * W.size
    assert_one_mode(test, rtol=5e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda own: [*own[:5], own[5].replace("7   1", "seven 1"), *own[6:]], "record 6 is not of the fields"),
        (lambda own: own[:-1], "12 of its 14 points"),
        (lambda own: [*own[:-1], own[-1][:13] + "*" * 13 + own[-1][26:]], "holds what is not a number: '\\*"),
        (lambda own: [*own[:6], "six things that say nothing at all", *own[7:]], "record 7 does not say"),
        (lambda own: own[:4], "has no whole heading"),
    ],
)
def test_records_that_nobody_can_read_are_named(
    tmp_path: Path, change: Callable[[list[str]], list[str]], words: str
) -> None:
    (tmp_path / "t.uff").write_text(text(shaker_test(), lambda own: change(list(own))), encoding="ascii")
    with pytest.raises(ValueError, match=f"t.uff, data set 1:? ?.*{words}"):
        rf.read(tmp_path / "t.uff")


def test_a_record_that_is_there_twice_is_taken_once(tmp_path: Path) -> None:
    records = shaker_test()
    with pytest.warns(UserWarning, match=r"there twice, to the last digit, were taken once: 5 is 1"):
        test = rf.read(written(tmp_path / "t.uff", [*records, records[0]]))
    assert len(test) == 4 * W.size


def test_conjugated_responses_are_called_so(tmp_path: Path) -> None:
    records = shaker_test(lambda record, *_: record | {"data": record["data"].conj()})
    with pytest.warns(UserWarning, match="are the FRFs conjugated"):
        read(written(tmp_path / "t.uff", records))
    inverted = shaker_test(lambda record, *_: record | {"data": -record["data"]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(written(tmp_path / "t.uff", inverted))


def test_units_that_nothing_says_are_warned_of(tmp_path: Path) -> None:
    unsaid = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": ""}
    with pytest.warns(UserWarning, match="no unit is said, neither by the axis nor by data set 164"):
        assert_one_mode(rf.read(written(tmp_path / "t.uff", shaker_test(lambda record, *_: record | unsaid))))
