"""
Figs 18 to 20: a seal with antiswirl injection
==============================================

Fluid that is injected against the rotation slows the circumferential flow. It reduces lam, while damping and
stiffness follow the pressure. One sweep of a rotating force at each pressure gives the three parameters with their
errors, and a campaign draws them against the flow (Fig. 19). The lower lam, the higher the threshold of stability.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
structure = {"M": 1.2, "K": 5e3, "Ds": 8.0}
rpm = np.linspace(150, 2500, 20)
rpm = np.r_[-rpm[::-1], rpm]


def seal(pressure, antiswirl):
    """Coefficients of a fictitious seal at a pressure in psi, with the trends of the paper."""
    lam = 0.44 - (0.0035 * pressure if antiswirl else 0.0007 * pressure)
    return {"K0": 2e3 + 110 * pressure, "D": 250 + 2.2 * pressure, "lam": lam, "Mf": 0.35}


# %%
# Fig. 18: dynamic stiffness with radial and with antiswirl ports at three speeds.

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
axes[0, 0].set(ylabel="direct stiffness, kN/m")
axes[1, 0].set(ylabel="quadrature stiffness, kN/m")
axes[0, 0].legend(loc="lower center")

# %%
# Fig. 19: parameters identified from a sweep at each flow, with both inlets in one campaign. The pressure is
# proportional to the square of the flow, and K0 and D follow the pressure. A parabola in the flow shows this, with an
# error for each coefficient.

tests = []
for number, flow in enumerate((3.0, 5.0, 6.5, 8.0, 9.0, 10.5, 12.0)):  # l/min
    for inlet in ("radial", "antiswirl"):
        test = rf.simulate(
            model, structure | seal(0.55 * flow**2, inlet == "antiswirl"), speed_rpm=1000, frequency_rpm=rpm, force=3.0,
            noise=0.03, seed=300 + 2 * number + (inlet == "radial"),
        )  # fmt: skip
        conditions = {"flow_l_min": np.full(len(test), flow), "inlet": np.full(len(test), inlet)}
        tests.append(replace(test, source=f"{inlet}, {flow:g} l/min", attributes=conditions))
found = rf.campaign(model, tests, split=None, known=structure)
print(found.summary(against="flow_l_min", by="inlet", degree=2))
found.plot.trends(against="flow_l_min", by="inlet", degree=2)

# %%
# A straight line does not fit: its scatter, chi-squared per degree of freedom, is far above one.

for trend in found.trends("K0", against="flow_l_min", by="inlet"):
    print(f"{trend.group:<9} straight line: scatter {trend.scatter:.1f}")
for run in found.runs[-2:]:
    print(f"{run.name}: threshold {found.fit(run.name).threshold_speed().to('rpm')}")

# %%
# Fig. 20: both inlets at once. Fluid from the radial inlet dilutes the swirl of the antiswirl ports, so that lam falls
# with the pressure drop over the ports, the less the more comes in radially.


def mixed(radial, drop):
    """Coefficients of the fictitious seal with a radial pressure and a pressure drop over the ports, psi."""
    return seal(radial + drop, False) | {"lam": 0.43 - 0.30 * drop / (60 + drop + radial)}


mixes = []
for radial in (20, 40, 60):
    for drop in (0, 10, 20, 30, 45, 60):
        test = rf.simulate(
            model, structure | mixed(radial, drop), speed_rpm=1000, frequency_rpm=rpm, force=3.0, noise=0.03,
            seed=700 + 7 * radial + drop, exact=True,
        )  # fmt: skip
        conditions = {"drop_psi": np.full(len(test), drop), "radial_psi": np.full(len(test), radial)}
        mixes.append(replace(test, source=f"{radial} psi radial, {drop} psi", attributes=conditions))
mix = rf.campaign(model, mixes, split=None, known=structure)
mix.plot.trends(("lam",), against="drop_psi", by="radial_psi", degree=2)

# %%
# What to look at: in Fig. 18 the antiswirl inlet moves the zero of the quadrature line to the left at equal speed, but
# not its slope. In Fig. 19 stiffness and damping do not depend on the inlet, while lam does. For real campaigns, files
# with a column for the flow are fitted in one call: :doc:`/campaigns`.
