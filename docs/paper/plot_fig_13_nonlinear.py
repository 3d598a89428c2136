"""
Figs 13 to 15: larger forces, a nonlinear fluid
===============================================

With a heavier perturbation weight the orbit grows, the film stiffens, and the straight line and the parabola
bend from the whirl resonance on. A circular orbit about the centre has a constant
radius, so that one phasor equation is exact at every line, with the stiffness at that radius. The difference
to the linear rotor is the nonlinear stiffness.
"""

import numpy as np

import rotorfit as rf

model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=80.0)
structure = {"M": 1.2, "K": 3e3, "Ds": 8.0}
fluid = {"K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.0, "b": 0.5}
rpm = np.linspace(400, 1500, 27)
rpm = np.r_[-rpm[::-1], rpm]
weights = [20e-6, 50e-6, 90e-6]  # kg m
test = rf.simulate(model, structure | fluid, speed_rpm=1600, frequency_rpm=rpm, unbalance=weights, noise=0.005, seed=1)

# %%
# Figs 13 and 14: measured stiffness at three weights, with the fit.

fit = rf.fit(model, test, known=structure)
for name, value in fluid.items():
    parameter = fit.params[name]
    print(f"{name:<4} truth {value:6g}   fitted {parameter.value:8.4g} +- {parameter.stderr:.2g} {parameter.unit}")
fit.plot_dynamic_stiffness()

# %%
# Fig. 15: what the nonlinear fluid adds to the linear one.

fit.plot_nonlinear_stiffness()

# %%
# The law behind it, with its band; the ticks at the bottom are the eccentricities that were reached.

fit.plot_law()

# %%
# What to look at: forward, the curves of the three weights part from ``lam Om`` on, where the orbit grows;
# backward, where it stays small, they agree. Stiffness over eccentricity (right) is not one curve, as what
# damping and inertia add depends on the frequency too. A linear fit of the same data would be a
# mean over what happened to be measured; whether the data ask for a law is answered by :func:`rotorfit.compare_laws`
# (:doc:`/experiments`).
