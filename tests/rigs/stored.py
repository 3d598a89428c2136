"""Test files for a store: small tests of one machine, day after day, cheap to fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest

STUDY = {"model": "one-mode", "known": {"Ds": 8.0, "K": 8000.0}}
"""A study of them."""


def day(number: int, *, date: bool = True, machine: str = "", **changed: float) -> PerturbationTest:
    """One day's test; what has changed in the machine is given as factors."""
    model = rf.models.OneMode()
    truth = np.array([TYPICAL["one-mode"][name] * changed.get(name, 1.0) for name in model.parameter_names])
    frequency = np.concatenate([np.linspace(-200, -20, 12), np.linspace(20, 200, 12)])
    test = circular_test(model, truth, speeds=(100.0, 180.0), frequency=frequency, noise=0.01, seed=number)
    attributes = {"date": f"2026-03-{number + 1:02d}"} if date else {}
    attributes |= {"machine": machine} if machine else {}
    rows = {name: np.full(len(test), text) for name, text in attributes.items()}
    return replace(test, attributes=rows)


def days(folder: Path, count: int) -> list[Path]:
    """Files of so many days."""
    files = [folder / f"day{number}.csv" for number in range(count)]
    for number, file in enumerate(files):
        rf.write(day(number), file)
    return files
