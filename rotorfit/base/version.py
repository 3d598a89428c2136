"""The version of the package and that of its numbers, apart from the front so that lower rooms know them."""

__version__ = "1.0.0.dev0"
RESULTS = "234c4510"
"""Digest of the golden numbers, another where fits give other numbers; ``python tests/golden.py --write`` writes it.
What a store holds of another one is marked, and fitted again when asked."""
VERSIONS = f"{__version__}, results {RESULTS}"
"""Both, as files and reports name what wrote them."""
