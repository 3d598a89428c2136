"""Free vibration after an impulse: frequency and damping of its modes, or the records of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S, UNITS
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.small_motion import FreeVibrations
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.table_columns import ECCENTRICITY, FREQUENCY, PURE, Column, Layout, X, Y, noise
from rotorfit.lab.observing.rows import check_clearance, check_finite, of_rows, spread_of_repeats
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ImpulseTest(Experiment):
    """Free vibration after an impulse: frequency and damping of a mode, one row an impulse (Fig. 29).

    The journal rests at ``eccentricity``, or, where that is NaN, at ``position``.

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        frequency: damped natural frequency, rad/s; off-centre motion turns both ways, so its sign does not count.
        damping_ratio: ``zeta = -Re s / |s|`` of the eigenvalue s; negative where the rotor is unstable.
        eccentricity: static eccentricity of the journal, NaN where ``position`` is given.
        position: static position of the journal, ``x + j y``, m, NaN where ``eccentricity`` is given.
        sigma: standard deviation of the real and of the imaginary part of s, 1/s, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "impulse test"
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("frequency", (FREQUENCY,)),
            Column("damping_ratio", (("damping", "ratio", PURE),)),
            Column("eccentricity", (ECCENTRICITY,), needed=False),
            Column("position", (X, Y)),
            noise("rpm", UNITS["frequency"]),
        ),
        marks=("damping_ratio",),
        run="impulse",
        known="speed_rpm, frequency_rpm, damping_ratio, eccentricity_ratio (or x_um, y_um), optional run, sigma_rpm",
    )

    frequency: Float
    damping_ratio: Float
    eccentricity: Float
    position: ComplexArray
    sigma: Float

    def __post_init__(self) -> None:
        super().__post_init__()
        bad = np.abs(self.damping_ratio) >= 1
        if bad.any():
            raise ValueError(
                f"{self.source or 'impulse test'}: damping_ratio {self.damping_ratio[bad][0]:g} in row "
                f"{np.flatnonzero(bad)[0] + 1}; a mode that vibrates has one between -1 and 1"
            )

    def excursion(self, plane: str, clearance: float) -> Float:
        """Where the journal rests."""
        return np.where(np.isnan(self.eccentricity), np.abs(self.position), self.eccentricity * clearance)

    @property
    def eigenvalue(self) -> ComplexArray:
        """Eigenvalues ``s = |w_d| (-zeta / sqrt(1 - zeta^2) + j)``, 1/s, shape ``(R,)``."""
        w = np.abs(self.frequency)
        return np.asarray(w * (1j - self.damping_ratio / np.sqrt(1 - self.damping_ratio**2)))

    @property
    def frequency_ratio(self) -> Float:
        """Damped frequency over rotative speed, which the paper reports as lam(eps); good to the damping ratio."""
        return np.abs(self.frequency) / np.abs(self.speed)

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _observed(self, model, group)

    def table_columns(self) -> dict[str, NDArray[Any]]:
        """See any experiment.

        Raises:
            ValueError: some impulses have an eccentricity and others a position, which one column cannot say.
        """
        if 0 < np.isfinite(self.eccentricity).sum() < len(self):
            raise ValueError("a CSV holds impulses with eccentricities or with positions, not some with either")
        return super().table_columns()

    def own_findings(self) -> Iterator[Finding]:
        """See any experiment."""
        return _odd_frequencies(self, "the frequency (frequency_rpm, frequency_hz)")

    def unread(self, sigma: Float) -> Experiment:
        """See any experiment."""
        return replace(self, sigma=sigma)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RingDownTest(Experiment):
    """Records of free vibration after impulses, one row a sample, one run a record.

    :func:`rotorfit.ring_down_modes` reduces it to an :class:`ImpulseTest`; fits do so by themselves.

    Attributes:
        run: name of the record, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s, one value in each record.
        time: s, equally spaced in each record.
        x, y: displacements of the journal, m; they settle at its static position.
        eccentricity: static eccentricity; NaN where it follows from where x and y settle.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "ring-down records"
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("time", (("time", "s", {"s": 1.0, "ms": 1e-3, "us": 1e-6}),)),
            Column("x", (X,)),
            Column("y", (Y,)),
            Column("eccentricity", (ECCENTRICITY,), needed=False),
        ),
        marks=("time_",),
        run="ring-down",
        known="speed_rpm, time_s, x_um, y_um, optional run, eccentricity_ratio",
    )
    reducer: ClassVar[str] = "ring_downs"
    tells_noise: ClassVar[bool] = True

    time: Float
    x: Float
    y: Float
    eccentricity: Float

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment: as the impulse test that its records are reduced to."""
        from rotorfit.lab.data.ring_down import ring_down_modes  # late: it knows these classes

        _, first = np.unique(self.run, return_index=True)
        return ring_down_modes(self).observe(model, group[np.sort(first)])

    def own_findings(self) -> Iterator[Finding]:
        """See any experiment: records that show no mode, and those of the modes that they show."""
        from rotorfit.lab.data.ring_down import ring_down_modes  # late: it knows these classes

        try:
            modes = ring_down_modes(self)
        except ValueError as error:
            yield Finding("error", "ring-down", f"A record of free vibration cannot be used: {error}.")
            return
        yield from _odd_frequencies(modes, "the time (time_s, time_ms)")


