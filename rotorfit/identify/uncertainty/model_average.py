"""Posteriors averaged over model structures: what is known of shared quantities while the structure is in doubt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray
from rotorfit.base.digits import significant, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table
from rotorfit.base.units import in_rad_s
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import SamplerKeywords, check_keywords
from rotorfit.identify.uncertainty.derived import Derived, Draws, StiffnessBand
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.identify.uncertainty.sampling import sample

NEGLIGIBLE_WEIGHT = 0.002
"""Weight below which a model is not sampled: its draws could not move a 99 % interval."""


@dataclass(frozen=True, eq=False, repr=False)
class ModelAverage(ByValue, Draws):
    """Posteriors of several models of the same data, weighted by ``exp(-BIC / 2)``.

    BIC approximates the probability of a model given the data (Schwarz 1978), all models being as likely beforehand.

    Attributes:
        posteriors: of the models that count, the most probable first.
        weights: their probabilities.
    """

    posteriors: tuple[Posterior, ...]
    weights: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that all models share."""
        first, *others = self.posteriors
        return tuple(name for name in first.names if all(name in other.names for other in others))

    @property
    def converged(self) -> bool:
        """True if the chains of all models have converged."""
        return all(posterior.converged for posterior in self.posteriors)

    def parameter(self, name: str) -> Derived:
        """One parameter over all models.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.

        Raises:
            KeyError: the models do not share this parameter.
        """
        if name not in self.names:
            raise KeyError(unknown_name("parameter that all models share", name, self.names))
        return self._mixed(lambda posterior: posterior.parameter(name))

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Derived:
        """See :meth:`Posterior.threshold_speed`.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        return self._mixed(lambda posterior: posterior.threshold_speed(at))

    def whirl_ratio(self, at: Mapping[str, Any] | None = None) -> Derived:
        """See :meth:`Posterior.whirl_ratio`.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        return self._mixed(lambda posterior: posterior.whirl_ratio(at))

    def lam_speed(
        self,
        speed: float | None = None,
        at: Mapping[str, Any] | None = None,
        *,
        speed_rpm: float | None = None,
        name: str = "lam",
    ) -> Derived:
        """See :meth:`Posterior.lam_speed`.

        Args:
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            speed_rpm: the speed in rpm.
            name: velocity ratio to use, of models that have ``lam_D`` and ``lam_M``.
        """
        turning = in_rad_s("speed", speed, rpm=speed_rpm)
        return self._mixed(lambda posterior: posterior.lam_speed(turning, at, name=name))

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
        """See :meth:`Posterior.dynamic_stiffness`.

        Args:
            frequency: signed perturbation frequencies, rad/s, shape ``(N,)``.
            speed: rotative speed, rad/s.
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
            frequency_rpm, frequency_hz, speed_rpm: the same in other units.
        """
        w = in_rad_s("frequency", frequency, rpm=frequency_rpm, hz=frequency_hz)
        turning = in_rad_s("speed", speed, rpm=speed_rpm)
        bands = {id(p): p.dynamic_stiffness(w, turning, at) for p in self.posteriors}
        return StiffnessBand(
            frequency=next(iter(bands.values())).frequency,
            direct=self._mixed(lambda posterior: bands[id(posterior)].direct),
            quadrature=self._mixed(lambda posterior: bands[id(posterior)].quadrature),
        )

    def _mixed(self, quantity: Callable[[Posterior], Derived]) -> Derived:
        """Evenly spaced draws of each model in proportion to its weight."""
        parts = [quantity(posterior) for posterior in self.posteriors]
        count = min(len(part.samples) / weight for part, weight in zip(parts, self.weights, strict=True))
        chosen = []
        for part, weight in zip(parts, self.weights, strict=True):
            size = len(part.samples)
            wanted = min(size, max(1, round(count * weight)))
            chosen.append(part.samples[np.linspace(0, size - 1, wanted).astype(np.intp)])
        notes = dict.fromkeys(part.note for part in parts if part.note)
        return Derived(name=parts[0].name, unit=parts[0].unit, samples=np.concatenate(chosen), note="; ".join(notes))

    def parts(self) -> list[str | Table]:
        """What is printed: the models with their weights and of the parameters that they share."""
        from rotorfit.identify.fitting.structure.refine import structure_name

        models = [["model", "BIC", "weight", ""]]
        for posterior, weight in zip(self.posteriors, self.weights, strict=True):
            name = f"{posterior.fit.model.name}, {structure_name(posterior.fit.model)}"
            verdict = "" if posterior.converged else f"NOT CONVERGED: {posterior.message.partition(': ')[2]}"
            models.append([name, f"{posterior.fit.bic:.1f}", f"{weight:.3f}", verdict])
        rows = [["parameter", "median", "sd", "2.5 %", "97.5 %", "unit"]]
        for name in self.names:
            d = self.parameter(name)
            low, high = d.interval(0.95)
            middle, *ends = (with_error(float(v), d.stderr)[0] for v in (d.value, low, high))
            rows.append([name, middle, significant(d.stderr, 2), *ends, d.unit])
        return [Table(models, "<58 >12 >9 <1"), "", Table(rows, "<22 >13 >10 >13 >13 <1")]


