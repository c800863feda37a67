"""`pb4u measure-body`: a body's measures, from which GarmentCode makes patterns that fit it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.cli.console import BodyShape, JsonFlag, ShapeFlag, check_json_target, keep_inputs, tell, verb
from pb4u.errors import InputError
from pb4u.io.atomic_file import check_writable


@verb()
def measure_body(
    out: Annotated[Path, typer.Option(metavar="FILE.yaml")],
    body: Annotated[str, typer.Option(metavar="NAME|FILE")] = DEFAULT_BODY,
    body_shape: ShapeFlag = None,
    json: JsonFlag = None,
) -> None:
    """Measure a body for GarmentCode: 26 lengths and angles [cm, degrees].\f

    Args:
        out: GarmentCode body file to write.
        body: Body to measure.
        body_shape: shape of the body.
        json: file for the result.

    Raises:
        InputError: the body has no bones, or a file cannot be read or written.
    """
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"Measures are written as .yaml; {out} has another suffix.")
    keep_inputs([body], [("--out", out), ("--json", json)])
    check_writable(out, "--out")
    check_json_target(json)

    from pb4u.body.library import load_boned_body
    from pb4u.io.atomic_file import replace_file
    from pb4u.pattern.body_measurements import body_measurements, measurements_yaml

    figure = load_boned_body(body, BodyShape.of(body_shape))
    measures = body_measurements(figure)
    replace_file(out, measurements_yaml(measures).encode())
    summary = {"body": figure.name, "measures": measures, "out": str(out)}
    tell(summary, json, f"Wrote {out}, {len(measures)} measures of {figure.name}.")
