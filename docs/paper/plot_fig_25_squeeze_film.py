"""
Fig. 25: squeeze film
=====================

At standstill only the force rotates: ``lam Om`` is zero, and forward and backward are alike. Over the square of the
frequency the direct stiffness is a straight line, whose slope is the inertia of rotor and fluid together. Inlet
pressure moves the line up and leaves its slope unchanged.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

model = rf.models.OneMode()
structure = {"M": 0.6, "K": 1e3, "Ds": 0.0, "lam": 0.46}
rpm = np.linspace(200, 1600, 30)
figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
for pressure, stiffness in ((1, 5e3), (2, 15e3), (3, 25e3)):
    truth = structure | {"K0": stiffness, "D": 350.0, "Mf": 1.1}
    test = rf.simulate(model, truth, "squeeze-film", frequency_rpm=rpm, force=8.0, noise=0.01, seed=pressure)
    fit = rf.fit(model, test, known=structure)
    measured = rf.dynamic_stiffness(test)
    squares = measured.frequency**2 / 1e3
    axis.errorbar(
        squares, measured.kappa[:, 0, 0].real / 1e3, measured.sigma[:, 0, 0] / 1e3, fmt=f"C{pressure}.", ms=4,
        label=f"{pressure} bar",
    )  # fmt: skip
    line = fit.params["K0"].value + 1e3 - (fit.params["Mf"].value + 0.6) * np.array([0, squares.max()]) * 1e3
    axis.plot([0, squares.max()], line / 1e3, color=f"C{pressure}")
    found = [f"{p.name} {p}" for p in fit.params.values() if p.vary]
    print(f"{pressure} bar: {', '.join(found)}")
axis.axhline(0, color="0.7", lw=0.8)
axis.set(xlabel="square of the perturbation frequency, 1000 rad²/s²", ylabel="direct dynamic stiffness, kN/m")
axis.set_title("squeeze-film test at three inlet pressures")
axis.legend()

# %%
# The figure of the last fit shows both parts.

fit.plot.dynamic_stiffness(against="square")

# %%
# What to look at: the lines are parallel. Their slope is M + Mf, which no test at standstill can separate, so the fit
# was given M. The quadrature stiffness is a line through zero whose slope is D.
