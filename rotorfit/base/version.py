"""The version, and names of earlier ones, apart from the front so that lower rooms know them without importing it."""

import warnings

__version__ = "0.1.0"

RESULTS = "1"
"""Version of the numbers that fits give: what a store holds of another one is marked, and fitted again when asked."""


def renamed(name: str, today: str) -> None:
    """Warn the caller of a property that it has another name today; the property goes with the next release."""
    warnings.warn(f"{name} is called {today} now", DeprecationWarning, stacklevel=3)
