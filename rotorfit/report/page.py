"""The frame of a report: one HTML page with its style inside and no network."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from datetime import datetime
from importlib.resources import files
from pathlib import Path

from rotorfit.estimators.atomic_file import whole_file
from rotorfit.report.explained import explained
from rotorfit.report.html import Html, element, join
from rotorfit.version import __version__


def page(title: str, source: str, sections: Sequence[Html], scripted: Sequence[Html] = ()) -> Html:
    """The whole page; of scripts, those in the sections ``scripted`` run and no others."""
    style = (files("rotorfit.report") / "report.css").read_text(encoding="utf-8")
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
    found = re.findall(r'<section id="([\w-]+)".*?<h2>(.*?)</h2>', "".join(sections), re.DOTALL)
    links = [element("a", Html(title), href=f"#{name}") for name, title in found]
    when = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    banner = element(
        "header",
        element("h1", title),
        element("p", join([source, f"rotorfit {__version__}", when], " · "), class_="byline"),
        element("nav", *links) if len(links) > 1 else Html(""),
    )
    whole = element("html", head, element("body", banner, element("main", *explained(sections))), lang="en")
    return Html("<!DOCTYPE html>\n" + whole + "\n")


def write_whole(path: Path, content: bytes) -> Path:
    """Write a file whole or not at all."""
    with whole_file(path) as draft:
        draft.write_bytes(content)
    return path
