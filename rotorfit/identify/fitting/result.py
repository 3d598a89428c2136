"""Result of a fit: parameters with their errors, goodness of fit, identifiability, derived quantities."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, Unpack

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.chance import Seed, seed_of
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.units import in_rad_s
from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference.covariance import widening
from rotorfit.estimators.inference.identifiability import Identifiability
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.sweep_noise import READINGS_OF_NOISE
from rotorfit.identify.fitting.causes.table import Causes, table_of
from rotorfit.identify.fitting.noise.residual_study import ResidualStudy, is_misfit, largest_redchi
from rotorfit.identify.fitting.propagation import error_bar, independent_parts, made_of, propagated, theta_at
from rotorfit.identify.fitting.quantities import (
    THRESHOLD,
    ErrorBar,
    FittedParameter,
    Number,
    Parameters,
    Quantity,
    ResponseQuality,
    Share,
)
from rotorfit.identify.fitting.settings import (
    FitSettings,
    JudgeKeywords,
    PredictKeywords,
    SampleKeywords,
    check_keywords,
)
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel, Threshold, threshold_speed
from rotorfit.models.motion.stability import stability_band
from rotorfit.models.shafts.angular_rates import real_number

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from pandas import DataFrame

    from rotorfit.estimators.inference.log_posterior import Noise
    from rotorfit.identify.fitting.anisotropy import TurningAnisotropy
    from rotorfit.identify.fitting.other_solutions import OtherSolution
    from rotorfit.identify.fitting.structure.coefficients import CoefficientRows, Coefficients, FrequencyRows
    from rotorfit.identify.fitting.structure.modes import Modes, NaturalFrequencies
    from rotorfit.identify.uncertainty.bootstrap import Bootstrap
    from rotorfit.identify.uncertainty.budget import Budget
    from rotorfit.identify.uncertainty.jackknife import Jackknife
    from rotorfit.identify.uncertainty.posterior import Posterior
    from rotorfit.identify.uncertainty.prediction import Prediction
    from rotorfit.identify.uncertainty.profile import Profile
    from rotorfit.identify.uncertainty.stability.record import StabilityReport
    from rotorfit.identify.uncertainty.target import LogDensity
    from rotorfit.lab.io.shafts.ross_elements import ElementKind, RossElement


def noise_known_from(problem: Problem) -> float:
    """Readings that the noise of the data is known from, infinite where it was given."""
    given = all(block.sigma_given for block in problem.responses)
    return min(math.inf if given else READINGS_OF_NOISE * problem.n_data, freedom_of(problem.blocks))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FitResult(ByValue):
    """Result of :func:`rotorfit.fit` or :func:`rotorfit.closed_form`. Frozen; a failed fit is a result that says so.

    Attributes:
        model: the rotor.
        experiments: the data.
        settings: what was asked for.
        method: "least squares" or "closed form".
        problem: the optimisation problem, for re-evaluation.
        x: fitted vector (free parameters, then nuisance parameters).
        params: parameters by name, fitted and known.
        covar: covariance of the fitted vector, widened like ``stderr``, unresolved directions left out.
        chisqr, redchi: sum of squared residuals over the noise of the data, and that over the degrees of freedom.
        ndata, nvarys, nfree: real data, fitted values, degrees of freedom.
        aic, bic: with the noise as estimated from the data.
        start: where the search began; ``settings.start`` replaced single values, ``init_value`` of ``params`` are those
            that were used. "closed form" (eqs 5 to 9); "short fit": the best end of a few steps from several closed
            forms; "random starts": the same from many typical rotors, where there is no closed form; "rational fit":
            poles and residues (``Modal``); "spectral lines": linear least squares, line after line; "given": all were;
            "earlier fit": the optimum of the fit that this one varies.
        perhaps_local: True if another minimum may be as deep or deeper; one of :attr:`warnings` says why.
        success, message, nfev: how the optimisation ended.
        responses: agreement response by response.
        identifiability: what the data determine.
        notices: what the fit itself was found to lack, as :attr:`findings` has it too.
        noise: what the residuals are, and what the error bars rest on; ``None`` where that was not looked into (closed
            forms, robust losses, other tests than sweeps).
        model_uncertainty: share of ``covar`` by the choice among candidate models, shape ``(n, n)`` for the fitted
            parameters; ``None`` for a model that was not chosen among others.
    """

    model: RotorModel
    experiments: tuple[Experiment, ...]
    settings: FitSettings
    method: str
    problem: Problem = field(compare=False)
    x: Float
    params: Mapping[str, FittedParameter]
    covar: Float
    chisqr: float
    redchi: float
    ndata: int
    nvarys: int
    nfree: int
    aic: float
    bic: float
    success: bool
    message: str
    nfev: int
    responses: tuple[ResponseQuality, ...]
    identifiability: Identifiability
    notices: tuple[Finding, ...]
    noise: ResidualStudy | None = None
    model_uncertainty: Float | None = None
    start: str
    perhaps_local: bool = False

    plot = Accessor()

    def __post_init__(self) -> None:
        params = Parameters({name: replace(p) for name, p in self.params.items()})
        for p in params.values():
            object.__setattr__(p, "fit", self)
        object.__setattr__(self, "params", params)

    def __getattr__(self, name: str) -> NoReturn:
        """Say where something is that other packages keep on their results."""
        from rotorfit.identify.fitting.habits import ELSEWHERE

        where = f"; {ELSEWHERE[name]}" if name in ELSEWHERE else ""
        raise AttributeError(f"a fit has no {name}{where}", name=name, obj=self)

    def __repr__(self) -> str:
        """Model, data and goodness of fit, on one line; ``print(fit)`` shows the head of :meth:`summary`."""
        size = f"{self.nvarys} values from {self.ndata} data"
        return (
            f"<FitResult {self.model.name}, {self.method}: {size}, redchi {significant(self.redchi, 4)}, "
            f"{self.message}>"
        )

    # ---- what is wrong with the fit and its data, imported when asked for ------------------------------------------

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """All that is worth knowing of the fit and its data, errors first; each names its origin.

        What :func:`rotorfit.check` finds of the data, what the fit, its noise and its model ask a reader to know, and
        what explains a misfit.

        Where the model misses the data by far, trial fits look for an error of the data that explains it: an unbalance
        given as a constant force, exchanged speeds or planes, turned probes, filters, wrong units.

        Example:
            >>> [finding.code for finding in fit.findings if finding.severity != "note"]
            []
        """
        from rotorfit.identify.diagnosis.findings import findings_of

        return findings_of(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentences of those findings that are errors or warnings.

        Example:
            >>> fit.warnings
            ()
        """
        return tuple(dict.fromkeys(one.words for one in self.findings if one.severity != "note"))

    # ---- derived quantities ------------------------------------------------------------------------------------

    @property
    def var_names(self) -> tuple[str, ...]:
        """Names of the fitted vector's entries, the order of ``covar``."""
        return (*self.problem.space.names, *self.problem.space.nuisance)

    @property
    def widening(self) -> float:
        """Factor on the variances of the noise: redchi where it is above one and, with few mountings, beyond chance.

        One for robust losses, and where the noise was found in the residuals or scaled to them.
        """
        known = freedom_of(self.problem.blocks)
        return widening(
            self.redchi, self.problem.loss, rescaled=self.settings.rescaled, nfree=self.nfree, freedom=known
        )

    @property
    def model_limited(self) -> bool:
        """True if the model, not the noise, limits the fit, as far as a linear loss tells."""
        return self.problem.loss == "linear" and is_misfit(self.noise, self.widening)

    @property
    def largest_redchi(self) -> float:
        """redchi that noise alone exceeds once in a thousand tests, by the number of independent readings.

        Sigma that was estimated from the data is uncertain itself.

        Example:
            >>> fit.redchi < fit.largest_redchi  # causes beside the chain of two masses explain that rotor
            True
        """
        return largest_redchi(self.noise, self.nfree, noise_known_from(self.problem))

    @property
    def freedom(self) -> float:
        """Degrees of freedom behind the standard errors: infinite unless few mountings tell the noise."""
        known = freedom_of(self.problem.blocks)
        return min(known, float(self.nfree)) if self.widening > 1 and math.isfinite(known) else known

    def interval(self, name: str, level: float = 0.95, *, share: Share = "all") -> tuple[float, float]:
        """Interval that holds the parameter ``name``, or "threshold_speed" in rad/s, with the probability ``level``.

        By Student's t where standard errors have few degrees of freedom; infinite where the data do not determine it.
        It holds all causes; ``share`` "noise" leaves them out.

        Raises:
            KeyError: no such parameter; the message names the nearest.
            ValueError: a level that is no probability.

        Example:
            >>> [round(end, 4) for end in fit.interval("lam", 0.95, share="noise")]
            [0.4745, 0.4747]
        """
        if name != THRESHOLD and name not in self.params:
            raise KeyError(unknown_name("parameter", name, self.params))
        p = self.threshold_speed() if name == THRESHOLD else self.params[name]
        return p.interval(level, share=share)

    @property
    def causes(self) -> Causes:
        """Causes beside the model, as they were solved with the fitted values; empty with ``causes=None``.

        Example:
            >>> rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, causes={}).causes["gain"].determined < 0.5
            True
        """
        return table_of(self.settings.solved)

    @property
    def band(self) -> float:
        """Highest tested frequency, rad/s."""
        return max((float(np.abs(b.frequency).max()) for b in self.problem.responses), default=math.inf)

    @property
    def stability_band(self) -> float:
        """Frequencies that count for stability: all, but only the tested band with corrections above s^2 or delays."""
        return stability_band(self.model, self.band)

    @property
    def speeds(self) -> Float:
        """Rotative speeds at which the tests were made, rad/s; empty where the speed sweeps."""
        distinct: Float = np.unique(np.concatenate([np.zeros(0), *(e.set_speed for e in self.experiments)]))
        most = 50  # distinct speeds; more are those of a sweep
        return distinct if distinct.size <= most else np.zeros(0)

    def group(self, at: Mapping[str, Any] | None = None) -> int:
        """Number of the parameter group that ``at`` names by values of attributes, ``{"speed_rpm": 1000}``.

        Raises:
            ValueError: parameters were fitted per attribute and ``at`` does not name one group.
        """
        return self.problem.space.group(at)

    def theta(self, at: Mapping[str, Any] | None = None) -> Float:
        """Model parameter vector, shape ``(P,)``, of the group that ``at`` names as for :meth:`group`."""
        return np.asarray(self.thetas[self.group(at)])

    @property
    def thetas(self) -> Float:
        """Model parameter vectors of all groups, shape ``(G, P)``."""
        return self.problem.space.theta(self.x)

    def propagate(self, value: float, gradient: Float, unit: str, at: Mapping[str, Any] | None = None) -> Quantity:
        """A derived quantity with its standard error by the delta method.

        ``value`` in ``unit``, ``gradient`` by the model parameters, shape ``(P,)``, of the group that ``at`` names.
        """
        return propagated(self, self.group(at), value, gradient, unit)

    def error_of(self, slopes: Mapping[str, float]) -> ErrorBar | None:
        """The error of a result by its derivatives, share by share: all that is printed with an error comes from here.

        Args:
            slopes: by names of fitted and of known values, and by ``"cause NAME"`` of causes.

        Returns:
            ``None`` where no causes were solved.
        """
        return error_bar(self, slopes)

    def error_parts(self, slopes: Mapping[str, float]) -> Float:
        """The error of a result, ``slopes`` as for :meth:`error_of`, by independent parts that all results share; their
        squares add up to its variance."""
        return independent_parts(self, slopes)

    def quantity(self, value: float, slopes: Mapping[str, float], unit: str) -> Quantity:
        """A quantity made of parameters and the threshold speed, with its error.

        ``value`` in ``unit``, ``slopes`` by names in :attr:`params` or that of the threshold speed.
        """
        return made_of(self, value, slopes, unit)

    def threshold_speed(self, at: Mapping[str, Any] | None = None, *, eccentricity: float | None = None) -> Quantity:
        """Rotative speed at which the rotor becomes unstable, rad/s, with its standard error.

        The value is NaN where the fitted rotor is stable at every speed searched; the standard error is infinite where
        the data do not tell, or where only frequencies of the tested band could be searched, as the summary says.

        Args:
            at: group of parameters, where some were fitted per attribute.
            eccentricity: static eccentricity at which a load keeps the journal; by default it is centred.

        Raises:
            ValueError: an eccentricity outside of 0 to 1.

        Example:
            >>> onset = fit.threshold_speed()
            >>> round(onset.value * 30 / 3.14159), onset.unit
            (2654, 'rad/s')
        """
        allowed = "|displacement| / clearance, from 0 to below 1"
        away = 0.0 if eccentricity is None else real_number(eccentricity, "eccentricity", allowed)
        if not 0 <= away < 1:
            raise ValueError(f"eccentricity is {away:g}; it must be {allowed}")
        if not away:  # where the journal is centred
            found = self.threshold_of(self.group(at))
            if not math.isfinite(found.stderr) or len(self.thetas) > 1:
                return found
            return replace(found, source=self, slopes={THRESHOLD: 1.0})
        from rotorfit.identify.fitting.onset import off_centre_onset

        return off_centre_onset(self, self.group(at), away)

    def threshold_of(self, group: int) -> Quantity:
        """Threshold speed of the parameter ``group`` of that number, from 0; see :meth:`threshold_speed`."""
        from rotorfit.identify.fitting.onset import onset_of

        return onset_of(self, group)

    def onset(self, group: int) -> Threshold | None:
        """Onset of instability of the ``group`` of that number, searched once: a large structure takes seconds."""
        if group not in self._onsets:
            self._onsets[group] = threshold_speed(self.model, self.thetas[group], band=self.stability_band)
        return self._onsets[group]

    @cached_property
    def _onsets(self) -> dict[int, Threshold | None]:
        return {}

    def whirl_ratio(self, at: Mapping[str, Any] | None = None) -> float:
        """Whirl frequency at onset over the threshold speed, NaN without one, of the group that ``at`` names."""
        onset = self.onset(self.group(at))
        if onset is None and math.isfinite(self.stability_band) and self.settings.onsets:
            return self.settings.onsets[self.group(at)].whirl_ratio
        return math.nan if onset is None else onset.whirl_ratio

    def coefficients(
        self,
        speed: float | None = None,
        *,
        speed_rpm: float | None = None,
        plane: str | None = None,
        at: Mapping[str, Any] | None = None,
        eccentricity: float = 0.0,
    ) -> Coefficients:
        """Coefficients of a fitted fluid as engineers tabulate them: Kxx, Kxy, ... Cxx, ... Myy, with correlations.

        ``Kxx = K0 - Mf lam^2 Om^2``, ``Kxy = -Kyx = D lam Om``, ``Cxx = D``, ``Cxy = -Cyx = 2 lam Om Mf`` and ``Mxx =
        Mf``; of :class:`~rotorfit.models.Anisotropic` its own, of a rotor on supports that differ in two directions the
        sum.

        Args:
            speed: rotative speed, rad/s.
            speed_rpm: the same in rpm.
            plane: name of the plane, where forces were fitted at several.
            at: values of attributes that name one group; by default that of the speed, where parameters were fitted
                speed by speed.
            eccentricity: orbit radius over clearance, for models with a law.

        Raises:
            ValueError: a model without fluid, an unknown plane, or a speed that was not tested where parameters were
                fitted speed by speed.

        Example:
            >>> found = fit.coefficients(speed=157.0)
            >>> print(round(found["Kxy"].value / (fit.params["D"].value * fit.params["lam"].value * 157.0), 6))
            1.0
        """
        from rotorfit.identify.fitting.structure.coefficients import coefficients_of

        return coefficients_of(self, in_rad_s("speed", speed, rpm=speed_rpm), plane, at, eccentricity)

    def coefficient_table(
        self,
        speeds: Sequence[float] | None = None,
        *,
        speed_rpm: Sequence[float] | None = None,
        plane: str | None = None,
    ) -> CoefficientRows:
        """:meth:`coefficients` at several ``speeds``, rad/s, or ``speed_rpm``, by default those that were tested, and
        in all conditions that parameters were fitted per, as text, data frame and CSV; ``plane`` as there.

        Example:
            >>> fit.coefficient_table().to_csv(folder / "coefficients.csv")
        """
        from rotorfit.identify.fitting.structure.coefficients import coefficient_rows

        return coefficient_rows(self, in_rad_s("speed", speeds, needed=False, rpm=speed_rpm), plane)

    def frequency_coefficients(
        self, speeds: Sequence[float] | None = None, *, speed_rpm: Sequence[float] | None = None
    ) -> FrequencyRows:
        """Stiffness and damping of a seal or bearing frequency by frequency, as measured, beside the fitted ones.

        ``speeds`` are rotative speeds, rad/s, or ``speed_rpm``, by default those that were tested.

        Raises:
            ValueError: a fit of anything but :class:`~rotorfit.models.Anisotropic` of one plane.
        """
        from rotorfit.identify.fitting.structure.coefficients import frequency_coefficients_of

        return frequency_coefficients_of(self, in_rad_s("speed", speeds, needed=False, rpm=speed_rpm))

    def natural_frequencies(
        self, speed: float | None = None, at: Mapping[str, Any] | None = None, *, speed_rpm: float | None = None
    ) -> NaturalFrequencies:
        """Damped natural frequency (rad/s, signed), damping ratio and sense of each mode at a rotative speed, as named
        tuples; ``print`` shows a table with 95 % intervals.

        ``speed`` in rad/s, or ``speed_rpm``, is negative from y to x; ``at`` names a group of parameters, as for
        :meth:`group`.

        Raises:
            ValueError: a speed that is no finite number.

        Example:
            >>> [round(frequency.value) for frequency, damping, sense in fit.natural_frequencies(speed=150.0)][-1] > 0
            True
            >>> fit.natural_frequencies(speed_rpm=1500)[-1].sense
            'forward'
        """
        from rotorfit.identify.fitting.structure.modes import natural_frequencies

        return natural_frequencies(self, in_rad_s("speed", speed, rpm=speed_rpm), at)

    def modes(
        self,
        speed: float | None = None,
        *,
        speed_rpm: float | None = None,
        normalise: str | None = None,
        at: Mapping[str, Any] | None = None,
    ) -> Modes:
        """Natural frequency, damping ratio, shape, and modal mass, stiffness and damping of each mode, with errors.

        Of a passive rotor, as :class:`rotorfit.models.TwoDisk` is, each mode by itself: the paper's M_I, K_I, D_I, phi
        and zeta. The half-power bandwidth of the measured responses stands beside zeta.

        Args:
            speed: rotative speed, rad/s; by default the rotor is at rest.
            speed_rpm: the same in rpm.
            normalise: plane at which shapes are one, the first by default.
            at: names a group of parameters, as for :meth:`group`.

        Raises:
            KeyError: a plane that the rotor has not.
            ValueError: a speed that is no finite number.

        Example:
            >>> modes = rf.fit(rf.models.TwoDisk(), rf.datasets.two_disk()).modes()
            >>> [round(mode.mass.value, 1) for mode in modes], round(modes[1].shape["outboard"].value, 2)
            ([1.5, 1.4], -0.94)
        """
        from rotorfit.identify.fitting.structure.modes import modes_of

        turning = in_rad_s("speed", speed, needed=False, rpm=speed_rpm)
        return modes_of(self, 0.0 if turning is None else turning, normalise, at)

    def turning_anisotropy(self, *, level: float = 0.95, at: Mapping[str, Any] | None = None) -> TurningAnisotropy:
        """dK, dK/K and the stiff direction of a shaft that is not round.

        ``level`` is the probability of the intervals, ``at`` names a group of parameters, as for :meth:`group`.
        """
        from rotorfit.identify.fitting.anisotropy import turning_anisotropy

        return turning_anisotropy(self, level=level, at=at)

    # ---- other measures of uncertainty, imported when asked for ------------------------------------------------------

    def jackknife(self) -> Jackknife:
        """Errors from leaving out run after run, which assume nothing of how runs differ; no fit is repeated.

        Raises:
            ValueError: fewer than three runs, weights put on anew, or a fit that did not converge.

        Example:
            >>> fit.jackknife().parameter("lam").stderr < 0.05
            True
        """
        from rotorfit.identify.uncertainty.jackknife import jackknife

        return jackknife(self)

    def profile(
        self, name: str, *, level: float = 0.95, points: int = 21, at: Mapping[str, Any] | None = None
    ) -> Profile:
        """Interval and curve of a fitted parameter or the threshold speed, ``name``, by profile likelihood.

        The interval has the probability ``level``, the curve so many ``points``; ``at`` names a group of parameters.
        See :func:`rotorfit.identify.uncertainty.profile.profile`.

        Example:
            >>> low, high = fit.profile("lam", points=5).interval
            >>> low < fit.params["lam"].value < high
            True
        """
        from rotorfit.identify.uncertainty.profile import profile

        return profile(self, name, level=level, points=points, at=at)

    def profiles(
        self,
        names: Sequence[str] | None = None,
        *,
        level: float = 0.95,
        points: int = 21,
        at: Mapping[str, Any] | None = None,
        executor: Executor | None = None,
    ) -> tuple[Profile, ...]:
        """Profiles of several quantities, found together; see :func:`rotorfit.identify.uncertainty.profile.profiles`.

        ``names`` are by default those of every fitted parameter; ``level``, ``points`` and ``at`` as for
        :meth:`profile`, ``executor`` as for :meth:`bootstrap`.

        Example:
            >>> lam, D = fit.profiles(["lam", "D"])
            >>> lam.lower < fit.params["lam"].value < lam.upper
            True
        """
        from rotorfit.identify.uncertainty.profile import profiles

        return profiles(self, names, level=level, points=points, at=at, executor=executor)

    def predict(
        self, frequency: ArrayLike | None = None, speed: ArrayLike | None = None, **options: Unpack[PredictKeywords]
    ) -> Prediction:
        """Responses at frequencies, speeds and planes that need not have been tested, with their bands.

        Args:
            frequency: of the force, rad/s, negative turns backward; ``None`` is once per turn, the response to an
                unbalance.
            speed: rotative speed, rad/s; scalars and vectors ``(N,)`` may be mixed.
            **options: ``frequency_rpm``, ``frequency_hz``, ``speed_rpm``: the same in other units. ``force_plane``:
                where the force acts; may be left out of models of one plane. ``force``:
                ``F exp(j delta)``, N; 1 N where neither it nor ``mr`` is given. ``mr``: an unbalance, kg m, whose force
                is ``mr w^2``. ``plane``: where the motion is predicted, a plane of the model, with a probe or without,
                or a place between planes (``probes=`` of the model); by default that of the force. ``direction``: ``z``
                for x + j y, or of models of both directions ``x`` or ``y``. ``level``: probability that a band holds,
                0.95. ``whole``: bands that hold whole curves at once, in place of each point by itself.
                ``share``: "noise" for bands by the noise alone. ``at``: group of parameters, for fits with one value a
                group.

        Raises:
            TypeError: a keyword that is none of these.
            ValueError: no such plane, no force, a level that is no probability, a speed at which the rotor is unstable.

        Example:
            >>> prediction = fit.predict(None, [150.0, 160.0], force_plane="disk", mr=3e-5, plane="journal")
            >>> [round(1e6 * abs(z)) for z in prediction.response]
            [36, 48]
        """
        from rotorfit.identify.uncertainty.predict import predict

        check_keywords("predict", options, PredictKeywords)
        return predict(self, frequency, speed, **options)

    def stability_report(self, **options: Unpack[JudgeKeywords]) -> StabilityReport:
        """Criteria of stability at running speed, each with its interval and the probability that it is met.

        Args:
            **options: ``max_speed_rpm``, ``min_speed_rpm``, or ``max_speed``, ``min_speed`` in rad/s: the running
                speeds; by default the highest tested one.
                ``min_decrement``: logarithmic decrement that the least stable forward mode should have, 0.1.
                ``min_threshold_ratio``: threshold speed over the highest running speed, 1. ``cross_coupling``:
                anticipated cross-coupled stiffness, ``{"disk": 2e5}``, N/m; ``min_cross_coupling_ratio``: factor on it
                that the rotor should bear, 2. ``unbalance_g_mm``: ``{"disk": 30.0}``, for amplification factors and
                separation margins of critical speeds of ``plane``, by default that of the unbalance;
                ``max_amplitude_um``: largest 0-peak deflection allowed there at running speeds. ``sensitivity``: plane
                of a (magnetic) bearing whose sensitivity function should not exceed ``max_sensitivity``, 3, at the
                highest running speed. ``cases``: factors on
                parameters by name of a case, ``{"smallest clearance": {"K0": 1.3, "D": 1.5}}``. ``level``: probability
                of the intervals, 0.95. ``at``: group of parameters, for fits with one value a group.

        Raises:
            TypeError: a keyword that is none of these.
            ValueError: a speed, plane or limit that is impossible, a fit that did not converge.

        Example:
            >>> report = fit.stability_report(max_speed_rpm=2000, min_decrement=0.1)
            >>> report.criteria[0].probability
            1.0
        """
        from rotorfit.identify.uncertainty.stability.report import stability_report

        check_keywords("stability_report", options, JudgeKeywords)
        return stability_report(self, **options)

    def derive(
        self, quantity: Callable[[Any], Any], *, unit: str = "", at: Mapping[str, Any] | None = None
    ) -> Quantity:
        """A quantity made of parameters, with its error from their covariance and exact derivatives.

        Args:
            quantity: function of the parameters, which are attributes of its argument; NumPy's functions may be used.
            unit: its SI unit, for printing.
            at: group of parameters, for fits with one value a group.

        Raises:
            AttributeError: no such parameter.
            TypeError: no function.
            ValueError: not one finite number.

        Example:
            >>> print(fit.derive(lambda p: p.K0 / p.D, unit="1/s"))
            6.43 +- 0.64 1/s
            >>> print(fit.params["K0"] / fit.params["D"])  # the same: parameters of one fit know their covariance
            6.43 +- 0.64 1/s
        """
        from rotorfit.identify.fitting.derived import derive

        return derive(self, quantity, unit, at)

    def what_if(self, **values: float | Number) -> FitResult:
        """The fitted rotor with other values: a result whose predictions, stability and figures have the errors of what
        stays as it was fitted.

        Args:
            **values: parameters by name, SI: plain numbers, which are then known, or numbers made of this fit's
                parameters, ``D=2 * fit.params["D"]``, which keep their errors. Known values may be changed too.

        Returns:
            a result that was not fitted: goodness of fit, residuals and causes are still those of this fit.

        Raises:
            KeyError: no such parameter; the message names the nearest.
            ValueError: a fit that did not converge, or a number of another fit.

        Example:
            >>> swirl_brake = fit.what_if(lam=0.3, D=0.9 * fit.params["D"])
            >>> print(swirl_brake.threshold_speed().to("rpm"))
            4200 +- 33 rpm
            >>> figure = fit.plot.stability(beside=swirl_brake)
        """
        from rotorfit.identify.fitting.what_if import what_if

        return what_if(self, values)

    def bootstrap(
        self,
        *,
        n: int = 500,
        rng: Seed = None,
        seed: Seed = None,
        accelerate: bool | None = None,
        executor: Executor | None = None,
    ) -> Bootstrap:
        """Fits of data simulated from this one and their spread; see rotorfit.identify.uncertainty.bootstrap.bootstrap.

        Args:
            n: number of data sets to simulate and fit.
            rng: of random numbers, a generator or its seed, 0 by default.
            seed: the same.
            accelerate: with compiled kernels; by default where numba is installed.
            executor: any ``concurrent.futures`` executor, also Dask's ``client.get_executor(pure=False)``, that fits
                beside each other: for nonlinear rotors, of which one fit takes long.

        Example:
            >>> low, high = fit.bootstrap(n=20, seed=1).interval("lam")
            >>> low < high
            True
        """
        from rotorfit.identify.uncertainty.bootstrap import bootstrap

        return bootstrap(self, n=n, seed=seed_of(rng, seed, 0), accelerate=accelerate, executor=executor)

    def budget(self) -> Budget:
        """What the error of each result is made of: noise, causes found from the data, and sizes on trust, by cause.

        Example:
            >>> fit.budget()["lam"].noise < fit.budget()["lam"].stderr
            True
        """
        from rotorfit.identify.uncertainty.budget import budget_of

        return budget_of(self)

    # ---- files, imported when asked for ------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result and its data to a JSON file ``path``, whole or not at all, for :func:`rotorfit.load_fit`."""
        from rotorfit.identify.fitting.fit_file import save_fit

        save_fit(self, path)

    def to_ross(
        self,
        speeds: ArrayLike | None = None,
        *,
        speed_rpm: ArrayLike | None = None,
        version: str | int | None = None,
        nodes: Mapping[str, int] | None = None,
        element: ElementKind = "bearing",
        at: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
        eccentricity: float = 0.0,
    ) -> dict[str, RossElement]:
        """Bearings or seals for the ROSS package: the fitted fluid, and what else was fitted at a known shaft's planes.

        The table holds ``kxx = K0 - Mf lam^2 Om^2``, ``kxy = -kyx = D lam Om``, ``cxx = D``, ``mxx = Mf`` and
        ``cxy = -cyx = 2 lam Om Mf`` at the given speeds and at the threshold speed, where that lies among them.

        Args:
            speeds: rotative speeds, rad/s, at least five; of parameters that were fitted speed by speed, some of these
                speeds, by default all.
            speed_rpm: the same in rpm.
            version: of ROSS, "2.3" or "3.1", by default the one that is installed. A table over speed is called
                ``frequency`` up to 2.x and ``speed`` from 3.0 on, and each line takes the other's for something else.
            nodes: node of the ROSS rotor at each plane, for models that do not know it.
            element: "bearing" or "seal".
            at: names a group of parameters, as for :meth:`group`, or one at each speed: ``{"P_bar": 30}``; a list of
                several makes an element of each, called ``stator P_bar=30``.
            eccentricity: orbit radius over clearance, for models with a law.

        Returns:
            elements by plane: ``.build()`` makes the ROSS object, ``.save(path)`` writes a file for it.

        Raises:
            ValueError: fewer speeds, a model without fluid, planes without a node, no version where none is installed.

        Example:
            >>> element = fit.to_ross([0, 50, 100, 200, 300], version="3.1", nodes={"journal": 14})["journal"]
            >>> sorted(element.arguments)[:5]
            ['cxx', 'cxy', 'cyx', 'cyy', 'kxx']
        """
        from rotorfit.identify.fitting.structure.coefficients import groups_by_speed
        from rotorfit.lab.io.shafts.ross_elements import elements_of_speeds, ross_elements

        given: dict[str, Any] = {"version": version, "nodes": nodes, "element": element, "eccentricity": eccentricity}
        if not (at is None or isinstance(at, Mapping)):
            return {
                f"{plane} {condition}": made.named(f"{plane} {condition}")
                for one in at
                for condition in [", ".join(f"{name}={value}" for name, value in one.items())]
                for plane, made in self.to_ross(speeds, speed_rpm=speed_rpm, at=one, **given).items()
            }
        groups = groups_by_speed(self, at)
        if groups and speeds is None and speed_rpm is None:
            speeds = list(groups)
        rows = np.asarray(in_rad_s("speed", speeds, rpm=speed_rpm), dtype=float)
        if groups:
            return elements_of_speeds(self.model, lambda v: theta_at(self, groups[v], v), rows, list(groups), **given)
        group = self.group(at)
        onset = self.threshold_of(group).value
        if rows.size and rows.min() < onset < rows.max():
            rows = np.append(rows, onset)
        return ross_elements(
            self.model,
            lambda speed: theta_at(self, group, speed),
            rows,
            **given,
        )

    def to_ross_rotor(self, rotor: Any, speeds: ArrayLike | None = None, **options: Any) -> Any:
        """A rotor of ROSS with the fitted bearings or seals in it, in place of elements tagged by their planes' names.

        Args:
            rotor: ``ross.Rotor(...)``; it stays as it is.
            speeds: see :meth:`to_ross`.
            **options: of :meth:`to_ross`, such as ``nodes={"stator": 14}``.

        Raises:
            TypeError: something that is no rotor.
            ValueError: a node that the rotor does not have, and as for :meth:`to_ross`.

        Example:
            >>> whole = fit.to_ross_rotor(ross_rotor, np.linspace(0, 400, 9), nodes={"journal": 4})  # doctest: +SKIP
        """
        from rotorfit.lab.io.shafts.ross_elements import put_into

        return put_into(rotor, self.to_ross(speeds, **options))

    # ---- posterior, imported when asked for --------------------------------------------------------------------------

    @cached_property
    def other_solutions(self) -> tuple[OtherSolution, ...]:
        """Solutions that the data hold as well: values of the other sign, or two sets of them exchanged."""
        from rotorfit.identify.fitting.other_solutions import other_solutions

        return other_solutions(self)

    def log_posterior(self, noise: Noise | None = None) -> LogDensity:
        """The density that :meth:`sample` draws from, for any other sampler: a function of one vector or of many.

        Args:
            noise: "marginal", levels of noise unknown and integrated out, or "fixed"; see :func:`rotorfit.sample`.

        Raises:
            ValueError: a fit that cannot be sampled, as there.

        Example:
            >>> import emcee
            >>> density = fit.log_posterior()
            >>> sampler = emcee.EnsembleSampler(32, len(density.names), density, vectorize=True)
            >>> state = sampler.run_mcmc(density.walkers(32), 200)
            >>> draws = density.values(sampler.get_chain(flat=True))  # beside causes
            >>> draws.shape
            (6400, 10)
        """
        from rotorfit.identify.uncertainty.sampling import log_posterior

        return log_posterior(self, noise)

    def sample(self, **options: Unpack[SampleKeywords]) -> Posterior:
        """Sample the posterior with emcee; options as for :func:`rotorfit.sample`, for instance ``seed=1``.

        Args:
            **options: ``rng`` or ``seed``, ``walkers``, ``ess``, ``max_steps``, ``noise``, ``refine``, ``checkpoint``,
                ``progress``, ``moves``, ``accelerate``: see :func:`rotorfit.sample`.

        Raises:
            TypeError: a keyword that is none of these.
            ValueError: see there.

        Example:
            >>> posterior = fit.sample(seed=1, walkers=32, ess=100)
            >>> low, high = posterior.interval("lam", 0.95)
            >>> low < high
            True
        """
        from rotorfit.identify.uncertainty.sampling import sample

        check_keywords("sample", options, SampleKeywords)
        return sample(self, **options)

    # ---- presentation, imported when asked for ----------------------------------------------------------------------

    def to_dataframe(self) -> DataFrame:
        """The parameters as a table, a row each, SI: value, standard errors, 95 % interval.

        Example:
            >>> float(fit.to_dataframe().set_index("parameter").loc["K3", "value"])
            6000.0
        """
        from pandas import DataFrame

        rows = []
        for p in self.params.values():
            low, high = p.interval(0.95)
            errors = {"stderr": p.stderr, "noise": p.noise, "bounded": p.bounded, "trust": p.trust, "plain": p.plain}
            limits = {"low": low, "high": high, "unit": p.unit, "vary": p.vary, "determined": p.resolved}
            rows.append({"parameter": p.name, "value": p.value, **errors, **limits, "meaning": p.meaning})
        return DataFrame(rows)

    def summary(self) -> str:
        """Table of the result for a terminal."""
        from rotorfit.identify.fitting.summary import fit_summary

        return fit_summary(self)

    def __str__(self) -> str:
        from rotorfit.identify.fitting.summary import fit_head

        return fit_head(self)

    def _repr_html_(self) -> str:
        """Table for a notebook."""
        from rotorfit.identify.fitting.summary import fit_html

        return fit_html(self)
