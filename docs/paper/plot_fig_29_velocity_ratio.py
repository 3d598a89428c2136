"""
Fig. 29: frequency over speed after a tap
=========================================

Tapped, the journal rings at a frequency that, divided by the rotative speed, the paper reads as lam. The
ratio falls a little with eccentricity and then collapses, earlier at high speed. Read as lam it misleads: the
ring-down is an eigenvalue of the whole rotor, and near to lam only while the whirl mode is lightly damped.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
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
    print(f"{name:<4} truth {value:6g}   fitted {parameter.value:8.4g} +- {parameter.stderr:.2g} {parameter.unit}")

# %%
# Points: frequencies of the ring-downs over the speed. Curves: the same of the fitted rotor. The law itself is
# smooth.

fit.plot_velocity_ratio()

# %%
# The collapse, explained
# -----------------------
#
# The same eigenvalue, centred, while D changes and nothing else: lam stays 0.46. Where D is large the damped
# frequency over the speed is lam; where ``D lam Om`` is no larger than the stiffness, the mode is damped most, and
# the ratio leaves lam though lam has not moved.

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
axes[0].set(xlabel="D, N s/m", ylabel="damped frequency over speed", title="what a tap shows of lam = 0.46")
axes[0].legend()
axes[1].semilogx(damping, ratings)
axes[1].set(xlabel="D, N s/m", ylabel="damping ratio of that mode", title="its damping")

# %%
# What to look at: at small eccentricity the points lie on lam; further out, where the film is stiff, the fitted
# eigenvalue and lam part. A ratio is not lam where the damping ratio is large, nor where it lies far above: that is a
# mechanical mode. Fitted as eigenvalues the same ring-downs give lam within its error (the table above).
