"""Compile generated kernels with numba, where it is installed, and keep the machine code on disk."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from rotorfit.estimators.atomic_file import whole_file

Kernel = Callable[..., None]

_FAST = {"contract", "reassoc", "arcp", "nsz"}  # sums in any order; infinities and NaN keep their meaning


def available() -> bool:
    """Whether numba is installed (``pip install rotorfit[fast]``); it is not imported."""
    return importlib.util.find_spec("numba") is not None


def cache_directory() -> Path | None:
    """Directory for compiled kernels that only this user can write, ``None`` if there is no such place.

    ``ROTORFIT_CACHE_DIR`` chooses it, else the platform's cache directory of the user. Machine code is loaded from
    it, so a directory that others own or may write is refused.
    """
    chosen = os.environ.get("ROTORFIT_CACHE_DIR")
    if chosen:
        path = Path(chosen)
    elif sys.platform == "win32":
        path = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "rotorfit" / "kernels"
    elif sys.platform == "darwin":
        path = Path.home() / "Library" / "Caches" / "rotorfit" / "kernels"
    else:
        path = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "rotorfit" / "kernels"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.stat()
    except OSError:
        return None
    foreign = hasattr(os, "getuid") and (status.st_uid != os.getuid() or bool(status.st_mode & 0o022))
    return None if foreign or not os.access(path, os.W_OK) else path


def _write_once(path: Path, text: str) -> bool:
    """Put a file in place in one step, so that another process never sees half of it."""
    if path.exists():
        return True
    try:
        with whole_file(path) as draft:
            draft.write_text(text, encoding="utf-8")
    except OSError:
        return False
    return True


def _module_name(source: str) -> str:
    text = f"{version('numba')}\n{np.__version__}\n{source}"
    return f"rotorfit_kernel_{hashlib.sha256(text.encode()).hexdigest()[:32]}"


@cache
def compile_kernels(source: str) -> dict[str, Kernel]:
    """Compile the functions that a generated module decorates as ``outer``.

    The text compiled is the argument, never what lies on disk; the file gives numba's own cache a name and a time
    stamp.
    """
    import numba

    directory = cache_directory()
    name = _module_name(source)
    path = (directory or Path()) / f"{name}.py"
    stored = directory is not None and _write_once(path, source)
    kernels: dict[str, Kernel] = {}

    def outer(function: Callable[..., Any]) -> Any:
        options = {"fastmath": _FAST, "error_model": "numpy", "nogil": True, "cache": stored}
        kernels[function.__name__] = compiled = numba.njit(**options)(function)
        return compiled

    # numba looks the module of a cached function up by its name.
    module = sys.modules[name] = ModuleType(name)
    inner = numba.njit(fastmath=_FAST, error_model="numpy", nogil=True)
    vars(module).update(np=np, inner=inner, outer=outer, __file__=str(path))
    exec(compile(source, str(path), "exec"), vars(module))
    return kernels
