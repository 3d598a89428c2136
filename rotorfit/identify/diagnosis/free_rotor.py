"""A rotor seen in its own vibration beside any linear rotor of as many modes: the likelihood ratio of the two."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.estimators.minimisation.least_squares import Options, minimise
from rotorfit.estimators.starting.start_points import search_scale
from rotorfit.identify.fitting.problem_setup import build_problem, each_of, group_rows
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.findings import Finding
from rotorfit.models import FreePolynomial

LEAST_PROBABILITY = 1e-3
"""Probability of a likelihood ratio below which the rotor's equations are not those of the machine. Chosen."""


def beside_free_rotor(fit: FitResult) -> Iterator[Finding]:
    """Spectra that any matrices of damping and stiffness at each speed fit better than the rotor does, by more than
    chance."""
    ratio, freedom = likelihood_ratio(fit)
    if freedom <= 0:
        return
    from scipy.stats import chi2  # late: loading it takes longer than most fits

    if chi2.sf(ratio, freedom) < LEAST_PROBABILITY:
        text = (
            f"any damping and stiffness of {', '.join(fit.model.planes)} fit the spectra better than {fit.model.name} "
            f"does (likelihood ratio {significant(ratio, 3)}, {freedom} by chance): its equations, or what is known, "
            "are not quite those of this machine"
        )
        way_out = "compare with the modes of rf.models.FreePolynomial (--model free-polynomial), or free what is known"
        yield Finding("warning", "equations", f"{text}; {way_out}", remedy=way_out, origin="model")


def likelihood_ratio(fit: FitResult) -> tuple[float, int]:
    """Twice the logarithm of the ratio of likelihoods, and its degrees of freedom; none where there is nothing to
    compare: other tests, or a rotor that is no polynomial of its planes' motion of the second degree."""
    model, tests = fit.model, fit.experiments
    alike = model.frame == "z" and model.order == 2 and model.read_planes == model.planes and not model.at_one_speed
    if not (fit.success and alike and all(block.force_spectra for block in fit.problem.blocks)):
        return 0.0, 0
    free = FreePolynomial(model.planes)
    per = each_of(free, {"C*": "speed_rpm", "K*": "speed_rpm"}, {})
    settings = FitSettings(per=per, force_spectrum=fit.settings.force_spectrum, noise=fit.settings.noise, causes=None)
    problem = build_problem(free, tests, settings)
    x = np.zeros(problem.space.size)
    for test, groups, own in zip(tests, group_rows(tests, per)[1], group_rows(tests, fit.settings.per)[1], strict=True):
        for row in np.unique(groups, return_index=True)[1].tolist():
            K, C, M = model.coefficients(fit.thetas[own[row]], test.speed[row])
            entries = problem.space.index[groups[row]]
            x[entries[entries >= 0]] = free.with_matrices(np.linalg.solve(M, C), np.linalg.solve(M, K))[entries >= 0]
    rough = Options(max_iterations=30, method="gauss-newton", hessian="gauss-newton")  # less of the ratio tells less
    low, high = problem.space.lower, problem.space.upper
    found = minimise(problem, x, lower=low, upper=high, scale=search_scale(problem.space, x), options=rough)
    return 2 * (fit.problem.cost(fit.x) - found.cost), problem.space.size - fit.identifiability.rank
