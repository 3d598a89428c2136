"""``rotorfit template`` and ``rotorfit look``: a setup to fill in for a recording, and figures of what it holds."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rotorfit.cli.errors import DONE, checked

TEMPLATE = "print a setup, rig.toml, to fill in for a recording of raw signals"


def add_template_options(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit template``."""
    to.add_argument("file", type=Path, metavar="FILE", help="recording (.h5 .tdms .mat .wav .uff .csv .parquet)")


def run_template(options: argparse.Namespace) -> int:
    """Print the setup."""
    from rotorfit.recordings.template import template

    sys.stdout.write(checked(lambda: template(options.file)))
    return DONE
