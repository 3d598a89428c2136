"""References in docstrings to where something is written lead to the name under which users call it."""

from __future__ import annotations

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import rotorfit
from rotorfit import models
from rotorfit.base.accessors import PROVIDERS

HOMES = {f"{home}.{name}": f"rotorfit.{name}" for name, home in rotorfit._HOME.items() if home}
HOMES |= {
    f"{thing.__module__}.{name}": f"rotorfit.models.{name}"
    for name, thing in ((name, getattr(models, name)) for name in models.__all__)
    if hasattr(thing, "__module__")
}
HOMES |= {f"rotorfit.{member}": place.replace(":", ".") for member, place in PROVIDERS.items() if "Plots" in place}
"""Public names by the place where they are written; of what ``plot`` of a record leads to, the place."""


def _lead(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Node) -> nodes.Node | None:
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    for home, public in HOMES.items():
        if target == home or target.startswith(f"{home}."):
            place = public + target.removeprefix(home)
            domain = env.get_domain("py")
            return domain.resolve_xref(env, node["refdoc"], app.builder, node["reftype"], place, node, content)
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Ask where references that lead nowhere should lead."""
    app.connect("missing-reference", _lead)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
