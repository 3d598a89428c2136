"""
Figs 1 to 5 and 7: how a turning rotor is tested
================================================

A machine at work is fed by its rotation, so it is tested at work: a known force or motion goes in at a
frequency of its own, and what comes out gives the parameters. The force turns as a circle does, forward or
backward. Displacement probes in pairs and a mark per turn read the answer. Schematics, not to scale.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle


def sheet(title, width=7.0, height=2.4, reach=(0.0, 10.0, -1.6, 1.8)):
    """An empty drawing."""
    axis = plt.figure(figsize=(width, height), layout="constrained").subplots()
    axis.set(xlim=reach[:2], ylim=reach[2:], aspect="equal", title=title)
    axis.axis("off")
    return axis


def box(axis, x, y, width, height, text, **look):
    """A rectangle with words in it."""
    axis.add_patch(Rectangle((x, y), width, height, **({"facecolor": "#e8eef7", "edgecolor": "k"} | look)))
    axis.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=8)


def arrow(axis, begin, end, text="", above=0.15, **look):
    """An arrow with words at its middle."""
    axis.add_patch(FancyArrowPatch(begin, end, **({"arrowstyle": "-|>", "mutation_scale": 12, "color": "k"} | look)))
    axis.text((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2 + above, text, ha="center", va="bottom", fontsize=8)


def turning(axis, x, y, radius, text, sense=1, colour="k"):
    """An arrow round a circle."""
    begin, end = (x + radius, y), (x - radius * 0.2, y + radius)
    if sense < 0:
        begin, end = end, begin
    look = {"connectionstyle": f"arc3,rad={0.45 * sense}", "color": colour}
    arrow(axis, begin, end, **look)
    axis.text(x + radius * 1.15, y + radius * 0.8, text, color=colour, fontsize=8)


# %%
# Fig. 1: perturbation in, vibration out, while the machine runs.

axis = sheet("Fig. 1: the technique")
box(axis, 3.2, -0.7, 3.6, 1.4, "rotating machine\nin operation, speed Om")
arrow(axis, (0.3, 0), (3.2, 0), "perturbation:\nforce, frequency w")
arrow(axis, (6.8, 0), (9.7, 0), "response:\nvibration at w")
arrow(axis, (5, 1.7), (5, 0.7), "")
axis.text(5.15, 1.2, "rotation supplies energy", fontsize=8)

# %%
# Figs 2 and 3: forces. An unbalance on a free spinner or on an auxiliary shaft gives ``m r w²``; springs in an
# eccentric ring give a force that does not depend on the frequency.

axis = sheet("Fig. 2: unbalance on (a) a free spinner, (b) an auxiliary shaft; Fig. 3: springs in a turning ring", 10)
for x, end, name in ((0.3, 3.0, "(a)"), (3.8, 6.4, "(b)")):
    axis.plot([x, end], [0, 0], "k", lw=4)
    axis.text(x, 0.9, name)
box(axis, 1.4, -0.8, 0.35, 1.6, "", facecolor="#f3d9b1")
axis.plot(1.57, 0.7, "ko")
axis.text(1.9, 0.75, "m r, speed w", fontsize=8)
axis.plot([5.6, 6.9], [0, 0], "C0", lw=2)
box(axis, 6.3, -0.8, 0.3, 1.6, "", facecolor="#f3d9b1")
axis.plot(6.45, 0.7, "ko")
axis.text(5.3, -0.5, "pivoting bearing", fontsize=8, ha="center")
for radius, look in ((1.2, "k"), (0.35, "C0")):
    axis.add_patch(Circle((8.6 if radius > 1 else 8.8, 0), radius, fill=False, color=look))
for angle in np.radians([0, 90, 180, 270]):
    ends = np.array(
        [[8.8 + 0.35 * np.cos(angle), 8.6 + 1.2 * np.cos(angle)], [0.35 * np.sin(angle), 1.2 * np.sin(angle)]]
    )
    axis.plot(*ends, "C1", ls=(0, (2, 1)))
axis.text(8.6, -1.55, "ring turns at w", ha="center", fontsize=8)

# %%
# Fig. 4: the other way round: a cam drives the journal round a circle, pressures or load cells give the force.

axis = sheet("Fig. 4: displacement in, force out", 5, 2.6, (-3.2, 3.2, -1.7, 1.8))
axis.add_patch(Circle((0, 0), 1.4, fill=False, lw=2))
axis.add_patch(Circle((0, 0), 0.35, fill=False, ls=":", zorder=3))
axis.add_patch(Circle((0.25, 0.25), 0.9, facecolor="#e8eef7", edgecolor="k"))
turning(axis, 0.25, 0.25, 0.5, "", colour="C3")
for x, y in ((2.4, 0), (0, 1.75)):
    arrow(axis, (x, y), (1.45 * np.sign(x), 1.45 * np.sign(y)), "")
axis.text(1.6, 0.35, "load cells or\npressures", fontsize=8)
axis.text(-3.1, -1.6, "dotted: the imposed orbit,\nradius A, frequency w", fontsize=8)

# %%
# Fig. 5: what is read: x and y at each plane, and a mark per turn on shaft and perturbator. Rotation is from x
# to y; a forward force turns the same way.

axis = sheet("Fig. 5: probes, force, rotation", 5, 3.2, (-2.6, 3.2, -1.8, 2.2))
axis.add_patch(Circle((0, 0), 1.0, facecolor="#e8eef7", edgecolor="k"))
box(axis, 1.15, -0.15, 0.8, 0.3, "x")
box(axis, -0.15, 1.15, 0.3, 0.7, "y")
arrow(axis, (0, 0), (0.75, 0.55), "", color="C3")
axis.text(0.0, -0.25, "F, at w t + d", color="C3", fontsize=8)
turning(axis, 0, 0, 1.35, "forward, w > 0", colour="C3")
arrow(axis, (-0.2, -1.35), (1.1, -0.9), "", connectionstyle="arc3,rad=0.35")
axis.text(0.2, -1.65, "rotation, Om", fontsize=8)
axis.plot([-0.7, -0.95], [-0.7, -0.95], "k", lw=4)
axis.text(-2.5, -1.2, "mark: one pulse\nper turn", fontsize=8)

# %%
# Fig. 7: the rig for the fluid forces of one mode: a light rotor, rigid at one end and in oil at the other,
# with the perturbator at the journal.

axis = sheet("Fig. 7: rig of one mode", 9, 2.4, (0, 11, -1.6, 1.8))
box(axis, 0.1, -0.5, 1.0, 1.0, "motor\nOm")
axis.plot([1.1, 7.2], [0, 0], "k", lw=4)
box(axis, 1.8, -0.4, 0.35, 0.8, "", hatch="///")
axis.text(1.97, 0.55, "rigid bushing", ha="center", fontsize=8)
box(axis, 5.9, -0.55, 1.1, 1.1, "oil", facecolor="#f6efc9")
axis.text(6.45, 0.7, "journal in oil, x and y probes", ha="center", fontsize=8)
axis.plot([7.2, 9.2], [0, 0], "C0", lw=2)
box(axis, 8.0, -0.7, 0.3, 1.4, "", facecolor="#f3d9b1")
axis.text(8.15, 0.85, "m r", ha="center", fontsize=8)
box(axis, 9.2, -0.5, 1.2, 1.0, "motor\nw")
for x in (5.4, 7.35):
    axis.plot([x, x], [-0.1, -1.3], "C1", ls=(0, (2, 1)))
axis.text(6.4, -1.45, "radial springs centre the journal", ha="center", fontsize=8)

# %%
# What to look at: nothing in these pictures ties w to Om. The angles and signs of the files are on the page of
# :doc:`/conventions`.
