"""Symbolic rotor and fluid models. They know nothing of data, estimators or plots."""

if __name__ != "rotorfit.models":  # a second copy under another name would have classes of its own
    raise ImportError(f"import this package as rotorfit.models, not as {__name__}")

from rotorfit.models.fluid import FluidForce, PlaneFluid, fluid_force, fluids_of
from rotorfit.models.free_polynomial import FreePolynomial
from rotorfit.models.known_structure import KnownStructure
from rotorfit.models.laws import LAWS, Collapse, Constant, EvenPolynomial, Law, LinearInSpeed, MonotoneSpline, Muszynska
from rotorfit.models.lumped import Anisotropic, Chain, OneMode, Overhung, TwoDisk, WhirlWhip
from rotorfit.models.modal import Modal
from rotorfit.models.model import Coordinate, RotorModel
from rotorfit.models.motion.modes import ModePairs, mode_pairs
from rotorfit.models.motion.stability import Threshold, eigenvalues, threshold_speed
from rotorfit.models.motion.whirl import WhirlBranch, whirl_branch
from rotorfit.models.orthotropic import Orthotropic
from rotorfit.models.parameters import Parameter
from rotorfit.models.shafts.anisotropic_shaft import AnisotropicShaft
from rotorfit.models.shafts.chain_match import ChainFromModes, chain_from_modes, chain_modes
from rotorfit.models.shafts.shaft import ROSS_4, ROSS_6
from rotorfit.models.shafts.turning import Turning, TurningFrame, unstable_bands
from rotorfit.models.shafts.turning_on_supports import HarmonicSet, TurningOnSupports, harmonic_set
from rotorfit.models.structure import BLOCKS

MODELS: dict[str, type[RotorModel]] = {
    model.name: model
    for model in (OneMode, WhirlWhip, Anisotropic, TwoDisk, Overhung, Chain, Modal, AnisotropicShaft, FreePolynomial)
}
"""Models by the name the command line uses."""

__all__ = [
    "BLOCKS", "LAWS", "MODELS", "ROSS_4", "ROSS_6", "Anisotropic", "AnisotropicShaft", "Chain", "ChainFromModes",
    "Collapse", "Constant", "Coordinate", "EvenPolynomial", "FluidForce", "FreePolynomial", "HarmonicSet",
    "KnownStructure", "Law", "LinearInSpeed", "Modal", "ModePairs", "MonotoneSpline", "Muszynska", "OneMode",
    "Orthotropic", "Overhung", "Parameter", "PlaneFluid", "RotorModel", "Threshold", "Turning", "TurningFrame",
    "TurningOnSupports", "TwoDisk", "WhirlBranch", "WhirlWhip", "chain_from_modes", "chain_modes", "eigenvalues",
    "fluid_force", "fluids_of", "harmonic_set", "mode_pairs", "threshold_speed", "unstable_bands", "whirl_branch",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
