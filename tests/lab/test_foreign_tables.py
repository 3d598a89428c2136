"""Tables of other hands: words for gaps, JSON of records, published dynamic stiffness, hints that keep the unit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from plain import plain_fit

import rotorfit as rf
from rotorfit.base.names import nearest, unknown_name
from rotorfit.lab.data.experiments import FORCE_SIGMA, PerturbationTest
from rotorfit.lab.io.files import read
from rotorfit.lab.recordings.formats.files import open_raw

HEADER = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg"
ROWS = [["a", "1500", f"{300 + 60 * i}", "p", "10", "0", "p", "z", f"{4 + i / 7:.4f}", f"{-i}"] for i in range(12)]


def table(rows: list[list[str]], header: str = HEADER) -> str:
    return "\n".join([header, *map(",".join, rows)]) + "\n"


@pytest.mark.parametrize("mark", [
    "#N/A", "#VALUE!", "#DIV/0!", "OL", "O.L", "OVLD", "Overload", "Invalid", "1.#QNAN", "-1.#IND", "1.#INF", "NaN", "",
    "n/a", "--", "---", "****", "null", "Bad Input", "ERR", "None", "No data",
])  # fmt: skip
@pytest.mark.parametrize("column", [8, 9])
def test_whatever_word_says_that_there_is_no_reading(tmp_path: Path, mark: str, column: int) -> None:
    rows = [[*row] for row in ROWS]
    for at in (3, 7):
        rows[at][column] = mark
    (tmp_path / "a.csv").write_text(table(rows), encoding="utf-8")
    with pytest.warns(UserWarning, match=r"2 of 12 readings are empty and were skipped \(lines 5, 9\)"):
        test = read(tmp_path / "a.csv")
    assert len(test) == 10


def test_all_words_at_once_and_with_decimal_commas(tmp_path: Path) -> None:
    rows = [[cell.replace(".", ",") for cell in row] for row in ROWS]
    for at, mark in enumerate(("#N/A", "OL", "Invalid", "1.#QNAN")):
        rows[2 * at][8] = mark
    lines = [HEADER.replace(",", ";"), *map(";".join, rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    test = read(tmp_path / "a.csv", on_finding=lambda finding: None)
    assert len(test) == 8
    np.testing.assert_allclose(np.abs(test.response[:2]) * 1e6, [float(ROWS[1][8]), float(ROWS[3][8])])


def test_a_row_that_begins_with_an_error_of_a_spreadsheet_is_no_comment(tmp_path: Path) -> None:
    header = "amplitude_um," + HEADER.replace(",amplitude_um", "")
    rows = [[row[8], *row[:8], row[9]] for row in ROWS]
    rows[4][0] = "#N/A"
    (tmp_path / "a.csv").write_text("# a comment\n" + table(rows, header), encoding="utf-8")
    with pytest.warns(UserWarning, match=r"1 of 12 readings are empty"):
        assert len(read(tmp_path / "a.csv")) == 11


def test_a_gap_where_a_number_is_needed_is_refused(tmp_path: Path) -> None:
    rows = [[*row] for row in ROWS]
    rows[5][2] = "#N/A"
    (tmp_path / "a.csv").write_text(table(rows), encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"line 7, column 'frequency_rpm': a blank cell where a finite number is needed"
    ):
        read(tmp_path / "a.csv")


# ---- JSON --------------------------------------------------------------------------------------------------------

RECORDS = [
    {
        key: cell if key in ("run", "plane", "force_plane", "direction") else float(cell)
        for key, cell in zip(HEADER.split(","), row, strict=True)
    }
    for row in ROWS
]
COLUMNS = {key: [row[key] for row in RECORDS] for key in RECORDS[0]}
JSON = {
    "records": RECORDS,
    "a list inside": {"meta": {"rig": "a"}, "readings": RECORDS},
    "columns": COLUMNS,
    "split": {"columns": [*COLUMNS], "index": [*range(12)], "data": [[*row.values()] for row in RECORDS]},
    "numbers as text": [dict(zip(HEADER.split(","), row, strict=True)) for row in ROWS],
    "keys in any order": [dict(reversed([*row.items()])) for row in RECORDS],
}


@pytest.mark.parametrize("form", JSON)
def test_json_of_records_is_the_table(tmp_path: Path, form: str) -> None:
    (tmp_path / "a.csv").write_text(table(ROWS), encoding="utf-8")
    (tmp_path / "a.json").write_text(json.dumps(JSON[form]), encoding="utf-8-sig" if form == "split" else "utf-8")
    test, same = read(tmp_path / "a.json"), read(tmp_path / "a.csv")
    assert isinstance(test, PerturbationTest)
    assert isinstance(same, PerturbationTest)
    np.testing.assert_allclose(test.response, same.response, rtol=1e-14)
    assert test.source == "a.json"


def test_json_with_gaps(tmp_path: Path) -> None:
    rows = [{**row} for row in RECORDS]
    rows[2]["amplitude_um"], rows[5]["amplitude_um"] = None, float("nan")
    del rows[7]["phase_deg"]
    (tmp_path / "a.json").write_text(json.dumps(rows), encoding="utf-8")
    assert len(read(tmp_path / "a.json", on_finding=lambda finding: None)) == 9


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is not JSON: Expecting"),
        ("[]", "holds no records: readings are a list of objects"),
        ('{"a": 1}', "holds no records"),
        ('[{"run": [1, 2]}]', "record 1, 'run' holds several values"),
        ("[" * 100_000, "is not a readable table"),
        ('[{"run": "a", "speed": 3}]', "missing columns"),
        ("[1, 2]", "holds no records"),
    ],
)
def test_other_json_is_refused_in_words(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "a.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=f"a.json.*{words}"):
        read(tmp_path / "a.json")
    with pytest.raises(ValueError, match=r"b\.json: JSON of records is read, not written"):
        rf.write(rf.datasets.rig_open(), tmp_path / "b.json")


# ---- published dynamic stiffness ---------------------------------------------------------------------------------

HZ = np.arange(10.0, 210.0, 10.0)
K = np.array([[180e6, 60e6], [-70e6, 210e6]])
C = np.array([[220e3, -20e3], [15e3, 260e3]])
M = np.array([[-45.0, 8.0], [-6.0, -38.0]])


def stiffness(names: str, factor: float, *, isotropic: bool = False, noise: float = 0.6e6) -> str:
    w, rng = 2 * np.pi * HZ, np.random.default_rng(3)
    elements = {"xx": (0, 0), "xy": (0, 1)} if isotropic else {"xx": (0, 0), "xy": (0, 1), "yx": (1, 0), "yy": (1, 1)}
    columns = {"speed_rpm": np.full(HZ.size, 7000.0), "frequency_hz": HZ}
    for element, at in elements.items():
        value = K[at] + 1j * w * C[at] - w**2 * M[at]
        value = value + noise * (rng.normal(size=HZ.size) + 1j * rng.normal(size=HZ.size))
        columns |= {names.format("Re", element): value.real / factor, names.format("Im", element): value.imag / factor}
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(f"{v:.8g}" for v in row) for row in rows)]) + "\n"


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        ("{}_H{}_MN_m", 1e6),
        ("{}{}_N_m", 1.0),
        ("{} K{} (MN/m)", 1e6),
        ("{}_H{} [kN/mm]", 1e6),
        ("{} Z{} [lbf/in]", 4.4482216152605 / 0.0254),
        ("{}_dynamic_stiffness_{}_N_um", 1e6),
    ],
)
def test_published_dynamic_stiffness_gives_all_coefficients(tmp_path: Path, names: str, factor: float) -> None:
    (tmp_path / "a.csv").write_text(stiffness(names, factor), encoding="utf-8")
    told: list[str] = []
    test = read(tmp_path / "a.csv", constants={"plane": "seal"}, on_finding=lambda found: told.append(found.message))
    assert len(told) == 1
    assert "is what cubic curves over frequency leave over" in told[0]
    fit = plain_fit(rf.models.Anisotropic(("seal",)), test)
    assert 0.5 < fit.redchi < 1.6
    for i, axis in enumerate("xy"):
        for j, along in enumerate("xy"):
            for letter, true in (("K", K), ("D", C), ("M", M)):
                found = fit.params[f"{letter}{axis}{along}"]
                assert abs(found.value - true[i, j]) < 5 * found.stderr


def test_two_elements_are_an_isotropic_matrix_and_noise_may_be_given(tmp_path: Path) -> None:
    lines = stiffness("{}_H{}_MN_m", 1e6, isotropic=True).splitlines()
    lines = [f"{line},{'sigma_MN_m' if k == 0 else '0.6'}" for k, line in enumerate(lines)]
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    test = read(tmp_path / "a.csv", on_finding=lambda found: None)
    assert isinstance(test, PerturbationTest)
    assert test.planes == ("journal",)
    np.testing.assert_allclose(test.attributes[FORCE_SIGMA], 0.6 * np.sqrt(2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("Im_Hyx", "Im_Hyz"), "im of yx is missing"),
        (("Re_Hxx_MN_m", "Re_Hxx_MN"), "a unit of force over one of length"),
        (("frequency_hz", "frequenz"), "the noise of a dynamic stiffness is needed"),
    ],
)
def test_half_a_matrix_is_refused(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    (tmp_path / "a.csv").write_text(stiffness("{}_H{}_MN_m", 1e6).replace(*change), encoding="utf-8")
    with pytest.raises(ValueError, match=f"a.csv.*{words}"):
        read(tmp_path / "a.csv")


# ---- hints -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "allowed", "hint"),
    [
        ("amplitude_dB", ["amplitude_rad", "amplitude_um"], ""),
        ("amplitude_uin", ["amplitude_in", "amplitude_um"], ""),
        ("mr_g", ["mr_g_m", "mr_g_mm"], ""),
        ("Re_Hxx_MN_m", ["force_x_n"], ""),
        ("sensitivity_mV_per_g", ["sensitivity_mV_per_um"], ""),
        ("force_lb", ["force_lbf"], ""),
        ("frequncy_rpm", ["frequency_rpm", "speed_rpm"], "frequency_rpm"),
        ("speed_rmp", ["speed_rpm"], "speed_rpm"),
        ("sample_rate", ["sample_rate_hz"], "sample_rate_hz"),
        ("chanel", ["channel"], "channel"),
        ("force_plne", ["force_plane", "force_n"], "force_plane"),
        ("coupling_mas", ["coupling_mass", "gyroscopic"], "coupling_mass"),
    ],
)
def test_a_hint_keeps_the_unit(name: str, allowed: list[str], hint: str) -> None:
    assert nearest(name, allowed, 0.5) == hint
    assert ("did you mean" in unknown_name("key", name, allowed)) == bool(hint)


def test_units_and_suffixes_have_no_near_ones() -> None:
    assert "did you mean" not in unknown_name("unit of length", "uin", ["in", "um"])
    assert "did you mean 'mN'" in unknown_name("unit", "MN", ["mN", "um"])
    assert "did you mean" not in unknown_name("suffix", ".lvn", [".lvm", ".wav"])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.xls", "a spreadsheet .*save it as .xlsx or .csv"),
        ("a.tdm", "DIAdem .*export TDMS"),
        ("a.mf4", "MDF.*export MATLAB"),
        ("a.dat", "if it is a text of columns, name it .csv or .txt"),
        ("a.flac", "convert it to WAV"),
        ("a.pickle", "a pickled object"),
        ("a.qqq", "unknown suffix"),
    ],
)
def test_a_file_that_is_not_read_says_what_its_program_exports(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"something")
    for reader in (read, open_raw):
        with pytest.raises(ValueError, match=f"{name}: .*{words}"):
            reader(tmp_path / name)
