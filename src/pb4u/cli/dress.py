"""`pb4u dress`: a sewing pattern put on a body, once for all simulations."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.cli.console import (
    BodyShape,
    JsonFlag,
    ShapeFlag,
    check_json_target,
    keep_inputs,
    say,
    verb,
    with_notes,
    write_json,
)
from pb4u.errors import InputError
from pb4u.io.atomic_file import check_writable

_KINDS = (".npz", ".obj", ".json", ".svg", ".png")


@verb()
def dress(
    pattern: Annotated[Path, typer.Argument(metavar="PATTERN")],
    out: Annotated[list[Path], typer.Option(metavar="FILE")],
    body: Annotated[str, typer.Option(metavar="NAME|FILE")] = DEFAULT_BODY,
    body_shape: ShapeFlag = None,
    triangles: int = 5000,
    material: Annotated[str, typer.Option(metavar="NAME|FILE")] = "default",
    json: JsonFlag = None,
) -> None:
    """Sew a pattern around a body, and let it settle under gravity.\f

    Args:
        pattern: Sewing pattern: GarmentCode's .json, a .toml that names an SVG and its seams, or a dressed garment.
        out: Repeatable. .npz: the dressed garment with its pattern, for --garment; .obj: its mesh, UVs the pattern;
            .json: the pattern; .svg, .png: a picture of the pattern.
        body: Body that wears it.
        body_shape: shape of the body.
        triangles: Triangles of the garment.
        material: Material of the cloth.
        json: file for the result.

    Raises:
        InputError: the pattern cannot be sewn or put on this body, or a file cannot be read or written.
    """
    check_json_target(json)
    keep_inputs([pattern, body, material], [("--json", json), *(("--out", file) for file in out)])
    for file in out:
        if file.suffix.lower() not in _KINDS:
            raise InputError(f"--out writes {', '.join(_KINDS)}; {file} has another suffix.")
        check_writable(file, "--out")

    from pb4u.body.library import load_boned_body
    from pb4u.garment.material import load_material
    from pb4u.pattern.dressing import dress as dressed_on
    from pb4u.pattern.files import read_pattern, write_worn

    figure, sewn = load_boned_body(body, BodyShape.of(body_shape)), read_pattern(pattern)
    began = time.perf_counter()
    dressed = dressed_on(sewn, figure, triangles, load_material(material))
    seconds = time.perf_counter() - began
    for file in out:
        write_worn(file, dressed, figure)
    report: dict[str, Any] = {"seconds": round(seconds, 2), **dressed.to_json()}
    say(
        f"{sewn.name}: {len(sewn.panels)} panels, {len(sewn.seams)} seams, {report['triangles']} triangles, sewn on "
        f"{figure.name} in {seconds:.1f} s; {report['crossings']} crossings, {1000 * report['depth']:.1f} mm in the "
        f"body at most. Wrote {', '.join(map(str, out))}."
    )
    write_json(with_notes(report), json)
