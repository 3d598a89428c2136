"""
Figs 11 and 12: oil pressure, oil temperature
=============================================

Pressure stiffens the film: K0 grows, and with it the direct stiffness and the threshold. Temperature thins the oil: D
falls and the quadrature line becomes flatter, but neither its zero nor the threshold moves much. One campaign of
sweeps shows which parameter follows which condition.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
structure = {"M": 1.2, "K": 4e3, "Ds": 8.0}
fluid = {"K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
rpm = np.linspace(150, 2500, 24)
rpm = np.r_[-rpm[::-1], rpm]


def sweep(seed, **changed):
    """A test at 1500 rpm, and its fit."""
    test = rf.simulate(
        model, structure | fluid | changed, speed_rpm=1500, frequency_rpm=rpm, unbalance=60e-6, noise=0.01, seed=seed
    )
    return rf.dynamic_stiffness(test), rf.fit(model, test, known=structure)


def draw(axes, runs, unit):
    """Points and fitted curves of direct and quadrature stiffness."""
    w = np.linspace(-2500, 2500, 300) / RPM
    for number, (condition, (measured, fit)) in enumerate(runs.items()):
        kappa = fit.model.dynamic_stiffness(fit.theta(), w, np.full(w.size, 1500 / RPM))[:, 0, 0]
        for axis, part in zip(axes, (np.real, np.imag), strict=True):
            points = part(measured.kappa[:, 0, 0])
            good = measured.sigma[:, 0, 0] < 2e3
            axis.plot(measured.frequency[good] * RPM, points[good] / 1e3, ".", color=f"C{number}")
            axis.plot(w * RPM, part(kappa) / 1e3, color=f"C{number}", label=f"{condition} {unit}")
        axes[1].axhline(0, color="0.7", lw=0.8)


# %%
# Fig. 11: the stiffness of the film grows with the pressure.

pressures = {p: sweep(seed, K0=3e3 + 5e3 * p) for seed, p in enumerate((0.5, 1.0, 2.0))}
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
draw(axes, pressures, "bar")
axes[0].set(title="direct, three oil pressures", ylabel="direct stiffness, kN/m")
axes[1].set(title="quadrature", ylabel="quadrature stiffness, kN/m")
for axis in axes:
    axis.set_xlabel("perturbation frequency, rpm")
axes[0].legend()
for p, (_, fit) in pressures.items():
    onset = fit.threshold_speed().to("rpm")
    print(f"{p} bar: K0 {fit.params['K0'].value:7.0f} N/m, D {fit.params['D'].value:5.1f} N s/m, threshold {onset}")

# %%
# The paper draws phase, amplitude and both parts of the stiffness above one another. This figure comes from one fit of
# all three pressures, with a value of K0 and D for each.

tests = []
for seed, p in enumerate(pressures):
    test = rf.simulate(
        model,
        structure | fluid | {"K0": 3e3 + 5e3 * p},
        speed_rpm=1500,
        frequency_rpm=rpm,
        unbalance=60e-6,
        noise=0.01,
        seed=seed,
    )
    tests.append(replace(test, attributes={"oil_bar": np.full(len(test), p)}))
together = rf.fit(model, tests, known=structure, per={"K0": "oil_bar", "D": "oil_bar"})
together.plot.drive_point(mr=60e-6)

# %%
# Fig. 12: the damping falls with the temperature.

temperatures = {T: sweep(10 + T, D=450.0 * np.exp(-0.03 * (T - 25))) for T in (25, 35, 45)}
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
draw(axes, temperatures, "°C")
axes[0].set(title="direct, three oil temperatures", ylabel="direct stiffness, kN/m")
axes[1].set(title="quadrature", ylabel="quadrature stiffness, kN/m")
for axis in axes:
    axis.set_xlabel("perturbation frequency, rpm")
axes[0].legend()
for T, (_, fit) in temperatures.items():
    onset = fit.threshold_speed().to("rpm")
    print(f"{T} °C: K0 {fit.params['K0'].value:7.0f} N/m, D {fit.params['D'].value:5.1f} N s/m, threshold {onset}")

# %%
# What to look at: with pressure, the parabolas move apart and the lines coincide. With temperature, the lines fan out
# about one zero and the parabolas coincide. :func:`rotorfit.campaign` fits many such runs in one call; see
# :doc:`/campaigns`.
