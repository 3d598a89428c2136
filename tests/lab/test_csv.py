import re
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from any_test import rigs, same
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sentences import refuses

import rotorfit
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.io.files import read
from rotorfit.lab.io.tables.cells import encoding_of
from rotorfit.lab.io.tables.result_tables import frame_csv, records_csv, rows_csv
from rotorfit.lab.io.tables.tidy_csv import read_csv, write_csv
from rotorfit.lab.kinds.displacement_test import DisplacementTest

HEADER = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg"
ROW = "a,1000,300,disk,2.5,30,disk,x,12,-40"
DISPLACEMENT = (
    "run,speed_rpm,frequency_rpm,plane,amplitude_um,phase_deg,force_x_N,force_x_phase_deg,force_y_N,force_y_phase_deg"
)


def table(tmp_path, *rows, header=HEADER, name="test.csv"):
    path = tmp_path / name
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return path


def test_reads_si_units_and_leading_phases(tmp_path):
    test = read(table(tmp_path, ROW, "b,1000,-450,disk,1,0,journal,y,3,90"))
    assert isinstance(test, PerturbationTest)
    assert test.source == "test.csv"
    np.testing.assert_allclose(test.speed, 1000 * np.pi / 30)
    np.testing.assert_allclose(test.frequency, [10 * np.pi, -15 * np.pi])
    np.testing.assert_allclose(test.force, [2.5 * np.exp(1j * np.pi / 6), 1.0])
    np.testing.assert_allclose(test.response, [12e-6 * np.exp(-1j * np.radians(40)), 3e-6j], atol=1e-20)
    assert test.planes == ("disk", "journal")
    assert test.runs == ("a", "b")
    assert np.isnan(test.sigma).all()


@pytest.mark.parametrize(
    ("column", "other", "cell"),
    [
        ("frequency_rpm", "frequency_hz", 5.0),
        ("frequency_rpm", "frequency_rad_s", 10 * np.pi),
        ("frequency_rpm", "frequency_cpm", 300.0),
        ("speed_rpm", "speed_Hz", 1000 / 60),
        ("amplitude_um", "amplitude_m", 12e-6),
        ("amplitude_um", "amplitude_mm", 12e-3),
        ("amplitude_um", "amplitude_um_pp", 24.0),
        ("amplitude_um", "amplitude_mil_pp", 24 / 25.4),
        ("amplitude_um", "amplitude_µm", 12.0),
        ("force_N", "force_lbf", 2.5 / 4.4482216152605),
        ("force_N", "mr_kg_m", 2.5 / (10 * np.pi) ** 2),
        ("force_N", "mr_g_mm", 2.5e6 / (10 * np.pi) ** 2),
        ("phase_deg", "phase_lag_deg", 40.0),
        ("phase_deg", "phase_rad", -np.radians(40)),
        ("force_phase_deg", "force_phase_lag_deg", -30.0),
    ],
)
def test_other_units_by_suffix_give_the_same_test(tmp_path, column, other, cell):
    names = HEADER.split(",")
    at = names.index(column)
    cells = ROW.split(",")
    names[at], cells[at] = other, repr(float(cell))
    plain = read(table(tmp_path, ROW))
    test = read(table(tmp_path, ",".join(cells), header=",".join(names)))
    for name in ("speed", "frequency", "force", "response"):
        np.testing.assert_allclose(getattr(test, name), getattr(plain, name), rtol=1e-12)


def test_real_and_imaginary_part_and_noise(tmp_path):
    header = HEADER.replace("amplitude_um,phase_deg", "real_um,imag_um,sigma_um_pp")
    test = read(
        table(tmp_path, "a,1000,300,disk,1,0,disk,z,3,-4,0.5", "a,1000,310,disk,1,0,disk,z,-3,4,", header=header)
    )
    np.testing.assert_allclose(test.response, [3e-6 - 4e-6j, -3e-6 + 4e-6j])
    np.testing.assert_allclose(test.sigma, [0.25e-6, np.nan])


def test_comments_blank_lines_byte_order_mark_and_semicolons(tmp_path):
    path = tmp_path / "excel.csv"
    text = ['# a, comment with "quotes', HEADER.replace(",", ";"), "", "  # another", ROW.replace(",", ";"), ""]
    path.write_text("\r\n".join(text), encoding="utf-8-sig")
    assert len(read(path)) == 1


