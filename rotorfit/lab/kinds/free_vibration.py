"""Free vibration after an impulse: frequency and damping of its modes, or the records of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.small_motion import FreeVibrations
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.observing.rows import check_clearance, check_finite, of_rows, spread_of_repeats
from rotorfit.models import RotorModel


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


def _observed(test: ImpulseTest, model: RotorModel, group: Index) -> FreeVibrations:
    check_finite(test, test.frequency, test.damping_ratio)
    eps = test.eccentricity.copy()
    read = np.isnan(eps)
    if model.clearance is not None:
        eps = np.where(np.isnan(eps), np.abs(test.position) / model.clearance, eps)
    elif not model.eccentricity_dependent:
        eps[np.isnan(eps)] = 0.0
    if np.isnan(eps).any():
        row = int(np.flatnonzero(np.isnan(eps))[0]) + 1
        raise ValueError(
            f"{test.source or 'impulse test'}: row {row} gives neither eccentricity nor position of the journal; use 0 "
            f"for a centred one"
        )
    check_clearance(eps, model, "static positions")
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
