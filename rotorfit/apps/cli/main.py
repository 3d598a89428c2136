"""The command line: ``rotorfit demo``, ``fit``, ``run``, ``campaign``, ``simulate`` and others.

Exit codes: 0 done, 1 the data have an error or the fit or sampling did not converge, 2 bad input (one sentence on
stderr), 3 an alarm of a watched machine, 4 an error of the program, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib import import_module
from io import UnsupportedOperation
from typing import NoReturn

from numpy import errstate
from numpy.linalg import LinAlgError

from rotorfit.apps.cli.answer import Answer, BadInputError, ExitCode, answered, say
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.atomic_file import protected_inputs
from rotorfit.base.caches import cache_home
from rotorfit.base.file_reading import shown
from rotorfit.base.names import nearest
from rotorfit.base.version import VERSIONS

COMMANDS = {
    "demo": ("fits", "identify the bundled rig and compare with its truth"),
    "fit": ("fits", "fit a model to test files"),
    "run": ("fits", "fit with the settings of a TOML file"),
    "campaign": ("several", "fit every run of a campaign and show how the parameters change with its conditions"),
    "simulate": ("simulation", "simulate a test of a virtual rig by integration in time and write its file"),
    "vectors": (
        "recordings", "turn recordings of raw signals into vectors: responses with their noise, in a tidy CSV",
    ),
    "join": (
        "weights", "put runs of several files, such as a reference run and runs with a trial weight, into one file",
    ),
    "balance": (
        "weights", "correction weights with their errors, from a reference run and runs with trial weights",
    ),
    "predict": (
        "rotors", "predict responses of an identified rotor, with a band of the mean and one of a new reading",
    ),
    "plan": ("rotors", "plan a test: expected errors, speeds to run, and time for each line"),
    "judge": (
        "rotors", "judge the stability of an identified rotor at running speed, with the probability of each criterion",
    ),
    "store": ("history", "keep tests and their fits in one file: add to it, list it, follow it over time"),
    "open": ("fits", "view, fit and judge tests and recordings in a browser, on this machine only"),
    "watch": (
        "watch", "watch a folder: fit tests and recordings as they arrive, keep a history, raise an alarm on a change",
    ),
    "template": (
        "lists",
        "print an example file with comments, or a setup, rig.toml, to fill in for a recording of raw signals",
    ),
    "look": ("recordings", "summarise recordings of raw signals with their findings, and draw them"),
    "trend": (
        "history",
        "follow the observed stiffness, mass and damping of dated tests of one machine, or dK/K of saved fits (.json) "
        "of a shaft that is not round, and report changes",
    ),
    "models": ("lists", "list the models and their parameters"),
    "info": ("fits", "summarise a test file with its findings"),
    "completion": ("main", "print a script that lets a shell complete commands and options"),
}  # fmt: skip
"""The module of each command and what it is for. The module, with all that it needs, is imported when the command is
used: ``add_NAME`` adds the options, and ``NAME`` does the work and returns the exit code."""

EXAMPLES = {
    "demo": "demo --out demo",
    "fit": "fit rig.csv --model whirl-whip --known K3=6000 --out results\n"
    "fit sweep-*.h5 --setup rig.toml --model one-mode --per 'K*=speed_rpm'\n"
    "fit sweep.csv --model one-mode --clearance-um 100 --laws all",
    "run": "run study.toml --out results",
    "campaign": "campaign study.toml --against pressure_psi --out results\n"
    "campaign study.toml runs-*.csv --store runs.db",
    "simulate": "simulate virtual.toml --out test.csv",
    "vectors": "vectors sweep.h5 --setup rig.toml --out responses.csv",
    "join": "join reference.csv trial.csv --out both.csv",
    "balance": "balance both.csv --out weights",
    "predict": "predict fit.json --speed 500:2000:50 --synchronous --mr-g-mm 30",
    "plan": "plan plan.toml --out plan",
    "judge": "judge fit.json --max-speed 2000 --min-decrement 0.1",
    "store": "store add machine.db tests/*.csv --study study.toml",
    "open": "open tests",
    "watch": "watch inbox --study study.toml --store machine.db --once",
    "template": "template perturbation > test.csv",
    "look": "look sweep.h5 --setup rig.toml --out figures",
    "trend": "trend dated.csv --out trend",
    "models": "models whirl-whip",
    "info": "info rig.csv",
    "completion": "completion bash",
}
"""Lines for each command that may be typed as they stand, with files of one's own."""

