"""`pb4u measure-body`: a body's measures, from which GarmentCode makes patterns that fit it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pb4u.cli.console import BodyShape, ShapeFlag, keep_inputs, say
from pb4u.io.atomic_file import check_writable


def measure_body(
    out: Annotated[Path, typer.Option(metavar="FILE.yaml", help="GarmentCode body file to write.")],
    body: Annotated[str, typer.Option(metavar="NAME|FILE", help="Body to measure.")] = "woman",
    body_shape: ShapeFlag = None,
) -> None:
    """Measure a body for GarmentCode: 26 lengths and angles [cm, degrees].\f

    Each argument is described by its `help`.

    Raises:
        InputError: the body has no bones, or a file cannot be read or written.
    """
    keep_inputs([body], [("--out", out)])
    check_writable(out, "--out")

    from pb4u.body.library import load_boned_body
    from pb4u.io.atomic_file import replace_file
    from pb4u.pattern.body_measurements import measurements_yaml

    figure = load_boned_body(body, BodyShape.of(body_shape))
    replace_file(out, measurements_yaml(figure).encode())
    say(f"Wrote {out}, 26 measures of {figure.name}.")