def test_tilt_in_its_own_column_and_from_an_axial_probe(tmp_path):
    header = HEADER.replace("amplitude_um", "amplitude_um,amplitude_urad,sigma_um,sigma_urad")
    test = read(
        table(tmp_path, "a,100,300,disk,1,0,disk,x,12,,1,,0", "a,100,300,disk,1,0,disk,rx,,70,,2,0", header=header)
    )
    np.testing.assert_allclose(test.response, [12e-6, 70e-6])
    np.testing.assert_allclose(test.sigma, [1e-6, 2e-6])
    header = HEADER + ",sigma_um,probe_radius_mm"
    rows = ["a,100,300,disk,1,0,disk,x,12,0,1,", "a,100,300,disk,1,0,disk,ry,12,0,1,-50"]
    test = read(table(tmp_path, *rows, header=header))
    np.testing.assert_allclose(test.response, [12e-6, -12e-6 / 0.05])
    np.testing.assert_allclose(test.sigma, [1e-6, 1e-6 / 0.05])
    with refuses(ValueError):
        read(table(tmp_path, ROW.replace(",x,", ",rx,")))


def test_further_columns_are_attributes(tmp_path):
    rows = [ROW + ",41.5,ISO VG 32,7", ROW.replace("300", "310") + ",,ISO VG 32,"]
    test = read(table(tmp_path, *rows, header=HEADER + ",oil_temperature_C,Oil,blank_too"))
    np.testing.assert_array_equal(test.attribute("oil_temperature_C"), [41.5, np.nan])
    assert test.attribute("Oil").tolist() == ["ISO VG 32"] * 2
    np.testing.assert_array_equal(test.attribute("blank_too"), [7, np.nan])


def test_displacement_input_is_told_by_its_columns(tmp_path):
    test = read(table(tmp_path, "a,1000,300,seal,50,30,4,90,4,0", header=DISPLACEMENT))
    assert isinstance(test, DisplacementTest)
    np.testing.assert_allclose(test.displacement, 50e-6 * np.exp(1j * np.pi / 6))
    np.testing.assert_allclose(test.force_x, 4j, atol=1e-15)
    np.testing.assert_allclose(test.force_y, 4)
    write_csv(test, tmp_path / "again.csv")
    again = read(tmp_path / "again.csv")
    np.testing.assert_allclose(again.force_x, test.force_x, rtol=1e-14)
    with refuses(ValueError):
        read(table(tmp_path, "a,1000,300,seal,50,30,4,90,0", header=DISPLACEMENT.replace("force_y_N,", "")))


