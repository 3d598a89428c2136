"""Tables of other hands: words for gaps, JSON of records, published dynamic stiffness, hints that keep the unit."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from openpyxl import Workbook
from openpyxl.chart import LineChart
from plain import plain_fit
from scipy.io import savemat

import rotorfit as rf
from rotorfit.base.names import nearest, unknown_name
from rotorfit.lab.data.experiments import FORCE_SIGMA, PerturbationTest
from rotorfit.lab.io.files import read
from rotorfit.lab.io.sampling import is_stamp, seconds_of
from rotorfit.lab.recordings.formats.files import open_raw

pytestmark = pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")  # of what was left out

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
    test = read(tmp_path / "a.csv")
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
    said = [finding.message for finding in test.findings if finding.code == "keys"]
    assert len(said) == (form == "a list inside")
    assert all("keys beside the records are not read: meta" in words for words in said)


@pytest.mark.parametrize("suffix", ["json", "jsonl", "ndjson"])
def test_json_may_hold_a_record_a_line(tmp_path: Path, suffix: str) -> None:
    lines = tmp_path / f"a.{suffix}"
    lines.write_text("\n".join(map(json.dumps, RECORDS)) + "\n\n", encoding="utf-8")
    (tmp_path / "b.json").write_text(json.dumps(RECORDS), encoding="utf-8")
    same, test = read(tmp_path / "b.json"), read(lines)
    np.testing.assert_array_equal(test.response, same.response)
    (tmp_path / "c.json").write_text('{"run": 1}\n{"run": 2', encoding="utf-8")
    with pytest.raises(ValueError, match=r"c\.json is not JSON: Expecting"):
        read(tmp_path / "c.json")


def test_json_with_gaps(tmp_path: Path) -> None:
    rows = [{**row} for row in RECORDS]
    rows[2]["amplitude_um"], rows[5]["amplitude_um"] = None, float("nan")
    del rows[7]["phase_deg"]
    (tmp_path / "a.json").write_text(json.dumps(rows), encoding="utf-8")
    assert len(read(tmp_path / "a.json")) == 9


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
        ("{}(H{}) [MN/m]", 1e6),
    ],
)
def test_published_dynamic_stiffness_gives_all_coefficients(tmp_path: Path, names: str, factor: float) -> None:
    (tmp_path / "a.csv").write_text(stiffness(names, factor), encoding="utf-8")
    test = read(tmp_path / "a.csv", constants={"plane": "seal"})
    (told,) = test.findings
    assert "is what cubic curves over frequency leave over" in told.message
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
    test = read(tmp_path / "a.csv")
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


@pytest.mark.parametrize(("real", "imag"), [
    ("direct_stiffness", "quadrature_stiffness"), ("direct_N_per_m", "quadrature_N_per_m"),
    ("Direct [N/mm]", "Quad [N/mm]"), ("Re(DS) [MN/m]", "Im(DS) [MN/m]"), ("KD [lbf/in]", "KQ [lbf/in]"),
    ("Re(Kdyn) [MN/m]", "Im(Kdyn) [MN/m]"), ("stiffness_re", "stiffness_im"), ("Re_Z [N/m]", "Im_Z [N/m]"),
    ("Re_H_N_m", "Im_H_N_m"), ("kxx [N/m]", "kxy [N/m]"), ("Re(Hxx) [MN/m]", "Im(Hxx) [MN/m]"),
])  # fmt: skip
def test_a_single_dynamic_stiffness_says_how_it_is_entered(tmp_path: Path, real: str, imag: str) -> None:
    w = 2 * np.pi * HZ
    value = K[0, 0] - w**2 * M[0, 0] + 1j * w * C[0, 0]
    rows = [
        ["1500", *map(repr, row)] for row in zip(HZ.tolist(), value.real.tolist(), value.imag.tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text(table(rows, f"speed_rpm,frequency_hz,{real},{imag}"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"force over motion is read as a matrix.*Re_Hxx_N_m") as told:
        read(tmp_path / "a.csv")
    assert f"{real!r}, {imag!r}" in str(told.value)
    assert "did you mean" not in str(told.value)
    assert "journal_x" not in str(told.value)
    said = zip((1 / np.abs(value)).tolist(), (-np.degrees(np.angle(value))).tolist(), strict=True)
    entered = [
        ["a", "1500", f"{60 * hz:g}", "p", "1", "0", "p", "z", *map(repr, reading)]
        for hz, reading in zip(HZ, said, strict=True)
    ]
    (tmp_path / "b.csv").write_text(table(entered, HEADER.replace("amplitude_um", "amplitude_m")), encoding="utf-8")
    test = read(tmp_path / "b.csv")
    assert isinstance(test, PerturbationTest)
    np.testing.assert_allclose(test.force / test.response, value, rtol=1e-9)


@pytest.mark.parametrize("unit", ["[m/N]", "(um/N)", "um_per_N", "[mm/s/N]", "[m/s2/N]", "(g/N)", "[mil/lbf]"])
def test_motion_over_force_says_how_it_is_entered(tmp_path: Path, unit: str) -> None:
    rows = [["1500", str(hz), "1e-6", "2e-6"] for hz in HZ]
    (tmp_path / "a.csv").write_text(table(rows, f"speed_rpm,frequency_hz,Re_H {unit},Im_H {unit}"), encoding="utf-8")
    with pytest.raises(ValueError, match="motion over force is entered as the response to one newton") as told:
        read(tmp_path / "a.csv")
    assert "journal_x" not in str(told.value)


@pytest.mark.parametrize("name", ["Re_Z [N/m]", "support stiffness", "receptance [m/N]", "torque_N_m"])
def test_ratios_beside_readings_are_attributes(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.csv").write_text(table([[*row, "3"] for row in ROWS], f"{HEADER},{name}"), encoding="utf-8")
    assert set(read(tmp_path / "a.csv").attributes) == {name}


# ---- hints -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "allowed", "hint"),
    [
        ("amplitude_dB", ["amplitude_rad", "amplitude_um"], ""),
        ("amplitude_uin", ["amplitude_in", "amplitude_um"], ""),
        ("mr_g", ["mr_g_m", "mr_g_mm"], ""),
        ("mr_ug_mm", ["mr_g_mm"], ""),
        ("amplitude_uin_pp", ["amplitude_in_pp", "amplitude_um_pp"], ""),
        ("Direct [um]", ["direction"], ""),
        ("Re_Hxx_MN_m", ["force_x_n"], ""),
        ("sensitivity_mV_per_g", ["sensitivity_mV_per_um"], ""),
        ("force_lb", ["force_lbf"], ""),
        ("mobility_um_s", ["velocity_um_s"], ""),
        ("torque_Nm", ["real_nm"], ""),
        ("amp_um", ["amplitude_um", "speed_rpm"], "amplitude_um"),
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


@pytest.mark.parametrize("names", [("f", "H"), ("freq", "FRF"), ("Hz", "Hxx")])
@pytest.mark.parametrize("channels", [1, 3])
def test_frequencies_and_responses_of_matlab_alone_say_what_is_lacking(
    tmp_path: Path, names: tuple[str, str], channels: int
) -> None:
    f = np.linspace(1, 100, 50)
    savemat(tmp_path / "a.mat", {names[0]: f, names[1]: np.ones((50, channels)) / (4e5 - f[:, None] ** 2 + 3j)})
    with pytest.raises(
        ValueError, match=rf"a\.mat holds frequencies \({names[0]}\) and responses \({names[1]}\).*real_um"
    ):
        read(tmp_path / "a.mat")
    with pytest.raises(ValueError, match=rf"a\.mat holds frequencies \({names[0]}\) and responses \({names[1]}\)"):
        open_raw(tmp_path / "a.mat")
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["f"] = f[None]
        file["H"] = np.zeros((channels, 50), dtype=[("real", float), ("imag", float)])
    with (tmp_path / "b.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    for reader in (read, open_raw):
        with pytest.raises(
            ValueError, match=r"b\.mat is a MAT file of version 7.3; save it with save.name, ..., '-v7'"
        ):
            reader(tmp_path / "b.mat")


# ---- tables of monitors, orders and dates ------------------------------------------------------------------------

SPEEDS = [1500 + 100 * k for k in range(5)]


def test_direct_and_gap_beside_the_vector_are_attributes(tmp_path: Path) -> None:
    probes = [f"Brg1 {axis} {what}" for axis in "XY" for what in (
        "Direct (um pp)", "Gap (V)", "1X Amp (um pp)", "1X Phase (deg lag)", "Overall (um pp)",
    )]  # fmt: skip
    lines = [",".join(["run", "Speed (rpm)", "force_plane", "mr_g_mm", "force_phase_deg", *probes])]
    for run, weight in (("base", 0), ("trial", 20)):
        lines.append(f"{run},1500,Brg1,{weight},0," + ",".join(["30,-9.8,20,45,33"] * 2))
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    test = read(tmp_path / "a.csv")
    assert isinstance(test, PerturbationTest)
    np.testing.assert_allclose(test.response, 10e-6 * np.exp(-1j * np.pi / 4))
    assert {"Brg1 X Direct (um pp)", "Brg1 X Gap (V)", "Brg1 Y Overall (um pp)"} <= set(test.attributes)


@pytest.mark.parametrize(
    "title", ["Point: Brg 1 X", "Channel Name,Brg 1 X", "Measurement point Brg 1 X", "PROBE = Brg 1 X"]
)
def test_a_point_above_its_table_says_plane_and_direction(tmp_path: Path, title: str) -> None:
    rows = [f"06MAY2024 10:00:{k:02d},{rpm},2.5,{2 + k / 7:.3f},{300 + k},-9.8" for k, rpm in enumerate(SPEEDS)]
    head = "Date Time,Speed (rpm),Direct (mil pp),1X Ampl (mil pp),1X Phase (deg lag),Gap (V)"
    (tmp_path / "a.csv").write_text("\n".join(["Machine: C-101", title, "", head, *rows]), encoding="utf-8")
    with pytest.warns(UserWarning, match="holds no weight"):
        test = read(tmp_path / "a.csv")
    assert isinstance(test, PerturbationTest)
    assert test.planes == ("Brg 1",)
    assert set(test.direction.tolist()) == {"x"}
    np.testing.assert_allclose(np.abs(test.response), [(2 + k / 7) * 12.7e-6 for k in range(5)], rtol=1e-3)
    constants = {"force_plane": "Brg 1", "mr_g_mm": 20, "force_phase_deg": 0}
    assert isinstance(read(tmp_path / "a.csv", constants=constants), PerturbationTest)


def book(path: Path, points: list[str], columns: dict[str, list[str]] | None = None) -> Path:
    workbook = Workbook()
    workbook.remove(workbook.active)
    for point in points:
        sheet = workbook.create_sheet(point.replace(" ", "_"))
        sheet.append([f"Point: {point}"])
        sheet.append([])
        sheet.append((columns or {}).get(point, ["Speed (rpm)", "1X Ampl (um pp)", "1X Phase (deg lag)", "Gap (V)"]))
        for k, rpm in enumerate(SPEEDS):
            sheet.append([rpm, 20 + k, 45 + k, -9.8])
    workbook.save(path)
    return path


def test_sheets_one_a_probe_are_one_test(tmp_path: Path) -> None:
    path = book(tmp_path / "a.xlsx", ["Brg 1 X", "Brg 1 Y", "Brg 2 X"])
    test = read(path)
    assert isinstance(test, PerturbationTest)
    assert len(test) == 15
    assert test.planes == ("Brg 1", "Brg 2")
    alone = read(path, sheet="Brg_1_Y")
    assert isinstance(alone, PerturbationTest)
    assert set(alone.direction.tolist()) == {"y"}
    odd = {"Brg 1 Y": ["Speed (rpm)", "1X Ampl (um pp)", "1X Phase (deg lag)", "Temp (C)"]}
    with pytest.raises(ValueError, match=r"b\.xlsx: sheet 'Brg_1_Y' has other columns than the first: Temp"):
        read(book(tmp_path / "b.xlsx", ["Brg 1 X", "Brg 1 Y"], odd))


def test_units_may_have_a_row_of_their_own_below_a_point(tmp_path: Path) -> None:
    workbook = Workbook()
    workbook.active.append(["made by", "me"])
    for point in ("DE X", "DE Y"):
        sheet = workbook.create_sheet(point)
        for row in (["Point:", point], [], ["Speed", "1X Amplitude", "1X Phase"], ["rpm", "um pp", "deg"]):
            sheet.append(row)
        for k, rpm in enumerate(SPEEDS):
            sheet.append([rpm, 20 + k, 45 + k])
    workbook.save(tmp_path / "a.xlsx")
    test = read(tmp_path / "a.xlsx")
    assert test.planes == ("DE",)
    np.testing.assert_allclose(np.abs(test.response)[:5], [(10 + k / 2) * 1e-6 for k in range(5)])


def probe_sheets(file: Path, points: dict[str, str | None]) -> None:
    """A workbook with a sheet of speed, amplitude and phase by its name, its point above where there is one."""
    workbook = Workbook()
    workbook.remove(workbook.active)
    for name, point in points.items():
        sheet = workbook.create_sheet(name)
        head = [["Speed (rpm)", "Amplitude (um pp)", "Phase (deg)"]]
        for row in ([[point]] if point else []) + head + [[rpm, 20, 45] for rpm in SPEEDS]:
            sheet.append(row)
    workbook.save(file)


def test_the_sheet_of_a_probe_may_have_its_name(tmp_path: Path) -> None:
    probe_sheets(tmp_path / "a.xlsx", {"DE X": None, "Sheet2": "Point: DE Y", "NDE-x": None})
    test = read(tmp_path / "a.xlsx")
    assert [*dict.fromkeys(zip(test.plane, test.direction, strict=True))] == [("DE", "x"), ("DE", "y"), ("NDE", "x")]


@pytest.mark.parametrize("points", [
    {"Sheet1": None, "Sheet2": None}, {"A": "DE", "B": "NDE"}, {"A": "Point: DE", "B": "Point: NDE"},
    {"DE X": None, "B": None}, {"1VX": None, "1VY": None},
])  # fmt: skip
def test_sheets_of_probes_that_nothing_names_are_refused(tmp_path: Path, points: dict[str, str | None]) -> None:
    """Also the one among others that are named: its numbers would be dropped."""
    probe_sheets(tmp_path / "a.xlsx", points)
    unnamed = ", ".join(map(repr, [name for name in points if name != "DE X"]))
    with pytest.raises(ValueError, match=rf"a\.xlsx: nothing says of which probe .* in sheets? {unnamed} are: write a"):
        read(tmp_path / "a.xlsx")


def test_tables_in_sheets_that_are_not_read_are_said(tmp_path: Path) -> None:
    workbook = Workbook()
    sheets = [workbook.active, *(workbook.create_sheet(name) for name in ("day 2", "notes"))]
    for sheet in sheets[:2]:
        for row in (HEADER.split(","), *ROWS):
            sheet.append(row)
    sheets[2].append(["oil", "warm", "pump 3"])
    workbook.save(tmp_path / "a.xlsx")
    words = "a.xlsx: tables in other sheets are not read: day 2 (sheet=, --sheet)"
    assert [one.words for one in read(tmp_path / "a.xlsx").findings] == [words]
    assert not read(tmp_path / "a.xlsx", sheet="day 2").findings


@pytest.mark.parametrize("name", ["sigma", "Sigma", "probe_radius", "force_sigma"])
def test_a_quantity_without_unit_is_no_attribute(tmp_path: Path, name: str) -> None:
    """Nothing else in the table says it, so that it would be dropped silently."""
    (tmp_path / "a.csv").write_text(table([[*row, "1"] for row in ROWS], f"{HEADER},{name}"), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"a\.csv: column '{name}' has no unit; {name.lower()}_UNIT has one of"):
        read(tmp_path / "a.csv")


def test_orders_of_a_rotor_at_rest_are_no_frequencies(tmp_path: Path) -> None:
    rows = [[row[0], "0", "0.5", *row[3:]] for row in ROWS]
    (tmp_path / "a.csv").write_text(table(rows, HEADER.replace("frequency_rpm", "order")), encoding="utf-8")
    with pytest.raises(ValueError, match=r"a\.csv: line 2: an order of a rotor at rest is no frequency"):
        read(tmp_path / "a.csv")


def test_a_chart_that_has_a_sheet_of_its_own_is_passed_over(tmp_path: Path) -> None:
    workbook = Workbook()
    workbook.create_chartsheet("plot", 0).add_chart(LineChart())
    for row in (HEADER.split(","), *ROWS):
        workbook["Sheet"].append(row)
    workbook.save(tmp_path / "a.xlsx")
    assert len(read(tmp_path / "a.xlsx")) == len(ROWS)
    with pytest.raises(ValueError, match=r"a\.xlsx: unknown sheet 'plot'"):
        read(tmp_path / "a.xlsx", sheet="plot")
    del workbook["Sheet"]
    workbook.save(tmp_path / "b.xlsx")
    for sheet in (None, "plot"):
        with pytest.raises(ValueError, match=r"b\.xlsx: the workbook has no sheet with cells"):
            read(tmp_path / "b.xlsx", sheet=sheet)


@pytest.mark.parametrize("name", ["frequency_order", "Frequency (orders)", "order", "Freq (x)", "frequency_ratio"])
def test_orders_of_the_speed_are_frequencies(tmp_path: Path, name: str) -> None:
    header = HEADER.replace("frequency_rpm", name)
    rows = [[*row[:2], f"{0.25 * (k + 1) * (-1 if k > 5 else 1)}", *row[3:]] for k, row in enumerate(ROWS)]
    (tmp_path / "a.csv").write_text(table(rows, header), encoding="utf-8")
    test = read(tmp_path / "a.csv")
    assert isinstance(test, PerturbationTest)
    expected = [0.25 * (k + 1) * (-1 if k > 5 else 1) * 1500 * np.pi / 30 for k in range(12)]
    np.testing.assert_allclose(test.frequency, expected)
    assert name not in test.attributes


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1.00001, False), (2.0, True)])
def test_a_column_order_that_is_none_of_the_speed_is_said(tmp_path: Path, factor: float, said: bool) -> None:
    """Beside frequencies it is an attribute: silently only where it says the same."""
    rows = [[*row, f"{factor * float(row[2]) / float(row[1]):.3f}"] for row in ROWS]
    (tmp_path / "a.csv").write_text(table(rows, f"{HEADER},order"), encoding="utf-8")
    test = read(tmp_path / "a.csv")
    words = [finding.words for finding in test.findings]
    assert any("'order' is not the frequency over the speed (line 2" in one for one in words) == said, words
    assert "order" in test.attributes


@pytest.mark.parametrize("stamp", [
    "2024-05-06 10:00:{:09.6f}", "2024-05-06T10:00:{:09.6f}", "06.05.2024 10:00:{:09.6f}", "10:00:{:09.6f}",
    '"5/6/2024 10:00:{:09.6f}"', "2024/05/06 10:00:{:09.6f}Z", "5/6/2024 11:00:{:09.6f} PM",
    "6-May-2024 10:00:{:09.6f}", "06 May 24 10:00:{:09.6f}", "20240506T1000{:09.6f}", "2024-05-06T10:00:{:09.6f}+02:00",
])  # fmt: skip
def test_times_of_samples_may_be_dates(tmp_path: Path, stamp: str) -> None:
    rows = [f"{stamp.format(k / 2000)},{-10 + k % 3},{-9 - k % 4}" for k in range(300)]
    (tmp_path / "a.csv").write_text("\n".join(["When,disk_X [V],disk_Y [V]", *rows]), encoding="utf-8")
    raw = open_raw(tmp_path / "a.csv")
    assert list(raw.channels) == ["disk_X [V]", "disk_Y [V]"]
    assert raw.sample_rate == pytest.approx(2000, rel=1e-6)
    np.testing.assert_array_equal(raw.channels["disk_X [V]"].samples(0, 4), [-10, -9, -8, -10])


@pytest.mark.parametrize("day", [45418.25, 739378.25])
def test_times_of_samples_may_be_days_of_a_spreadsheet(tmp_path: Path, day: float) -> None:
    rows = [f"{day + k / 2000 / 86400:.11f},{-10 + k % 3},{-9 - k % 4}" for k in range(300)]
    (tmp_path / "a.csv").write_text("\n".join(["Time,disk_X [V],disk_Y [V]", *rows]), encoding="utf-8")
    assert open_raw(tmp_path / "a.csv").sample_rate == pytest.approx(2000, rel=1e-3)


def test_a_day_counts_twelve_hours_twice() -> None:
    stamps = [f"5/6/2024 {hour}" for hour in ("12:00:00 AM", "11:59:59.5 a.m.", "12:00:00 PM", "11:59:59 pm")]
    begin = seconds_of("5/6/2024 0:00:00")
    assert [seconds_of(stamp) - begin for stamp in stamps] == [0, 43199.5, 43200, 86399]
    assert not any(map(is_stamp, ("123456", "20240506", "1.5", "12:30", "2024-05-06")))


# ---- numbers that are none ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "cell", "words"),
    [
        (1, "1e30", "speed is 1.05e.29 rad/s; up to 1e.10 are allowed"),
        (2, "1e25", "frequency is 1.05e.24 rad/s; up to 1e.10"),
        (4, "1e-303", "force is 1e-303 in SI units; other than zero it is at least 1e-30"),
        (8, "1e-303", "response is 1e-309 in SI units; other than zero it is at least 1e-30"),
    ],
)
def test_numbers_that_no_machine_has_are_refused(tmp_path: Path, column: int, cell: str, words: str) -> None:
    rows = [[*row] for row in ROWS]
    rows[3][column] = cell
    (tmp_path / "a.csv").write_text(table(rows), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"a\.csv: reading 4: {words}"):
        read(tmp_path / "a.csv")
