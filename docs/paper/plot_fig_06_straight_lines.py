"""
Fig. 6: circle or straight lines?
=================================

Modal analysis fits circles to receptance. The paper fits straight lines to dynamic stiffness and calls them
"definitely the best to fit". They are the best to *look at*. An unweighted fit of them is not the best, because the
inversion of a response amplifies its noise by the square of the stiffness. A fit weighted by the noise is as good as
any.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
rng = np.random.default_rng(2)


def sweeps(model, values, w, speeds, noise):
    """A turning force of 1 N at every plane in turn, at several speeds, every plane read, with white noise."""
    columns = {name: [] for name in ("force_plane", "plane", "speed", "frequency", "response", "sigma")}
    for speed in speeds:
        H = model.receptance(model.vector(values), w, speed)
        for i, plane in enumerate(model.planes):
            for k, forced in enumerate(model.planes):
                sigma = noise * np.sqrt(np.mean(abs(H[:, i, k]) ** 2))
                read = H[:, i, k] + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                for name, value in zip(columns, (forced, plane, speed, w, read, sigma), strict=True):
                    columns[name].append(np.broadcast_to(value, w.shape))
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    return rf.perturbation_test(run="sweep", force=1.0, direction="z", **whole)


def errors_over_bound(estimates, truth, bound):
    """Root mean square error of each parameter over the smallest that any unbiased estimate can have (Cramer-Rao)."""
    return np.sqrt(np.mean((np.array(estimates) - truth) ** 2, axis=0)) / bound


# %%
# The claim
# ---------
#
# Take a rotor at rest with one mode. The receptance, times jw, runs through a circle of diameter 1/D, fastest at the
# natural frequency. The direct stiffness is a straight line over the square of the frequency. All points of the circle
# have nearly the same error bars; those of the line have not.

rotor = rf.models.OneMode()
passive = {"K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0}
truth = {"K": 17e3, "M": 1.2, "Ds": 60.0}
w = np.linspace(60.0, 180.0, 81)  # rad/s


def circle_fit(w, H):
    """K, M and D by the circle through jwH near resonance, and by how its points run along it."""
    near = abs(H) > 0.5 * abs(H).max()
    w, y = w[near], 1j * w[near] * H[near]
    columns = np.column_stack([2 * y.real, 2 * y.imag, np.ones(y.size)])
    a, b, c = np.linalg.lstsq(columns, abs(y) ** 2, rcond=None)[0]
    centre, radius = a + 1j * b, np.sqrt(c + a**2 + b**2)
    angle = np.angle((y - centre) / centre)
    slope, zero = np.polyfit(w**2, w * np.tan(angle / 2) / (2 * radius), 1)
    return (zero, -slope, 1 / (2 * radius)), centre, radius


test = sweeps(rotor, truth | passive, w, [0.0], 0.02)
measured = rf.dynamic_stiffness(test)
kappa, sigma = measured.kappa[:, 0, 0], measured.sigma[:, 0, 0]
_, centre, radius = circle_fit(w, 1 / kappa)
turn = np.exp(1j * np.linspace(0, 2 * np.pi, 200))

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
points = 1e3 * 1j * w / kappa
scatter = 1e3 * w * abs(kappa) ** -2 * sigma
left.errorbar(points.real, points.imag, scatter, scatter, fmt=".", lw=0.7)
ring = 1e3 * (centre + radius * turn)
left.plot(ring.real, ring.imag, "C3", lw=1, label="circle fitted near resonance")
left.set(title="(a) receptance times jw: a circle", xlabel="real part, mm/s per N", ylabel="imaginary part, mm/s per N")
left.set_aspect("equal")
left.legend(loc="center")
right.errorbar(w**2 / 1e3, kappa.real / 1e3, sigma / 1e3, fmt=".", lw=0.7)
right.plot(w**2 / 1e3, np.polyval(np.polyfit(w**2, kappa.real / 1e3, 1), w**2), "C3", lw=1, label="unweighted line")
right.set(
    title="(b) direct dynamic stiffness: a line",
    xlabel="square of the frequency, 1000 rad²/s²",
    ylabel="direct dynamic stiffness, kN/m",
)
right.legend()

# %%
# The answer
# ----------
#
# The same sweep is repeated two hundred times with new noise. The errors of K, M and D are divided by the bound that no
# estimate can beat. :func:`rotorfit.closed_form` solves the equations of the straight lines weighted by the noise, and
# :func:`rotorfit.fit` fits the responses.

ways = {"circle": [], "straight lines, unweighted": [], "straight lines, weighted": [], "fit of the responses": []}
for _ in range(200):
    test = sweeps(rotor, truth | passive, w, [0.0], 0.02)
    ways["circle"].append(circle_fit(w, test.response)[0])
    stiffness = 1 / test.response
    slope, zero = np.polyfit(w**2, stiffness.real, 1)
    ways["straight lines, unweighted"].append((zero, -slope, (w @ stiffness.imag) / (w @ w)))
    for name, solve in (("straight lines, weighted", rf.closed_form), ("fit of the responses", rf.fit)):
        found = solve(rotor, test, known=passive)
        ways[name].append([found.params[parameter].value for parameter in truth])
bound = [found.params[parameter].noise for parameter in truth]
for name, estimates in ways.items():
    ratios = errors_over_bound(estimates, list(truth.values()), bound)
    print(f"{name:<27} error over the bound: " + ", ".join(f"{p} {r:.2f}" for p, r in zip(truth, ratios, strict=True)))

# %%
# With a fluid, and with more planes
# ----------------------------------
#
# The receptance of a rotor in a fluid is no circle, because the quadrature stiffness changes with the frequency. The
# straight lines remain; with several planes they are the rows of the inverted matrix. Bars show the median parameter,
# and the thin lines extend from the best to the worst.

half = np.linspace(10.0, 320.0, 30)
both = np.r_[-half[::-1], half]
rotors = {
    "one mode": (
        rotor, {"M": 1.2, "K": 8e3, "Ds": 0.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.0}, both, [157.0],
        {"K": 8e3, "Ds": 0.0, "Mf": 0.0},
    ),
    "whirl and whip": (
        rf.models.WhirlWhip(),
        {"Md": 0.95, "Ds": 25.0, "K1": 14e3, "K2": 15e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
         "lam": 0.475, "Mf": 0.35},
        both, [80.0, 160.0], {"K3": 6e3},
    ),
    "two disks": (
        rf.models.TwoDisk(),
        {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0, "D11": 14.2, "D12": 7.0, "D21": 7.0,
         "D22": 14.8, "beta1": 1.0, "beta2": 1.0},
        np.linspace(50.0, 640.0, 80), [0.0], {},
    ),
}  # fmt: skip
names = ("straight lines, unweighted", "straight lines, weighted", "fit of the responses")
figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
for place, (label, (model, values, frequency, speeds, known)) in enumerate(rotors.items()):
    draws = {name: [] for name in names}
    for _ in range(40):
        test = sweeps(model, values, frequency, speeds, 0.01)
        found = (
            rf.closed_form(model, test, known=known, weighted=False),
            rf.closed_form(model, test, known=known),
            rf.fit(model, test, known=known),
        )
        free = [name for name, parameter in found[2].params.items() if parameter.vary]
        for name, result in zip(names, found, strict=True):
            draws[name].append([result.params[parameter].value for parameter in free])
    bound = [found[2].params[name].noise for name in free]
    for k, name in enumerate(names):
        ratio = errors_over_bound(draws[name], [values[parameter] for parameter in free], bound)
        at, middle = place + 0.26 * (k - 1), np.median(ratio)
        axis.bar(at, middle, 0.22, color=f"C{k}", label=None if place else name)
        axis.plot([at, at], [ratio.min(), ratio.max()], "k", lw=1)
        print(f"{label:<15} {name:<27} median {middle:6.2f}   worst {ratio.max():6.2f}")
axis.axhline(1, color="k", ls=":", lw=1)
axis.set(yscale="log", xticks=range(len(rotors)), xticklabels=rotors, ylabel="error over the bound")
axis.set(ylim=(0.5, 150), yticks=(1, 10, 100), yticklabels=("1", "10", "100"), title="1 % noise, 40 draws each")
axis.legend(ncols=3, loc="upper center")

# %%
# What to look at: the line in (b) is easy to judge by eye, but its last points, where the response is smallest,
# distort the unweighted fit. Weighted lines reach the bound without iteration. So draw the lines, fit them with
# weights, and fit the responses if the noise is large, a plane is missing or the rotor is not linear. ``python
# benchmarks/closed_form_vs_optimised.py`` repeats this over five models and 1000 draws. Up to 1 % noise, unweighted
# lines lose a factor of 1.6 to 23 (72 to 360 for overhung rotors that are forced at one coordinate), and weighted ones
# lose nothing; see :doc:`validation </reference/validation>`. ``fit.plot.polar()`` draws the receptance of a fitted
# rotor.
