"""Files as laboratories have them: encodings, separators, sheets, a column a probe, gaps, other axes, selections."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from plain import plain_fit
from sentences import hear, refuses, warns
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.io.templates import KINDS, example

COLUMNS = ("run", "force_plane", "plane", "direction", "speed", "frequency", "force", "response")


@pytest.fixture(scope="module")
def test_data():
    model = rf.models.WhirlWhip()
    theta = model.vector(TYPICAL["whirl-whip"])
    w = covering_frequencies(model, theta, SPEEDS["whirl-whip"], 20)
    test = circular_test(model, theta, speeds=SPEEDS["whirl-whip"], frequency=w, noise=0.01)
    return replace(test, attributes={"oil_C": 40.0 + np.arange(len(test)) / len(test)})


@pytest.fixture(scope="module")
def tidy(test_data, tmp_path_factory):
    """The text of the tidy CSV, with commas and points."""
    path = tmp_path_factory.mktemp("lab") / "rig.csv"
    rf.write(test_data, path)
    return path.read_text()


def same(read, expected):
    for name in COLUMNS:
        one, other = getattr(read, name), getattr(expected, name)
        if one.dtype.kind in "fc":
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())
        else:
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ","), ("\t", "."), (";", ".")])
def test_encodings_and_separators(tmp_path, tidy, test_data, encoding, separator, decimal):
    text = "# Prüfstand µm\n" + tidy.replace(",", separator)
    if decimal == ",":
        head, body = text.split("\nrun", 1)
        text = head + "\nrun" + body.replace(".", ",")
    path = tmp_path / "lab.csv"
    path.write_bytes(text.encode(encoding))
    same(rf.read(path), test_data)


def test_excel_says_its_separator_first_and_leaves_empty_columns_and_rows(tmp_path, tidy, test_data):
    lines = [line for line in tidy.replace(",", ";").splitlines() if not line.startswith("#")]
    path = tmp_path / "lab.csv"
    path.write_text("sep=;\r\n" + "\r\n".join(line + ";;" for line in lines) + "\r\n" + ";" * 20 + "\r\n")
    same(rf.read(path), test_data)


def test_points_and_commas_in_one_column_are_refused(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_text(example("perturbation").replace(",", ";").replace("41.2", "41,2"))
    with refuses(ValueError):
        rf.read(path)


@pytest.mark.parametrize(
    ("separator", "decimal", "speed", "words"),
    [
        (";", ".", "1,500", "'1,500' may be 1500 or 1.500"),
        (",", ".", '"1,500"', "'1,500' may be 1500 or 1.500"),
        (";", ",", "1.500", "'1.500' may be 1500 or 1.500"),
        ("\t", ",", "1.500", "'1.500' may be 1500 or 1.500"),
    ],
)
def test_marks_between_thousands_are_refused(tmp_path, separator, decimal, speed, words):
    rows = [line.split(",") for line in example("perturbation").splitlines() if not line.startswith("#")]
    for row in rows[1:]:
        row[:] = [cell.replace(".", decimal) for cell in row]
        row[1] = speed
    path = tmp_path / "lab.csv"
    path.write_text("\n".join(separator.join(row) for row in rows) + "\n")
    with refuses(ValueError):
        rf.read(path)


def test_a_row_of_units_is_refused(tmp_path):
    header, *rows = [line for line in example("perturbation").splitlines() if not line.startswith("#")]
    path = tmp_path / "lab.csv"
    path.write_text("\n".join([header, "-,[rpm],[rpm],-,[N],[deg],-,-,[mil],[deg],[degC]", *rows]) + "\n")
    with refuses(ValueError):
        rf.read(path)


@pytest.mark.parametrize(("column", "mark"), [("amplitude_um", "9999"), ("phase_deg", "-999.0"), ("phase_deg", "999")])
def test_marks_of_instruments_for_no_reading_are_refused(tmp_path, column, mark):
    header, *rows = [line.split(",") for line in example("perturbation").splitlines() if not line.startswith("#")]
    at = header.index(column)
    path = tmp_path / "lab.csv"

    def write():
        path.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")

    rows[3][at] = mark
    write()
    with refuses(ValueError):
        rf.read(path)
    for shift, row in enumerate(rows):  # phases that were never wrapped, and amplitudes that are as large
        row[at] = str(float(mark) - 5 * shift)
    rows[3][at] = mark
    write()
    assert len(rf.read(path)) == len(rows)


# ---- Excel ----------------------------------------------------------------------------------------------------------


def workbook(path, tidy):
    from openpyxl import Workbook

    book = Workbook()
    book.active.title = "notes"
    book.active.append(["written on Monday"])
    sheet = book.create_sheet("run 2")
    sheet.append(["# a remark"])
    for line in tidy.splitlines():
        if not line.startswith("#"):
            cells = []
            for cell in line.split(","):
                try:
                    cells.append(float(cell))
                except ValueError:
                    cells.append(cell)
            sheet.append(cells)
    book.save(path)
    return path


def test_excel_sheets_by_name(tmp_path, tidy, test_data, capsys, monkeypatch):
    path = workbook(tmp_path / "lab.xlsx", tidy)
    same(rf.read(path, sheet="run 2"), test_data)
    with refuses(ValueError):
        rf.read(path, sheet="run2")
    with refuses(ValueError):
        rf.read(path)
    assert main(["info", str(path), "--sheet", "run 2"]) == 0
    assert "measured at" in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert main(["info", str(path)]) == 2
    assert 'pip install "rotorfit[excel]"' in capsys.readouterr().err


def test_rows_of_a_sheet_are_named_as_the_sheet_counts_them(tmp_path, tidy):
    lines = tidy.splitlines()
    lines[5] = lines[5].replace(",x,", ",north,").replace(",y,", ",north,")
    path = workbook(tmp_path / "lab.xlsx", "\n".join(lines))
    # The first line is a comment in the text and in the sheet: line 6 of the one is row 6 of the other.
    with refuses(ValueError):
        rf.read(path, sheet="run 2")


def test_what_is_no_workbook_says_so(tmp_path):
    path = tmp_path / "lab.xlsx"
    path.write_text("run,speed_rpm\n")
    with refuses(ValueError):
        rf.read(path)
    (tmp_path / "lab.csv").write_bytes(workbook(tmp_path / "book.xlsx", "a,b\n1,2\n").read_bytes())
    with refuses(ValueError):
        rf.read(tmp_path / "lab.csv")
    (tmp_path / "old.csv").write_bytes(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(500))
    with refuses(ValueError):
        rf.read(tmp_path / "old.csv")
    with refuses(ValueError):
        rf.read(tmp_path / "old.xls")
    with refuses(ValueError):
        rf.read(rf.datasets.path("rig_open.csv"), sheet="a")


# ---- a column a probe -----------------------------------------------------------------------------------------------


def wide_text(test, style):
    """One row a line, a column a probe; ``style`` names amplitude and phase columns."""
    channels = list(dict.fromkeys(zip(test.plane.tolist(), test.direction.tolist(), strict=True)))
    lines = {}
    for i in range(len(test)):
        key = (test.run[i], test.speed[i], test.frequency[i], test.force_plane[i], test.force[i])
        lines.setdefault(key, {})[test.plane[i], test.direction[i]] = test.response[i]
    head = ["run", "speed_rpm", "frequency_hz", "force_plane", "force_N", "force_phase_deg"]
    head += [name.format(p=p, d=d) for p, d in channels for name in style]
    rows = [",".join(head)]
    for (run, speed, w, plane, force), found in lines.items():
        cells = [run, speed * 30 / np.pi, w / 2 / np.pi, plane, abs(force), np.degrees(np.angle(force))]
        for channel in channels:
            z = found[channel]
            turn = {"lag_deg": -np.degrees(1), "_deg": np.degrees(1), "_rad": 1.0}
            ending = "lag_deg" if "lag" in style[1] else next((end for end in turn if style[1].endswith(end)), "")
            factor = turn.get(ending)
            cells += [z.real * 1e3, z.imag * 1e3] if factor is None else [abs(z) * 2e6, factor * np.angle(z)]
        rows.append(",".join(c if isinstance(c, str) else f"{c:.15g}" for c in cells))
    return "\n".join(rows) + "\n"


def ordered(test):
    rows = np.lexsort([test.direction, test.plane, test.frequency, test.force_plane, test.speed])
    return test.select(rows)


@pytest.mark.parametrize(
    "style",
    [
        ("{p}_{d}_um_pp", "{p}_{d}_lag_deg"),
        ("{p}_{d}_um_pp", "{p}_{d}_deg"),
        ("{p}_{d}_um_pp", "{p}_{d}_phase_rad"),
        ("{p}_{d}_real_mm", "{p}_{d}_imag_mm"),
    ],
)
def test_a_wide_table_is_recognised(tmp_path, test_data, style):
    path = tmp_path / "wide.csv"
    path.write_text(wide_text(test_data, style))
    same(ordered(rf.read(path)), ordered(test_data))


@pytest.mark.parametrize(
    "style",
    [
        ("{p} {d} Amp (um pp)", "{p} {d} Phase (deg)"),
        ("{p}-{d} Amplitude [µm pk-pk]", "{p}-{d} Phase Lag [deg]"),
        ("1X Ampl {p} {d} (microns p-p)", "1X Phase {p} {d} (° lag)"),
        ("{p} {d}_umpp", "{p} {d}_deg"),
        ("{p} {d} Re (mm)", "{p} {d} Imag (mm)"),
    ],
)
@pytest.mark.parametrize("case", [str.title, str.upper])
def test_a_wide_table_with_names_as_people_write_them(tmp_path, test_data, style, case):
    plain = ("{p}_{d}_um_pp", "{p}_{d}_lag_deg" if "lag" in style[1].lower() else "{p}_{d}_deg")
    text = wide_text(test_data, ("{p}_{d}_real_mm", "{p}_{d}_imag_mm") if "Re" in style[0] else plain)
    _, _, rows = text.partition("\n")
    head = ["Run", "Speed (rpm)", "Freq [Hz]", "Force plane", "Force (N)", "Force Phase (deg)"]
    channels = dict.fromkeys(zip(test_data.plane.tolist(), test_data.direction.tolist(), strict=True))
    head += [case(name.format(p=p, d=d)) for p, d in channels for name in style]
    path = tmp_path / "wide.csv"
    path.write_text(",".join(head) + "\n" + rows, encoding="utf-8")
    read = rf.read(path)
    same(ordered(read), ordered(test_data))
    assert not read.attributes


def test_names_in_words_leave_tidy_tables_and_messages_as_they_are(tmp_path, tidy, test_data):
    path = tmp_path / "tidy.csv"
    head, _, rows = "\n".join(line for line in tidy.splitlines() if line[:1] != "#").partition("\n")
    words = {"speed_rpm": "Speed (rpm)", "frequency_rpm": "FREQUENCY [RPM]", "force_N": "Force (N)", "run": "Run"}
    path.write_text(",".join(words.get(name, name) for name in head.split(",")) + "\n" + rows)
    same(rf.read(path), test_data)
    path.write_text(path.read_text().replace(rows.splitlines()[0].split(",")[1], "slow", 1))
    with refuses(ValueError):
        rf.read(path)


@pytest.mark.parametrize(
    ("amplitude", "phase"),
    [
        ("Disk y", "Disk y phase"),
        ("Disk Y (thou)", "Disk Y ang"),
        ("2X Disk Y (um)", "2X Disk Y Phase (deg)"),
        ("disk_y_amp", "disk_y_ph"),
        ("Disk vertical (um)", "Disk vertical phase (deg)"),
    ],
)
@pytest.mark.parametrize("alone", [False, True])
def test_a_reading_in_doubt_is_no_attribute(tmp_path, run, amplitude, phase, alone):
    text = example("wide").replace("disk_y_um", amplitude).replace("disk_y_lag_deg", phase)
    path = tmp_path / "wide.csv"
    path.write_text(text.replace("disk_x_um", "Disk x").replace("disk_x_lag_deg", "Disk x lag") if alone else text)
    code, _, told = run("info", path)
    assert code == 2
    assert f"{amplitude!r}, {phase!r} look like readings" in told
    units = {"(thou)": "UNIT", "(um)": "um"}  # of the first in doubt, whose quantity the hint keeps
    assert f'=journal_x_{"um_pp" if alone else units.get(amplitude.split()[-1], "um_pp")}"' in told
    if not alone:
        with warns(UserWarning):
            read = rf.read(path, columns={amplitude: "disk_y_um", phase: "disk_y_lag_deg"})
        path.write_text(example("wide"))
        with warns(UserWarning):
            same(read, rf.read(path))


def test_gap_voltages_and_times_beside_readings_stay_attributes(tmp_path):
    path = tmp_path / "wide.csv"
    text = example("wide").replace("disk_y_um", "Gap X (V)").replace("disk_y_lag_deg", "Elapsed h")
    path.write_text(text.replace("16.0", "16"))
    read = rf.read(path)
    assert set(read.attributes) == {"Gap X (V)", "Elapsed h"}
    assert set(read.direction) == {"x"}


def test_planes_are_spelled_as_the_forced_ones(tmp_path):
    path = tmp_path / "wide.csv"
    text = (
        example("wide")
        .replace(",disk,", ",Main Disk,")
        .replace("disk_x", "MAIN_DISK_X")
        .replace("disk_y", "main disk y")
    )
    path.write_text(text)
    with warns(UserWarning):
        assert rf.read(path).planes == ("Main Disk",)


def test_a_wide_table_of_other_names_is_mapped_in_a_study(tmp_path, test_data, capsys):
    style = ("Ampl {p} {d}", "lag {p} {d}")
    text = wide_text(test_data.select(test_data.force_plane == "journal"), style)
    lines = [line.split(",") for line in text.splitlines()]
    at = lines[0].index("force_plane")
    (tmp_path / "wide.csv").write_text("\n".join(",".join(c for i, c in enumerate(row) if i != at) for row in lines))
    names = {f"Ampl {p} {d}": f"{p}_{d}_um_pp" for p in ("disk", "journal") for d in "xy"}
    names |= {f"lag {p} {d}": f"{p}_{d}_lag_deg" for p in ("disk", "journal") for d in "xy"}
    table = ", ".join(f'"{old}" = "{new}"' for old, new in names.items())
    (tmp_path / "study.toml").write_text(
        f'model = "whirl-whip"\nknown = {{K3 = 6000, Ds = 3, sigma = 0.95}}\n'
        f'files = [{{path = "wide.csv", columns = {{{table}}}, constants = {{force_plane = "journal"}}}}]\n'
    )
    assert main(["run", str(tmp_path / "study.toml")]) == 0
    assert "forced at    journal" in capsys.readouterr().out
    read = rf.read(tmp_path / "wide.csv", columns=names, constants={"force_plane": "journal"})
    same(ordered(read), ordered(test_data.select(test_data.force_plane == "journal")))
    with refuses(ValueError):
        rf.read(tmp_path / "wide.csv", columns={"Ampl north": "disk_x_um"})


def test_a_probe_without_its_phase_is_named(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(example("wide").replace("disk_y_lag_deg", "remark"))
    with refuses(ValueError):
        rf.read(path)


# ---- what may be left out -------------------------------------------------------------------------------------------


def test_empty_readings_are_skipped_with_a_count(tmp_path, capsys):
    path = tmp_path / "wide.csv"
    path.write_text(example("wide"))
    with warns(UserWarning) as told:
        test = rf.read(path)
    assert len(test) == 7
    line = int(str(told[0].message).rpartition("line ")[2].rstrip(")"))
    assert path.read_text().splitlines()[line - 1].endswith(",,")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["info", str(path)]) == 0  # a finding there, not a warning
    assert "1 of 8 readings are empty" in capsys.readouterr().out


def test_run_and_planes_left_out(tmp_path, tidy, test_data):
    rows = [line.split(",") for line in tidy.splitlines() if not line.startswith("#")]
    at = rows[0].index("run")
    path = tmp_path / "norun.csv"
    path.write_text("\n".join(",".join(c for i, c in enumerate(row) if i != at) for row in rows))
    read = rf.read(path)
    assert set(read.runs) == {
        f"{p} {v:.0f} rpm" for p in ("disk", "journal") for v in np.array(SPEEDS["whirl-whip"]) * 30 / np.pi
    }
    same(replace(read, run=test_data.run), test_data)
    known = {"K3": 6000.0}
    fit, other = (plain_fit(rf.models.WhirlWhip(), data, known=known) for data in (read, test_data))
    assert fit.params["D"].value == pytest.approx(other.params["D"].value, rel=1e-6)
    text = example("perturbation").replace("force_plane,", "").replace("plane,direction", "direction")
    (tmp_path / "one.csv").write_text(text.replace(",journal", ""))
    one = rf.read(tmp_path / "one.csv")
    assert (one.planes, one.force_planes) == (("journal",), ("journal",))


# ---- universal files with the shaft along another axis --------------------------------------------------------------


@pytest.mark.parametrize("axes", ["yz", "zx", "zy", "yx"])
def test_a_shaft_along_another_axis(tmp_path, axes):
    """FRFs of a rotor written with its x along one axis of the file and its y along another."""
    import pyuff

    first, second = ("xyz".index(a) + 1 for a in axes)
    w = np.linspace(20.0, 200.0, 40)
    model = rf.models.OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    forward = model.receptance(theta, w, 100.0)[:, 0, 0]
    backward = model.receptance(theta, -w, 100.0)[:, 0, 0]
    # With z = x + jy: a force along x gives x = (H+ + conj(H-))/2 and y = -j (H+ - conj(H-))/2.
    direct, cross = (forward + backward.conj()) / 2, -1j * (forward - backward.conj()) / 2
    sets = []
    for ref, rsp, values in (
        (first, first, direct),
        (first, second, cross),
        (second, second, direct),
        (second, first, -cross),
    ):
        sets.append({
            "type": 58, "func_type": 4, "rsp_node": 1, "rsp_dir": rsp, "ref_dir": ref, "ref_node": 1,
            "data": values, "x": w / 2 / np.pi, "id1": "lab", "rsp_ent_name": "journal", "ref_ent_name": "journal",
            "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 13,
            "z_axis_spec_data_type": 19, "z_axis_value": 100.0 * 30 / np.pi,
            "ordinate_axis_units_lab": "m", "orddenom_axis_units_lab": "N",
        })  # fmt: skip
    path = tmp_path / "lab.uff"
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    test = rf.read(path, axes=axes)
    fit = plain_fit(rf.models.OneMode(planes=test.planes), test, known={"K": 8000.0, "Ds": 8.0})
    assert fit.params["lam"].value == pytest.approx(TYPICAL["one-mode"]["lam"], rel=1e-4)
    assert fit.params["D"].value == pytest.approx(TYPICAL["one-mode"]["D"], rel=1e-4)


def test_axes_are_two_different_ones(tmp_path):
    from rotorfit.lab.io.universal_foreign import turned

    for axes in ("xx", "x", "yzx", "ab"):
        with refuses(ValueError):
            turned([], axes)
    rf.write(rf.datasets.rig_open(), tmp_path / "own.uff")
    with refuses(ValueError):
        rf.read(tmp_path / "own.uff", axes="yz")


# ---- selections -----------------------------------------------------------------------------------------------------


def test_rows_are_chosen_by_conditions(tmp_path, tidy, test_data, capsys):
    path = tmp_path / "rig.csv"
    path.write_text(tidy)
    low = test_data.speed_rpm[0] if hasattr(test_data, "speed_rpm") else test_data.speed[0] * 30 / np.pi
    some = rf.read(path, where={"speed_rpm": low, "oil_C": (40.1, 40.6)}, exclude={"direction": "y"})
    oil = test_data.attributes["oil_C"]
    keep = (
        np.isclose(test_data.speed, test_data.speed[0]) & (oil >= 40.1) & (oil <= 40.6) & (test_data.direction == "x")
    )
    same(some, test_data.select(keep))
    near = rf.read(path, drop_near_1x=0.2)
    assert (np.abs(np.abs(near.frequency) / near.speed - 1) >= 0.2).all()
    assert 0 < len(near) < len(test_data)
    run = test_data.runs[0]
    assert main(["info", str(path), "--exclude", f"run={run}", "--drop-near-1x", "20", "--where", "oil_C=:40.9"]) == 0
    assert f"in {len(test_data.runs) - 1} run" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--where", "oil=40"], "unknown attribute 'oil'"),
        (["--where", "run=nothing"], "unknown run 'nothing'"),
        (["--where", "plane=1:2"], "plane holds text"),
        (["--where", "oil_C=warm"], "oil_C holds numbers, not 'warm'"),
        (["--where", "oil_C"], "--where takes NAME=VALUE or NAME=LO:HI"),
        (["--where", "oil_C=60:"], "no reading is left"),
        (["--drop-near-1x", "0.0"], None),
        (["--drop-near-1x", "100"], "--drop-near-1x is per cent of the speed, from 0 to below 100; got 100"),
        (["--sheet", "a"], "sheet is an option of Excel files"),
        (["--axes", "yz"], "axes is an option of universal files"),
    ],
)
def test_selections_that_cannot_be(tmp_path, tidy, capsys, words, message):
    path = tmp_path / "rig.csv"
    path.write_text(tidy)
    code = main(["info", str(path), *words])
    err = capsys.readouterr().err
    assert (code, err == "") == ((0, True) if message is None else (2, False))
    if message:
        assert message in err
        assert err.count("\n") == 1


# ---- templates ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("study", "simulation")])
def test_every_template_is_read(tmp_path, capsys, kind):
    assert main(["template", kind]) == 0
    path = tmp_path / f"{kind}.csv"
    path.write_text(capsys.readouterr().out)
    assert main(["info", str(path)]) == 0
    assert "readings in" in capsys.readouterr().out


def test_the_template_of_a_study_runs(tmp_path, capsys):
    assert main(["template", "study"]) == 0
    text = capsys.readouterr().out
    (tmp_path / "rig.csv").write_bytes(rf.datasets.path("rig_open.csv").read_bytes())
    from rotorfit.apps.study_files.study_file import read_study

    (tmp_path / "study.toml").write_text(text)
    assert read_study(tmp_path / "study.toml").known == {"K3": 6000.0}
    (tmp_path / "study.toml").write_text(text.replace("  # {path", "  {path"))
    files = read_study(tmp_path / "study.toml").files
    assert [file.path.name for file in files] == ["rig.csv", "other.xlsx", "wide.csv"]
    assert files[1].options["where"] == {"oil_C": (40, 60)}
    assert files[2].options["drop_near_1x"] == 0.05


def test_unknown_templates_list_those_there_are(capsys):
    assert main(["template", "perturbations"]) == 2
    hear(capsys.readouterr().err)


# ---- words ----------------------------------------------------------------------------------------------------------


def test_findings_name_lines_of_the_file(tmp_path, capsys):
    """Readings at 1x, below a comment and a header, with one empty reading above them."""
    rig = rf.datasets.rig_open()
    rig = rig.select((rig.speed == rig.speed[0]) & (np.abs(rig.frequency) < 250))
    at = int(np.flatnonzero((rig.plane == "disk") & (rig.frequency > 80))[0])
    rig = replace(rig, frequency=np.where(rig.frequency == rig.frequency[at], rig.speed[at], rig.frequency))
    path = tmp_path / "rig.csv"
    rf.write(rig, path)
    lines = path.read_text().splitlines()
    head = lines[1].split(",")
    cells = lines[2].split(",")
    cells[head.index("amplitude_um")] = cells[head.index("phase_deg")] = ""
    path.write_text("\n".join([lines[0], "# a remark", lines[1], ",".join(cells), *lines[3:]]) + "\n")
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    finding = next(line for line in out.splitlines() if "Lines" in line)
    first = int(finding.partition("Lines ")[2].split(",")[0].split("-")[0].rstrip("."))
    row = dict(zip(head, path.read_text().splitlines()[first - 1].split(","), strict=True))
    assert float(row["frequency_rpm"]) == pytest.approx(float(row["speed_rpm"]))
    assert "read(..." not in out


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("perturbation", ["amplitude    15.7 to 55.6 um 0-peak", "force        2 N"]),
        ("wide", ["amplitude    6.6 to 37 um 0-peak", "unbalance    150 g mm"]),
        ("displacement", ["amplitude    30 um 0-peak", "force        0.515 to 1.26 N"]),
        ("static-load", ["load         0.5 to 2 N", "position     32.2 to 117 um"]),
    ],
)
def test_info_says_how_large_everything_was_taken_to_be(tmp_path, capsys, kind, words):
    """Peak-to-peak amplitudes, mils and pounds read as something else show in nothing but their size."""
    path = tmp_path / "lab.csv"
    path.write_text(example(kind))
    main(["info", str(path)])
    printed = capsys.readouterr().out
    assert all(f"  {line}\n" in printed for line in words), printed