def _observed(test: ImpulseTest, model: RotorModel, group: Index) -> FreeVibrations:
    check_finite(test, test.frequency, test.damping_ratio)
    eps = test.eccentricity.copy()
    read = np.isnan(eps)
    clearance = journal(model).clearance if model.eccentricity_dependent else model.least_clearance
    if clearance is not None:
        eps = np.where(np.isnan(eps), np.abs(test.position) / clearance, eps)
    elif not model.eccentricity_dependent:
        eps[np.isnan(eps)] = 0.0
    if np.isnan(eps).any():
        row = int(np.flatnonzero(np.isnan(eps))[0]) + 1
        raise ValueError(
            f"{test.source or 'impulse test'}: row {row} gives neither eccentricity nor position of the journal; use 0 "
            f"for a centred one"
        )
    if clearance is not None:
        check_clearance(eps, clearance, "static positions")
    s = test.eigenvalue
    sigma = test.sigma.copy()
    if np.isnan(sigma).any():
        spread = spread_of_repeats(s, distinguished(test.speed, np.round(eps, 9))[1])
        if spread is None:
            raise ValueError(
                f"{test.source or 'impulse test'}: the noise of frequency and damping is not known; give a sigma_rpm "
                f"column, or repeat impulses at the same speed and eccentricity"
            )
        sigma[np.isnan(sigma)] = spread
    return FreeVibrations(
        **of_rows(model, test, np.char.add(test.run, " / eigenvalue").tolist()),
        eccentricity=eps,
        position_read=read,
        reading_group=group,
        measured=s,
        sigma=sigma,
    )


def _odd_frequencies(test: ImpulseTest, unit: str) -> Iterator[Finding]:
    """Frequencies in another unit than the speed, as the name of their column, or of the time's, says it."""
    ratio = np.abs(test.frequency) / np.where(test.speed == 0, np.nan, np.abs(test.speed))
    # Frequency of free vibration over the speed outside of which one of the two, or the time, has another unit
    frequency_ratios = 0.02, 50.0
    odd = np.flatnonzero((ratio < frequency_ratios[0]) | (ratio > frequency_ratios[1]))
    if odd.size:
        first, runs = int(odd[0]), list(dict.fromkeys(test.run[odd].tolist()))
        text = (
            f"Free vibration at {significant(abs(test.frequency[first]) * RPM_PER_RAD_S, 4)} cycles a minute, at a "
            f"speed of {significant(abs(test.speed[first]) * RPM_PER_RAD_S, 4)} rpm, in {listed(runs)}. Check the unit "
            f"of {unit}, or of the speed."
        )
        yield Finding("warning", "frequency-unit", text)
