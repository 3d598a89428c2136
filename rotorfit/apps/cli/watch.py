"""``rotorfit watch``: fit what arrives in a folder, and raise an alarm when the machine has changed."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rotorfit.apps.cli.answer import ExitCode, ProgressLine, checked, say
from rotorfit.apps.cli.arguments import add_false_alarm, add_jobs, option, workers_of
from rotorfit.apps.cli.history import add_followed, add_study, added_json, added_words
from rotorfit.apps.store.page import page_of, write_page
from rotorfit.apps.store.store import Store, study_for_store
from rotorfit.apps.store.watch import FolderWatch, MachineState, sources_in
from rotorfit.apps.study_files.wording import json_text, sentence
from rotorfit.base.atomic_file import refuse_input
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.identify.options.kinds import positive_word, words


def add_watch(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    help = "folder in which files arrive; a folder in it is one test"
    to.add_argument("folder", type=Path, metavar="FOLDER", help=help)
    add_study(to, required=True)
    option(to, "--store STORE", "machine.db; machine.html is beside it", Path, required=True)
    add_followed(to)
    option(to, "--against A,B", "conditions that a level may depend on", words, default=())
    help = "probability that a machine which does not change ever raises an alarm [%(default)g]"
    add_false_alarm(to, help, FolderWatch)
    option(to, "--running-speed RPM", "watch the threshold speed against it", positive_word)
    option(to, "--margin X", "threshold speed over --running-speed that is required [1]", positive_word)
    option(to, "--on-alarm CMD", "program and arguments; it reads the alarm as JSON", default="")
    add_jobs(to, "fit")
    option(to, "--once", "one round, for cron; exit code 3 while an alarm stands")
    option(to, "--every S", "seconds between rounds [%(default)g]", positive_word, default=10.0)
    help = "seconds for which a file must not change before it is read [%(default)g]"
    option(to, "--settle S", help, float, of=FolderWatch)
    option(to, "--json", "print events as JSON, one per line")
    option(to, "--quiet", "print alarms only")


def watch(options: argparse.Namespace) -> ExitCode:
    """One round, or rounds without end."""
    with ExitStack() as stack:
        made = checked(lambda: _watch(options))
        made.executor = checked(lambda: stack.enter_context(workers_of(options)))
        return _go_round(made, options)


def _go_round(watch: FolderWatch, options: argparse.Namespace) -> ExitCode:
    if options.once:
        states = checked(lambda: _take_in_and_report(watch, wait=True))
        if not options.json and not options.quiet:
            print("\n".join(state.sentence(rule) for state in states for rule in state.rules) or "no test yet")
        return ExitCode.ALARM if any(state.alarms for state in states) else ExitCode.DONE
    said = ""
    while True:
        try:
            _take_in_and_report(watch)
            said = ""
        except BrokenPipeError:
            raise
        except (OSError, ValueError) as problem:  # a network that is down, a full disk: the next round may do
            if str(problem) != said:
                _tell(options, {"event": "problem", "said": sentence(problem)})
            said = str(problem)
        time.sleep(options.every)


def _take_in_and_report(watch: FolderWatch, *, wait: bool = False) -> list[MachineState]:
    """Look, fit, raise alarms, and write the page where something is new."""
    added = watch.look()
    if wait and watch.waiting():
        time.sleep(watch.settle)
        added += watch.look()
    states = watch.states()
    if added or wait or not page_of(watch.store).exists():
        write_page(watch.store, states)
    return states


def _watch(options: argparse.Namespace) -> FolderWatch:
    _check(options)
    study = study_for_store(options.study)
    if study is None:
        raise ValueError("--study is needed")
    if options.setup is not None and not options.setup.is_file():
        raise FileNotFoundError(2, "there is no such file", str(options.setup))
    others = sources_in(options.folder, replace(study, files=()), options.setup)
    if others and not sources_in(options.folder, study, options.setup):
        patterns = ", ".join(file.path.name for file in study.files)
        say(f"none of the {len(others)} files in {options.folder} has a name that the study's files name: {patterns}")
    speed = None if options.running_speed is None else options.running_speed * RAD_S_PER_RPM
    store = Store(options.store)
    refuse_input(page_of(store))
    return FolderWatch(
        folder=options.folder,
        store=store,
        study=study,
        names=tuple(options.follow or ()),
        false_alarm=options.false_alarm,
        running_speed=speed,
        margin=options.margin or 1.0,
        against=tuple(options.against),
        since=options.since,
        setup=options.setup,
        machine=options.machine,
        settle=options.settle,
        on_alarm=options.on_alarm,
        tell=partial(_tell, options),
        progress=ProgressLine(enabled=not (options.quiet or options.json) and sys.stderr.isatty()),
    )


def _check(options: argparse.Namespace) -> None:
    """Refuse, before anything is fitted, what could not work."""
    if not options.folder.is_dir():
        raise NotADirectoryError(f"{options.folder} is no folder; give the one in which files arrive")
    if not 0 <= options.settle < float("inf"):
        raise ValueError(f"--settle takes seconds from 0, got {options.settle:g}")
    if options.margin is not None and options.running_speed is None:
        raise ValueError("--margin is a factor on the running speed: give --running-speed RPM too")
    if options.on_alarm:
        try:
            program = shlex.split(options.on_alarm, posix=os.name == "posix")[0]
        except (ValueError, IndexError) as problem:
            raise ValueError(f"--on-alarm {options.on_alarm!r} is no command: {problem}") from problem
        if shutil.which(program) is None:
            raise FileNotFoundError(f"--on-alarm: there is no program {program} that can be run")


def _tell(options: argparse.Namespace, event: dict[str, Any]) -> None:
    """One event, as a JSON line or a sentence."""
    if event["event"] == "test":
        added, fits = event["added"], {event["fit"].number: event["fit"]}
        if options.json:
            print(json_text({"event": "test", **added_json(added, fits)}, indent=None), flush=True)
        elif not options.quiet:
            print(added_words(added, fits), flush=True)
    elif options.json:
        print(json_text(event, indent=None), flush=True)
    elif event["event"] == "alarm":
        print(event["said"], flush=True)
    elif event["event"] == "refused":
        say(f"{event['source']}: refused: {event['reason']}")
    else:
        say(event["said"])
