"""Members of a record that a storey above provides: figures of a fit, a structure read from a rotor of ROSS.

The record names the member, the front names its provider in :data:`PROVIDERS`, and the provider is imported when the
member is first asked for. So no file of a record imports the storeys above it.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from types import MethodType
from typing import Any

PROVIDERS: dict[str, str] = {}
"""Providers, ``"module:name"``, by class and member, ``"FitResult.plot"``; the front fills it."""


class Accessor:
    """A member that a class or a function elsewhere provides.

    A class is made with the record, ``fit.plot`` is ``FitPlots(fit)``; a function is called with it, as a method is. On
    the record's class the member is the provider itself, with its documentation.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._key = f"{owner.__name__}.{name}"

    def __get__(self, record: Any, owner: type) -> Any:
        provider = self._provider()
        if record is None:
            return provider
        return MethodType(provider, record) if inspect.isfunction(provider) else provider(record)

    def _provider(self) -> Any:
        module, _, name = PROVIDERS[self._key].partition(":")
        return getattr(import_module(module), name)


class ClassAccessor(Accessor):
    """The same of a function that is called with the class, as a class method is."""

    def __get__(self, record: Any, owner: type) -> Any:
        return MethodType(self._provider(), owner)