def test_speeds_that_jitter_are_one_speed_and_others_are_left_alone(tmp_path):
    def row(run, speed, frequency):
        return f"{run},{speed},{frequency},disk,1,0,disk,x,1,0"

    rows = [row("a", 999, 100), row("a", 1001, 200), row("b", 1000, -100), row("b", 2000, -200)]
    test = read(table(tmp_path, *rows))
    np.testing.assert_allclose(test.set_speed * 30 / np.pi, [1000, 1000, 1000, 2000])
    np.testing.assert_allclose(test.speed * 30 / np.pi, [999, 1001, 1000, 2000])
    assert read(table(tmp_path, *rows), speed_tolerance=0.0005).attribute("speed_rpm").tolist() == [
        999,
        1001,
        1000,
        2000,
    ]
    sweep = read(table(tmp_path, *[row("a", 1000 + 3 * i, 500) for i in range(100)]))
    np.testing.assert_allclose(sweep.attribute("speed_rpm"), 1000 + 3 * np.arange(100))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"bad\.csv is empty.*speed_rpm"),
        ("# only\n# comments\n", "is empty"),
        (HEADER + "\n", "has one line.*no rows"),
        (f"{HEADER}\n{ROW},7\n", "line 2 has 11 cells, the header has 10"),
        (f"{HEADER},run\n{ROW},7\n", "every column needs a name of its own"),
        (
            f"{HEADER}\n{ROW}\n{ROW.replace('12', 'twelve')}\n",
            r"line 3, column 'amplitude_um': 'twelve' is not a number",
        ),
        (f"{HEADER}\n" + ROW.replace("12", '"1,2 N"') + "\n", "'1,2 N' is not a number"),
        (f"{HEADER}\n{ROW.replace('12', 'NaN')}\n", "line 2, column 'amplitude_um': NaN where a finite number"),
        (f"{HEADER}\n{ROW.replace('300', 'inf')}\n", "line 2, column 'frequency_rpm': inf where a finite number"),
        (f"{HEADER}\n{ROW.replace('300', '')}\n", "column 'frequency_rpm': a blank cell where a finite number"),
        (f"{HEADER}\n{ROW.replace('12', '')}\n", "direction x: a length is needed"),
        (f"{HEADER}\n{ROW.replace('12', '-12')}\n", "-12 is negative; amplitudes are not"),
        (f"{HEADER}\n{ROW.replace(',x,', ',u,')}\n", "unknown direction 'u'.*x, y, z"),
        (f"{HEADER}\n{ROW.replace('disk,x', ',x')}\n", "line 2, column 'plane' is blank"),
        (f"{HEADER},sigma_um\n{ROW},0\n", "column 'sigma_um': 0 must be positive"),
        (
            f"{HEADER},sigma_umm\n{ROW},1\n",
            r"unknown column 'sigma_umm'; unknown unit 'umm'\. Allowed: m, mm, um, nm, in, mil\.",
        ),
        (f"{HEADER},sigm_um\n{ROW},1\n", r"unknown column 'sigm_um'; did you mean 'sigma_um'\?"),
        (f"{HEADER},frequency_hz\n{ROW},1\n", "frequency is given twice, as frequency_rpm and frequency_hz"),
        (f"{HEADER},mr_g_mm\n{ROW},1\n", "both force_N and mr_g_mm are given"),
        (f"{HEADER},amplitude_mil\n{ROW},1\n", "given twice, as amplitude_um and amplitude_mil"),
        (
            f"{HEADER.replace('frequency_rpm', 'freqency_rpm')}\n{ROW}\n",
            r"missing columns: frequency_rpm\. Columns not recognised: 'freqency_rpm' \(did you mean 'freq",
        ),
        (
            f"{HEADER}\n{ROW.replace('300', '1e300').replace(',12,', ',1e308,')}\n{ROW}",
            r"frequency is 1\.05e\+299 rad/s; up to 1e\+10 are allowed",
        ),
        (f"{HEADER.replace('force_N', 'mr_kg_m')}\n{ROW.replace('300', '1e300')}\n", "force overflows"),
        (f"{HEADER}\n{ROW}\n{ROW.replace('disk', 'inboard').replace('inboard,x', 'outboard,x')}\n", "two rigs"),
        (f'{HEADER}\n"{ROW}\n', "not a readable CSV"),
    ],
)
def test_bad_input_is_refused_with_what_and_where(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read(path)


def test_other_encodings_and_missing_files(tmp_path):
    path = tmp_path / "latin.csv"
    path.write_bytes(f"# Öl\n{HEADER}\n{ROW}\n".encode("latin-1"))
    assert len(read(path)) == 1
    path.write_bytes(b"# \x81\xff\n" + f"{HEADER}\n{ROW}\n".encode())  # 0x81 has no letter in Windows-1252
    with refuses(ValueError):
        read(path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none.csv")


def test_a_hundred_thousand_rows_take_a_second_or_two(tmp_path):
    n = 100_000
    rows = [f"r{i // 1000},1000,{i % 1000 + 1.5},disk,2.5,30,disk,{'xy'[i % 2]},{i % 7}.25,-40,41.5" for i in range(n)]
    path = table(tmp_path, *rows, header=HEADER + ",oil")
    start = time.process_time()
    assert len(read(path)) == n
    assert time.process_time() - start < 6  # generous: the machine may be busy


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(test=rigs())
def test_any_test_reads_back_to_fifteen_digits(tmp_path_factory, test):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    write_csv(test, path)
    same(read_csv(path), test, rtol=1e-13)  # two conversions of units and 15 digits: a few 1e-15, phases of up to pi


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    header=st.lists(st.one_of(st.sampled_from([*HEADER.split(","), *DISPLACEMENT.split(",")]), st.text(max_size=8))),
    rows=st.lists(st.lists(st.one_of(st.text(max_size=6), st.floats().map(str)), max_size=12), max_size=4),
)
def test_random_tables_are_read_or_refused_in_words(tmp_path_factory, header, rows):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    path.write_bytes("\n".join(",".join(row) for row in [header, *rows]).encode("utf-8", "surrogatepass"))
    refused_in_words(path)


def test_bytes_of_another_encoding_are_found_block_by_block(tmp_path):
    path, size = tmp_path / "long.csv", 5_000_000
    text = b"-" * ((1 << 20) - 1) + "µ".encode() + b"-" * size  # the second block begins in a character
    path.write_bytes(text)
    tracemalloc.start()
    assert encoding_of(path) == "utf-8"
    assert tracemalloc.get_traced_memory()[1] < size  # the file is not read as a whole
    tracemalloc.stop()
    path.write_bytes(text + b"\xff\x81")  # neither in UTF-8 nor in Windows-1252
    with pytest.raises(ValueError, match=rf"at byte {len(text) + 1}\); save it"):
        encoding_of(path)


def test_a_warning_of_a_file_names_the_line_that_read_it(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("\n".join([HEADER, ROW, ROW.rpartition(",")[0] + ","]), encoding="utf-8")
    with pytest.warns(UserWarning, match="1 of 2 readings are empty") as told:
        rotorfit.read(path)
    assert {warning.filename for warning in told} == {__file__}


@pytest.mark.filterwarnings("ignore:.*readings are empty")
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cells=st.lists(st.one_of(st.text(max_size=4), st.floats().map(str)), min_size=10, max_size=10))
def test_random_cells_are_read_or_refused_in_words(tmp_path_factory, cells):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    path.write_bytes("\n".join([HEADER, ROW, ",".join(cells)]).encode("utf-8", "surrogatepass"))
    refused_in_words(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(content=st.binary(max_size=200))
def test_random_bytes_are_refused_in_words(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    path.write_bytes(content)
    refused_in_words(path)


def refused_in_words(path):
    message = None
    try:
        read(path)
    except ValueError as error:
        message = str(error)
    assert message is None or (message.startswith("t.csv") and len(message.split()) > 4)


def test_names_that_no_cell_can_hold_are_refused(tmp_path):
    test = read(table(tmp_path, ROW))
    broken = perturbation_test(
        run=["a\nb"],
        speed=1.0,
        frequency=2.0,
        force_plane=["p"],
        force=1.0,
        plane=["p"],
        direction=["x"],
        response=1e-6,
    )
    with refuses(ValueError):
        write_csv(broken, tmp_path / "t.csv")
    columns = {name: getattr(test, name) for name in test._columns()}
    for name in ("plane", "Force Plane", "mr (g m)"):
        clash = type(test)(**columns, attributes={name: test.speed})
        with refuses(ValueError):
            write_csv(clash, tmp_path / "t.csv")


def test_names_that_spreadsheets_run_are_text_in_files_and_read_back(tmp_path):
    """A plane named as a formula, as a hostile file has it; numbers keep their sign."""
    names = ["=cmd|' /C calc'!A0", "-journal", "@run"]
    source = table(tmp_path, *[f'{names[2]},1000,300,"{p}",-2.5,-30,"{p}",x,12,-40' for p in names[:2]])
    test = read(source)
    write_csv(test, tmp_path / "a.csv")
    for line in (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[2:]:
        assert not [cell for cell in line.split(",") if cell.startswith(("=", "@", "-j"))]
        assert "-40" in line
    again = read(tmp_path / "a.csv")
    same(again, test, rtol=1e-12)
    assert (again.planes, again.runs) == (tuple(names[:2]), tuple(names[2:]))


def test_names_that_spreadsheets_run_are_text_in_tables_of_results(tmp_path):
    """Columns and cells, of rows as of DataFrames; numbers are not touched."""
    import pandas as pd

    expected = "plane,'@x\n'=cmd,-1.5\n-b2,\n".replace("-b2", "'-b2")
    rows = [["plane", "@x"], ["=cmd", -1.5], ["-b2", None]]
    assert rows_csv(rows) == expected
    assert records_csv([dict(zip(rows[0], row, strict=True)) for row in rows[1:]]) == expected
    assert frame_csv(pd.DataFrame(rows[1:], columns=rows[0])) == expected


def test_all_tables_of_results_are_written_by_one_writer():
    """Which is the one that keeps formulas out."""
    package = Path(rotorfit.__file__).parent
    own = re.compile(r"csv\.(writer|DictWriter)|dataframe\(.*\)\.to_csv|import csv$", re.M)
    writers = {file.name for file in package.rglob("*.py") if own.search(file.read_text(encoding="utf-8"))}
    assert writers == {"cells.py", "result_tables.py"}


def test_titles_speed_alone_and_columns_of_other_names(tmp_path):
    """As a start-up leaves an analyser: titles above the header, one speed, a column of another name."""
    header = "speed_rpm,force_plane,mr_g_mm,force_phase_deg,plane,direction,amplitude_um,phase_deg"
    rows = [f"{speed},disk,100,0,disk,x,{speed / 90:.3f},-{speed // 20}" for speed in range(300, 1800, 100)]
    start_up = read(table(tmp_path, *rows, header=header))
    np.testing.assert_array_equal(start_up.frequency, start_up.speed)
    assert start_up.synchronous
    titled = table(
        tmp_path, header.replace("speed_rpm", "Drehzahl"), *rows, header="Machine: K-201\nDate: 5/3\n", name="b.csv"
    )
    np.testing.assert_array_equal(read_csv(titled, columns={"Drehzahl": "speed_rpm"}).speed, start_up.speed)
    with refuses(ValueError):  # theirs first
        read_csv(titled, columns={"speed_rpm": "Drehzahl"})
    forced = table(tmp_path, *rows, header=header.replace("mr_g_mm", "force_N"), name="c.csv")
    with refuses(ValueError):  # a force may turn at any frequency
        read(forced)
