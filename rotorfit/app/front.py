"""Interface that the parts of a page use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rotorfit.app.session import Session
from rotorfit.app.work import Task


class Front(Protocol):
    """A page with its session."""

    session: Session

    def change(self, asked: Callable[[], Session]) -> None:
        """Put other data in the place of the session's, or say why not."""

    def change_model(self, asked: Callable[[], Session]) -> None:
        """Put another model, or other options of the fit, in the place of the session's."""

    def opened_with(self, setup: str) -> None:
        """Open the same recordings with another setup, which has just been written."""

    def start(self, task: Task) -> None:
        """Begin long work on the study, in place of what is going on."""

    def say(self, words: str) -> None:
        """Say what is wrong with something that was entered."""
