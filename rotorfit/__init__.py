"""rotorfit: rotor and fluid-force parameters from rotating-force perturbation tests, with honest error bars."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotorfit.base.accessors import PROVIDERS
from rotorfit.base.version import __version__

if TYPE_CHECKING:  # `as` tells type checkers that these names are for users
    from rotorfit import datasets as datasets
    from rotorfit import models as models
    from rotorfit.apps.store.store import Store as Store
    from rotorfit.identify.diagnosis.check import check as check
    from rotorfit.identify.diagnosis.check import read as read
    from rotorfit.identify.fitting.causes.calibration import Calibration as Calibration
    from rotorfit.identify.fitting.fit import closed_form as closed_form
    from rotorfit.identify.fitting.fit import fit as fit
    from rotorfit.identify.fitting.fit_file import load_fit as load_fit
    from rotorfit.identify.fitting.quantities import FittedParameter as FittedParameter
    from rotorfit.identify.fitting.quantities import Quantity as Quantity
    from rotorfit.identify.fitting.result import FitResult as FitResult
    from rotorfit.identify.fitting.structure.coefficients import CoefficientRows as CoefficientRows
    from rotorfit.identify.fitting.structure.coefficients import Coefficients as Coefficients
    from rotorfit.identify.fitting.structure.law_ranking import LawComparison as LawComparison
    from rotorfit.identify.fitting.structure.law_ranking import compare_laws as compare_laws
    from rotorfit.identify.fitting.structure.law_ranking import fit_law as fit_law
    from rotorfit.identify.fitting.structure.modes import two_disk_from_modes as two_disk_from_modes
    from rotorfit.identify.fitting.structure.mountings import Mountings as Mountings
    from rotorfit.identify.fitting.structure.mountings import mountings as mountings
    from rotorfit.identify.fitting.structure.refine import Refinement as Refinement
    from rotorfit.identify.fitting.structure.refine import one_lam_test as one_lam_test
    from rotorfit.identify.fitting.structure.refine import refine as refine
    from rotorfit.identify.uncertainty.bootstrap import Bootstrap as Bootstrap
    from rotorfit.identify.uncertainty.budget import Budget as Budget
    from rotorfit.identify.uncertainty.comparison import Comparison as Comparison
    from rotorfit.identify.uncertainty.comparison import compare as compare
    from rotorfit.identify.uncertainty.model_average import ModelAverage as ModelAverage
    from rotorfit.identify.uncertainty.model_average import sample_models as sample_models
    from rotorfit.identify.uncertainty.posterior import Posterior as Posterior
    from rotorfit.identify.uncertainty.posterior_file import load_posterior as load_posterior
    from rotorfit.identify.uncertainty.prediction import Prediction as Prediction
    from rotorfit.identify.uncertainty.profile import Profile as Profile
    from rotorfit.identify.uncertainty.sampling import sample as sample
    from rotorfit.identify.uncertainty.stability.record import Criterion as Criterion
    from rotorfit.identify.uncertainty.stability.record import StabilityReport as StabilityReport
    from rotorfit.lab.data.balancing import Balance as Balance
    from rotorfit.lab.data.balancing import balance as balance
    from rotorfit.lab.data.balancing import run_up as run_up
    from rotorfit.lab.data.experiments import PerturbationTest as PerturbationTest
    from rotorfit.lab.data.findings import DataWarning as DataWarning
    from rotorfit.lab.data.findings import Finding as Finding
    from rotorfit.lab.data.from_arrays import perturbation_test as perturbation_test
    from rotorfit.lab.data.joined import join_runs as join_runs
    from rotorfit.lab.data.ring_down import ring_down_modes as ring_down_modes
    from rotorfit.lab.data.synchronous import difference_synchronous as difference_synchronous
    from rotorfit.lab.data.weights import Influences as Influences
    from rotorfit.lab.data.weights import influence as influence
    from rotorfit.lab.io.files import to_dataframe as to_dataframe
    from rotorfit.lab.io.files import write as write
    from rotorfit.lab.kinds.coefficient_table import CoefficientTable as CoefficientTable
    from rotorfit.lab.kinds.displacement_test import DisplacementTest as DisplacementTest
    from rotorfit.lab.kinds.free_vibration import ImpulseTest as ImpulseTest
    from rotorfit.lab.kinds.free_vibration import RingDownTest as RingDownTest
    from rotorfit.lab.kinds.line_test import LineTest as LineTest
    from rotorfit.lab.kinds.operating_test import OperatingTest as OperatingTest
    from rotorfit.lab.kinds.static_test import StaticTest as StaticTest
    from rotorfit.lab.observing.measured_stiffness import dynamic_stiffness as dynamic_stiffness
    from rotorfit.lab.recordings.recording import Recording as Recording
    from rotorfit.lab.recordings.recording import read_recording as read_recording
    from rotorfit.lab.recordings.reduction.operating_spectra import operating_spectra as operating_spectra
    from rotorfit.lab.recordings.reduction.responses import responses as responses
    from rotorfit.lab.recordings.reduction.ring_downs import ring_downs as ring_downs
    from rotorfit.lab.recordings.reduction.shaft_lines import shaft_lines as shaft_lines
    from rotorfit.lab.recordings.reduction.static_positions import static_positions as static_positions
    from rotorfit.lab.recordings.rig.setup import RigSetup as RigSetup
    from rotorfit.lab.simulation.instruments import Instruments as Instruments
    from rotorfit.lab.simulation.recordings import simulate_recordings as simulate_recordings
    from rotorfit.lab.simulation.simulate import simulate as simulate
    from rotorfit.lab.simulation.turbulence import Turbulence as Turbulence
    from rotorfit.show.report.balance import write_balance_report as write_balance_report
    from rotorfit.show.report.write import write_report as write_report
    from rotorfit.studies.campaigns.campaign import Campaign as Campaign
    from rotorfit.studies.campaigns.campaign import campaign as campaign
    from rotorfit.studies.campaigns.campaign_report import write_campaign_report as write_campaign_report
    from rotorfit.studies.monitoring.observed_stiffness import ObservedStiffness as ObservedStiffness
    from rotorfit.studies.monitoring.observed_stiffness import observed_stiffness as observed_stiffness
    from rotorfit.studies.monitoring.trend import DatedValues as DatedValues
    from rotorfit.studies.monitoring.trend import MachineTrend as MachineTrend
    from rotorfit.studies.monitoring.trend import dated_anisotropy as dated_anisotropy
    from rotorfit.studies.monitoring.trend import trend as trend
    from rotorfit.studies.planning.design import Design as Design
    from rotorfit.studies.planning.plan import plan as plan
    from rotorfit.studies.planning.record import Plan as Plan

_NAMES = {
    "studies.campaigns.campaign": "Campaign campaign",
    "lab.data.balancing": "Balance balance run_up",
    "lab.data.experiments": "PerturbationTest",
    "lab.kinds.coefficient_table": "CoefficientTable",
    "lab.kinds.displacement_test": "DisplacementTest",
    "lab.kinds.free_vibration": "ImpulseTest RingDownTest",
    "lab.kinds.line_test": "LineTest",
    "lab.kinds.operating_test": "OperatingTest",
    "lab.kinds.static_test": "StaticTest",
    "lab.data.from_arrays": "perturbation_test",
    "lab.data.findings": "DataWarning Finding",
    "lab.data.joined": "join_runs",
    "lab.data.ring_down": "ring_down_modes",
    "lab.data.synchronous": "difference_synchronous",
    "lab.data.weights": "Influences influence",
    "identify.diagnosis.check": "check read",
    "identify.fitting.causes.calibration": "Calibration",
    "identify.fitting.fit": "closed_form fit",
    "identify.fitting.fit_file": "load_fit",
    "identify.fitting.quantities": "FittedParameter Quantity",
    "identify.fitting.result": "FitResult",
    "identify.fitting.structure.coefficients": "CoefficientRows Coefficients",
    "identify.fitting.structure.law_ranking": "LawComparison compare_laws fit_law",
    "identify.fitting.structure.modes": "two_disk_from_modes",
    "identify.fitting.structure.mountings": "Mountings mountings",
    "identify.fitting.structure.refine": "Refinement one_lam_test refine",
    "lab.io.files": "to_dataframe write",
    "studies.monitoring.observed_stiffness": "ObservedStiffness observed_stiffness",
    "studies.monitoring.trend": "DatedValues MachineTrend dated_anisotropy trend",
    "lab.observing.measured_stiffness": "dynamic_stiffness",
    "studies.planning.design": "Design",
    "studies.planning.plan": "plan",
    "studies.planning.record": "Plan",
    "lab.recordings.recording": "Recording read_recording",
    "lab.recordings.reduction.operating_spectra": "operating_spectra",
    "lab.recordings.reduction.responses": "responses",
    "lab.recordings.reduction.ring_downs": "ring_downs",
    "lab.recordings.reduction.shaft_lines": "shaft_lines",
    "lab.recordings.reduction.static_positions": "static_positions",
    "lab.recordings.rig.setup": "RigSetup",
    "studies.campaigns.campaign_report": "write_campaign_report",
    "show.report.balance": "write_balance_report",
    "show.report.write": "write_report",
    "lab.simulation.instruments": "Instruments",
    "lab.simulation.recordings": "simulate_recordings",
    "lab.simulation.simulate": "simulate",
    "lab.simulation.turbulence": "Turbulence",
    "apps.store.store": "Store",
    "identify.uncertainty.bootstrap": "Bootstrap",
    "identify.uncertainty.budget": "Budget",
    "identify.uncertainty.comparison": "Comparison compare",
    "identify.uncertainty.model_average": "ModelAverage sample_models",
    "identify.uncertainty.posterior": "Posterior",
    "identify.uncertainty.posterior_file": "load_posterior",
    "identify.uncertainty.prediction": "Prediction",
    "identify.uncertainty.profile": "Profile",
    "identify.uncertainty.sampling": "sample",
    "identify.uncertainty.stability.record": "Criterion StabilityReport",
}
"""Public names by the module that they are written in."""
PROVIDERS.update(
    {
        "Balance.plot": "rotorfit.show.plots.run_up_figure:plot_balance",
        "Campaign.plot": "rotorfit.studies.campaigns.trend_figure:CampaignPlots",
        "Comparison.plot": "rotorfit.show.plots.estimates:plot_comparison",
        "FitResult.plot": "rotorfit.show.plots.fit_plots:FitPlots",
        "KnownStructure.from_ross": "rotorfit.lab.io.shafts.ross_rotor:from_ross",
        "MachineTrend.plot": "rotorfit.studies.monitoring.history_figure:plot_trend",
        "OperatingTest.plot": "rotorfit.show.plots.measured_plots:OperatingPlots",
        "PerturbationTest.plot": "rotorfit.show.plots.measured_plots:MeasuredPlots",
        "Plan.plot": "rotorfit.studies.planning.plan_figure:plot_plan",
        "Posterior.plot": "rotorfit.show.plots.uncertainty:PosteriorPlots",
        "Prediction.plot": "rotorfit.show.plots.estimates:plot_prediction",
        "Profile.plot": "rotorfit.show.plots.estimates:plot_profile",
        "Recording.plot": "rotorfit.show.plots.recording_plots:RecordingPlots",
        "StabilityReport.plot": "rotorfit.show.plots.stability_report:plot_stability_report",
    }
)
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
