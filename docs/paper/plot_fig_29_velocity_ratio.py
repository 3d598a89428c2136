"""
Fig. 29: frequency over speed after a tap
=========================================

After a tap the journal rings down. The paper takes its frequency, divided by the rotative speed, as lam. This ratio
falls slightly with eccentricity and then collapses, earlier at high speed. As a measure of lam it can mislead: the
ring-down is an eigenvalue of the whole rotor, and the ratio is near lam only while the whirl mode is lightly damped.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi

# %%
# Fig. 29 (a): spectra of a recording after one blow at the disk, with 1x and the modes. The whirl, near lam times the
# speed, is forward only. The whip, the bending mode, is in the disk's motion, and a blow along one axis excites it
# backward too.

rotor = rf.models.WhirlWhip()
thick_oil = {
    "Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 6e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 5e3, "D": 1500.0,
    "lam": 0.475, "Mf": 0.35,
}  # fmt: skip
folder = Path(tempfile.mkdtemp())
(blow,) = rf.simulate_recordings(
    rotor, thick_oil, folder, "impulse", speed_rpm=2100, impulse=0.3, blows=1, plane="disk"
)
roots = rf.models.eigenvalues(rotor, rotor.vector(thick_oil), 2100 / RPM)
whirl, whip = sorted(roots[roots.imag > 50].imag)
record = rf.read_recording(blow)
record.plot.full_spectrum(marks={"whirl": whirl, "whip": whip, "whip, backward": -whip}, limit_hz=50)

# %%
# Figs 29 (b) and (c): journals that rest at several eccentricities are tapped, at two speeds.

law = rf.models.Muszynska()
model = rf.models.OneMode(law=law, clearance_um=200.0)
structure = {"M": 1.2, "K": 2e3, "Ds": 8.0}
fluid = {"K0": 4e3, "D": 600.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.0, "b": 0.6}
tests = [
    rf.simulate(
        model, structure | fluid, "impulse", speed_rpm=speed, load=[0.3, 1.0, 2.0], impulse=1e-5, noise=0.03, seed=speed
    )
    for speed in (800, 1200)
]
fit = rf.fit(model, tests, known=structure | {"Mf": 0.4})
for name, value in fluid.items():
    parameter = fit.params[name]
    print(f"{name:<4} truth {value:6g}   fitted {parameter}")

# %%
# What Figs 29 (b) and (c) show, as numbers: the ratio of each tap, and the lam of the law at the same eccentricity.

print("rpm   eccentricity   frequency over speed   lam of the law")
for block in fit.problem.blocks:
    rest = block.measured_eccentricity(fit.thetas)
    for rpm, eps, ratio in zip(block.speed * RPM, rest, block.measured.imag / block.speed, strict=True):
        print(f"{rpm:4.0f}{eps:14.2f}{abs(ratio):23.3f}{fluid['lam'] * (1 - eps) ** fluid['b']:17.3f}")

# %%
# The points are frequencies of the ring-downs over the speed, and the curves are those of the fitted rotor. The law
# itself is smooth: over these eccentricities its lam (dashed) falls steadily.

fit.plot.velocity_ratio()

# %%
# The collapse, explained
# -----------------------
#
# These figures show the same eigenvalue of a centred journal. Only D changes, and lam stays 0.46. If D is large, the
# damped frequency over the speed equals lam. If ``D lam Om`` is no larger than the stiffness, the mode is heavily
# damped, and the ratio departs from lam although lam has not changed.

linear = rf.models.OneMode()
damping = np.geomspace(20, 2000, 200)
speed = 600 / RPM
figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
ratios, ratings = [], []
for D in damping:
    theta = linear.vector(structure | {"K0": 9000.0, "D": D, "lam": 0.46, "Mf": 0.4})
    roots = rf.models.eigenvalues(linear, theta, speed)
    whirl = max(roots, key=lambda s: s.real)
    ratios.append(whirl.imag / speed)
    ratings.append(-whirl.real / abs(whirl))
axes[0].semilogx(damping, ratios)
axes[0].axhline(0.46, color="0.6", ls=":", label="lam")
axes[0].set(xlabel="D, N s/m", ylabel="damped frequency over speed", title="frequency after a tap, lam = 0.46")
axes[0].legend()
axes[1].semilogx(damping, ratings)
axes[1].set(xlabel="D, N s/m", ylabel="damping ratio", title="damping of that mode")
for axis in axes:
    axis.set(xticks=(20, 100, 500, 2000), xticklabels=("20", "100", "500", "2000"))

# %%
# What to look at: at small eccentricity the points lie on lam. At larger eccentricity, where the film is stiff, the
# fitted eigenvalue differs from lam. The ratio is not lam if the damping ratio is large, nor if the ratio lies far
# above lam, because then the mode is a mechanical one. Fitted as eigenvalues, the same ring-downs give lam within its
# error (the table above).

# %%
# Where lam itself collapses
# --------------------------
#
# Static loads give lam without a ring-down (Figs 26 to 28). In the law ``Collapse`` lam falls slightly and then
# collapses, at an eccentricity that is smaller at high speed. Here it is fitted to loads on a rig whose lam collapses
# by another formula. A power law cannot follow this collapse.

import casadi as ca  # noqa: E402

from rotorfit.models.laws import Fluid, Law  # noqa: E402


class Axial(Law):
    """Flow that becomes axial at an eccentricity which decreases with speed."""

    name = "axial"
    parameters = ()

    def at(self, p, eccentricity):
        """Return the fluid at the reference speed."""
        return self.at_speed(p, eccentricity, 100.0)

    def at_speed(self, p, eccentricity, speed):
        """Return K0, D and the factor of lam."""
        wide, edge = 1 - eccentricity**2, 0.85 - 0.0012 * (speed - 60.0)
        ratio = (1 - 0.12 * eccentricity) * (1 - ca.tanh((eccentricity - edge) / 0.08)) / 2
        return Fluid(p.K0 * wide**-1.3, p.D * wide**-1.0, ratio)


rig = rf.models.OneMode(law=Axial(), clearance_um=200.0)
truth = structure | {"K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
loads = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 7.0]
static = rf.simulate(rig, truth, "static-load", speed_rpm=[600, 1200, 1800], load=loads, load_deg=-90, noise=0.005)
laws = {law.name: law for law in (rf.models.Muszynska(), rf.models.Collapse())}
fits = {
    name: rf.fit(rf.models.OneMode(law=law, clearance_um=200.0), static, known=structure | {"Mf": 0.4})
    for name, law in laws.items()
}
for name, one in fits.items():
    print(f"{name:<10} redchi {one.redchi:7.4g} with {one.nvarys} parameters")

# %%
# A law that changes with speed has a curve for each speed.

fits["collapse"].plot.law()
