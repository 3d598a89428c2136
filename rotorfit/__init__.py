"""rotorfit: rotor and fluid-force parameters from rotating-force perturbation tests, with honest error bars."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from rotorfit import datasets, models
    from rotorfit.campaigns import Campaign, campaign
    from rotorfit.check import Finding, check
    from rotorfit.experiments import DisplacementTest, PerturbationTest, perturbation_test
    from rotorfit.fitting import closed_form, fit
    from rotorfit.readers import read, write
    from rotorfit.refinement import Refinement, one_lam_test, refine
    from rotorfit.report import write_report
    from rotorfit.results import FitResult, FittedParameter, Quantity
    from rotorfit.stiffness import dynamic_stiffness
    from rotorfit.synchronous import difference_synchronous

_HOME = {
    "Finding": "rotorfit.check",
    "check": "rotorfit.check",
    "Campaign": "rotorfit.campaigns",
    "campaign": "rotorfit.campaigns",
    "DisplacementTest": "rotorfit.experiments",
    "PerturbationTest": "rotorfit.experiments",
    "perturbation_test": "rotorfit.experiments",
    "closed_form": "rotorfit.fitting",
    "fit": "rotorfit.fitting",
    "read": "rotorfit.readers",
    "write": "rotorfit.readers",
    "Refinement": "rotorfit.refinement",
    "one_lam_test": "rotorfit.refinement",
    "refine": "rotorfit.refinement",
    "write_report": "rotorfit.report",
    "FitResult": "rotorfit.results",
    "FittedParameter": "rotorfit.results",
    "Quantity": "rotorfit.results",
    "dynamic_stiffness": "rotorfit.stiffness",
    "difference_synchronous": "rotorfit.synchronous",
    "datasets": "",
    "models": "",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for, when it is asked for: ``import rotorfit`` stays light."""
    if name not in _HOME:
        raise AttributeError(f"module 'rotorfit' has no attribute {name!r}")
    value = import_module(f"rotorfit.{name}") if not _HOME[name] else getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_HOME, "__version__"])


__all__ = [*_HOME, "__version__"]  # noqa: PLE0604 - names resolved on demand
