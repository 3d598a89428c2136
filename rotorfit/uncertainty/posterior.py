"""Posterior samples of a fit: what the data leave open, parameter by parameter and for all that follows from them."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.estimators.correlated import freedom_of
from rotorfit.fitting.notebook import text_html
from rotorfit.fitting.result import FitResult
from rotorfit.models.array_types import Float
from rotorfit.models.stability import threshold_speeds
from rotorfit.uncertainty.derived import Derived, Mode, StiffnessBand, modes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.estimators.ensemble_sampler import SamplerProgress
    from rotorfit.estimators.log_posterior import LogPosterior, Noise


WALKERS = 128
"""Walkers by default, enough to keep vectorised likelihoods busy; more where there are many parameters."""
FEW_WALKERS = 32
"""The same where the likelihood is evaluated vector by vector, as with the matrices of a whole shaft."""
DERIVED_DRAWS = 2000
"""Draws from which derived quantities are computed, evenly spaced over the chain; a quantile of so many is within a
twentieth of a standard deviation."""
_SHAFT_DRAWS = 100  # the same for models with the matrices of a whole shaft
_HIGHER = 0.5  # excess of the log density over that at the optimum that is more than an optimum's inaccuracy
_TYPICAL_STEPS = 400  # of a well-behaved posterior, to judge whether compiling pays


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """How a posterior was sampled; see :func:`sample`.

    Attributes:
        noise: treatment of the noise level: "marginal", "fixed" or "sampled".
        inflation: factor on the noise variances with fixed noise, 1 unless the model limits the fit.
        walkers, ess, max_steps: as asked for.
        steps: steps made in all.
    """

    noise: Noise
    inflation: float
    walkers: int
    ess: float
    max_steps: int
    steps: int


@dataclass(frozen=True, eq=False)
class Posterior:
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
            from rotorfit.models.parameters import unknown_name

            raise KeyError(unknown_name("sampled parameter", name, self.names))
        return Derived(name, self.unit(name), self.samples[:, self.names.index(name)])

    def interval(self, name: str, probability: float = 0.95) -> tuple[float, float]:
        """Central interval of one entry, equal shares of the rest on both sides.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.
            probability: share of the distribution inside, between 0 and 1.
        """
        low, high = self.parameter(name).interval(probability)
        return float(low), float(high)

    def unit(self, name: str) -> str:
        """SI unit of an entry.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.
        """
        return self.fit.params[name].unit if name in self.fit.params else "1"

    # ---- derived quantities ------------------------------------------------------------------------------------------

    def thetas(self, at: Mapping[str, Any] | None = None, *, draws: int | None = None) -> Float:
        """Model parameter vectors of evenly spaced draws, shape ``(N, P)``.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``, where some were fitted per attribute.
            draws: how many at most, by default :data:`DERIVED_DRAWS`, fewer for models with a whole shaft.
        """
        limit = draws or (DERIVED_DRAWS if self.fit.model.shaft is None else _SHAFT_DRAWS)
        samples, space = self.samples, self.fit.problem.space
        chosen = np.unique(np.linspace(0, len(samples) - 1, min(limit, len(samples))).astype(np.intp))
        return np.asarray(space.theta(samples[chosen, : space.size])[:, space.group(at)])

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Derived:
        """Rotative speed at which the rotor becomes unstable, rad/s; infinite for draws that are always stable.

        Args:
            at: values of attributes that name one group, ``{"speed_rpm": 1000}``; needed where parameters were fitted
                per attribute.
        """
        return Derived("threshold speed", "rad/s", self._onsets(at)[0])

    def whirl_ratio(self, at: Mapping[str, Any] | None = None) -> Derived:
        """Frequency of the self-excited whirl at onset over the threshold speed, NaN for draws without a threshold.

        Args:
            at: values of attributes that name one group, ``{"speed_rpm": 1000}``; needed where parameters were fitted
                per attribute.
        """
        speed, whirl = self._onsets(at)
        return Derived("whirl ratio at onset", "1", whirl / np.where(speed > 0, speed, np.nan))

    def _onsets(self, at: Mapping[str, Any] | None) -> tuple[Float, Float]:
        group = self.fit.group(at)
        if group not in self._cache:
            self._cache[group] = threshold_speeds(self.fit.model, self.thetas(at), band=self.fit.stability_band)
        return self._cache[group]

    @cached_property
    def _cache(self) -> dict[int, tuple[Float, Float]]:
        return {}

    def modal_parameters(self, speed: float, at: Mapping[str, Any] | None = None) -> list[Mode]:
        """Natural frequency, damping, decay rate and mode shape of every mode at a rotative speed (rad/s).

        Args:
            speed: rotative speed, rad/s.
            at: values of attributes that name one group, ``{"speed_rpm": 1000}``; needed where parameters were fitted
                per attribute.
        """
        return modes(self.fit.model, self.thetas(at), speed, self.fit.stability_band)

    def natural_frequencies(self, speed: float, at: Mapping[str, Any] | None = None) -> list[tuple[Derived, Derived]]:
        """Damped natural frequency (rad/s, signed) and damping ratio of each mode at a rotative speed (rad/s).

        Args:
            speed: rotative speed, rad/s.
            at: values of attributes that name one group, ``{"speed_rpm": 1000}``; needed where parameters were fitted
                per attribute.
        """
        return [(mode.frequency, mode.damping_ratio) for mode in self.modal_parameters(speed, at)]

    def lam_speed(self, speed: float, at: Mapping[str, Any] | None = None, *, name: str = "lam") -> Derived:
        """Mean angular speed of the fluid, ``lam Omega``, rad/s.

        Args:
            speed: rotative speed, rad/s.
            at: group of parameters, where some were fitted per attribute.
            name: velocity ratio to use, of models that have ``lam_D`` and ``lam_M``.

        Raises:
            KeyError: the model has no such velocity ratio.
        """
        self.fit.model.parameter(name)
        ratio = self.thetas(at, draws=len(self.samples))[:, self.fit.model.parameter_names.index(name)]
        return Derived(f"{name} * Omega", "rad/s", ratio * speed)

    def dynamic_stiffness(
        self, frequency: ArrayLike, speed: float, at: Mapping[str, Any] | None = None
    ) -> StiffnessBand:
        """Direct and quadrature dynamic stiffness at signed frequencies, rad/s, and a rotative speed, rad/s.

        Args:
            frequency: signed perturbation frequencies, rad/s, shape ``(N,)``.
            speed: rotative speed, rad/s.
            at: values of attributes that name one group, ``{"speed_rpm": 1000}``; needed where parameters were fitted
                per attribute.
        """
        w = np.atleast_1d(np.asarray(frequency, dtype=float))
        kappa = self.fit.model.dynamic_stiffness(self.thetas(at)[:, None, :], w, speed)
        return StiffnessBand(
            w,
            Derived("direct dynamic stiffness", "N/m", np.ascontiguousarray(kappa.real)),
            Derived("quadrature dynamic stiffness", "N/m", np.ascontiguousarray(kappa.imag)),
        )

    # ---- presentation and files, imported when asked for -------------------------------------------------------------

    def summary(self) -> str:
        """Table: mean, standard deviation, quantiles, split R-hat, effective samples, acceptance, convergence."""
        from rotorfit.uncertainty.posterior_file import summary

        return summary(self)

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return text_html(str(self))

    def plot_corner(self) -> Figure:
        """Marginal and pairwise densities, the optimum of the fit marked."""
        from rotorfit.plots.responses import plot_corner

        optimum = {name: float(value) for name, value in zip(self.fit.var_names, self.fit.x, strict=True)}
        return plot_corner(self.samples, self.names, optimum)

    def plot_traces(self) -> Figure:
        """Walkers against the step."""
        from rotorfit.plots.responses import plot_traces

        return plot_traces(self.chain, self.names)

    def to_arviz(self) -> Any:
        """For ArviZ: ``arviz.InferenceData`` with ArviZ before 1.0, ``xarray.DataTree`` from there on."""
        from rotorfit.uncertainty.posterior_file import to_arviz

        return to_arviz(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the draws to netCDF in ArviZ's layout; :func:`rotorfit.load_posterior` reads them, ArviZ does too.

        Args:
            path: file to write, whole or not at all.
        """
        from rotorfit.uncertainty.posterior_file import save

        save(self, Path(path))


