"""The numbers of a study as JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rotorfit.fitting.result import FitResult
from rotorfit.studies.json_text import json_text
from rotorfit.studies.results import closed_value, status
from rotorfit.studies.study import Outcome
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.uncertainty.bootstrap import Bootstrap
    from rotorfit.uncertainty.posterior import Posterior


def outcome_json(outcome: Outcome) -> str:
    """The numbers of a study as one JSON object; what the data do not determine is null."""
    best = outcome.best
    onset = _threshold(best)
    return json_text(
        {
            "model": best.model.name,
            "files": [str(path) for file in outcome.study.files for path in getattr(file, "paths", (file.path,))],
            "out": None if outcome.study.out is None else str(outcome.study.out),
            **{name: getattr(best, name) for name in ("success", "message", "redchi", "aic", "bic")},
            "blocks": list(getattr(best.model, "blocks", ())),
            "parameters": {
                p.name: {
                    "value": p.value if p.resolved else None,
                    "stderr": p.stderr if p.resolved else None,
                    "stderr_noise": p.stderr_noise if p.resolved else None,
                    "systematic": p.systematic,
                    "unit": p.unit,
                    "status": status(p),
                    "closed_form": closed_value(outcome, p.name),
                }
                for p in best.params.values()
            },
            "threshold_rpm": onset,
            "profiles": {
                p.name: {"lower": p.lower, "upper": p.upper, "level": p.level, "message": p.message}
                for p in outcome.profiles
            },
            "bootstrap": _bootstrap_json(outcome.bootstrap),
            "posterior": _posterior_json(outcome.posterior),
            "unresolved": list(best.identifiability.unresolved),
            "findings": [[str(f) for f in found] for found in outcome.findings],
            "warnings": list(best.warnings),
        }
    )


def _bootstrap_json(bootstrap: Bootstrap | None) -> dict[str, Any] | None:
    if bootstrap is None:
        return None
    return {"seed": bootstrap.seed, "failures": bootstrap.failures, "stderr": bootstrap.stderr}


def _posterior_json(posterior: Posterior | None) -> dict[str, Any] | None:
    if posterior is None:
        return None
    return {
        "converged": posterior.converged,
        "message": posterior.message,
        "treatment": posterior.treatment,
        "seed": posterior.seed,
        "interval_95": {name: posterior.interval(name) for name in posterior.names},
    }


def _threshold(fit: FitResult) -> dict[str, float | None] | None:
    if not fit.model.speed_dependent or fit.problem.space.index.shape[0] > 1:
        return None
    onset = fit.threshold_speed()
    if not (math.isfinite(onset.value) and math.isfinite(onset.stderr)):
        return None
    shares = {"value": onset.value, "stderr": onset.stderr, "systematic": onset.systematic}
    return {name: share * RPM_PER_RAD_S for name, share in shares.items()}
