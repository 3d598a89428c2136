"""
Figs 21 to 24: whirl and whip
=============================

A heavy disk at mid-span and a journal in oil: two complex modes. Forced at the disk and then at the journal,
and read at both, the rotor gives a matrix of four responses, each with a whirl resonance near ``lam Om`` and
a whip resonance near the first bending frequency (Fig. 23). Eq. (18) with identified parameters draws the
same matrix (Fig. 24).
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi

# %%
# Figs 21 and 22, the rig and its model: a disk at mid-span, a journal in oil at the end, probes and perturbators
# at both.

figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
axis.plot([0, 9], [0, 0], "k", lw=3)
parts = (
    (0.6, 0.3, 0.6, "pivoting\nbearing"),
    (4.2, 0.6, 2.0, "disk: Md, Ds\nprobes, perturbator"),
    (7.6, 0.7, 0.8, "journal: Mb\nK0, D, lam, Mf\nprobes, perturbator"),
)
for x, width, height, name in parts:
    axis.add_patch(plt.Rectangle((x, -height / 2), width, height, facecolor="#e8eef7", edgecolor="k"))
    axis.text(x + width / 2, height / 2 + 0.15, name, ha="center", va="bottom", fontsize=8)
axis.text(2.5, -0.35, "shaft, K1", ha="center", fontsize=8)
axis.text(6.2, -0.35, "shaft, K2", ha="center", fontsize=8)
for x in (7.75, 8.15):
    axis.plot([x, x], [-0.4, -1.2], "C1", ls=(0, (2, 1)))
axis.text(7.95, -1.4, "springs, K3", ha="center", va="top", fontsize=8)
axis.set(xlim=(-0.2, 10), ylim=(-1.9, 2.1), title="rotor of two complex modes")
axis.axis("off")

# %%
# A virtual rig of that kind, 1500 rpm, forced forward and backward at each plane in turn.

model = rf.models.WhirlWhip()
truth = {
    "Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 15e3, "sigma": 0.95, "Mb": 0.3, "K3": 6e3,
    "K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35,
}  # fmt: skip
rpm = np.linspace(100, 3000, 50)
rpm = np.r_[-rpm[::-1], rpm]
test = rf.simulate(model, truth, speed_rpm=1500, frequency_rpm=rpm, unbalance=20e-6, noise=0.01, seed=1)

# %%
# Both figures in one: points are the experiment, curves the identified model. K3, the supporting spring, was
# measured at rest; K0 + K3 is all that any test sees.

fit = rf.fit(model, test, known={"K3": 6e3})
print(fit.summary())
fit.plot_bode()

# %%
# What to look at: forced at the disk, both planes show the whip peak, forward and backward alike. Forced at the
# journal, the journal has a broad peak forward, the whirl resonance, and none backward; where the disk takes up
# the force it has a dip.
#
# The roots
# ---------
#
# The eigenvalues against speed show whirl and whip from the inside. The mode called whirl follows ``lam Om``
# until that comes near the bending frequency; from there on it keeps close to that frequency, now called whip,
# and loses its damping.

fit.plot_stability()

# %%
# The same as a root locus: damping to the left, frequency up, colour by speed.

speeds = np.linspace(100, 4500, 220) / RPM
figure, axis = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
for speed in speeds:
    roots = rf.models.eigenvalues(model, fit.theta(), speed)
    dots = axis.scatter(roots.real, roots.imag * RPM, c=np.full(roots.size, speed * RPM), s=6, vmin=0, vmax=4500)
axis.axvline(0, color="k", lw=0.8)
axis.set(xlim=(-120, 40), ylim=(-2200, 2600), xlabel="growth rate, 1/s", ylabel="frequency, rpm (negative: backward)")
axis.set_title("root locus of whirl and whip")
figure.colorbar(dots, label="rotative speed, rpm")
onset = fit.threshold_speed()
print(f"threshold {onset.to('rpm')}, whirl ratio there {fit.whirl_ratio():.3f}")
