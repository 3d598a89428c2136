"""What tests of reports share: a report taken apart, what must hold for every one of them, material made by hand."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rotorfit as rf
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import SampleSettings
from rotorfit.identify.uncertainty.profile import Profile
from rotorfit.show.plots import style
from rotorfit.show.report import budget, figures, recorded, verdict
from rotorfit.show.report.html import Html, picture
from rotorfit.show.report.material import ReportInput

DOT = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
)
"""A picture of one pixel."""


def leave_pixels_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put one pixel in the place of every figure of the command line, and of a report, which are not even drawn."""

    def embedded(material: ReportInput, name: str, draw: object, words: str, *, caption: str | None = None) -> Html:
        if material.figure_format == "none":
            return Html("")
        material.pictures[name] = DOT
        return picture(DOT, words, 1.0, words if caption is None else caption)

    monkeypatch.setattr(style, "picture_of", lambda figure, *_, **__: DOT)
    for module in (figures, recorded, verdict, budget):
        monkeypatch.setattr(module, "embedded", embedded)


@dataclass
class Page(HTMLParser):
    """A report taken apart by the standard library's parser."""

    text: str
    tags: list[str] = field(default_factory=list)
    attributes: list[tuple[str, str, str]] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.feed(self.text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, key, value or "") for key, value in attrs]
        if tag not in ("meta", "img", "wbr", "mspace"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag != "mspace":
            assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def shown(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def made_profile(name: str, lower: float, upper: float, level: float = 0.95) -> Profile:
    middle = (lower + upper) / 2
    values = np.linspace(lower, upper, 5)
    return Profile(
        name=name,
        unit="1",
        value=middle,
        level=level,
        lower=lower,
        upper=upper,
        values=values,
        rise=3.84 * (2 * (values - middle) / (upper - lower)) ** 2,
        message="",
    )


def report_of(fit: FitResult, path: Path, **options: Any) -> Page:
    """Write a report and hold what must hold for every one of them."""
    assert rf.write_report(fit, path, **options) == path
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    assert not {"script", "link", "iframe", "object", "embed", "form", "base"} & set(page.tags)
    for tag, key, value in page.attributes:
        assert not key.startswith("on"), (tag, key)
        if key == "href":
            assert (tag, value[0]) == ("a", "#")
            assert ("section", "id", value[1:]) in page.attributes
        if key == "src":
            assert tag == "img"
            kind, _, data = value.partition(",")
            assert kind == "data:image/png;base64"
            assert base64.b64decode(data, validate=True).startswith(b"\x89PNG")
    assert not re.search(r"https?:|//|url\(|@import", re.sub(r"base64,[A-Za-z0-9+/=]+", "", page.text))
    printed = re.sub(r"\w=None\b", "", page.shown)  # an option of the script
    assert not re.search(r"\bnan\b|\binf\b|None|<array", printed), re.findall(r".{30}(?:nan|inf|None).{30}", printed)
    return page


def normal_draws(fit: FitResult, **changes: Any) -> rf.Posterior:
    """A posterior made by hand: independent draws from the normal approximation of a fit."""
    rng = np.random.default_rng(5)
    size = np.sqrt(np.diag(fit.covar))
    steps, walkers = 25, 40
    whitened = rng.multivariate_normal(np.zeros(size.size), fit.covar / np.outer(size, size), (steps, walkers))
    made: dict[str, Any] = {
        "fit": fit,
        "names": fit.var_names,
        "chain": fit.x + size * whitened,
        "log_density": -0.5 * (whitened**2).sum(axis=2),
        "acceptance": np.full(walkers, 0.5),
        "tau": np.ones(size.size),
        "burn_in": 0,
        "converged": True,
        "message": "converged: made for a test",
        "treatment": "noise as given with the data",
        "seed": 5,
        "settings": SampleSettings(
            noise="fixed", inflation=1.0, walkers=walkers, ess=4000.0, max_steps=1000, steps=steps
        ),
    }
    return rf.Posterior(**{**made, **changes})
