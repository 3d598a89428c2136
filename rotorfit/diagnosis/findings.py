"""All that is found of a fit's data: what they show themselves, and what the fit gives away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rotorfit.data.findings import Finding, attributed
from rotorfit.data.probes import at_common_zero
from rotorfit.diagnosis.check import check
from rotorfit.diagnosis.probe_pairs import UNEVEN
from rotorfit.diagnosis.trials.explanations import explained
from rotorfit.estimators.inference.smooth_causes import Kind
from rotorfit.estimators.misfit.parameter_space import DATUM
from rotorfit.estimators.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.fitting.fit import fitted
from rotorfit.fitting.result import FitResult
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.parameters import bare_name


def findings_of(fit: FitResult) -> tuple[Finding, ...]:
    """Findings about the data of a fit, errors first, and of these first the ones that explain its misfit."""
    datum = fit.params[DATUM].value if DATUM in fit.params else 0.0
    experiments = at_common_zero(fit.experiments, datum) if datum else fit.experiments
    sources = [test.source or test.title for test in experiments]
    shown = attributed([check(test) for test in experiments], sources)
    if fit.model.frame == "z" and fit.success and len(fit.thetas) == 1:
        # Anisotropy is a warning where an isotropic fit does not bear it, and nothing where it does.
        weighty = any(entry.name.startswith(Kind.PAIR.value) for entry in fit.assumed.entries)
        uneven = [replace(one, severity="warning") if one.code == UNEVEN else one for one in shown]
        shown = [one for one in uneven if one.code != UNEVEN or weighty]
    given = fit
    if fit.model_uncertainty is not None:  # blocks that were chosen for its model may follow an error of the data
        model, asked = fit.model.variant(blocks=()), fit.settings.asked
        own = {name: prior for name, prior in asked.priors.items() if bare_name(name) in model.parameter_names}
        known = {name: value for name, value in asked.known.items() if name in model.parameter_names}
        given = fitted(model, fit.experiments, replace(asked, known=known, priors=own, start={}))
    return (*other_rig(fit), *explained(given, {finding.code for finding in shown}), *shown)


def other_rig(fit: FitResult) -> Iterator[Finding]:
    """The dry run or stator mass of a fit, where more moves in it than in the test with fluid, although a fluid adds
    mass; or where less does, the model has no mass of the fluid to make up for it, and misses the data."""
    baseline = fit.settings.baseline
    # Share of the dry rig's mass that a fluid's negative direct inertia may take at most, or that may be missing
    largest_loss = 0.1
    for block in fit.problem.responses:
        if block.beside is None:
            continue
        dry, _ = _mass(np.abs(block.s), block.beside)
        whole = stiffness_matrices(block)
        added, error = _mass(np.abs(whole.frequency), np.asarray(whole.kappa - block.beside[whole.first_line]))
        least = max(largest_loss * abs(dry), SIGNIFICANT_ERRORS * error)
        if baseline is None:
            given, undo = f"stator_mass_kg is {significant(dry, 3)}", "the mass of this stator in kg"
            question = "Is it that of this stator, in kg?"
        else:
            given, undo = (
                f"{significant(dry, 3)} kg in the dry run {baseline.source}".rstrip(),
                "the dry run of this rig",
            )
            question = "Is the dry run of another rig, or of this one with other parts on its stator?"
        seen = f"In the test with fluid {significant(dry + added, 3)} +- {significant(error, 1)} kg move; {given}"
        if added < -least:
            yield Finding("error", "other-rig", f"{seen}. A fluid adds mass. {question}", undo=undo)
            continue
        _, group, speed = block.condition
        inertia = [fit.model.coefficients(fit.thetas[g], float(v))[2].real for g, v in zip(group, speed, strict=True)]
        missing = added - float(np.mean([np.diag(one).mean() for one in inertia]))  # the mass of the fitted model, kg
        if missing > least and fit.redchi > fit.largest_redchi:
            text = (
                f"{seen}, and the model lacks {significant(missing, 3)} kg. {question} If it is right, leave "
                "the fluid's mass free."
            )
            yield Finding("error", "missing-mass", text, undo=undo)


def _mass(w: Float, kappa: ComplexArray) -> tuple[float, float]:
    """Moving mass by ``Re kappa = K - w^2 M``, mean of the directions, and its standard error."""
    along = np.mean(np.diagonal(kappa, axis1=1, axis2=2).real, axis=1)
    design = np.column_stack([np.ones(w.size), -(w**2)])
    found, left, rank, _ = np.linalg.lstsq(design, along, rcond=None)
    if rank < design.shape[1] or w.size <= design.shape[1]:
        return 0.0, float("inf")
    spread = float(left[0]) / (w.size - design.shape[1])
    return float(found[1]), float(np.sqrt(spread * np.linalg.inv(design.T @ design)[1, 1]))
