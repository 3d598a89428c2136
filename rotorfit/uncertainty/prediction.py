"""Responses that a fitted rotor would give elsewhere, with a band of the mean and one of a new reading."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.figure_keywords import PlotKeywords
from rotorfit.estimators.blocks.correlated import quantile
from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.blocks.small_motion import OffCentreResponses
from rotorfit.estimators.inference.score_tests import term_change
from rotorfit.fitting.assumptions.assumption_table import Assumption
from rotorfit.fitting.result import FitResult
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.stability import growth_rate
from rotorfit.models.parameters import unknown_name
from rotorfit.models.text_table import Printed, text_table
from rotorfit.observing.observations import observe_any
from rotorfit.uncertainty.derived import DERIVED_DRAWS
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, kw_only=True)
class Band:
    """Limits of amplitude and phase."""

    amplitude: Float  # lower and upper limit, m (rad for slopes), shape ``(N, 2)``
    phase: Float  # the same of the phase lead, rad, shape ``(N, 2)``; the whole circle where it is not determined


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Prediction(Printed):
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
            :meth:`FitResult.assumptions`; zero for statistical bands.
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

    def plot(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Amplitude and phase with both bands: of the mean, and of a new reading.

        Args:
            **look: ``ax`` and ``unit``, as for :meth:`FitResult.plot_bode`.

        Example:
            >>> figure = fit.predict([280.0, 300.0], 200.0, force_plane="disk", plane="journal").plot()
        """
        from rotorfit.uncertainty.prediction_figure import plot_prediction

        return plot_prediction(self, **look)

    def __str__(self) -> str:
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
            numbers = [
                significant(at[0], 5),
                significant(at[1], 5),
                significant(abs(self.response[i]) * 1e6, 4),
            ]
            rows.append([*numbers, *cells, f"{np.rad2deg(np.angle(self.seen[i])):.1f}"])
        what = "of whole curves" if self.whole else "at each frequency"
        by = "statistical errors and what the model leaves out" if self.systematic.any() else "statistical errors"
        count = self.response.size
        points = f"{count} points; first, largest and last" if count > 1 else "one point"
        head = (
            f"response at {self.plane} to a force at {self.force_plane}, {points}; "
            f"{significant(100 * self.level, 4)} % bands {what}, by {by}"
        )
        return "\n".join([head, *text_table(rows, ">8 >10 >10 >20 >20 >11"), *self.notes])


def _parts(covariance: Float) -> ComplexArray:
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return np.asarray(spread[:, 0] + 1j * spread[:, 1])


def _along_and_across(response: ComplexArray, covariance: Float) -> tuple[Float, Float]:
    """Standard errors in the direction of each phasor and at right angles to it."""
    unit = np.exp(1j * np.angle(response))
    along = np.column_stack([unit.real, unit.imag])
    across = np.column_stack([-unit.imag, unit.real])
    spread = [np.sqrt(np.einsum("ni,nij,nj->n", u, covariance, u)) for u in (along, across)]
    return spread[0], spread[1]