DAILY = {
    "fit": ("setup", "where", "model", "known", "per", "undo", "refine", "profile", "sample", "out", "json", "quiet"),
}
"""What ``--help`` shows of commands with many options; ``--help-all`` shows the rest."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        the exit code.
    """
    try:
        try:
            return _carry_out(arguments)
        finally:  # help ends by an exit of its own
            sys.stdout.flush()
    except BrokenPipeError:  # whoever reads the output, `head` for instance, has seen enough
        _close_output()
        return ExitCode.DONE
    except OSError as problem:  # the output, or what no command expects of its files
        _close_output()
        print(f"rotorfit: the output cannot be written: {shown(sentence(problem))}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except ImportError as problem:
        say(f"{problem}: a package is missing or damaged; install it, or rotorfit anew")
        return ExitCode.BAD_INPUT
    except Exception:
        traceback.print_exc()
        say(f"this is an error of rotorfit {VERSIONS}, not of your data: please report it, with the lines above")
        return ExitCode.ERROR_OF_THE_PROGRAM


def _carry_out(arguments: Sequence[str] | None) -> int:
    """Do what the words say; what is wrong with them, or with the files that they name, becomes a sentence."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    asked = [word for word in words if word in COMMANDS][:1]
    if asked:
        cache_home()  # before packages that have caches are loaded
    parser = build_parser(asked)
    _refuse_misspelt(parser, words)
    options = parser.parse_args(words)
    options.words = words
    if options.command is None:
        parser.print_help()
        return ExitCode.DONE
    named = (getattr(options, name, None) for name in ("setup", "study", "fit"))
    read = [path for path in (*getattr(options, "files", ()), *named) if path is not None]
    try:
        with warnings.catch_warnings(), errstate(all="ignore"), protected_inputs(read):
            # As a sentence, without the file and line of the program that it comes from; what NumPy says of single
            # operations is none.
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            return int(options.command(options))
    except BadInputError as problem:
        print(f"rotorfit: {shown(str(problem))}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except LinAlgError as problem:  # equations of motion that cannot be solved, as known values are
        print(f"rotorfit: {problem}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt as stop:
        print(f"rotorfit: interrupted, {stop.args[0] if stop.args else 'nothing was written'}", file=sys.stderr)
        return ExitCode.INTERRUPTED


def _close_output() -> None:
    """Drop what is still to be printed: nor may the last flush complain."""
    with suppress(UnsupportedOperation):  # an output of no file, as of tests and notebooks
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Lines(argparse.HelpFormatter):
    """Help that keeps the lines of examples apart."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(super(_Lines, self)._fill_text(line, width, indent) for line in text.splitlines()) + "\n"


class _DailyHelp(argparse.Action):
    """Prints the help of the options that are used every day."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        daily = {"--help-all", *(f"--{name}" for name in self.const)}
        for action in parser._actions:
            if action.option_strings and not daily & {*action.option_strings}:
                action.help = argparse.SUPPRESS
        parser.usage = "%(prog)s [OPTION ...] FILE [FILE ...]"
        parser.print_help()
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """A parser that refuses in one sentence, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        near = wrong and nearest(wrong[1], re.findall(r"[\w-]+", wrong[2]), 0.5)
        if near:
            message = f"{message.partition(' (choose')[0]}, did you mean {near!r}?"
        self.exit(ExitCode.BAD_INPUT, f"rotorfit: {message}; `{self.prog} --help` says what there is\n")


def _refuse_misspelt(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Name the option that was meant, before anything is found to be missing."""
    known = _options_of(parser)
    for word in (word.partition("=")[0] for word in words if word.startswith("--")):
        near = "" if word in known or word == "--" else nearest(word, known, 0.6)
        if near:
            parser.error(f"unrecognized arguments: {word}, did you mean {near}?")


def _options_of(parser: argparse.ArgumentParser) -> list[str]:
    """All options of a parser and of the commands below it."""
    found: list[str] = []
    for action in parser._actions:
        found += action.option_strings
        if isinstance(action.choices, dict):
            found += [option for below in action.choices.values() for option in _options_of(below)]
    return found


def build_parser(filled: Iterable[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The words that the command line understands, with the options of some commands; of all by default."""
    whole = _Parser(
        prog="rotorfit",
        allow_abbrev=False,
        description="Identify rotor and fluid-force parameters from rotating-force perturbation tests.",
        epilog="Exit codes: 0 done, 1 the data have an error or the fit or sampling did not converge, 2 bad input, "
        "3 an alarm, 4 an error of the program.",
    )
    whole.add_argument("--version", action="version", version=f"rotorfit {VERSIONS}")
    whole.set_defaults(command=None)
    group = whole.add_subparsers(metavar="COMMAND")
    for name, (home, help) in COMMANDS.items():
        lines = [f"rotorfit {line}" for line in EXAMPLES[name].splitlines()]
        example = "\n".join(["Examples:", *lines]) if len(lines) > 1 else f"Example: {lines[0]}"
        added = group.add_parser(
            name, help=help, description=help, epilog=example, formatter_class=_Lines, allow_abbrev=False,
            add_help=name not in DAILY,
        )  # fmt: skip
        if name in DAILY:
            words = "show the options of every day and exit"
            added.add_argument("-h", "--help", action=_DailyHelp, nargs=0, const=DAILY[name], help=words)
            added.add_argument("--help-all", action="help", help="show all options and exit")
        if name in filled:
            module, function = import_module(f"rotorfit.apps.cli.{home}"), name.replace("-", "_")
            getattr(module, f"add_{function}")(added)
            added.set_defaults(command=getattr(module, function))
    return whole


def add_completion(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit completion``."""
    words = "the shell; source the printed script when it starts"
    to.add_argument("shell", choices=("bash", "zsh", "tcsh"), help=words)


@answered
def completion(options: argparse.Namespace) -> Answer:
    """The script."""
    try:
        import shtab
    except ImportError as reason:
        raise BadInputError('completion needs shtab: pip install "rotorfit[completion]"') from reason
    return Answer(text=shtab.complete(build_parser(), options.shell))
