"""Whose fault an exception is: the user's, whom a ``raise`` of ours refuses, a foreign library's, or the program's."""

from __future__ import annotations

from opcode import opmap

_OF_DATA = (OSError, MemoryError, RecursionError, UnicodeError)
"""What the system lacks, or a text has, whatever line found it."""


def of_program(problem: BaseException) -> bool:
    """True for an error of the program: a line of ours failed. Not where it refuses by ``raise``, nor where a library,
    or an equation of the user's own, raised: these have lines, or exceptions, of their own."""
    trace, kind = problem.__traceback__, type(problem)
    if trace is None or isinstance(problem, _OF_DATA) or not _ours(kind.__module__, "builtins"):
        return False
    while trace.tb_next is not None:
        trace = trace.tb_next
    code, line = trace.tb_frame.f_code.co_code, trace.tb_lasti
    return _ours(str(trace.tb_frame.f_globals.get("__name__"))) and code[line] != opmap["RAISE_VARARGS"]


def of_library(problem: BaseException) -> bool:
    """True where a line of a library raised it, in words that say nothing of a rotor."""
    trace = problem.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and not _ours(str(trace.tb_frame.f_globals.get("__name__")))


def _ours(module: str, *others: str) -> bool:
    return module.partition(".")[0] in ("rotorfit", *others)
