"""The frame of a report: one HTML page with its style inside and no network, and links to the pages that explain it."""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Sequence
from datetime import datetime
from importlib.resources import files
from pathlib import Path

from rotorfit.base.atomic_file import whole_file
from rotorfit.base.version import VERSIONS
from rotorfit.show.report.html import Html, element, join


def page(title: str, source: str, sections: Sequence[Html], scripted: Sequence[Html] = ()) -> Html:
    """The whole page; of scripts, those in the sections ``scripted`` run and no others."""
    style = (files("rotorfit.show.report") / "report.css").read_text(encoding="utf-8")
    # No network and no script but those known: a reader need not trust the file, nor the names in the data.
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", "".join(scripted), re.DOTALL)
    if scripts:
        known = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts]
        policy += " blob:; script-src " + " ".join(f"'sha256-{one}'" for one in known)
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        Html(f"<style>{style}</style>"),
    )
    # Sections that a click unfolds are not named: a row of links that is read at a glance.
    found = re.findall(r'<section id="([\w-]+)"[^>]*><h2>(.*?)</h2>', "".join(sections))
    links = [element("a", Html(title), href=f"#{name}") for name, title in found]
    when = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    banner = element(
        "header",
        element("h1", title),
        element("p", join([source, f"rotorfit {VERSIONS}", when], " · "), class_="byline"),
        element("nav", *links) if len(links) > 1 else Html(""),
    )
    whole = element("html", head, element("body", banner, element("main", *explained(sections))), lang="en")
    return Html("<!DOCTYPE html>\n" + whole + "\n")


def write_whole(path: Path, content: bytes) -> Path:
    """Write a file whole or not at all."""
    with whole_file(path) as draft:
        draft.write_bytes(content)
    return path


SECTIONS = {
    "Verdict": "howto/faq.html",
    "Dynamic stiffness": "_gallery/plot_fig_10_dynamic_stiffness.html",
    "Stability": "judging.html",
    "Parameters": "theory/models.html",
    "Identifiability": "howto/faq.html#faq-not-determined",
    "95 % intervals": "uncertainty.html",
    "Error budget": "uncertainty.html#what-the-error-bar-holds",
    "Causes beside the model": "uncertainty.html#what-the-error-bar-holds",
    "Bode plots": "conventions.html",
    "Polar plots": "conventions.html",
    "Mode shapes": "real_rig.html",
    "Residuals": "howto/faq.html#faq-redchi",
    "Quality of fit": "howto/faq.html#faq-redchi",
    "Fluid against eccentricity": "experiments.html",
    "Nonlinear dynamic stiffness": "_gallery/plot_fig_13_nonlinear.html",
    "Static loads": "_gallery/plot_fig_26_static_load.html",
    "Static stiffness": "_gallery/plot_fig_26_static_load.html",
    "Impulse tests": "_gallery/plot_fig_29_velocity_ratio.html",
    "Spectral lines": "anisotropic_shaft.html",
    "Profile likelihoods": "uncertainty.html",
    "Posterior": "uncertainty.html",
    "Test and data": "reference/file_columns.html",
    "Recordings": "volts.html#how-signals-become-responses",
    "Model": "theory/models.html",
    "Structural refinement": "structure.html",
    "Trends": "campaigns.html",
}
"""Page of each section of a report, by its heading."""
VERDICT = {
    "misfit": "howto/faq.html#faq-redchi",
    "not determined?": "howto/faq.html#faq-not-determined",
    "extrapolated": "howto/faq.html#faq-extrapolated",
}
"""Page of what a verdict says, by the words that say it."""


def site() -> str | None:
    """Address of the built site, with a slash at its end: one of the web or a folder; None where it is not there."""
    given = os.environ.get("ROTORFIT_DOCS", "")
    if re.match(r"(https?|file)://", given):
        return given.rstrip("/") + "/"
    return Path(given).resolve().as_uri() + "/" if given and (Path(given) / "index.html").is_file() else None


def explained(sections: Sequence[Html]) -> Sequence[Html]:
    """The sections with their links."""
    address = site()
    return sections if address is None else [_linked(one, address) for one in sections]


def _linked(section: Html, address: str) -> Html:
    heading = re.search(r"(<h2[^>]*>)(.*?)</h2>", section)
    if heading is None or heading[2] not in SECTIONS:
        return section
    more = element("a", "explained", href=address + SECTIONS[heading[2]], class_="explained", rel="noreferrer")
    text = section.replace(heading[0], f"{heading[1]}{heading[2]} {more}</h2>", 1)
    for words, page in VERDICT.items() if heading[2] == "Verdict" else ():

        def link(found: re.Match[str], page: str = page) -> str:
            return element("a", found[0], href=address + page, rel="noreferrer")

        text = re.sub(rf"\b{words}\b(?![^<]*>)", link, text, count=1)  # not within a tag
    return Html(text)
