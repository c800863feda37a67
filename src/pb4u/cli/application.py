"""The verbs of `pb4u` together."""

from __future__ import annotations

from typing import Annotated

import typer

from pb4u import __version__
from pb4u.cli import (
    assets,
    batch,
    check,
    convert_weights,
    dress,
    evaluate,
    info,
    measure_body,
    simulate,
    train,
    trajectory_verbs,
)
from pb4u.cli.verbs import Verbs, brief_verb

app = typer.Typer(
    cls=Verbs,
    name="pb4u",
    help="Garment simulation on moving bodies: any body, any garment, any triangle count.",
    epilog="Add --debug to any command to see where an error came from. Lengths are metres, times seconds.",
    no_args_is_help=True,
    add_completion=False,
    # The usual markup takes [fixed] for a style and leaves it out.
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
for verb, brief in (
    (simulate.simulate, ("scene", "garment", "material", "triangles", "body", "motion", "frames", "model", "out")),
    (trajectory_verbs.view, ()),
    (check.check, ()),
    (dress.dress, ()),
    (measure_body.measure_body, ()),
    (trajectory_verbs.convert, ("trajectory", "out", "every", "range_", "on", "view", "size")),
    (convert_weights.convert_weights, ()),
    (train.train, ()),
    (evaluate.evaluate, ("protocol", "models", "garments", "motions", "levels", "frames", "workers", "out", "retry")),
    (batch.batch, ("jobs", "out", "workers", "half", "plan", "retry")),
    (info.info, ()),
):
    app.command(cls=brief_verb(*brief))(verb)
app.add_typer(assets.group, name="assets")


def _tell_version(is_given: bool) -> None:
    if is_given:
        print(f"pb4u {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_tell_version, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
