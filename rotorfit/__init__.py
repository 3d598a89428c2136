"""rotorfit: rotor and fluid-force parameters from rotating-force perturbation tests, with honest error bars."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotorfit.version import __version__

if TYPE_CHECKING:  # `as` tells type checkers that these names are for users
    from rotorfit import datasets as datasets
    from rotorfit import models as models
    from rotorfit.campaigns.campaign import Campaign as Campaign
    from rotorfit.campaigns.campaign import campaign as campaign
    from rotorfit.data.balancing import Balance as Balance
    from rotorfit.data.balancing import balance as balance
    from rotorfit.data.experiments import CoefficientTable as CoefficientTable
    from rotorfit.data.experiments import DisplacementTest as DisplacementTest
    from rotorfit.data.experiments import ImpulseTest as ImpulseTest
    from rotorfit.data.experiments import LineTest as LineTest
    from rotorfit.data.experiments import PerturbationTest as PerturbationTest
    from rotorfit.data.experiments import RingDownTest as RingDownTest
    from rotorfit.data.experiments import StaticTest as StaticTest
    from rotorfit.data.experiments import perturbation_test as perturbation_test
    from rotorfit.data.findings import DataWarning as DataWarning
    from rotorfit.data.findings import Finding as Finding
    from rotorfit.data.joined import join_runs as join_runs
    from rotorfit.data.ring_down import ring_down_modes as ring_down_modes
    from rotorfit.data.synchronous import difference_synchronous as difference_synchronous
    from rotorfit.data.weights import Influences as Influences
    from rotorfit.data.weights import influence as influence
    from rotorfit.diagnosis.check import check as check
    from rotorfit.diagnosis.check import read as read
    from rotorfit.fitting.assumptions.calibration import Calibration as Calibration
    from rotorfit.fitting.fit import closed_form as closed_form
    from rotorfit.fitting.fit import fit as fit
    from rotorfit.fitting.fit_file import load_fit as load_fit
    from rotorfit.fitting.fit_file import save_fit as save_fit
    from rotorfit.fitting.quantities import FittedParameter as FittedParameter
    from rotorfit.fitting.quantities import Quantity as Quantity
    from rotorfit.fitting.result import FitResult as FitResult
    from rotorfit.fitting.structure.coefficients import CoefficientRows as CoefficientRows
    from rotorfit.fitting.structure.coefficients import Coefficients as Coefficients
    from rotorfit.fitting.structure.law_ranking import LawComparison as LawComparison
    from rotorfit.fitting.structure.law_ranking import compare_laws as compare_laws
    from rotorfit.fitting.structure.law_ranking import fit_law as fit_law
    from rotorfit.fitting.structure.modes import two_disk_from_modes as two_disk_from_modes
    from rotorfit.fitting.structure.mountings import Mountings as Mountings
    from rotorfit.fitting.structure.mountings import mountings as mountings
    from rotorfit.fitting.structure.refine import Refinement as Refinement
    from rotorfit.fitting.structure.refine import one_lam_test as one_lam_test
    from rotorfit.fitting.structure.refine import refine as refine
    from rotorfit.io.files import to_dataframe as to_dataframe
    from rotorfit.io.files import write as write
    from rotorfit.monitoring.observed_stiffness import ObservedStiffness as ObservedStiffness
    from rotorfit.monitoring.observed_stiffness import observed_stiffness as observed_stiffness
    from rotorfit.monitoring.trend import DatedValues as DatedValues
    from rotorfit.monitoring.trend import MachineTrend as MachineTrend
    from rotorfit.monitoring.trend import dated_anisotropy as dated_anisotropy
    from rotorfit.monitoring.trend import trend as trend
    from rotorfit.observing.measured_stiffness import dynamic_stiffness as dynamic_stiffness
    from rotorfit.planning.design import Design as Design
    from rotorfit.planning.plan import plan as plan
    from rotorfit.planning.record import Plan as Plan
    from rotorfit.recordings.recording import Recording as Recording
    from rotorfit.recordings.recording import read_recording as read_recording
    from rotorfit.recordings.reduction.responses import responses as responses
    from rotorfit.recordings.reduction.ring_downs import ring_downs as ring_downs
    from rotorfit.recordings.reduction.shaft_lines import shaft_lines as shaft_lines
    from rotorfit.recordings.reduction.static_positions import static_positions as static_positions
    from rotorfit.recordings.rig.setup import RigSetup as RigSetup
    from rotorfit.report.campaign import write_campaign_report as write_campaign_report
    from rotorfit.report.write import write_report as write_report
    from rotorfit.simulation.instruments import Instruments as Instruments
    from rotorfit.simulation.recordings import simulate_recordings as simulate_recordings
    from rotorfit.simulation.simulate import simulate as simulate
    from rotorfit.store.store import Store as Store
    from rotorfit.uncertainty.bootstrap import Bootstrap as Bootstrap
    from rotorfit.uncertainty.budget import Budget as Budget
    from rotorfit.uncertainty.comparison import Comparison as Comparison
    from rotorfit.uncertainty.comparison import compare as compare
    from rotorfit.uncertainty.model_average import ModelAverage as ModelAverage
    from rotorfit.uncertainty.model_average import sample_models as sample_models
    from rotorfit.uncertainty.posterior import Posterior as Posterior
    from rotorfit.uncertainty.posterior_file import load_posterior as load_posterior
    from rotorfit.uncertainty.prediction import Prediction as Prediction
    from rotorfit.uncertainty.profile import Profile as Profile
    from rotorfit.uncertainty.sampling import sample as sample
    from rotorfit.uncertainty.stability.record import Criterion as Criterion
    from rotorfit.uncertainty.stability.record import StabilityReport as StabilityReport

_NAMES = {
    "campaigns.campaign": "Campaign campaign",
    "data.balancing": "Balance balance",
    "data.experiments": "CoefficientTable DisplacementTest ImpulseTest LineTest PerturbationTest RingDownTest "
    "StaticTest perturbation_test",
    "data.findings": "DataWarning Finding",
    "data.joined": "join_runs",
    "data.ring_down": "ring_down_modes",
    "data.synchronous": "difference_synchronous",
    "data.weights": "Influences influence",
    "diagnosis.check": "check read",
    "fitting.assumptions.calibration": "Calibration",
    "fitting.fit": "closed_form fit",
    "fitting.fit_file": "load_fit save_fit",
    "fitting.quantities": "FittedParameter Quantity",
    "fitting.result": "FitResult",
    "fitting.structure.coefficients": "CoefficientRows Coefficients",
    "fitting.structure.law_ranking": "LawComparison compare_laws fit_law",
    "fitting.structure.modes": "two_disk_from_modes",
    "fitting.structure.mountings": "Mountings mountings",
    "fitting.structure.refine": "Refinement one_lam_test refine",
    "io.files": "to_dataframe write",
    "monitoring.observed_stiffness": "ObservedStiffness observed_stiffness",
    "monitoring.trend": "DatedValues MachineTrend dated_anisotropy trend",
    "observing.measured_stiffness": "dynamic_stiffness",
    "planning.design": "Design",
    "planning.plan": "plan",
    "planning.record": "Plan",
    "recordings.recording": "Recording read_recording",
    "recordings.reduction.responses": "responses",
    "recordings.reduction.ring_downs": "ring_downs",
    "recordings.reduction.shaft_lines": "shaft_lines",
    "recordings.reduction.static_positions": "static_positions",
    "recordings.rig.setup": "RigSetup",
    "report.campaign": "write_campaign_report",
    "report.write": "write_report",
    "simulation.instruments": "Instruments",
    "simulation.recordings": "simulate_recordings",
    "simulation.simulate": "simulate",
    "store.store": "Store",
    "uncertainty.bootstrap": "Bootstrap",
    "uncertainty.budget": "Budget",
    "uncertainty.comparison": "Comparison compare",
    "uncertainty.model_average": "ModelAverage sample_models",
    "uncertainty.posterior": "Posterior",
    "uncertainty.posterior_file": "load_posterior",
    "uncertainty.prediction": "Prediction",
    "uncertainty.profile": "Profile",
    "uncertainty.sampling": "sample",
    "uncertainty.stability.record": "Criterion StabilityReport",
}
"""Public names by the module that they are written in."""
_HOME = {name: f"rotorfit.{home}" for home, names in _NAMES.items() for name in names.split()}
_HOME |= {"datasets": "", "models": ""}


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
