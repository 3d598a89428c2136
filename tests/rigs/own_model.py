"""A model as a user writes one, in a module that is not rotorfit's."""

from __future__ import annotations

from rotorfit.models import Parameter, RotorModel, fluid_force


class Disk(RotorModel):
    """A user's model: one disk in a fluid with a cubic-free extra spring."""

    name = "my-disk"
    planes = ("disk",)
    parameters = (
        Parameter("M", "kg", "mass"),
        Parameter("K0", "N/m", "fluid stiffness", 1e4),
        Parameter("D", "N s/m", "damping", 100.0),
        Parameter("lam", "1", "velocity ratio", 0.5),
    )

    def equation(self, p, speed, eccentricity):
        fluid = fluid_force(p.K0, p.D, 0.0, p.lam, p.lam, speed)
        return [[fluid.K]], [[fluid.C]], [[p.M + fluid.M]]