def _band(response: ComplexArray, covariance: Float, reach: Float) -> Band:
    size, angle = np.abs(response), np.angle(response)
    determined = np.asarray(np.isfinite(covariance).all(axis=(1, 2)), dtype=bool)
    along, across = _along_and_across(response, np.where(determined[:, None, None], covariance, 0.0))
    half = np.where(determined, reach * along, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(determined & (size > 0), np.minimum(reach * across / size, np.pi), np.pi)
    return Band(
        amplitude=np.column_stack([np.maximum(size - half, 0.0), size + half]),
        phase=np.column_stack([angle - turn, angle + turn]),
    )


# ---- from a fit, from a posterior --------------------------------------------------------------------------------


def predict(
    fit: FitResult,
    frequency: ArrayLike | None,
    speed: ArrayLike,
    *,
    force_plane: str | None = None,
    force: complex | None = None,
    mr: complex | None = None,
    plane: str | None = None,
    direction: str | None = None,
    level: float = 0.95,
    whole: bool = False,
    statistical: bool = False,
    at: Mapping[str, Any] | None = None,
    thetas: Float | None = None,
) -> Prediction:
    """Responses with their bands, by the fit's covariance or over parameter vectors of draws, shape ``(W, P)``."""
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; a band has a probability between 0 and 1")
    model, group = fit.model, fit.group(at)
    test = _planned(fit, frequency, speed, force_plane, force, mr, plane, direction)
    _refuse_unstable(fit, group, np.unique(test.speed))
    block = _block(fit, test, group)
    mean = _by_covariance(fit, block, group) if thetas is None else _by_draws(fit, block, thetas)
    noise = _noise(fit, test, model.coordinate(test.plane[0], _axis(test)), mean.response)
    moved = _moved(fit, block, () if statistical else fit.assumed.entries)
    systematic = np.einsum("kni,knj->nij", moved, moved)
    wider = 1 + np.nan_to_num(np.trace(systematic, axis1=1, axis2=2) / np.trace(mean.covariance, axis1=1, axis2=2))
    freedom = mean.freedom * wider**2  # Satterthwaite: the systematic share is taken as known
    reach = reach_new = np.array([quantile(level, float(one)) for one in freedom])
    if whole:
        scale = reach / quantile(level, math.inf)  # of t over that of the normal distribution
        errors = _draws_of_errors(fit.covar, mean.slopes) if mean.errors is None else mean.errors
        sizes = np.random.default_rng(2).normal(size=(len(errors), len(moved)))
        errors = errors + np.einsum("wk,kni->wni", sizes, moved)
        known = np.nan_to_num(noise)[:, None]
        own = np.random.default_rng(0).normal(size=errors.shape) * known
        both = mean.covariance + systematic
        new = both + known[:, None] ** 2 * np.eye(2)
        reach = scale * _largest(mean.response, both, errors, level)
        reach_new = scale * _largest(mean.response, new, errors + own, level)
    return Prediction(
        frequency=test.frequency,
        speed=test.speed,
        plane=str(test.plane[0]),
        direction=str(test.direction[0]),
        force_plane=str(test.force_plane[0]),
        response=mean.response,
        covariance=mean.covariance,
        systematic=systematic,
        noise=noise,
        reach=reach,
        reach_new=reach_new,
        level=level,
        whole=whole,
        notes=_notes(fit, test, noise),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Mean:
    """Responses ``(N,)`` with the covariance of their parts, its degrees of freedom, and what whole curves vary by."""

    response: ComplexArray
    covariance: Float
    freedom: Float
    slopes: Float
    errors: Float | None = None


def _by_covariance(fit: FitResult, block: Block, group: int) -> _Mean:
    response, slopes = _slopes(fit, block, group)
    covariance = slopes @ fit.covar @ slopes.transpose(0, 2, 1)
    undetermined = fit.identifiability.leaves_open(np.abs(response), slopes) if fit.success else np.s_[:]
    covariance[undetermined] = np.inf
    return _Mean(response=response, covariance=covariance, freedom=_freedom(fit, slopes), slopes=slopes)


def _by_draws(fit: FitResult, block: Block, thetas: Float) -> _Mean:
    drawn = np.array([block.predict(np.broadcast_to(t, fit.thetas.shape)) for t in thetas])
    response = drawn.mean(axis=0)
    errors = np.stack([drawn.real, drawn.imag], axis=2) - np.column_stack([response.real, response.imag])
    covariance = np.einsum("wni,wnj->nij", errors, errors) / (len(errors) - 1)
    freedom = np.full(response.size, np.inf)
    return _Mean(response=response, covariance=covariance, freedom=freedom, slopes=np.zeros(0), errors=errors)


def _moved(fit: FitResult, block: Block, entries: Sequence[Assumption]) -> Float:
    """Change of real and imaginary parts by a standard uncertainty of each assumption, shape ``(K, N, 2)``: of what
    acts on the rotor the change itself, and what it would have made of the tested parameters."""
    names, changes = fit.problem.space.names, []
    slopes = _slopes(fit, block, 0)[1][..., : len(names)]
    for entry in entries:
        change = slopes @ np.array([entry.shifts[name] for name in names])
        if entry.acts is not None:
            direct = term_change(block, fit.thetas, entry.acts)
            change = change + np.column_stack([direct.real, direct.imag])
        changes.append(entry.left * change)
    return np.array(changes).reshape(len(changes), block.measured.size, 2)


def _slopes(fit: FitResult, block: Block, group: int) -> tuple[ComplexArray, Float]:
    """Predicted responses ``(N,)`` and the derivatives of their parts by the fitted parameters, ``(N, 2, p)``."""
    response, slope = block.predict_jacobian(fit.thetas)
    return response, np.stack([fit.problem.space.pull_back(part, group) for part in (slope.real, slope.imag)], axis=1)


def _planned(
    fit: FitResult,
    frequency: ArrayLike | None,
    speed: ArrayLike,
    force_plane: str | None,
    force: complex | None,
    mr: complex | None,
    plane: str | None,
    direction: str | None,
) -> PerturbationTest:
    """The readings to predict, as a test whose readings are not known yet."""
    model = fit.model
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    w = speeds if frequency is None else np.atleast_1d(np.asarray(frequency, dtype=float))
    try:
        w, speeds = (np.array(values) for values in np.broadcast_arrays(w, speeds))
    except ValueError:
        raise ValueError(
            f"{w.size} frequencies and {speeds.size} speeds do not go together; give one of either"
        ) from None
    if w.ndim != 1 or not w.size or not (np.isfinite(w).all() and np.isfinite(speeds).all()):
        raise ValueError("frequency and speed are finite numbers or vectors of them, rad/s")
    if force is not None and mr is not None:
        raise ValueError("give a force, N, or an unbalance mr, kg m, not both")
    where = _plane("force plane", force_plane, model.planes)
    drive = np.full(w.shape, 1.0 if force is None else force, dtype=complex) if mr is None else mr * w**2 + 0j
    if not (np.isfinite(drive).all() and drive.all()):
        raise ValueError("the force is zero or not finite: there is no response to predict")
    read = "z" if model.frame == "z" else "x"
    return PerturbationTest(
        run=np.full(w.shape, "prediction"),
        speed=speeds,
        frequency=w,
        force_plane=np.full(w.shape, where),
        force=drive,
        plane=np.full(w.shape, _plane("plane", where if plane is None else plane, model.read_planes)),
        direction=np.full(w.shape, read if direction is None else direction),
        response=np.full(w.shape, 1e-9, dtype=complex),  # m, inside any clearance: to be predicted, none of it is used
        sigma=np.ones(w.shape),
        source="prediction",
    )


def _plane(what: str, name: str | None, planes: Sequence[str]) -> str:
    if name is None and len(planes) == 1:
        return str(planes[0])
    if name is None:
        raise ValueError(
            f"give the {what} ({what.replace(' ', '_')}=, --{what.replace(' ', '-')}): one of {', '.join(planes)}"
        )
    if name not in planes:
        raise ValueError(unknown_name(what, name, planes))
    return name


def _axis(test: PerturbationTest) -> str:
    return str(test.direction[0])[-1]


def _block(fit: FitResult, test: PerturbationTest, group: int) -> Block:
    """The readings in the model's coordinates; of a fluid that changes with eccentricity, orbits followed from rest."""
    block = observe_any(fit.model, test, np.full(len(test), group, dtype=np.intp))
    if isinstance(block, OrbitResponses):
        return replace(block, mode="followed", sweep=np.zeros_like(block.sweep))
    if isinstance(block, OffCentreResponses):
        raise ValueError("orbits about an equilibrium off the centre are not predicted")
    return block


def _refuse_unstable(fit: FitResult, group: int, speeds: Float) -> None:
    """Refuse speeds at which a response would not be steady."""
    for value in speeds.tolist():
        if growth_rate(fit.model, fit.thetas[group], value, fit.stability_band) > 0:
            onset = fit.threshold_of(group).value
            limit = (
                f"; speeds are allowed below its threshold of {significant(onset * RPM_PER_RAD_S, 5)} rpm"
                if onset > 0
                else ""
            )
            raise ValueError(
                f"the fitted rotor is unstable at {significant(value * RPM_PER_RAD_S, 5)} rpm "
                f"({significant(value, 5)} rad/s): it whirls by "
                f"itself, and has no steady response to a force{limit}"
            )


def _freedom(fit: FitResult, slopes: Float) -> Float:
    """Degrees of freedom of the errors at each point: the fewer of those of real and imaginary part."""
    if fit.noise is None:
        return np.full(len(slopes), fit.freedom)
    return np.array([min(fit.noise.degrees(part) for part in point) for point in slopes])


def _draws_of_errors(covar: Float, slopes: Float) -> Float:
    """Simulated errors of the parts of whole curves, shape ``(W, N, 2)``."""
    values, vectors = np.linalg.eigh(covar)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.random.default_rng(1).normal(size=(DERIVED_DRAWS, root.shape[1])) @ root.T
    return np.asarray(np.einsum("wp,nip->wni", drawn, slopes))


def _largest(response: ComplexArray, covariance: Float, errors: Float, level: float) -> Float:
    """Quantile of the largest error of a curve, over standard errors, in amplitude or phase."""
    unit = np.exp(1j * np.angle(response))
    turned = (errors[..., 0] + 1j * errors[..., 1]) / unit
    determined = np.isfinite(covariance).all(axis=(1, 2)) & (np.abs(response) > 0)
    if not determined.any():
        return np.asarray(np.inf)
    along, across = _along_and_across(response[determined], covariance[determined])
    turned = turned[:, determined]
    worst = np.maximum(np.abs(turned.real) / along, np.abs(turned.imag) / across).max(axis=1)
    return np.asarray(np.quantile(worst, level))


def _noise(fit: FitResult, test: PerturbationTest, coordinate: int, response: ComplexArray) -> Float:
    """Noise of a new reading: that of the fitted readings of its coordinate, a constant and a share of the response."""
    sigma, size = [], []
    for block, predicted in zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True):
        base = responses_of(block)
        if base is not None and not base.imposed:
            rows = base.coordinate == coordinate
            sigma.append(base.sigma[rows])
            size.append(np.abs(predicted[rows]))
    variance, power = np.concatenate([*sigma, []]) ** 2, np.concatenate([*size, []]) ** 2
    if not variance.size:
        return np.full(response.size, np.nan)
    from scipy.optimize import nnls

    # Relative errors of the variances count, which span decades where noise is proportional.
    columns = np.column_stack([np.ones_like(power), power]) / variance[:, None]
    top = columns.max(axis=0)
    shares = nnls(columns / top, np.ones(variance.size))[0] / top
    return np.asarray(np.sqrt(fit.widening * (shares[0] + shares[1] * np.abs(response) ** 2)))


def _notes(fit: FitResult, test: PerturbationTest, noise: Float) -> tuple[str, ...]:
    """Notes on the bands."""
    bases = [base for base in map(responses_of, fit.problem.blocks) if base is not None]
    found: list[str] = []
    for what, values, tested in (
        ("speeds", test.speed, [base.speed for base in bases]),
        ("frequencies", test.frequency, [base.frequency for base in bases]),
    ):
        found += extrapolation(what, values, tested)
    if np.isnan(noise).any():
        found.append(f"No readings at {test.plane[0]} were fitted: the noise of a new reading there is not known.")
    if fit.model_limited:
        found.append("The model misses the data beyond their noise: the bands may be too narrow.")
    if len(fit.thetas) > 1:
        found.append("Bands hold the statistical errors only: parameters were fitted per attribute.")
    if fit.noise is not None and fit.noise.effects:
        found.append("Runs differ: a new run differs from the mean by more than the band of a new reading.")
    return tuple(found)


def extrapolation(what: str, values: Float, tested: Sequence[Float]) -> list[str]:
    """A sentence where values lie outside the tested ones of their sign."""
    if not tested:
        return [f"The fit has no responses to forces that turn: all {what} are extrapolated."]
    known = np.concatenate(tested)
    low, high = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    for sign in (-1.0, 1.0):
        same = known[np.sign(known) == sign]
        if same.size:
            here = np.sign(values) == sign
            low[here], high[here] = same.min(), same.max()
    margin = SPEED_TOLERANCE * np.abs(known).max(initial=0.0)
    sides = [values[values < low - margin] * RPM_PER_RAD_S, values[values > high + margin] * RPM_PER_RAD_S]
    count = sum(side.size for side in sides)
    if not count:
        return []
    where = " and ".join(_span(side.min(), side.max()) for side in sides if side.size)
    tested_span = _span(known.min() * RPM_PER_RAD_S, known.max() * RPM_PER_RAD_S)
    verb = "lie" if count > 1 else "lies"
    return [f"Extrapolated: {count} of {values.size} {what}, {where} rpm, {verb} outside the tested {tested_span} rpm."]


def _span(low: float, high: float) -> str:
    ends = significant(low, 5), significant(high, 5)
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)
