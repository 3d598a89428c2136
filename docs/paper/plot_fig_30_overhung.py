"""
Figs 30 to 32: an overhung rotor and its gyroscopic effect
==========================================================

A disk at the end of a shaft moves and tilts. A rotating disk that tilts exerts a gyroscopic moment, which is
proportional to the speed. It raises the forward natural frequencies and lowers the backward ones. A circular force in
each direction excites them in separate sweeps.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.Overhung()
truth = {"M": 8.0, "It": 0.06, "Ip": 0.11, "k11": 4e5, "k12": -5e4, "k22": 2e4, "d1": 300.0, "d2": 4.0}

# %%
# Fig. 30: the rig, with the deflection z of the disk and its tilt phi. An axial probe at the disk's face measures the
# tilt.

figure, axis = plt.subplots(figsize=(6.5, 2.6), layout="constrained")
axis.add_patch(Rectangle((0.2, -0.25), 0.25, 0.5, fill=False, hatch="///"))
axis.add_patch(Rectangle((2.2, -0.25), 0.25, 0.5, fill=False, hatch="///"))
shaft = np.linspace(0, 4, 100)
line = 0.03 * np.maximum(shaft - 2.3, 0) ** 3 + 0.05 * np.maximum(shaft - 2.3, 0)
axis.plot(shaft, line, "k", lw=2)
tilt = 0.09 * 1.7**2 + 0.05
axis.plot([4 + 0.7 * tilt, 4 - 0.7 * tilt], [line[-1] - 0.7, line[-1] + 0.7], "C0", lw=6)
axis.annotate("", (4.6, line[-1]), (4.6, 0), arrowprops={"arrowstyle": "<->"})
axis.text(4.7, line[-1] / 2, "z", va="center")
axis.plot([0, 5], [0, 0], "k:", lw=0.8)
axis.annotate("axial probe", (3.75, 0.75), (2.6, 0.95), arrowprops={"arrowstyle": "->"})
axis.text(4.05, 1.0, "tilt φ")
axis.set(xlim=(-0.1, 5.2), ylim=(-0.8, 1.3), aspect="equal", title="overhung disk on two bearings")
axis.axis("off")

# %%
# Fig. 31: polar plots of deflection and tilt at several speeds. The force acts at the disk, forward (filled points) and
# backward (open points).

rpm = np.linspace(1200, 7000, 30)
tests = [
    rf.simulate(
        model, truth, speed_rpm=speed, frequency_rpm=np.r_[-rpm[::-1], rpm], force=20.0, noise=0.005, seed=speed
    )
    for speed in (0, 800, 2000, 3200)
]
fit = rf.fit(model, tests, known={"It": 0.06})
for name, value in truth.items():
    parameter = fit.params[name]
    print(f"{name:<4} truth {value:8g}   fitted {parameter}")
fit.plot.polar()

# %%
# Fig. 32: natural frequencies over speed, from the identified parameters; dots mark the tested speeds. The dashed line
# is 1x. The rotor has a critical speed where a forward frequency crosses it.

speeds = np.linspace(0, 4000, 120)
figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
roots = np.array([rf.models.eigenvalues(model, fit.theta(), speed / RPM).imag * RPM for speed in speeds])
for forward, colour in ((True, "C0"), (False, "C1")):
    values = np.sort(np.where((roots > 0) == forward, abs(roots), np.nan), axis=1)
    axis.plot(speeds, values, colour)
    axis.plot([], [], colour, label="forward" if forward else "backward")
for speed in (800, 2000):
    for damped, *_ in fit.natural_frequencies(speed / RPM):
        value = damped.value * RPM
        axis.errorbar(speed, abs(value), damped.stderr * RPM, fmt="C0o" if value > 0 else "C1o", ms=4)
axis.plot(speeds, speeds, "k--", lw=0.8, label="1x")
axis.set(xlabel="rotative speed, rpm", ylabel="natural frequency, rpm", title="gyroscopic splitting")
axis.legend()

# %%
# The figure of the fit shows the damping too. Circles mark the peaks of the measured responses.

fit.plot.stability()

# %%
# What to look at: at rest, forward and backward frequencies are equal in pairs. The speed splits each pair, and the
# second pair more, because that mode tilts more. Deflections alone cannot determine all eight parameters: the paper
# took the disk's transverse inertia It as known, and so did this fit.
