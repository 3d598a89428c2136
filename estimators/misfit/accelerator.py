"""Compile generated kernels with numba, where it is installed, and keep the machine code on disk."""

from __future__ import annotations

import glob
import hashlib
import importlib.util
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from rotorfit.base.atomic_file import whole_file
from rotorfit.base.caches import cache_home
from rotorfit.base.file_reading import is_sealed, seal
from rotorfit.base.version import RESULTS

Kernel = Callable[..., None]

_FAST = {"contract", "reassoc", "arcp", "nsz"}  # sums in any order; infinities and NaN keep their meaning


def available() -> bool:
    """True if numba is installed (``pip install rotorfit[fast]``); it is not imported."""
    return importlib.util.find_spec("numba") is not None


def cache_directory() -> Path | None:
    """Directory for compiled kernels that only this user can write, ``None`` if there is no such place.
    ``ROTORFIT_CACHE_DIR`` chooses it, else the platform's cache directory of the user. Machine code is loaded from it,
    so a directory that others own or may write, or may replace by another, is refused."""
    chosen = os.environ.get("ROTORFIT_CACHE_DIR")
    path = Path(chosen) if chosen else cache_home() / "rotorfit" / "kernels"
    try:
        for part in (*reversed(path.parents), path, path / "__pycache__"):
            part.mkdir(mode=0o700, exist_ok=True)
    except OSError:
        return None
    return path if _only_mine(path / "__pycache__") and os.access(path, os.W_OK) else None


def _only_mine(path: Path) -> bool:
    """True if nobody but this user and root can change a path, or put another in the place of any part of it.
    Folders above it may be open to others if these cannot rename what is not theirs there (``/tmp``)."""
    if not hasattr(os, "getuid"):
        return True
    for part in dict.fromkeys(p for start in (path.absolute(), path.resolve()) for p in (start, *start.parents)):
        status = part.stat()
        sticky = bool(status.st_mode & stat.S_ISVTX) and part != path
        if status.st_uid not in (0, os.getuid()) or (status.st_mode & 0o022 and not sticky):
            return False
    return path.stat().st_uid == os.getuid()


class _SealedCache:
    """numba's cache of a function on disk, whose files carry checksums: a damaged one is removed and compiled again."""

    def __init__(self, function: Callable[..., Any]) -> None:
        from numba.core.caching import FunctionCache

        self._kept = FunctionCache(function)
        self.cache_path = self._kept.cache_path
        if not _only_mine(Path(self.cache_path)):  # where NUMBA_CACHE_DIR is, for instance
            self._kept.disable()

    def _files(self) -> list[Path]:
        """The index and the machine code of every signature."""
        base = glob.escape(self._kept._impl.filename_base)
        return sorted(Path(self.cache_path).glob(f"{base}*.nb[ic]"))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Machine code of a signature, None where there is none, or it is damaged or may be changed by others."""
        try:
            files = self._files()
            if not all(file.is_file() and _only_mine(file) and is_sealed(file) for file in files):
                for file in files:
                    file.unlink(missing_ok=True)
        except FileNotFoundError:  # another process removes it at this moment
            pass
        except OSError:  # a folder of that name, for instance, stays
            self._kept.disable()
        return self._kept.load_overload(signature, context)

    def save_overload(self, signature: Any, code: Any) -> None:
        """Keep machine code; where the disk is full it is compiled again by the next process."""
        with suppress(OSError):
            self._kept.save_overload(signature, code)
            for file in self._files():
                if not is_sealed(file):
                    file.chmod(0o600)
                    seal(file)


@cache
def compile_kernels(source: str) -> dict[str, Kernel]:
    """Compile functions decorated as ``outer``; the text is the argument, the file only names numba's own cache."""
    import numba

    directory = cache_directory()
    versions = f"{RESULTS}\n{version('numba')}\n{np.__version__}\n{source}"
    name = f"rotorfit_kernel_{hashlib.sha256(versions.encode()).hexdigest()[:32]}"
    path = (directory or Path()) / f"{name}.py"
    if directory is not None and not path.exists():
        with suppress(OSError), whole_file(path) as draft:  # in one step: another process never sees half of it
            draft.write_text(source, encoding="utf-8")
    stored = directory is not None and path.exists()
    kernels: dict[str, Kernel] = {}

    def outer(function: Callable[..., Any]) -> Any:
        kernels[function.__name__] = compiled = numba.njit(fastmath=_FAST, error_model="numpy", nogil=True)(function)
        if stored:
            compiled._cache = _SealedCache(function)
        return compiled

    # numba looks the module of a cached function up by its name.
    module = sys.modules[name] = ModuleType(name)
    inner = numba.njit(fastmath=_FAST, error_model="numpy", nogil=True)
    vars(module).update(np=np, inner=inner, outer=outer, __file__=str(path))
    exec(compile(source, str(path), "exec"), vars(module))
    return kernels
