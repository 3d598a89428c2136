"""Files that are not read: which they are by their suffix, and what their program exports that is read."""

from __future__ import annotations

from rotorfit.base.names import unknown_name

_TABLE = "save it as .xlsx or .csv"
_SIGNALS = "export MATLAB (.mat), universal file (.uff), TDMS or CSV from the program that wrote it"
_WAVES = "convert it to WAV of 16 or 24 bits"
_PACKED = "unpack it first"
_TEXT = "if it is a text of columns, name it .csv or .txt; else " + _SIGNALS
_OTHERS = {
    (".xls", ".ods", ".xlsb", ".numbers"): ("a spreadsheet", _TABLE),
    (".tdm", ".tdx"): ("a pair of files of DIAdem", "export TDMS"),
    (".mf4", ".mdf"): ("a measurement data file (MDF)", "export MATLAB (.mat), Parquet or CSV, as asammdf does"),
    (".dxd", ".dwd", ".d7d"): ("a recording of Dewesoft", _SIGNALS),
    (".lms", ".ldsf", ".sdf", ".sie", ".pul", ".bkc", ".atfx", ".rpc", ".sif", ".dac", ".pxp", ".spe", ".wvf"): (
        "a file of an analyser's own",
        _SIGNALS,
    ),
    (".dat", ".asc", ".prn", ".lst", ".out", ".log", ".fdf"): ("a file whose name does not say its format", _TEXT),
    (".bin", ".raw", ".pcm", ".daq"): ("a file of numbers without a heading", _SIGNALS),
    (".flac", ".mp3", ".ogg", ".aif", ".aiff", ".w64", ".m4a"): ("a sound file of another kind", _WAVES),
    (".zip", ".gz", ".7z", ".tar", ".tgz", ".bz2", ".rar", ".xz"): ("an archive", _PACKED),
    (".pkl", ".pickle", ".joblib"): ("a pickled object, which is not opened: it can run anything", "save .npz or .csv"),
    (".npy",): ("one array without names", "save it with np.savez(path, disk_X=..., fs=...)"),
    (".feather", ".arrow", ".ipc"): ("an Arrow file", "save it as Parquet"),
    (".xml", ".html", ".htm", ".pdf", ".docx", ".doc", ".rtf", ".odt"): ("a document", "export its table as CSV"),
    (".db", ".sqlite", ".sqlite3"): ("a database", "export its table as CSV; a store is opened by rf.Store"),
    (".bdf", ".op2", ".nas", ".inp", ".cdb", ".rst"): (
        "a file of a finite-element program",
        "export mass, damping and stiffness matrices, see docs/structure.md",
    ),
}  # fmt: skip


def unread_suffix(kind: str, suffix: str, allowed: list[str]) -> str:
    """Sentence for a file of a suffix that is not read, with the way from its format where that is known."""
    lower = suffix.lower()
    found = next((words for suffixes, words in _OTHERS.items() if lower in suffixes), None)
    if found is None:
        return unknown_name(kind, suffix, allowed)
    what, way = found
    return f"{what} ({lower}), which is not read: {way}. Allowed: {', '.join(allowed)}"
