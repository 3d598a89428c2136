"""Where caches go: the folder of the user, or a temporary one where that cannot be written, as of a service."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

_LOG = logging.getLogger("rotorfit")
_TEMPORARY: list[TemporaryDirectory[str]] = []
"""Folders that are gone when the process ends."""


def cache_home() -> Path:
    """The user's folder for caches. Where it cannot be written a temporary one takes its place, for other packages and
    processes that are started too, and that is said."""
    own = _usual()
    existing = next((part for part in (own, *own.parents) if os.path.exists(part)), own)
    if own.is_absolute() and existing.is_dir() and os.access(existing, os.W_OK):
        return own
    _TEMPORARY.append(TemporaryDirectory(prefix="rotorfit-", ignore_cleanup_errors=True))
    made = Path(_TEMPORARY[-1].name)
    os.environ["LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"] = str(made)
    if not own.is_absolute():  # packages ask for a home, and fail where there is none
        os.environ["HOME"] = str(made)
    os.environ.setdefault("MPLCONFIGDIR", str(made / "matplotlib"))
    _LOG.warning(f"rotorfit: the folder for caches, {own}, cannot be written; a temporary one is used: {made}")
    return made


def _usual() -> Path:
    """The folder, not absolute for a user who has no home."""
    home = Path(os.path.expanduser("~"))
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local"))
    named = os.environ.get("XDG_CACHE_HOME")  # asked for on macOS too, where it has no meaning of its own
    return Path(named or home / ("Library/Caches" if sys.platform == "darwin" else ".cache"))
