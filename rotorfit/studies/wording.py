"""Exceptions as sentences."""

from __future__ import annotations


def sentence(problem: BaseException) -> str:
    """Message of an exception as a person would write it."""
    if isinstance(problem, KeyError) and problem.args:
        return str(problem.args[0])  # str() of a KeyError puts quotes around the sentence
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename}: {problem.strerror}" if problem.filename else problem.strerror
    return str(problem)
