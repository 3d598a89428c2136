"""Recordings as other programs write them: LabVIEW's text and WAV of every header, each in several awkward forms."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
from recorded import RATE, SETUP, volts

import rotorfit as rf
from rotorfit.lab.recordings.formats.files import open_raw

CHANNELS = {name: values[:2048] for name, values in volts(1.0).items()}
NAMES = list(CHANNELS)
ROWS = np.round(np.column_stack(list(CHANNELS.values())), 4)
STEP = 1 / RATE


def lvm(
    rows: np.ndarray = ROWS,
    *,
    times: str = "No",
    comma: bool = False,
    separator: str = "Tab",
    names: list[str] = NAMES,
    comment: str | None = "OK",
    segments: int = 1,
    gap: float = 0.0,
) -> str:
    """A LabVIEW measurement file; NaN is an empty cell."""
    mark = "," if separator == "Comma" else "\t"
    count = len(names)

    def number(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.6f}".replace(".", "," if comma else ".")

    def heading(key: str, cells: list[str]) -> str:
        return mark.join([key, *(each for cell in cells for each in ((cell, "") if times == "Multi" else (cell,)))])

    head = ["LabVIEW Measurement", "Writer_Version\t2", f"Separator\t{separator}"]
    head += [f"Decimal_Separator\t{',' if comma else '.'}", f"X_Columns\t{times}", "Date\t2024/05/06"]
    lines = [*head, "Time\t23:59:59,5", "***End_of_Header***", ""]
    size = len(rows) // segments
    for k in range(segments):
        begin = k * size * STEP + k * gap
        lines += [f"Channels{mark}{count}", heading("Samples", [str(size)] * count)]
        lines += [heading("Y_Unit_Label", ["Volts"] * count), heading("X0", [number(begin)] * count)]
        lines += [heading("Delta_X", [repr(STEP).replace(".", "," if comma else ".")] * count), "***End_of_Header***"]
        lines += ["***Start_Special***", "a note", "***End_Special***"] * (k == 0)
        above = [each for name in names for each in (("X_Value", name) if times == "Multi" else (name,))]
        lines.append(mark.join([*([] if times == "Multi" else ["X_Value"]), *above, "Comment"]))
        for i, row in enumerate(rows[k * size : (k + 1) * size]):
            time = number(begin + i * STEP)
            cells = [
                each for value in row for each in ((time, number(value)) if times == "Multi" else (number(value),))
            ]
            cells = cells if times == "Multi" else [time if times == "One" else "", *cells]
            lines.append(mark.join([*cells, *([comment] if comment and i % 7 else [])]))
        lines.append("")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("times", ["No", "One", "Multi"])
@pytest.mark.parametrize(("comma", "separator"), [(False, "Tab"), (True, "Tab"), (False, "Comma")])
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_labview_text_is_read(tmp_path: Path, times: str, comma: bool, separator: str, encoding: str) -> None:
    comment = "Prüfstand läuft"
    (tmp_path / "a.lvm").write_text(lvm(times=times, comma=comma, separator=separator, comment=comment), encoding)
    raw = open_raw(tmp_path / "a.lvm")
    assert list(raw.channels) == NAMES
    assert raw.attributes == {"date": "2024-05-06"}
    for name, values in zip(NAMES, ROWS.T, strict=True):
        channel = raw.channels[name]
        np.testing.assert_array_equal(channel.samples(0, channel.size), values)
        assert channel.sample_rate == pytest.approx(RATE, rel=1e-6)
        assert channel.unit == "Volts"


@pytest.mark.parametrize(("comma", "word", "mark"), [(False, "Comma", ","), (True, "Semicolon", ";")])
def test_the_heading_of_labview_may_be_separated_as_the_rest(tmp_path: Path, comma: bool, word: str, mark: str) -> None:
    text = lvm(times="One", comma=comma).replace("\t", mark).replace(f"Separator{mark}Tab", f"Separator{mark}{word}")
    (tmp_path / "a.lvm").write_text(text, encoding="utf-8")
    for name, values in zip(NAMES, ROWS.T, strict=True):
        channel = open_raw(tmp_path / "a.lvm").channels[name]
        np.testing.assert_array_equal(channel.samples(0, channel.size), values)


def test_a_recording_by_labview_is_a_recording(tmp_path: Path) -> None:
    (tmp_path / "a.lvm").write_text(lvm(), encoding="utf-8")
    (tmp_path / "a.txt").write_text(lvm(), encoding="utf-8")
    (tmp_path / "rig.toml").write_text(SETUP.replace("sample_rate_hz = 3200.0\n", ""), encoding="utf-8")
    for name in ("a.lvm", "a.txt"):
        record = rf.read_recording(tmp_path / name, tmp_path / "rig.toml")
        assert record.sample_rate == pytest.approx(RATE)
        assert record.motion("disk").size == len(ROWS)
    with pytest.raises(ValueError, match=r"a\.lvm is a recording of raw signals, not of vectors"):
        rf.read(tmp_path / "a.lvm")


def test_channels_of_labview_that_are_empty_or_have_no_name(tmp_path: Path) -> None:
    rows = np.column_stack([ROWS[:, 0], np.full(len(ROWS), np.nan), ROWS[:, 1:]])
    (tmp_path / "a.lvm").write_text(lvm(rows, names=["", "spare", "disk_Y", "shaft", "shaft"]), encoding="utf-8")
    raw = open_raw(tmp_path / "a.lvm")
    assert list(raw.channels) == ["channel_1", "disk_Y", "shaft", "shaft (5)"]
    assert raw.remarks == ("a.lvm: channels without a number were left out: spare",)
    np.testing.assert_array_equal(raw.channels["shaft (5)"].samples(0, 9), ROWS[:9, 3])


@pytest.mark.parametrize("times", ["No", "One", "Multi"])
def test_segments_of_labview_are_one_recording_where_one_follows_the_other(tmp_path: Path, times: str) -> None:
    (tmp_path / "a.lvm").write_text(lvm(times=times, segments=4), encoding="utf-8")
    channel = open_raw(tmp_path / "a.lvm").channels["disk_X"]
    np.testing.assert_array_equal(channel.samples(0, channel.size), ROWS[:, 0])
    (tmp_path / "b.lvm").write_text(lvm(times=times, segments=4, gap=0.5), encoding="utf-8")
    with pytest.raises(ValueError, match=r"b\.lvm.*(does not go on where the one before ended|not evenly spaced)"):
        open_raw(tmp_path / "b.lvm")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("-5", "x5"), r"a\.lvm: line \d+ holds what is not a number: 'x5"),
        (("***End_of_Header***", "no end"), r"a\.lvm holds no signals: no numbers stand below a second"),
        (("Decimal_Separator\t.", "Decimal_Separator\t,"), ""),
    ],
)
def test_damaged_labview_files_are_refused_in_words(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    (tmp_path / "a.lvm").write_text(lvm().replace(*change), encoding="utf-8")
    if not words:  # a file that does not do what its heading says
        assert open_raw(tmp_path / "a.lvm").channels["disk_X"].size == len(ROWS)
        return
    with pytest.raises(ValueError, match=words):
        open_raw(tmp_path / "a.lvm")


# ---- WAV ---------------------------------------------------------------------------------------------------------

COUNTS = np.round(ROWS / 20 * 2**23).astype("<i4")


def chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def wav(
    content: bytes,
    width: int,
    *,
    tag: int = 0xFFFE,
    sub: int = 1,
    count: int = 4,
    head: bytes = b"RIFF",
    before: bytes = b"",
) -> bytes:
    """A WAV file: with an extensible header, or the plain one of a tag."""
    form = struct.pack("<HHIIHH", tag, count, int(RATE), int(RATE) * count * width, count * width, 8 * width)
    if tag == 0xFFFE:
        form += (
            struct.pack("<HHI", 22, 8 * width, 0)
            + struct.pack("<H", sub)
            + bytes.fromhex("000000001000800000aa00389b71")
        )
    body = b"WAVE" + before + chunk(b"fmt ", form) + chunk(b"LIST", b"INFOIART\x04\0\0\0rigs") + chunk(b"data", content)
    return head + struct.pack("<I", len(body)) + body


def packed(width: int) -> bytes:
    counts = COUNTS << 8 if width == 4 else COUNTS if width == 3 else COUNTS >> 8
    return counts.reshape(-1, 1).view(np.uint8)[:, :width].tobytes()


FORMS = {
    "24 bits, extensible": wav(packed(3), 3),
    "16 bits, extensible": wav(packed(2), 2),
    "32 bits, extensible": wav(packed(4), 4),
    "24 bits, plain": wav(packed(3), 3, tag=1),
    "floats, extensible": wav(ROWS.astype("<f4").tobytes(), 4, sub=3),
    "doubles, plain": wav(ROWS.astype("<f8").tobytes(), 8, tag=3),
    "beyond 4 GB": wav(
        packed(3), 3, head=b"RF64", before=chunk(b"ds64", struct.pack("<QQQI", 0, len(packed(3)), 2048, 0))
    ).replace(b"data" + struct.pack("<I", len(packed(3))), b"data\xff\xff\xff\xff"),
}


def streamed(whole: bytes, riff: int, data: int, cut: int = 0) -> bytes:
    """A file whose writer went on before it knew the lengths, or was cut off."""
    length, at = len(packed(3)), whole.index(b"data") + 4
    whole = whole[:4] + struct.pack("<I", riff) + whole[8:at] + struct.pack("<I", data) + whole[at + 4 :]
    assert len(whole) == at + 4 + length
    return whole[: len(whole) - cut]


FORMS |= {
    f"streamed, {name}": streamed(FORMS["24 bits, extensible"], *lengths)
    for name, lengths in {
        "none known": (0xFFFFFFFF, 0xFFFFFFFF),
        "a sample cut in two": (0xFFFFFFFF, 0xFFFFFFFF, 7),
        "largest of SoX": (0x7FFFF024, 0x7FFFF000),
        "largest of ALSA": (0x7FFFFFFF, 0x80000000),
        "cut off": (0, 0),
    }.items()
}


@pytest.mark.parametrize("form", FORMS)
def test_wav_of_every_header_is_read_in_pieces(tmp_path: Path, form: str) -> None:
    (tmp_path / "a.wav").write_bytes(FORMS[form])
    raw = open_raw(tmp_path / "a.wav")
    assert list(raw.channels) == [f"channel_{k}" for k in range(1, 5)]
    for channel, values in zip(raw.channels.values(), ROWS.T, strict=True):
        found = channel.samples(100, 400) / (channel.full_count or 20.0) * 20
        np.testing.assert_allclose(found, values[100:400], atol=1e-3 if "16" in form else 3e-6)
        assert channel.samples(5000, 6000).size == 0
    assert raw.sample_rate == RATE


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (wav(packed(2), 2, sub=2), "packed or coded .format 0x0002.; export 16 or 24 bits"),
        (wav(packed(2), 2, tag=0x55), "packed or coded .format 0x0055."),
        (wav(b"\x80" * 4096, 1, tag=1), "8 bits, too coarse"),
        (FORMS["24 bits, extensible"][:-100], "is not a whole WAV file: it ends before its 2048 samples"),
        (FORMS["24 bits, extensible"][:60], "it has no samples"),
        (b"FORM" + bytes(400), "it is AIFF; export WAV"),
        (b"fLaC" + bytes(400), "it is FLAC; export WAV"),
        (b"RIFF\x04\0\0\0WAVE", "it has no samples"),
        (wav(b"", 3), "holds no signals"),
    ],
    ids=["ADPCM", "MP3", "8 bits", "cut", "header alone", "AIFF", "FLAC", "nothing", "empty"],
)
def test_other_sound_files_are_refused_with_what_can_be_read(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.wav.*{words}"):
        open_raw(tmp_path / "a.wav")


# ---- a matrix with a list of names -------------------------------------------------------------------------------


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("where", ["beside", "bytes", "in a group", "attribute", "with units"])
def test_a_matrix_of_hdf5_with_a_list_of_names(tmp_path: Path, where: str, turned: bool) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("run 1") if where == "in a group" else file
        data = group.create_dataset("data", data=ROWS.T if turned else ROWS)
        if where == "attribute":
            data.attrs["labels"] = NAMES
        elif where == "bytes":
            group["channel_names"] = np.array(NAMES, dtype="S")
        else:
            group["names"] = np.array(NAMES, dtype=h5py.string_dtype())
        if where == "with units":
            group["units"] = np.array(["V"] * 4, dtype="S")
        group["fs"] = RATE
        file["speed_rpm"] = 1200.0
    raw = open_raw(tmp_path / "a.h5")
    assert list(raw.channels) == NAMES
    assert raw.attributes["speed_rpm"] == 1200.0
    assert raw.sample_rate == RATE
    np.testing.assert_array_equal(raw.channels["disk_Y"].samples(3, 90), ROWS[3:90, NAMES.index("disk_Y")])


def test_a_table_of_hdf5_with_fields(tmp_path: Path) -> None:
    """As PyTables, pandas and some loggers write: a field a channel, among them the times."""
    fields = ["time", "keyphasor", "disk_X", "disk_Y", "force"]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        table = np.rec.fromarrays([np.arange(len(ROWS)) / RATE, *ROWS.T], names=fields)
        file.create_dataset("run/table", data=table)
    raw = open_raw(tmp_path / "a.h5")
    assert list(raw.channels) == fields[1:]
    assert raw.sample_rate == pytest.approx(RATE)
    for channel, values in zip(raw.channels.values(), ROWS.T, strict=True):
        np.testing.assert_array_equal(channel.samples(100, 400), values[100:400])


def test_lists_of_other_lengths_name_nothing(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data"], file["names"], file["fs"] = ROWS, np.array(["a", "b"], dtype="S"), RATE
    assert list(open_raw(tmp_path / "a.h5").channels) == ["data_1", "data_2", "data_3", "data_4"]
