"""Posterior samples of a fit: what the data leave open, parameter by parameter and for all that follows from them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float, Index
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table
from rotorfit.base.units import in_rad_s
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import JudgeKeywords, PredictKeywords, check_keywords
from rotorfit.identify.uncertainty.derived import (
    DERIVED_DRAWS,
    SHAFT_DRAWS,
    Derived,
    Draws,
    Mode,
    Onsets,
    StiffnessBand,
    modes,
    onsets_of,
)
from rotorfit.lab.data.findings import Finding, errors_first
from rotorfit.models.shafts.angular_rates import angular_rate, angular_rates

if TYPE_CHECKING:
    from pandas import DataFrame

    from rotorfit.estimators.inference.log_posterior import Noise
    from rotorfit.identify.uncertainty.prediction import Prediction
    from rotorfit.identify.uncertainty.stability.record import StabilityReport


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """How a posterior was sampled; see :func:`rotorfit.sample`."""

    noise: Noise  # treatment of the noise level: "marginal", "fixed" or "sampled"
    inflation: float  # factor on variances, beside the level of unknown noise: of misfits, of correlated readings
    walkers: int  # how many there are
    ess: float  # effective samples asked for of each parameter
    max_steps: int  # as asked for
    steps: int  # steps made in all
    between_runs: bool = False  # whether the variance of effects of runs was integrated out, not taken as estimated
    causes: bool = False  # whether causes beside the model were integrated out


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Posterior(ByValue, Draws):
    """Draws from the posterior of a fit.

    Attributes:
        fit: the fit whose data, model, priors and bounds these are.
        names: of the entries: parameters, nuisance entries, with sampled noise ``log_s[...]`` of each channel.
        chain: positions of the walkers after burn-in, shape ``(steps, walkers, p)``, SI units.
        log_density: up to a constant, shape ``(steps, walkers)``.
        acceptance: accepted share of each walker's proposals, shape ``(walkers,)``.
        tau: autocorrelation time of each entry in steps, shape ``(p,)``.
        burn_in: steps dropped at the beginning.
        converged: whether the autocorrelation time is resolved and the effective samples asked for are there.
        message: how the run ended, in words.
        treatment: what was done about the noise level and about model-form error, in words.
        seed: of the random numbers; the same seed gives the same draws.
        settings: how it was sampled.
        sizes: of causes beside the model, drawn with the positions, none of one sign below zero, shape
            ``(steps, walkers, k)``; None without any.
    """

    fit: FitResult
    names: tuple[str, ...]
    chain: Float
    log_density: Float
    acceptance: Float
    tau: Float
    burn_in: int
    converged: bool
    message: str
    treatment: str
    seed: int
    settings: SampleSettings
    sizes: Float | None = None

    plot = Accessor()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those of the fit, and whether the draws are enough, errors first."""
        words = f"The sampling of the posterior has {self.message}."
        own = [] if self.converged else [Finding("warning", "sampling", words, origin="fit")]
        return tuple(errors_first([*own, *self.fit.findings]))

    @property
    def samples(self) -> Float:
        """All draws, shape ``(steps * walkers, p)``."""
        return self.chain.reshape(-1, len(self.names))

    def parameter(self, name: str) -> Derived:
        """One entry with its spread.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.

        Raises:
            KeyError: no such entry; the message names the nearest.
        """
        if name not in self.names:
            raise KeyError(unknown_name("sampled parameter", name, self.names))
        return Derived(name=name, unit=self.unit(name), samples=self.samples[:, self.names.index(name)])

    def unit(self, name: str) -> str:
        """SI unit of an entry.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.
        """
        return self.fit.params[name].unit if name in self.fit.params else "1"

    def __repr__(self) -> str:
        return f"<Posterior: {len(self.samples)} draws of {len(self.names)} values of {self.fit.model.name}>"

    # ---- derived quantities ------------------------------------------------------------------------------------------

    def to_dataframe(self) -> DataFrame:
        """All draws as a table, a row each, SI, by the names of the entries.

        Example:
            >>> list(fit.sample(seed=1, walkers=32, ess=100).to_dataframe().columns[:2])
            ['Md', 'Ds']
        """
        from pandas import DataFrame

        return DataFrame(self.samples, columns=list(self.names))

    def thetas(self, at: Mapping[str, Any] | None = None, *, draws: int | None = None) -> Float:
        """Model parameter vectors of evenly spaced draws, shape ``(N, P)``.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``, where some were fitted per attribute.
            draws: how many at most, by default :data:`DERIVED_DRAWS`, fewer for models with a whole shaft.
        """
        samples, space = self.samples, self.fit.problem.space
        return np.asarray(space.theta(samples[self._chosen(draws), : space.size])[:, space.group(at)])

    def _chosen(self, draws: int | None = None) -> Index:
        """Evenly spaced draws by their numbers."""
        limit = draws or (DERIVED_DRAWS if self.fit.model.shaft is None else SHAFT_DRAWS)
        count = len(self.samples)
        return np.unique(np.linspace(0, count - 1, min(limit, count)).astype(np.intp))

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Derived:
        """Rotative speed at which the rotor becomes unstable, rad/s; see :class:`Onsets`.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        found = self._onsets(at)
        return Derived(name="threshold speed", unit="rad/s", samples=found.speed, note=found.note)

    def predict(
        self, frequency: ArrayLike | None = None, speed: ArrayLike | None = None, **options: Unpack[PredictKeywords]
    ) -> Prediction:
        """Responses elsewhere, mean and spread over the draws; see :meth:`FitResult.predict`.

        Args:
            frequency, speed, options: as there.
        """
        from rotorfit.identify.uncertainty.predict import predict

        check_keywords("predict", options, PredictKeywords)
        return predict(self.fit, frequency, speed, thetas=self.thetas(options.get("at")), **options)

    def stability_report(self, **options: Unpack[JudgeKeywords]) -> StabilityReport:
        """Criteria of stability over the draws; see :meth:`FitResult.stability_report`.

        Args:
            **options: as there.
        """
        from rotorfit.identify.uncertainty.stability.report import stability_report

        check_keywords("stability_report", options, JudgeKeywords)
        return stability_report(self.fit, thetas=self.thetas(options.get("at")), **options)

    def whirl_ratio(self, at: Mapping[str, Any] | None = None) -> Derived:
        """Frequency of the self-excited whirl at onset over the threshold speed, NaN for draws without a threshold.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        found = self._onsets(at)
        return Derived(name="whirl ratio at onset", unit="1", samples=found.whirl_ratio, note=found.note)

    def _onsets(self, at: Mapping[str, Any] | None) -> Onsets:
        group = self.fit.group(at)
        if group not in self._cache:
            sizes = None if self.sizes is None else self.sizes.reshape(len(self.samples), -1)[self._chosen()]
            self._cache[group] = onsets_of(self.fit, self.thetas(at), group, self.seed, sizes)
        return self._cache[group]

    @cached_property
    def _cache(self) -> dict[int, Onsets]:
        return {}

    def modal_parameters(
        self, speed: float | None = None, at: Mapping[str, Any] | None = None, *, speed_rpm: float | None = None
    ) -> list[Mode]:
        """Natural frequency, damping, decay rate and mode shape of every mode at a rotative speed (rad/s).

        Args:
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            speed_rpm: the speed in rpm.

        Raises:
            ValueError: a speed that is no finite number.
        """
        turning = angular_rate(in_rad_s("speed", speed, rpm=speed_rpm))
        return modes(self.fit.model, self.thetas(at), turning, self.fit.stability_band)

    def natural_frequencies(
        self, speed: float | None = None, at: Mapping[str, Any] | None = None, *, speed_rpm: float | None = None
    ) -> list[tuple[Derived, Derived]]:
        """Damped natural frequency (rad/s, signed) and damping ratio of each mode at a rotative speed (rad/s).

        Args:
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            speed_rpm: the speed in rpm.

        Raises:
            ValueError: a speed that is no finite number.
        """
        return [(mode.frequency, mode.damping_ratio) for mode in self.modal_parameters(speed, at, speed_rpm=speed_rpm)]

    def lam_speed(
        self,
        speed: float | None = None,
        at: Mapping[str, Any] | None = None,
        *,
        speed_rpm: float | None = None,
        name: str = "lam",
    ) -> Derived:
        """Mean angular speed of the fluid, ``lam Omega``, rad/s.

        Args:
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            speed_rpm: the speed in rpm.
            name: velocity ratio to use, of models that have ``lam_D`` and ``lam_M``.

        Raises:
            KeyError: the model has no such velocity ratio.
            ValueError: a speed that is no finite number.
        """
        speed = angular_rate(in_rad_s("speed", speed, rpm=speed_rpm))
        self.fit.model.parameter(name)
        ratio = self.thetas(at, draws=len(self.samples))[:, self.fit.model.parameter_names.index(name)]
        return Derived(name=f"{name} * Omega", unit="rad/s", samples=ratio * speed)

    def dynamic_stiffness(
        self,
        frequency: ArrayLike | None = None,
        speed: float | None = None,
        at: Mapping[str, Any] | None = None,
        *,
        frequency_rpm: ArrayLike | None = None,
        frequency_hz: ArrayLike | None = None,
        speed_rpm: float | None = None,
    ) -> StiffnessBand:
        """Direct and quadrature dynamic stiffness at signed frequencies, rad/s, and a rotative speed, rad/s.

        Args:
            frequency: signed perturbation frequencies, rad/s, shape ``(N,)``.
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            frequency_rpm, frequency_hz, speed_rpm: the same in other units.

        Raises:
            ValueError: a frequency or a speed that is no finite number.
        """
        frequency = in_rad_s("frequency", frequency, rpm=frequency_rpm, hz=frequency_hz)
        speed = angular_rate(in_rad_s("speed", speed, rpm=speed_rpm))
        w = np.atleast_1d(angular_rates(frequency, "frequency"))
        kappa = self.fit.model.dynamic_stiffness(self.thetas(at)[:, None, :], w, speed)
        return StiffnessBand(
            frequency=w,
            direct=Derived(name="direct dynamic stiffness", unit="N/m", samples=np.ascontiguousarray(kappa.real)),
            quadrature=Derived(
                name="quadrature dynamic stiffness", unit="N/m", samples=np.ascontiguousarray(kappa.imag)
            ),
        )

    # ---- presentation and files, imported when asked for -------------------------------------------------------------

    def parts(self) -> list[str | Table]:
        """What is printed: mean, standard deviation, quantiles, split R-hat, effective samples, convergence."""
        from rotorfit.identify.uncertainty.posterior_file import summary

        return summary(self)

    def to_arviz(self) -> Any:
        """For ArviZ: ``arviz.InferenceData`` with ArviZ before 1.0, ``xarray.DataTree`` from there on."""
        from rotorfit.identify.uncertainty.posterior_file import to_arviz

        return to_arviz(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the draws to netCDF in ArviZ's layout; :func:`rotorfit.load_posterior` reads them, ArviZ does too.

        Args:
            path: file to write, whole or not at all.
        """
        from rotorfit.identify.uncertainty.posterior_file import save

        save(self, Path(path))
