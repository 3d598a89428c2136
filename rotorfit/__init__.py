"""rotorfit: rotor and fluid-force parameters from rotating-force perturbation tests, with honest error bars."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:  # `as` tells type checkers that these names are for users
    from rotorfit import datasets as datasets
    from rotorfit import models as models
    from rotorfit.averaging import ModelAverage as ModelAverage
    from rotorfit.averaging import sample_models as sample_models
    from rotorfit.bootstrapping import Bootstrap as Bootstrap
    from rotorfit.budget import Budget as Budget
    from rotorfit.calibration import Calibration as Calibration
    from rotorfit.campaigns import Campaign as Campaign
    from rotorfit.campaigns import campaign as campaign
    from rotorfit.data_check import Finding as Finding
    from rotorfit.data_check import check as check
    from rotorfit.experiments import CoefficientTable as CoefficientTable
    from rotorfit.experiments import DisplacementTest as DisplacementTest
    from rotorfit.experiments import ImpulseTest as ImpulseTest
    from rotorfit.experiments import PerturbationTest as PerturbationTest
    from rotorfit.experiments import RingDownTest as RingDownTest
    from rotorfit.experiments import StaticTest as StaticTest
    from rotorfit.experiments import perturbation_test as perturbation_test
    from rotorfit.fitting import closed_form as closed_form
    from rotorfit.fitting import fit as fit
    from rotorfit.law_comparison import LawComparison as LawComparison
    from rotorfit.law_comparison import compare_laws as compare_laws
    from rotorfit.law_fitting import fit_law as fit_law
    from rotorfit.posterior import Posterior as Posterior
    from rotorfit.posterior import sample as sample
    from rotorfit.posterior_io import load_posterior as load_posterior
    from rotorfit.profiles import Profile as Profile
    from rotorfit.readers import read as read
    from rotorfit.readers import write as write
    from rotorfit.recordings.recording import Recording as Recording
    from rotorfit.recordings.recording import read_recording as read_recording
    from rotorfit.recordings.setup import RigSetup as RigSetup
    from rotorfit.refinement import Refinement as Refinement
    from rotorfit.refinement import one_lam_test as one_lam_test
    from rotorfit.refinement import refine as refine
    from rotorfit.report import write_report as write_report
    from rotorfit.results import FitResult as FitResult
    from rotorfit.results import FittedParameter as FittedParameter
    from rotorfit.results import Quantity as Quantity
    from rotorfit.ring_down import ring_down_modes as ring_down_modes
    from rotorfit.serialise import load_fit as load_fit
    from rotorfit.serialise import save_fit as save_fit
    from rotorfit.simulation import simulate as simulate
    from rotorfit.stiffness import dynamic_stiffness as dynamic_stiffness
    from rotorfit.synchronous import difference_synchronous as difference_synchronous

_HOME = {
    "Finding": "rotorfit.data_check",
    "check": "rotorfit.data_check",
    "Campaign": "rotorfit.campaigns",
    "campaign": "rotorfit.campaigns",
    "CoefficientTable": "rotorfit.experiments",
    "ImpulseTest": "rotorfit.experiments",
    "RingDownTest": "rotorfit.experiments",
    "StaticTest": "rotorfit.experiments",
    "DisplacementTest": "rotorfit.experiments",
    "PerturbationTest": "rotorfit.experiments",
    "perturbation_test": "rotorfit.experiments",
    "fit_law": "rotorfit.law_fitting",
    "closed_form": "rotorfit.fitting",
    "fit": "rotorfit.fitting",
    "ModelAverage": "rotorfit.averaging",
    "sample_models": "rotorfit.averaging",
    "Posterior": "rotorfit.posterior",
    "sample": "rotorfit.posterior",
    "load_posterior": "rotorfit.posterior_io",
    "read": "rotorfit.readers",
    "write": "rotorfit.readers",
    "Recording": "rotorfit.recordings.recording",
    "read_recording": "rotorfit.recordings.recording",
    "RigSetup": "rotorfit.recordings.setup",
    "Refinement": "rotorfit.refinement",
    "one_lam_test": "rotorfit.refinement",
    "refine": "rotorfit.refinement",
    "write_report": "rotorfit.report",
    "FitResult": "rotorfit.results",
    "FittedParameter": "rotorfit.results",
    "Quantity": "rotorfit.results",
    "ring_down_modes": "rotorfit.ring_down",
    "Bootstrap": "rotorfit.bootstrapping",
    "Budget": "rotorfit.budget",
    "Calibration": "rotorfit.calibration",
    "Profile": "rotorfit.profiles",
    "load_fit": "rotorfit.serialise",
    "save_fit": "rotorfit.serialise",
    "dynamic_stiffness": "rotorfit.stiffness",
    "difference_synchronous": "rotorfit.synchronous",
    "LawComparison": "rotorfit.law_comparison",
    "compare_laws": "rotorfit.law_comparison",
    "simulate": "rotorfit.simulation",
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