def sample(
    fit: FitResult,
    *,
    seed: int | None = None,
    walkers: int | None = None,
    ess: float = 4000,
    max_steps: int = 20_000,
    noise: Noise | None = None,
    refine: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool | Callable[[SamplerProgress], None] = False,
    moves: Sequence[tuple[Any, float]] | None = None,
    accelerate: bool | None = None,
) -> Posterior:
    """Sample the posterior of a fit with emcee until enough effective samples are there.

    Known values, bounds, priors, ``per`` and loss are those of the fit; without a prior a parameter's density is flat
    between its bounds.

    Args:
        fit: result of :func:`rotorfit.fit`.
        seed: of the random numbers; by default one is drawn, and kept in the result.
        walkers: even number of walkers, by default 128 (32 where the likelihood is evaluated vector by
            vector) or twice the number of entries.
        ess: effective samples to reach.
        max_steps: steps after which to stop in any case; the result then says that it is not converged.
        noise: level of the noise in each channel: "marginal" (default: unknown and integrated out, so that a channel
            that the model misses widens by itself), "sampled" (the same, its logarithm sampled too) or "fixed" (as
            given with the data, the only one for a robust loss; widened by redchi where the model limits the fit).
        refine: first add the structural blocks that AIC asks for, see :func:`rotorfit.refine`.
        checkpoint: HDF5 file to write at every look at the chain; a run that was stopped continues from it.
        progress: print a line of progress to stderr, or a function that is called with steps, effective samples and
            autocorrelation time.
        moves: emcee moves with weights, by default independence proposals from the normal approximation mixed with
            emcee's DE and stretch moves.
        accelerate: compile the likelihood with numba; by default where it is installed and pays.

    Returns:
        the draws; :attr:`Posterior.converged` and :attr:`Posterior.message` say how the run ended.

    Raises:
        ValueError: a closed-form result or a fit that did not converge, an unknown noise treatment or one that the loss
            rules out, a posterior without limits in some direction, too few walkers, a checkpoint of another run.
    """
    from rotorfit.estimators.ensemble_sampler import sample as run
    from rotorfit.estimators.log_posterior import LogPosterior

    notes = ""
    if refine:
        fit, notes = _refined(fit)
    if fit.method != "least squares" or not fit.success:
        state = "a closed form" if fit.method != "least squares" else f"a fit that did not converge ({fit.message})"
        raise ValueError(f"this is {state}: walkers start from the optimum of rf.fit")
    if np.isfinite(freedom_of(fit.problem.blocks)):
        raise ValueError(
            "few mountings of weights tell the noise of these data, and their readings err together: a likelihood that "
            "takes the noise as known would give intervals that are too narrow. Use params[...].interval(), which is "
            "Student's t, or profile"
        )
    level: Noise = noise or ("marginal" if fit.settings.loss == "linear" else "fixed")
    limited = fit.model_limited
    inflation = fit.widening if limited and level == "fixed" else 1.0
    size = fit.problem.space.size
    work = max(ess, (walkers or WALKERS) * _TYPICAL_STEPS)
    target = LogPosterior(fit.problem, level, inflation=inflation, accelerate=accelerate, work=work)
    count = walkers or max(FEW_WALKERS if target.batch.one_by_one else WALKERS, 2 * target.size)
    centre, covariance = target.laplace(fit.x)
    report = _printer() if progress is True else progress or None
    try:
        chain = run(
            target,
            centre,
            covariance,
            walkers=count,
            ess=ess,
            max_steps=max_steps,
            seed=seed,
            checkpoint=None if checkpoint is None else Path(checkpoint),
            report=report,
            moves=list(moves) if moves else None,
        )
    finally:
        if progress is True:
            print(file=sys.stderr)
    return Posterior(
        fit,
        target.names,
        chain.draws,
        chain.log_density,
        chain.acceptance,
        chain.tau,
        chain.burn_in,
        chain.converged,
        chain.message,
        notes + _treatment(fit, target, centre[:size]) + _better_optimum(target, centre, chain.log_density),
        chain.seed,
        SampleSettings(
            noise=level, inflation=inflation, walkers=count, ess=ess, max_steps=max_steps, steps=chain.steps
        ),
    )


