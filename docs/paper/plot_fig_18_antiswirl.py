"""
Figs 18 to 20: a seal with antiswirl injection
==============================================

Fluid injected against the rotation slows the circumferential flow: lam falls, while damping and stiffness
follow the pressure. One sweep of a rotating force at each pressure gives the three parameters with their
errors, and a campaign draws them against the pressure (Fig. 19). The lower lam, the higher the threshold of
stability.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
structure = {"M": 1.2, "K": 5e3, "Ds": 8.0}
rpm = np.linspace(150, 2500, 20)
rpm = np.r_[-rpm[::-1], rpm]


def seal(pressure, antiswirl):
    """What this imagined seal does at a pressure in psi: the numbers are made up, the trends are the paper's."""
    lam = 0.44 - (0.0035 * pressure if antiswirl else 0.0007 * pressure)
    return {"K0": 2e3 + 110 * pressure, "D": 250 + 2.2 * pressure, "lam": lam, "Mf": 0.35}


# %%
# Fig. 18: dynamic stiffness with radial and with antiswirl ports, at three speeds.

figure, axes = plt.subplots(2, 2, figsize=(10, 6), sharex=True, sharey="row", layout="constrained")
for column, (antiswirl, title) in enumerate(((False, "radial inlet"), (True, "antiswirl inlet"))):
    theta = model.vector(structure | seal(60, antiswirl))
    for speed_rpm in (500, 1000, 1500):
        w = np.linspace(-1200, 1200, 200) / RPM
        kappa = model.dynamic_stiffness(theta, w, np.full(w.size, speed_rpm / RPM))[:, 0, 0]
        axes[0, column].plot(w * RPM, kappa.real / 1e3, label=f"{speed_rpm} rpm")
        axes[1, column].plot(w * RPM, kappa.imag / 1e3)
    axes[0, column].set(title=title)
    axes[1, column].axhline(0, color="0.7", lw=0.8)
    axes[1, column].set(xlabel="perturbation frequency, rpm")
axes[0, 0].set(ylabel="direct, kN/m")
axes[1, 0].set(ylabel="quadrature, kN/m")
axes[0, 0].legend()

# %%
# Figs 19 and 20: identified from a sweep at each pressure, with 95 % intervals (noise alone).

figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
pressures = (5, 20, 40, 60, 80)
for colour, antiswirl in enumerate((False, True)):
    fits = []
    for pressure in pressures:
        test = rf.simulate(
            model, structure | seal(pressure, antiswirl), speed_rpm=1000, frequency_rpm=rpm, force=3.0, noise=0.03,
            seed=300 + pressure + antiswirl,
        )  # fmt: skip
        fits.append(rf.fit(model, test, known=structure))
    for axis, name in zip(axes, ("K0", "lam", "D"), strict=True):
        values = [fit.params[name].value for fit in fits]
        errors = [1.96 * fit.params[name].stderr for fit in fits]
        axis.errorbar(pressures, values, errors, fmt="o-", color=f"C{colour}", label=("radial", "antiswirl")[antiswirl])
        axis.set(xlabel="pressure, psi", title=f"{name}, {fits[0].params[name].unit}".removesuffix(", 1"))
    onsets = [fit.threshold_speed().value * RPM for fit in fits]
    print(("radial   ", "antiswirl")[antiswirl], "threshold, rpm:", ", ".join(f"{onset:.0f}" for onset in onsets))
axes[0].legend()

# %%
# What to look at: in Fig. 18 the zero of the quadrature line moves left at equal speed, its slope stays. In
# Fig. 19 the stiffness and damping do not know where the fluid comes from; lam does. Real campaigns are files
# with a column for the pressure, and one call: :doc:`/campaigns`.
