"""Columns of printed tables stay columns whatever is in them."""

from __future__ import annotations

from rotorfit.base.text_table import Wide, text_table

NAME = "K0_seal[speed_rpm=1000.523]"


def test_a_long_name_moves_all_rows_alike() -> None:
    rows = [["parameter", "value", "unit"], ["K0", "1.5", "N/m"], [NAME, "12345678901.25", "N s/m"]]
    lines = text_table(rows, "<12 >8 <1")
    assert [line.index(unit) for line, unit in zip(lines, ("unit", "N/m", "N s/m"), strict=True)] == [44] * 3
    assert lines[1] == f"{'K0':<{len(NAME)}}{'1.5':>15}  N/m"


def test_a_wide_cell_and_a_remark_leave_the_columns_where_they_are() -> None:
    rows = [
        ["a", "b", "c", "unit"],
        ["x", Wide("not determined", 2), "m"],
        ["y", "1", "2", "m"],
        ["z", Wide("a remark that is longer than the table", 3, remark=True)],
    ]
    lines = text_table(rows, "<2 >4 >4 <1")
    assert lines[1] == "x  not determined  m"
    assert lines[2].index("m") == lines[1].rindex("m")
    assert lines[3] == "z   a remark that is longer than the table"
