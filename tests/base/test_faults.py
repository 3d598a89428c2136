"""Whose fault an exception is: what passes a reader, and what becomes a sentence on the file."""

from __future__ import annotations

import pytest
from failing_lines import LINES, of_rotorfit
from sentences import refuses

from rotorfit.base.faults import of_program
from rotorfit.base.file_reading import reading


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_errors_of_the_program_pass_a_reader(line: str) -> None:
    with pytest.raises(Exception) as caught, reading("rig.csv", "table"):  # noqa: PT011 - which is the line's
        of_rotorfit(line)()
    assert caught.value.__cause__ is None
    assert of_program(caught.value)


def test_a_function_of_a_library_has_no_line_of_its_own() -> None:
    """Its exception tells it from an error of the line that calls it."""
    with refuses(ValueError), reading("a.mat", "MAT file"):
        of_rotorfit("__import__('zlib').decompress(b'1234')")()


def test_a_missing_package_passes_a_reader() -> None:
    """It is no damage of the file."""
    with pytest.raises(ImportError, match="nowhere"), reading("a.mat", "MAT file"):
        of_rotorfit("__import__('nowhere')")()
