"""Files are replaced whole or not at all."""

from __future__ import annotations

from pathlib import Path

from sentences import refuses

from rotorfit.base.atomic_file import whole_file


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text("old", encoding="utf-8")

    def half_written() -> None:
        with whole_file(path) as draft:
            draft.write_text("ne", encoding="utf-8")
            raise RuntimeError("power cut")

    with refuses(RuntimeError):
        half_written()
    assert [file.read_text(encoding="utf-8") for file in tmp_path.iterdir()] == ["old"]


def test_a_whole_file_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text("old", encoding="utf-8")
    with whole_file(path) as draft:
        assert draft.suffix == path.suffix  # some writers add the suffix that they miss
        draft.write_text("new", encoding="utf-8")
        assert path.read_text(encoding="utf-8") == "old"
    assert [file.read_text(encoding="utf-8") for file in tmp_path.iterdir()] == ["new"]


def test_a_folder_that_is_not_there_is_named() -> None:
    with refuses(FileNotFoundError), whole_file(Path("nowhere/fit.json")):
        pass
