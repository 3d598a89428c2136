"""Predicted responses with a band of the mean and one of a new reading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import Table, Tabled
from rotorfit.base.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


@dataclass(frozen=True, eq=False, kw_only=True)
class Band:
    """Limits of amplitude and phase."""

    amplitude: Float  # lower and upper limit, m (rad for slopes), shape ``(N, 2)``
    phase: Float  # the same of the phase lead, rad, shape ``(N, 2)``; the whole circle where it is not determined


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Prediction(ByValue, Tabled):
    """Predicted responses of one plane to a force at one plane; see :meth:`FitResult.predict`.

    Attributes:
        frequency: signed frequency of the force, rad/s, shape ``(N,)`` like all that follow.
        speed: rotative speed, rad/s.
        plane: where the rotor's motion is predicted.
        direction: of the motion: ``z`` for x + j y at the signed frequency, ``x`` or ``y`` for one probe.
        force_plane: where the force acts.
        response: predicted phasor, m (rad for slopes): of x + j y at the signed frequency, or of one probe, phase lead.
        covariance: of its real and imaginary part, shape ``(N, 2, 2)``; infinite where the data do not determine it.
        systematic: the same by what the model leaves out or takes as known, in proportion to the table of
            :attr:`FitResult.causes`; zero for bands by the noise alone.
        noise: standard deviation of each part of a new reading about the truth, NaN where the fit has no readings of
            that plane.
        reach: half-width of the bands in standard errors, by Student's t; larger for bands of whole curves.
        reach_new: the same of the band of new readings.
        level: probability that the bands hold.
        whole: whether it is that of all points at once.
        notes: what the bands do not hold: extrapolation, runs that differ.
    """

    frequency: Float
    speed: Float
    plane: str
    direction: str
    force_plane: str
    response: ComplexArray
    covariance: Float
    systematic: Float
    noise: Float
    reach: Float
    reach_new: Float
    level: float
    whole: bool
    notes: tuple[str, ...]

    plot = Accessor()

    @property
    def seen(self) -> ComplexArray:
        """The response as a probe shows it, phase lead: of a motion in x + jy that turns backward the conjugate.

        Example:
            >>> prediction = fit.predict(-300.0, 200.0, force_plane="disk", plane="journal")
            >>> bool(prediction.seen[0] == prediction.response[0].conjugate())
            True
        """
        backward = (self.direction in ("z", "rz")) & (self.frequency < 0)
        return np.where(backward, self.response.conj(), self.response)

    @property
    def stderr(self) -> ComplexArray:
        """Statistical standard error of the mean: that of the real part plus j times that of the imaginary part.

        Example:
            >>> prediction = fit.predict(300.0, 200.0, force_plane="disk", plane="journal")
            >>> bool(prediction.stderr.real[0] < 0.01 * abs(prediction.response[0]))
            True
        """
        return _parts(self.covariance)

    @property
    def stderr_new(self) -> ComplexArray:
        """The same of a new reading, whose own noise joins.

        Example:
            >>> prediction = fit.predict(300.0, 200.0, force_plane="disk", plane="journal")
            >>> bool(prediction.stderr_new.real[0] > prediction.stderr.real[0])
            True
        """
        return _parts(self._of_readings)

    @cached_property
    def band(self) -> Band:
        """Limits of the mean.

        Example:
            >>> low, high = fit.predict(300.0, 200.0, force_plane="disk", plane="journal").band.amplitude[0]
            >>> bool(low < high)
            True
        """
        return _band(self.response, self.covariance + self.systematic, self.reach)

    @cached_property
    def band_new(self) -> Band:
        """Limits of a new reading.

        Example:
            >>> prediction = fit.predict(300.0, 200.0, force_plane="disk", plane="journal")
            >>> bool(prediction.band_new.amplitude[0, 1] > prediction.band.amplitude[0, 1])
            True
        """
        return _band(self.response, self._of_readings + self.systematic, self.reach_new)

    @property
    def _of_readings(self) -> Float:
        return np.asarray(self.covariance + self.noise[:, None, None] ** 2 * np.eye(2))

    def to_dataframe(self) -> DataFrame:
        """The prediction as a table, a row a point, units in the names of its columns.

        Example:
            >>> list(fit.predict(300.0, 200.0, force_plane="disk", plane="journal").to_dataframe().columns[:3])
            ['speed_rpm', 'frequency_rpm', 'force_plane']
        """
        from pandas import DataFrame

        table: dict[str, Any] = {
            "speed_rpm": self.speed * RPM_PER_RAD_S,
            "frequency_rpm": self.frequency * RPM_PER_RAD_S,
            "force_plane": self.force_plane,
            "plane": self.plane,
            "direction": self.direction,
            "amplitude_um": np.abs(self.response) * 1e6,
            "phase_deg": np.rad2deg(np.angle(self.response)),
        }
        for name, band in (("", self.band), ("new_", self.band_new)):
            for i, end in enumerate(("low", "high")):
                table[f"{name}amplitude_{end}_um"] = band.amplitude[:, i] * 1e6
                table[f"{name}phase_{end}_deg"] = np.rad2deg(band.phase[:, i])
        return DataFrame(table)

    def to_xarray(self) -> Dataset:
        """The prediction as an ``xarray.Dataset`` over its points, SI units: the complex response, limits of amplitude
        and phase.

        Example:
            >>> fit.predict([300.0, 400.0], 200.0, force_plane="disk", plane="journal").to_xarray().response.dtype
            dtype('complex128')
        """
        from xarray import Dataset

        data: dict[str, Any] = {"response": ("point", self.response, {"units": "m or rad, 0-peak"})}
        for name, band in (("", self.band), ("new_", self.band_new)):
            data[f"{name}amplitude"] = (("point", "limit"), band.amplitude)
            data[f"{name}phase"] = (("point", "limit"), band.phase, {"units": "rad"})
        where = {name: ("point", getattr(self, name), {"units": "rad/s"}) for name in ("frequency", "speed")}
        told = {"plane": self.plane, "direction": self.direction, "force_plane": self.force_plane, "level": self.level}
        return Dataset(data, {**where, "limit": ["low", "high"]}, told)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        largest = int(np.argmax(np.abs(self.response)))
        chosen = sorted({0, largest, self.response.size - 1})
        rows = [["speed", "frequency", "amplitude", "of the mean", "of a new reading", "phase lead"]]
        rows.append(["rpm", "rpm", "um", "um", "um", "deg"])
        for i in chosen:
            ends = [band.amplitude[i] * 1e6 for band in (self.band, self.band_new)]
            cells = [
                f"{significant(low, 4)} to {significant(high, 4)}" if math.isfinite(high) else "not known"
                for low, high in ends
            ]
            at = (self.speed[i] * RPM_PER_RAD_S, self.frequency[i] * RPM_PER_RAD_S)
            numbers = [*(significant(one, 5) for one in at), significant(abs(self.response[i]) * 1e6, 4)]
            rows.append([*numbers, *cells, f"{np.rad2deg(np.angle(self.seen[i])):.1f}"])
        what = "of whole curves" if self.whole else "at each frequency"
        by = "noise and causes beside the model" if self.systematic.any() else "noise"
        count = self.response.size
        points = f"{count} points; first, largest and last" if count > 1 else "one point"
        head = (
            f"response at {self.plane} to a force at {self.force_plane}, {points}; "
            f"{significant(100 * self.level, 4)} % bands {what}, by {by}"
        )
        return [head, Table(rows, ">8 >10 >10 >20 >20 >11"), *self.notes]


def _parts(covariance: Float) -> ComplexArray:
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return np.asarray(spread[:, 0] + 1j * spread[:, 1])


def along_and_across(response: ComplexArray, covariance: Float) -> tuple[Float, Float]:
    """Standard errors in the direction of each phasor and at right angles to it."""
    unit = np.exp(1j * np.angle(response))
    along = np.column_stack([unit.real, unit.imag])
    across = np.column_stack([-unit.imag, unit.real])
    spread = [np.sqrt(np.einsum("ni,nij,nj->n", u, covariance, u)) for u in (along, across)]
    return spread[0], spread[1]


def _band(response: ComplexArray, covariance: Float, reach: Float) -> Band:
    size, angle = np.abs(response), np.angle(response)
    determined = np.asarray(np.isfinite(covariance).all(axis=(1, 2)), dtype=bool)
    along, across = along_and_across(response, np.where(determined[:, None, None], covariance, 0.0))
    half = np.where(determined, reach * along, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(determined & (size > 0), np.minimum(reach * across / size, np.pi), np.pi)
    return Band(
        amplitude=np.column_stack([np.maximum(size - half, 0.0), size + half]),
        phase=np.column_stack([angle - turn, angle + turn]),
    )
