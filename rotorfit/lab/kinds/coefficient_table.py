"""Tables of the coefficients of a bearing or seal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.small_motion import JournalCoefficients
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.table_columns import ECCENTRICITY, PURE, Column, Layout, noise
from rotorfit.lab.observing.rows import check_finite, of_rows
from rotorfit.models import RotorModel

_UNITS = {"kxx": "N_m", "kxy": "N_m", "cxx": "N_s_m", "cxy": "N_s_m", "mxx": "kg"}
"""Unit by coefficient."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CoefficientTable(Experiment):
    """Coefficients of an isotropic bearing or seal by speed and eccentricity, from a seal code or a test report.

    ``kxx = kyy``, ``kxy = -kyx`` and so on, with the signs of the fluid force: positive kxy drives forward whirl.

    Attributes:
        run: name of the conditions, rows that differ in eccentricity alone having the same, shape ``(R,)`` like all
            that follow.
        speed: rotative speed, rad/s.
        eccentricity: orbit radius over clearance.
        kxx, kxy: N/m.
        cxx, cxy: N s/m.
        mxx: kg.
        sigma: standard deviation of each coefficient as a fraction of it, for instance 3e-7 for a table of six digits.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "table of coefficients"
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("eccentricity", (ECCENTRICITY,)),
            *(Column(name, ((name, unit, {unit.lower(): 1.0}),)) for name, unit in _UNITS.items()),
            noise("ratio", PURE),
        ),
        marks=("kxx_",),
        run="",
        known="speed_rpm, eccentricity_ratio, kxx_N_m, kxy_N_m, cxx_N_s_m, cxy_N_s_m, mxx_kg, "
        "optional run, sigma_ratio",
    )

    eccentricity: Float
    kxx: Float
    kxy: Float
    cxx: Float
    cxy: Float
    mxx: Float
    sigma: Float

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _observed(self, model, group)

    def unread(self, sigma: Float) -> Experiment:
        """See any experiment."""
        return replace(self, sigma=sigma)


def _observed(test: CoefficientTable, model: RotorModel, group: Index) -> JournalCoefficients:
    values = np.stack([test.kxx, test.kxy, test.cxx, test.cxy, test.mxx], axis=1)
    check_finite(test, test.speed, test.eccentricity, *values.T)
    if np.isnan(test.sigma).any():
        raise ValueError(
            f"{test.source or 'table'}: the accuracy of the coefficients is not known; give a sigma_ratio column, for "
            f"instance 3e-7 for a table of six digits"
        )
    floor = 1e-9 * np.abs(values).max(axis=0)
    error = np.maximum(test.sigma[:, None] * np.abs(values), floor)
    spread = np.concatenate([error[:, 0:2], error[:, 2:4], error[:, [4, 4]]])  # of stiffness, damping and mass
    parts = np.concatenate([values[:, 0:2], values[:, 2:4], np.column_stack([test.mxx, np.zeros(len(test))])])
    names = (f"{run} / {what}" for what in ("stiffness", "damping", "mass") for run in test.run.tolist())
    return JournalCoefficients(
        **{**of_rows(model, test, names), "run": np.tile(test.run, 3)},
        eccentricity=test.eccentricity,
        group=group,
        spread=spread,
        measured=parts[:, 0] / spread[:, 0] + 1j * parts[:, 1] / spread[:, 1],
        sigma=np.ones(len(parts)),
    )
