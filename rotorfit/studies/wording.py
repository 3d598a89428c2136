"""Messages of the library in the words of the command line."""

from __future__ import annotations

import re

_SPOKEN = (
    (r"rf\.join_runs\(\[reference, trial\]\)", "rotorfit join REFERENCE TRIAL --out BOTH.csv"),
    (r"rf\.influence\(test, speeds=\.\.\.\), or fit the differences, rf\.difference_synchronous", "--speeds RPM,RPM"),
    (r"rf\.refine\(fit\) \(--refine\)", "--refine"),
    (r"the slow roll, read\(\.\.\., slow_roll=\.\.\.\), or", "the slow roll (--slow-roll-below RPM), or"),
    (r"give it, read\(path, speed=\.\.\.\) in rad/s", "give it, --speed RPM"),
    (r"at=\{attribute: value\}", "--at NAME=VALUE"),
    (r"free a default with known=\{name: None\}", "free a default with --known NAME=free"),
    (r"use rf\.fit\(model, experiments\)", "use `rotorfit fit`"),
    (
        r"sample a refined fit instead, rf\.refine\(fit\)\.best\.sample\(\).*?\(rf\.refine\(fit\)\.steps\)",
        "sample a refined fit instead, --refine",
    ),
    (r"Fit rf\.models\.Modal\(.*?modes=(\d+)\) \(--model modal\)", r"Fit --model modal --modes \1"),
    (r",? or (?:use )?rf\.read_recording(?:\([^)]*\))?", ""),
    (r"\(?\baxes, (--axes(?: yz)?)\)?", r"\1"),
    (r"\w+\(planes=\(\.\.\.\)\) or --planes", "--planes A,B"),
    (r"\(where=\{'plane': \.\.\., 'force_plane': \.\.\.\}\)", "(--where plane=A --where force_plane=A)"),
    (r"Give their angles \(probe_angles\)", "Give their angles (--probe-angles)"),
    (r"\b(max|min)_speed_rpm\b", r"--\1-speed"),
    (r"^plane and max_amplitude_um\b", "--plane and --max-amplitude"),
    (r"\bunbalance_g_mm\b", "--unbalance"),
    (r"\bcross_coupling\b", "--cross-coupling"),
    (r"^(unknown )?force_plane\b", r"\1--force-plane"),
)
"""Words of a message in Python, as a pattern, and with options."""

_OPTIONS = (
    (r"\b(give|check) clearance_um\b", r"\1 --clearance-um"),
    (r"^probe_angles: ", "--probe-angles: "),
    (r"^runout_um belongs", "--runout-um belongs"),
)
"""The same of settings that a study calls by the names of the library."""


def in_options(text: str) -> str:
    """A refusal with options in place of the names of settings."""
    for setting, option in _OPTIONS:
        text = re.sub(setting, option, text)
    return text


def spoken(text: str) -> str:
    """A message, or several, with options where it names functions and arguments of Python."""
    for python, option in _SPOKEN:
        text = re.sub(python, option, text)
    return text


def sentence(problem: BaseException) -> str:
    """Message of an exception as a person would write it."""
    if isinstance(problem, KeyError) and problem.args:
        return str(problem.args[0])  # str() of a KeyError puts quotes around the sentence
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename}: {problem.strerror}" if problem.filename else problem.strerror
    return str(problem)


def refusal(problem: BaseException) -> str:
    """The sentence of the command line where a file or a setting of the user is wrong."""
    return in_options(spoken(sentence(problem)))
