"""
Figs 21 to 24: whirl and whip
=============================

A rotor with a heavy disk at mid-span and a journal in oil has two complex modes. A force at the disk and then at the
journal, with probes at both, gives a matrix of four responses. Each has a whirl resonance near ``lam Om`` and a whip
resonance near the first bending frequency (Fig. 23). Eq. (18) with the identified parameters gives the same matrix
(Fig. 24).
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi

# %%
# Figs 21 and 22: the rig and its model. A disk sits at mid-span and a journal in oil at the end, with probes and
# perturbators at both.

figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
axis.plot([0, 9], [0, 0], "k", lw=3)
parts = (
    (0.6, 0.3, 0.6, "pivoting\nbearing"),
    (4.2, 0.6, 2.0, "disk: Md, Ds\nprobes, perturbator"),
    (7.6, 0.7, 0.8, "journal: Mb\nK0, D, lam, Mf\nprobes, perturbator"),
)
for x, width, height, name in parts:
    axis.add_patch(plt.Rectangle((x, -height / 2), width, height, facecolor="#e8eef7", edgecolor="k"))
    axis.text(x + width / 2, height / 2 + 0.15, name, ha="center", va="bottom", fontsize=9)
axis.text(2.5, -0.35, "shaft, K1", ha="center", fontsize=9)
axis.text(6.2, -0.35, "shaft, K2", ha="center", fontsize=9)
for x in (7.75, 8.15):
    axis.plot([x, x], [-0.4, -1.2], "C1", ls=(0, (2, 1)))
axis.text(7.95, -1.4, "springs, K3", ha="center", va="top", fontsize=9)
axis.set(xlim=(-0.2, 10), ylim=(-1.9, 2.1), title="Figs 21 and 22: rotor with two complex modes")
axis.axis("off")

# %%
# A virtual rig of this kind runs at 1500 rpm. The force acts forward and backward at each plane in turn.

model = rf.models.WhirlWhip()
truth = {
    "Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 15e3, "sigma": 0.95, "Mb": 0.3, "K3": 6e3,
    "K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35,
}  # fmt: skip
rpm = np.linspace(100, 3000, 50)
rpm = np.r_[-rpm[::-1], rpm]
test = rf.simulate(model, truth, speed_rpm=1500, frequency_rpm=rpm, unbalance=20e-6, noise=0.01, seed=1)

# %%
# One figure shows both: points are the experiment, curves the identified model. The supporting spring K3 was measured
# at rest, because any test shows only the sum K0 + K3.

fit = rf.fit(model, test, known={"K3": 6e3})
print(fit.summary())
fit.plot.bode()

# %%
# What to look at: with the force at the disk, both planes show the whip peak, forward and backward alike. With the
# force at the journal, the journal has a broad forward peak, the whirl resonance, and no backward peak. It has a dip
# where the disk absorbs the force.
#
# The roots
# ---------
#
# The eigenvalues over speed explain whirl and whip. The mode called whirl follows ``lam Om`` until it comes near the
# bending frequency. From there on it stays close to that frequency, is called whip, and loses its damping.

fit.plot.stability()

# %%
# The same eigenvalues as a root locus: damping increases to the left, frequency upwards, and colours show the speed.

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
