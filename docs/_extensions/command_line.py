"""The directive ``command-line``: every command and option, from the parser that the command line itself uses."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from rotorfit.apps.cli.main import build_parser


def plain(text: str) -> str:
    """Text that reStructuredText takes as it is."""
    return re.sub(r"([\\*`|_])", r"\\\1", text)


def explained(action: argparse.Action, program: str) -> str:
    """The help of an option, with its default where the help names it."""
    return plain((action.help or "") % {**vars(action), "prog": program})


def forms(action: argparse.Action) -> list[str]:
    """How an argument or option is written: ``--known NAME=VALUE``."""
    choices = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else ""
    name = choices or action.dest.upper()
    values = action.metavar if isinstance(action.metavar, tuple) else (action.metavar or name,)
    value = "" if action.nargs == 0 else " ".join(values)
    if action.nargs in ("+", "*"):
        value += " ..."
    return [f"{option} {value}".rstrip() for option in action.option_strings] or [value]


def lines_of(parser: argparse.ArgumentParser) -> Iterator[str]:
    """One command as reStructuredText."""
    purpose = plain(parser.description or "")
    yield from (parser.prog, "-" * len(parser.prog), "", f"{purpose[:1].upper()}{purpose[1:]}.", "")
    yield from (f".. program:: {parser.prog}", "")
    for group in parser._action_groups:
        left_out = argparse._HelpAction | argparse._SubParsersAction
        actions = [action for action in group._group_actions if not isinstance(action, left_out)]
        if actions and group.title not in ("options", "positional arguments"):
            yield from (f"*{plain(group.title or '')}*", "")
        for action in actions:
            yield from (f".. option:: {', '.join(forms(action))}", "", f"   {explained(action, parser.prog)}", "")


class CommandLine(SphinxDirective):
    """Sections of all commands."""

    def run(self) -> list[nodes.Node]:
        """Read the parser, and let Sphinx read what it says."""
        whole = build_parser()
        commands = next(action for action in whole._actions if isinstance(action, argparse._SubParsersAction))
        text = [plain(whole.epilog or ""), ""]
        for parser in commands.choices.values():
            text += lines_of(parser)
            for actions in (one for one in parser._actions if isinstance(one, argparse._SubParsersAction)):
                for action in actions.choices.values():
                    text += lines_of(action)
        return self.parse_text_to_nodes("\n".join(text), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive; the page is read again whenever something was changed."""
    app.add_directive("command-line", CommandLine)
    app.connect("env-get-outdated", lambda *_: ["reference/command_line"])
    return {"parallel_read_safe": True, "parallel_write_safe": True}
