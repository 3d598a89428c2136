"""The obstacle to adding structural blocks to a model, asked before it is advised and before it is tried."""

from __future__ import annotations

from rotorfit.estimators.inference.identifiability import Identifiability
from rotorfit.models import RotorModel


def why_not_refined(model: RotorModel, identifiability: Identifiability) -> str:
    """Why :func:`rotorfit.refine` refuses a fit; empty where it can be tried."""
    if not hasattr(model, "blocks"):
        return f"{model.name} has no structural blocks to add: they couple two or more planes"
    if identifiability.unresolved:
        return f"resolve the parameters of the plain model before adding to it. {identifiability}"
    return ""
