"""
Figs 1 to 5 and 7: testing a rotating machine
=============================================

A machine draws energy from its rotation, so it must be tested while it rotates. A known force or motion is applied at a
frequency of its own, and the parameters follow from the response. The force rotates, forward or backward. Pairs of
displacement probes and a mark on each shaft measure the response. The figures are schematics, not to scale.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

STEEL, BRASS, OIL = "#e8eef7", "#f3d9b1", "#f6efc9"


def sheet(title, width=6.6, height=2.4, reach=(0.0, 10.0, -1.6, 1.8)):
    """An empty drawing."""
    axis = plt.figure(figsize=(width, height), layout="constrained").subplots()
    axis.set(xlim=reach[:2], ylim=reach[2:], aspect="equal", title=title)
    axis.axis("off")
    return axis


def words(axis, x, y, text, **look):
    """Words, centred unless said otherwise."""
    axis.text(x, y, text, **({"ha": "center", "va": "center", "fontsize": 9} | look))


def box(axis, x, y, width, height, text="", **look):
    """A rectangle with words in it."""
    axis.add_patch(Rectangle((x, y), width, height, **({"facecolor": STEEL, "edgecolor": "k"} | look)))
    words(axis, x + width / 2, y + height / 2, text)


def arrow(axis, begin, end, text="", **look):
    """An arrow with words above its middle."""
    axis.add_patch(FancyArrowPatch(begin, end, **({"arrowstyle": "-|>", "mutation_scale": 12, "color": "k"} | look)))
    words(axis, (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2 + 0.12, text, va="bottom")


def spring(axis, begin, end):
    """A zigzag line between two points of the complex plane."""
    way = np.linspace(0, 1, 14)
    line = begin + (end - begin) * way + 0.07j * (end - begin) / abs(end - begin) * np.cos(np.pi * np.arange(14))
    axis.plot(line.real, line.imag, "C1")


def turning(axis, centre, radius, begin, end, colour="k"):
    """An arrow along a circle, between two angles in degrees."""
    angle = np.radians(np.linspace(begin, end, 60))
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    axis.plot(x[:-3], y[:-3], color=colour, lw=1.2, zorder=4)
    style = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (x[-1], y[-1]), (x[-6], y[-6]), arrowprops=style, zorder=4)


# %%
# Fig. 1: the perturbation goes in and the vibration comes out, while the machine runs.

axis = sheet("Fig. 1: the technique")
box(axis, 3.2, -0.8, 3.6, 1.5, "rotating machine\nin operation, speed Ω")
arrow(axis, (0.1, 0), (3.2, 0), "perturbation:\nforce, frequency ω")
arrow(axis, (6.8, 0), (9.9, 0), "response:\nvibration at ω")
arrow(axis, (5, 1.7), (5, 0.7))
words(axis, 5.2, 1.2, "energy of the rotation", ha="left")

# %%
# Fig. 2: a rotating unbalance gives the force ``m r w²``. It sits on a free spinner (a) or on an auxiliary shaft (b)
# that is driven independently of the main shaft.

axis = sheet("Fig. 2: unbalance on (a) a free spinner, (b) an auxiliary shaft", reach=(0.0, 10.0, -1.5, 1.5))
words(axis, 0.4, 1.1, "(a)")
axis.plot([0.3, 3.9], [0, 0], "k", lw=4)
box(axis, 1.9, -0.9, 0.4, 1.8, facecolor=BRASS)
axis.plot(2.1, 0.65, "ko")
words(axis, 2.6, 0.65, "m r, at ω", ha="left")
words(axis, 0.4, 0.3, "shaft, Ω", ha="left")
words(axis, 5.3, 1.1, "(b)")
axis.plot([5.2, 7.4], [0, 0], "k", lw=4)
axis.plot([7.6, 9.7], [0, 0], "C0", lw=3)
box(axis, 7.25, -0.3, 0.5, 0.6, facecolor="w")
words(axis, 7.2, -0.65, "pivoting bearing")
box(axis, 8.5, -0.9, 0.4, 1.8, facecolor=BRASS)
axis.plot(8.7, 0.65, "ko")
words(axis, 9.1, 0.65, "m r, at ω", ha="left")
words(axis, 5.3, 0.3, "shaft, Ω", ha="left")
words(axis, 8.7, -1.2, "auxiliary shaft, ω")

# %%
# Fig. 3: springs in an eccentric rotating ring give a force that does not depend on the frequency.

axis = sheet("Fig. 3: springs in a rotating ring", 4.6, 2.7, (-3.2, 3.2, -1.6, 1.6))
axis.add_patch(Circle((0, 0), 1.4, fill=False, lw=2))
axis.add_patch(Circle((0.25, 0), 0.4, facecolor=STEEL, edgecolor="k"))
for direction in (1, 1j, -1, -1j):
    spring(axis, 0.25 + 0.4 * direction, 1.4 * direction)
turning(axis, (0, 0), 1.55, 20, 70, "C3")
words(axis, 1.35, 1.25, "ring turns at ω", color="C3", ha="left")
words(axis, 1.6, -0.9, "shaft off the ring's\ncentre: constant force", ha="left")

# %%
# Fig. 4: the reverse test. A cam moves the journal round a circle, and load cells or pressures give the force.

axis = sheet("Fig. 4: displacement in, force out", 4.6, 2.9, (-3.3, 3.3, -1.8, 2.0))
axis.add_patch(Circle((0, 0), 1.4, fill=False, lw=2))
axis.add_patch(Circle((0.25, 0.25), 0.9, facecolor=STEEL, edgecolor="k"))
axis.add_patch(Circle((0, 0), 0.354, fill=False, ls=":", zorder=3))
axis.plot(0.25, 0.25, "k.", zorder=5)
turning(axis, (0, 0), 0.354, 45, 130, "C3")
for x, y in ((2.3, 0), (0, 2.0)):
    arrow(axis, (x, y), (1.45 * np.sign(x), 1.45 * np.sign(y)))
words(axis, 1.6, 0.5, "load cells or\npressures", ha="left")
words(axis, -3.25, -1.5, "dotted: the imposed orbit,\nradius A, frequency ω", ha="left")

# %%
# Fig. 5: the readings are x and y at each plane, and one pulse per turn of the shaft and of the perturbator. The shaft
# rotates from x to y. A forward force rotates in the same direction.

axis = sheet("Fig. 5: probes, force, rotation", 4.6, 3.4, (-3.0, 3.4, -1.9, 2.3))
axis.add_patch(Circle((0, 0), 1.0, facecolor=STEEL, edgecolor="k"))
box(axis, 1.15, -0.15, 0.8, 0.3, "x")
box(axis, -0.15, 1.15, 0.3, 0.8, "y")
arrow(axis, (0, 0), (0.77, 0.64), color="C3")
words(axis, -0.1, -0.35, "F, at ωt + δ", color="C3")
turning(axis, (0, 0), 1.3, 18, 72, "C3")
words(axis, 1.15, 1.1, "forward, ω > 0", color="C3", ha="left")
turning(axis, (0, 0), 1.2, 255, 330)
words(axis, 0.7, -1.45, "rotation, Ω", ha="left")
axis.plot([-0.71, -0.98], [-0.71, -0.98], "k", lw=4)
words(axis, -2.95, -1.35, "mark: one pulse\nper turn", ha="left")

# %%
# Fig. 7: the rig for the fluid forces of one mode. A light rotor is rigidly supported at one end and runs in oil at the
# other, with the perturbator at the journal.

axis = sheet("Fig. 7: rig of one mode", 7.0, 2.4, (0, 10.6, -1.7, 1.6))
axis.plot([1.1, 7.2], [0, 0], "k", lw=4, zorder=1)
axis.plot([7.2, 9.3], [0, 0], "C0", lw=2, zorder=1)
box(axis, 0.1, -0.5, 1.0, 1.0, "motor\nΩ")
box(axis, 1.8, -0.4, 0.4, 0.8, hatch="///")
words(axis, 2.0, 0.65, "rigid bushing")
box(axis, 5.7, -0.6, 1.3, 1.2, facecolor=OIL)
box(axis, 5.7, -0.3, 1.3, 0.6)
words(axis, 6.35, 0.9, "journal in oil,\nx and y probes")
box(axis, 8.0, -0.7, 0.35, 1.4, facecolor=BRASS)
words(axis, 8.17, 0.95, "m r")
box(axis, 9.3, -0.5, 1.1, 1.0, "motor\nω")
for x in (5.4, 7.35):
    axis.plot([x, x], [-0.1, -1.2], "C1", ls=(0, (2, 1)))
words(axis, 6.4, -1.45, "radial springs centre the journal")

# %%
# What to look at: in none of these rigs is ω tied to Ω. The page on :doc:`/conventions` defines the angles and signs of
# the files.
