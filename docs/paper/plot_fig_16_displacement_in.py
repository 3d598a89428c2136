"""
Figs 16 and 17: displacement in, force out
==========================================

A cam moves the shaft round a circle and load cells measure the force. The dynamic stiffness is then the measured
response itself, force over displacement, without inversion. It has no resonance, only a parabola and a line. For a
linear rotor both kinds of test give the same parameters, as eqs (14) and (15) say.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
structure = {"M": 1.2, "K": 8e3, "Ds": 8.0}
fluid = {"K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
rpm = np.linspace(100, 3000, 30)
rpm = np.r_[-rpm[::-1], rpm]
cam = rf.simulate(
    model, structure | fluid, "displacement", speed_rpm=1500, frequency_rpm=rpm, amplitude_um=50, noise=0.01, seed=1
)
spinner = rf.simulate(model, structure | fluid, speed_rpm=1500, frequency_rpm=rpm, force=5.0, noise=0.01, seed=2)
by_cam = rf.fit(model, cam, known=structure)
by_spinner = rf.fit(model, spinner, known=structure)

# %%
# Fig. 16 shows the forces that hold the orbit, and Fig. 17 the stiffness from both kinds of test.

figure, axes = plt.subplots(2, 2, figsize=(10, 6), sharex=True, layout="constrained")
w = np.linspace(-3000, 3000, 300) / RPM
kappa = by_cam.model.dynamic_stiffness(by_cam.theta(), w, np.full(w.size, 1500 / RPM))[:, 0, 0]
force = 50e-6 * kappa
axes[0, 0].plot(w * RPM, abs(force))
axes[0, 0].set(title="Fig. 16: force at 50 µm 0-pk", ylabel="force amplitude, N 0-pk")
cell = np.where(w < 0, force.conj(), force)  # as a load cell shows it, backward too: fit.plot.bode() draws the same
for side in (w < 0, w > 0):
    axes[1, 0].plot(w[side] * RPM, np.degrees(np.angle(cell[side])), "C0")
axes[1, 0].set(ylabel="phase lead of the force, deg", xlabel="perturbation frequency, rpm")
for row, (part, name) in enumerate(((np.real, "direct"), (np.imag, "quadrature"))):
    axes[row, 1].plot(w * RPM, part(kappa) / 1e3, color="C0", label="from displacement in, fitted")
    measured = rf.dynamic_stiffness(spinner)
    good = measured.sigma[:, 0, 0] < 3e3
    axes[row, 1].plot(
        measured.frequency[good] * RPM, part(measured.kappa[good, 0, 0]) / 1e3, "C1.", label="from force in, measured"
    )
    axes[row, 1].set(ylabel=f"{name} stiffness, kN/m", title=f"Fig. 17: {name} dynamic stiffness")
axes[1, 1].set(xlabel="perturbation frequency, rpm")
axes[0, 1].legend(fontsize=8)

# %%
# What to look at: there is no resonance in the left column, and both tests give the same curve in the right column. The
# parameters agree within their errors:

for name in fluid:
    one, other = by_cam.params[name], by_spinner.params[name]
    print(f"{name:<4} cam {one!s:<22} spinner {other}")
