"""What went through pickle is equal to what it was: tests, models, structures, fits and what follows from fits."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from inspect import isclass
from typing import Any

import numpy as np
from own_model import Disk
from plain import plain_fit

import rotorfit as rf

KNOWN = {"K3": 6000.0}
SHAFT = rf.models.KnownStructure(
    np.eye(2), None, None, np.diag([3e4, 2e4]), planes={"a": 0, "b": 1}, fluid="a", dofs=("z",)
)


def copied(thing: Any) -> Any:
    return pickle.loads(pickle.dumps(thing))


def of_a_fit(fit: rf.FitResult) -> Iterator[Any]:
    yield from (fit, fit.params["lam"], fit.modes(), fit.coefficients(speed_rpm=1000), fit.bootstrap(n=3, seed=1))
    yield from (fit.sample(seed=1, walkers=32, ess=20, max_steps=100), fit.budget(), fit.profile("lam"))
    yield from (
        fit.stability_report(),
        fit.threshold_speed(),
        fit.predict(speed_rpm=1000, force_plane="disk"),
        fit.jackknife(),
    )


def test_a_copy_is_equal_and_found_by_its_hash() -> None:
    rig = rf.datasets.rig_lumped()
    fit = plain_fit(rf.models.WhirlWhip(), rig, known=KNOWN)
    seal, volts = rf.datasets.seal_muszynska_tum(), rf.read_recording(rf.datasets.operation())
    for thing in (rig, seal, volts, SHAFT, rf.models.Orthotropic(SHAFT, at="a"), Disk(), *of_a_fit(fit)):
        copy = copied(thing)
        assert copy == thing, thing
        assert hash(copy) == hash(thing)
    assert plain_fit(rf.models.WhirlWhip(), copied(rig), known=KNOWN) == fit


def test_what_differs_is_not_equal() -> None:
    rig, model = rf.datasets.rig_lumped(), rf.models.WhirlWhip()
    fit = plain_fit(model, rig, known=KNOWN)
    assert plain_fit(model, rig, known={"K3": 6001.0}) != fit
    assert rig.select(np.arange(len(rig) - 1)) != rig != replace(rig, source="elsewhere")
    assert replace(rig, response=rig.response * (1 + 1e-15)) != rig
    assert SHAFT.variant(K=np.diag([3e4, 2.1e4])) != SHAFT != SHAFT.variant(fluid="b")
    assert Disk() != Disk()  # its equation may draw on more than its attributes


def test_every_public_record_is_compared_by_value() -> None:
    public = [getattr(rf, name) for name in rf.__all__] + [getattr(rf.models, name) for name in rf.models.__all__]
    records = [one for one in public if isclass(one) and (is_dataclass(one) or issubclass(one, rf.models.RotorModel))]
    assert not [one for one in records if one.__eq__ is object.__eq__]


def test_a_structure_keeps_the_matrices_that_it_was_made_with() -> None:
    """Its options, by which it is told from others, are no more those that their owner goes on to change."""
    K = np.diag([3e4, 2e4])
    first = SHAFT.variant(K=K)
    K[0, 0] *= 2
    assert first == SHAFT != SHAFT.variant(K=K)
