"""What there is: ``rotorfit models`` and ``template``."""

from __future__ import annotations

import argparse
from pathlib import Path

from rotorfit.apps.cli.answer import Answer, answered
from rotorfit.apps.cli.arguments import option
from rotorfit.base.names import unknown_name
from rotorfit.lab.io.templates import KINDS, example
from rotorfit.models import MODELS, KnownStructure

RECORDING = "recording (.h5 .tdms .mat .npz .wav .uff .csv .parquet)"


def add_template(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit template``."""
    to.add_argument("what", metavar="KIND|FILE", help=f"{', '.join(KINDS)}; or a {RECORDING}")


@answered
def template(options: argparse.Namespace) -> Answer:
    """An example, or a setup to fill in."""
    what = options.what
    if what in KINDS:
        return Answer(text=example(what).removesuffix("\n"))
    if not Path(what).exists() and not Path(what).suffix:
        raise ValueError(f"{unknown_name('kind of file', what, KINDS)}; nor is there a recording of that name")
    from rotorfit.lab.recordings.rig.template import template  # late: with it comes what reads recordings

    return Answer(text=template(Path(what)).removesuffix("\n"))


def add_models(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit models``."""
    to.add_argument("name", nargs="?", help="only this one")
    option(to, "--json", "print the parameters as JSON instead of tables")


@answered
def models(options: argparse.Namespace) -> Answer:
    """The models with their parameters."""
    one = KnownStructure([[1.0]], None, None, [[1.0]], planes={"journal": 0}, fluid="journal", dofs=("z",))
    known = {**{name: model() for name, model in MODELS.items()}, one.name: one}
    if options.name is not None and options.name not in known:
        raise ValueError(unknown_name("model", options.name, MODELS))
    chosen = list(known.values()) if options.name is None else [known[options.name]]
    tables = []
    for model in chosen:
        head, _, rows = model.describe().partition("\n")
        first = (model.__doc__ or "").partition("\n")[0]
        tables.append(f"{head}\n  {first}\n{rows}")
    rows_of = {model.name: [vars(parameter) for parameter in model.parameters] for model in chosen}
    return Answer(text="\n\n".join(tables), plain=lambda: rows_of)
