"""All that is found of a fit's data: what they show themselves, and what the fit gives away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rotorfit.data.findings import Finding, attributed
from rotorfit.data.probes import at_common_zero
from rotorfit.diagnosis.check import check
from rotorfit.diagnosis.dry_runs import other_rig
from rotorfit.diagnosis.probe_pairs import UNEVEN
from rotorfit.diagnosis.trials.explanations import explained
from rotorfit.estimators.inference.smooth_causes import Kind
from rotorfit.estimators.misfit.parameter_space import DATUM
from rotorfit.fitting.fit import fitted
from rotorfit.fitting.result import FitResult
from rotorfit.models.parameters import bare_name


def findings_of(fit: FitResult) -> tuple[Finding, ...]:
    """Findings about the data of a fit, errors first, and of these first the ones that explain its misfit."""
    datum = fit.params[DATUM].value if DATUM in fit.params else 0.0
    experiments = at_common_zero(fit.experiments, datum) if datum else fit.experiments
    sources = [test.source or test.title for test in experiments]
    shown = _with_weight(fit, attributed([check(test) for test in experiments], sources))
    return (*other_rig(fit), *explained(_as_given(fit), {finding.code for finding in shown}), *shown)


def _with_weight(fit: FitResult, shown: Sequence[Finding]) -> list[Finding]:
    """Findings, of which anisotropy is a warning where an isotropic fit does not bear it, and nothing where it does."""
    if fit.model.frame != "z" or not fit.success or len(fit.thetas) > 1:
        return list(shown)
    weighty = any(entry.name.startswith(Kind.PAIR.value) for entry in fit.assumed.entries)
    return [
        replace(finding, severity="warning") if finding.code == UNEVEN else finding
        for finding in shown
        if finding.code != UNEVEN or weighty
    ]


def _as_given(fit: FitResult) -> FitResult:
    """The fit before blocks were chosen for its model: they may follow an error of the data."""
    if fit.model_uncertainty is None:
        return fit
    model, asked = fit.model.variant(blocks=()), fit.settings.asked
    own = {name: prior for name, prior in asked.priors.items() if bare_name(name) in model.parameter_names}
    known = {name: value for name, value in asked.known.items() if name in model.parameter_names}
    return fitted(model, fit.experiments, replace(asked, known=known, priors=own, start={}))