def _refined(fit: FitResult) -> tuple[FitResult, str]:
    from rotorfit.fitting.refine import refine, structure_name

    ladder = refine(fit)
    tried = ", ".join(structure_name(step.model) for step in ladder.steps)
    return ladder.best, f"structure chosen by AIC: {structure_name(ladder.best.model)} (of: {tried}); "


def _treatment(fit: FitResult, target: LogPosterior, centre: Float) -> str:
    """What was done about noise and model-form error."""
    if target.noise == "fixed":
        if fit.settings.levels:
            return "noise of each response at the level of the residuals of the refined fit"
        if fit.settings.loss != "linear":
            return f"noise as given with the data, {fit.settings.loss} loss"
        if target.inflation == 1.0:
            return "noise as given with the data"
        done = f"noise as given with the data, standard deviations widened by {np.sqrt(target.inflation):.3g}"
    else:
        level = np.sqrt((target.batch.sums(centre[None])[0] + 1.0) / target.counts)
        level *= [fit.settings.levels.get(name, 1.0) for name in target.batch.channel_names]
        how = "integrated out" if target.noise == "marginal" else "sampled"
        done = (
            f"noise level of each channel unknown and {how}; at the optimum {level.min():.3g} to {level.max():.3g} "
            "times the noise given with the data"
        )
    if not fit.model_limited:
        return done
    if fit.settings.levels:
        advice = "bring the shaft's matrices (KnownStructure)"
    elif hasattr(fit.model, "blocks"):
        advice = (
            "sample a refined fit instead, rf.refine(fit).best.sample() or fit.sample(refine=True), or "
            "average over structures, rf.sample_models(rf.refine(fit).steps)"
        )
    else:
        advice = "a richer model is needed"
    return (
        f"{done}. redchi is {fit.redchi:.3g}: the model, not the noise, limits the fit. That widens the intervals, but "
        f"parameters may be biased beyond them: {advice}"
    )


def _better_optimum(target: LogPosterior, centre: Float, log_density: Float) -> str:
    """What to say where draws are denser than the optimum that the walkers started from can be."""
    lead = float(log_density.max() - target(centre[None])[0])
    if not lead > _HIGHER:
        return ""
    return (
        f". The log density of the best draw is {lead:.3g} above that of the optimum found from the fit: the fit did "
        "not end in the lowest minimum, fit again with start at the medians of these draws"
    )


def _printer() -> Callable[[SamplerProgress], None]:
    def show(state: SamplerProgress) -> None:
        text = f"{state.steps} steps, {100 * state.done:.0f} %: {state.waiting}"
        print(f"\r{text:<60}", end="", file=sys.stderr, flush=True)

    return show
