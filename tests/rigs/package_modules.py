"""Modules of the package, those of the linked sub-packages included."""

from __future__ import annotations

import importlib
import pkgutil


def modules(package: str = "rotorfit") -> list[str]:
    """A package and all below it, rooms and the symlinked sub-packages included."""
    path = importlib.import_module(package).__path__
    return [package, *(i.name for i in pkgutil.walk_packages(path, f"{package}.") if not i.name.endswith("__main__"))]


MODULES = modules()
