"""Names that steer a terminal, begin a line or turn the writing, and a test that holds one."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest

HOSTILE = ("\x1b[31mred", "all\rwell", "a\nrotorfit: all is well", "gnp\u202e", "\x9b2J\u2028\t\x07")
STEERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]|^rotorfit: all", re.MULTILINE)


def named(name: str) -> PerturbationTest:
    """The bundled rig with its journal, one of its runs and an attribute called otherwise."""
    rig = rf.datasets.rig_lumped()
    rig = rig.select(np.arange(len(rig)) % 40 < 4)  # one frequency in ten

    def called(column: np.ndarray, old: str) -> np.ndarray:
        return np.array([name if word == old else word for word in column.tolist()])

    return replace(
        rig,
        run=called(rig.run, rig.runs[0]),
        plane=called(rig.plane, "journal"),
        force_plane=called(rig.force_plane, "journal"),
        attributes={f"oil {name}": np.array([name] * len(rig))},
    )
