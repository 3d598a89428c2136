"""Example files of every kind of experiment, of studies and virtual tests, to fill in: ``rotorfit template KIND``."""

from __future__ import annotations

from importlib.resources import files

from rotorfit.base.names import unknown_name

_TESTS = ("perturbation", "wide", "synchronous", "displacement", "static-load", "impulse", "ring-down", "coefficients")
KINDS = (*_TESTS, "study", "simulation")
"""Names of the templates."""


def example(kind: str) -> str:
    """Text of an example file."""
    if kind not in KINDS:
        raise ValueError(unknown_name("kind of file", kind, KINDS))
    suffix = "csv" if kind in _TESTS else "toml"
    return files("rotorfit.lab.io").joinpath(f"example-{kind}.{suffix}").read_text(encoding="utf-8")