def sample_models(fits: Sequence[FitResult], **options: Unpack[SamplerKeywords]) -> ModelAverage:
    """Sample several models of the same data and average over them by BIC.

    Args:
        fits: results for the same readings, for instance ``rf.refine(fit).steps``.
        options: ``seed``, ``walkers``, ``ess``, ``max_steps``, ``noise``, ``progress``, ``moves``, ``accelerate``: see
            :func:`rotorfit.sample`.

    Raises:
        ValueError: no fits, fits of different data, or an option that does not go with several models.
        TypeError: a keyword that is none of these.

    Example:
        >>> rotor, bench = rf.models.OneMode(), {"M": 2.0, "K": 1e5, "Ds": 50.0}
        >>> truth = {**bench, "K0": 2e4, "D": 800.0, "lam": 0.45, "Mf": 1.0}
        >>> rpm = [-4000, -3000, -2000, -1000, 1000, 2000, 3000, 4000]
        >>> test = rf.simulate(rotor, truth, speed_rpm=[1500, 3000], frequency_rpm=rpm, force=1.0, noise=0.01, seed=1)
        >>> fits = [rf.fit(model, test, known=bench) for model in (rotor, rf.models.OneMode(two_lam=True))]
        >>> average = rf.sample_models(fits, seed=1, walkers=32, ess=100)
        >>> average.posteriors[0].fit.model is rotor
        True
    """
    given: Mapping[str, object] = options
    check_keywords("sample_models", given.keys() - {"checkpoint", "refine"}, SamplerKeywords)
    for name in ("checkpoint", "refine"):
        if given.get(name):
            raise ValueError(f"{name} does not go with several models: sample them one by one")
    if not fits:
        raise ValueError("no fits to average over")
    measured = [_readings(fit) for fit in fits]
    if any(
        each.shape != measured[0].shape or not np.allclose(each, measured[0], rtol=1e-9, atol=0) for each in measured
    ):
        raise ValueError("the fits are of different data: only models of the same readings can be averaged over")
    losses = sorted({fit.settings.loss for fit in fits})
    if len(losses) > 1:
        raise ValueError(f"the fits have losses of their own ({', '.join(losses)}), so that no BIC compares them")
    bic = np.array([fit.bic for fit in fits])
    weight = np.exp(-(bic - bic.min()) / 2)
    weight /= weight.sum()
    counted = [i for i in np.argsort(bic) if weight[i] >= NEGLIGIBLE_WEIGHT]
    posteriors = tuple(sample(fits[i], **options) for i in counted)
    total = float(weight[counted].sum())
    return ModelAverage(posteriors, tuple(float(weight[i]) / total for i in counted))


def _readings(fit: FitResult) -> ComplexArray:
    """The readings with what causes were found to add to them."""
    solved = fit.settings.solved
    return fit.problem.measured if solved is None else fit.problem.measured + np.concatenate(solved.shift)
