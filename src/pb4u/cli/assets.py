"""`pb4u assets`: what is built in, and any of it as a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.cli.console import BodyShape, JsonFlag, ShapeFlag, check_json_target, tell, verb, write_json
from pb4u.cli.verbs import Verb, Verbs
from pb4u.errors import InputError, refuse_unknown
from pb4u.io.atomic_file import check_writable
from pb4u.progress import progress_bar

if TYPE_CHECKING:
    from pb4u.body.body_model import ShapedBody
    from pb4u.garment.material import Material
    from pb4u.geometry.mesh_file import PolygonMesh

_SUFFIXES = {"garment": ".obj", "body": ".obj", "motion": ".npz", "material": ".json"}
"""What each kind of asset is written as."""

_PICTURES = (".png", ".jpg", ".jpeg")

_WHAT = {
    "tshirt": "short sleeves, to the hips",
    "tanktop": "no sleeves, close, to the hips",
    "longsleeve": "sleeves to the wrists, to the hips",
    "dress": "no sleeves, flared, to the calves",
    "fitted_dress": "short sleeves, close, to above the knees",
    "cardigan": "open in front, sleeves to the wrists, wide: over other garments",
    "trousers": "to the ankles, held by the waistband",
    "skirt": "flared, to the knees, held by the waistband",
    "shirt": "buttoned, with collar, placket and cuffs, of a pattern by measure",
    "jeans": "straight, with yoke and waistband, which holds them, of a pattern by measure",
    "circle_dress": "no sleeves, fitted with darts, full-circle skirt to the knees, of a pattern by measure",
    "walk": "a steady walk: easy for cloth",
    "run": "a steady run: arms and legs move fast",
    "jump": "crouches, jumps on the spot and lands: cloth flies up",
    "arms": "lifts the arms to the sides, overhead and across the chest: sleeves",
    "twist": "turns the trunk from side to side: wrinkles at the waist",
    "squat": "deep knee bends: thighs and belly fold, hard for cloth",
    "turn": "turns on the spot: skirts swing out",
    "dance": "side steps, swaying hips and sweeping arms: all of it moves",
}
"""What each garment and motion is good for."""

group = typer.Typer(
    cls=Verbs, help="List the built-in bodies, motions, garments, materials and models; write any of them to a file."
)


@group.callback(invoke_without_command=True)
def assets(
    context: typer.Context,
    json: JsonFlag = None,
) -> None:
    """List the built-in bodies, motions, garments, materials and models; write any of them to a file."""
    if context.invoked_subcommand:
        return
    check_json_target(json)
    assets_by_kind = catalogue()
    write_json(assets_by_kind, json)
    if json == "-":
        return
    from rich.console import Console
    from rich.table import Table

    for kind, rows in assets_by_kind.items():
        table = Table(
            title=kind, title_justify="left", title_style="bold", show_header=False, box=None, padding=(0, 2, 0, 2)
        )
        for row in rows:
            table.add_row(row["name"], row.get("description", ""))
        Console().print(table)


def catalogue() -> dict[str, list[dict[str, Any]]]:
    """Descriptions of everything built in, by kind."""
    from dataclasses import asdict

    from pb4u.body.library import body_names
    from pb4u.garment.cuts import CUTS
    from pb4u.garment.drafted import DRAFTED
    from pb4u.garment.library import LEVELS
    from pb4u.garment.material import BUILT_IN
    from pb4u.motion.library import motion_names
    from pb4u.simulation.models import model_descriptions

    fabrics = {name: cut.fabric for name, cut in CUTS.items()}
    fabrics |= {name: garment.fabric for name, garment in DRAFTED.items()}
    return {
        "bodies": [{"name": name, **_body_entries(name)} for name in body_names()],
        "motions": [{"name": name, "description": _WHAT[name]} for name in motion_names()],
        "garments": [
            {
                "name": name,
                "description": f"{_WHAT[name]}; of {fabric}",
                "material": fabric,
                "levels": dict(LEVELS),
            }
            for name, fabric in fabrics.items()
        ],
        "materials": [
            {"name": name, "description": _material_line(material), **asdict(material)}
            for name, material in BUILT_IN.items()
        ],
        "models": [{"name": name, "description": text} for name, text in model_descriptions().items()],
    }


def _body_entries(name: str) -> dict[str, Any]:
    from pb4u.body.library import load_boned_body

    body = load_boned_body(name)
    low, high = (load_boned_body(name, {"height": share}).height for share in (0.0, 1.0))
    ranges = f"height 0 to 1: {low:.2f} to {high:.2f} m; weight 0 to 1: thin to fat; muscle 0 to 1: slack to strong"
    return {"description": f"{body.height:.2f} m; --body-shape {ranges}", "shape": dict(body.shape)}


def _material_line(material: Material) -> str:
    warp, weft, bends = material.warp_stiffness, material.weft_stiffness, 0.25e6 * material.bending
    return f"{1e3 * material.density:.3g} g/m^2, warp {warp:.4g} and weft {weft:.4g} N/m, bends with {bends:.2g} uN m"


@group.command("write", cls=Verb)
@verb()
def write(
    name: str,
    out: Path,
    body: str = DEFAULT_BODY,
    body_shape: ShapeFlag = None,
    triangles: int | None = None,
    frames: int = 60,
    fps: float = 30.0,
    json: JsonFlag = None,
) -> None:
    """Write one built-in asset, or a body of your own at rest, to a file.\f

    Args:
        name: Name of a built-in garment, body, motion or material, or a file of a body, written at rest.
        out: OBJ for garments and bodies, JSON for materials, NPZ for motions: the body that performs one, which
            `pb4u simulate` takes as --body.
        body: Body that a garment is cut for, or that performs a motion.
        body_shape: shape of the body.
        triangles: Triangles of a garment.
        frames: Frames of a motion.
        fps: Frames per second of a motion.
        json: file for the result.

    Raises:
        InputError: there is no such asset, or the file cannot be written or has the wrong suffix for its kind.
    """
    from pb4u.body.library import body_names, load_boned_body
    from pb4u.garment.library import garment_names
    from pb4u.garment.material import BUILT_IN
    from pb4u.motion.library import motion_names

    names_by_kind = {"garment": garment_names(), "body": body_names(), "motion": motion_names(), "material": BUILT_IN}
    kinds = {name: kind for kind, names in names_by_kind.items() for name in names}
    if name not in kinds and Path(name).exists():
        kinds[name] = "body"
    refuse_unknown("built-in asset", [name], kinds)
    kind = kinds[name]
    if out.suffix.lower() != _SUFFIXES[kind]:
        raise InputError(f"{name} is written as {_SUFFIXES[kind]}; {out} has another suffix.")
    check_writable(out, "the asset")
    check_json_target(json)
    if kind != "material" and (frames < 1 or not 1.0 <= fps <= 1000.0):
        raise InputError(f"A motion has 1 frame or more at 1 to 1000 per second, not {frames} at {fps:g}.")

    def figure() -> ShapedBody:
        return load_boned_body(name if kind == "body" else body, BodyShape.of(body_shape))

    writers = {
        "garment": lambda: _write_garment(name, figure(), triangles, out),
        "body": lambda: _write_body(figure(), out),
        "motion": lambda: _write_motion(name, figure(), frames, fps, out),
        "material": lambda: _write_material(name, out),
    }
    tell({"name": name, "kind": kind, "out": str(out), **writers[kind]()}, json, f"Wrote {out}")


def _write_garment(name: str, figure: ShapedBody, triangles: int | None, out: Path) -> dict[str, Any]:
    from pb4u.garment.library import LEVELS, build_garment

    garment = build_garment(name, figure, LEVELS["base"] if triangles is None else triangles)
    return _write_mesh(figure, garment.mesh, out)


def _write_body(figure: ShapedBody, out: Path) -> dict[str, Any]:
    from pb4u.geometry.mesh_file import PolygonMesh

    return _write_mesh(figure, PolygonMesh(figure.vertices, tuple(figure.faces)), out)


def _write_mesh(figure: ShapedBody, mesh: PolygonMesh, out: Path) -> dict[str, Any]:
    """Write the mesh of a body, or of what is cut for it, as OBJ."""
    from pb4u.geometry.obj_file import write_obj

    write_obj(out, mesh)
    return {"body": figure.name, "vertices": len(mesh.vertices), "triangles": len(mesh.polygons)}


def _write_motion(name: str, figure: ShapedBody, frames: int, fps: float, out: Path) -> dict[str, Any]:
    from pb4u.body.sequence_files import write_vertex_sequence
    from pb4u.motion.library import load_motion

    moving = figure.posed(load_motion(name).poses(figure, fps, frames))
    write_vertex_sequence(out, moving.positions(0, frames).numpy(), figure.faces, fps, figure.contact)
    summary = {"body": figure.name, "vertices": len(figure.vertices), "triangles": len(figure.faces)}
    return {**summary, "frames": frames, "fps": fps}


def _write_material(name: str, out: Path) -> dict[str, Any]:
    from dataclasses import asdict

    from pb4u.garment.material import BUILT_IN

    write_json(asdict(BUILT_IN[name]), str(out))
    return {}


@group.command("swatches", cls=Verb)
@verb()
def swatches(
    out: Path,
    material: Annotated[list[str] | None, typer.Option(metavar="NAME|FILE")] = None,
    edge: float = 14.0,
    json: JsonFlag = None,
) -> None:
    """Drape a disc of each fabric over a smaller one, as a laboratory does, and draw them on one sheet.\f

    Below each are its drape coefficient, the share of the free ring that its shadow covers, and the published range of
    its class. A disc takes 10 to 60 seconds.

    Args:
        out: PNG or JPEG to write.
        material: Built-in material or JSON file; repeatable. Default: all fabrics.
        edge: Edge length of the disc's triangles [mm], 3 to 30: 14 is that of a garment of 11,000.
        json: file for the result.

    Raises:
        InputError: there is no such material, or the file cannot be written or is not a picture.
    """
    from pb4u.export.swatches import Swatch, write_swatches
    from pb4u.garment.material import FABRICS, load_material
    from pb4u.measures.drape_test import drape_test, published

    if out.suffix.lower() not in _PICTURES:
        raise InputError(f"Swatches are drawn as {' or '.join(_PICTURES)}; {out} has another suffix.")
    check_writable(out, "the swatches")
    check_json_target(json)
    made_of = {name: load_material(name) for name in material or FABRICS}
    sheet, rows = [], []
    with progress_bar("drape") as progress:
        for number, (name, fabric) in enumerate(made_of.items(), start=1):
            test, band = drape_test(fabric, 1e-3 * edge), published().get(name)
            caption = f"{test.coefficient:.0f} %" + (f", published {band.lowest:g} to {band.highest:g}" if band else "")
            sheet.append(Swatch(test.draped, (Path(name).stem, caption)))
            rows.append(
                {
                    "material": name,
                    "drape_coefficient": test.coefficient,
                    "folds": test.folds,
                    "unsolved_steps": test.unsolved,
                    "published": band and band._asdict(),
                }
            )
            progress(number, len(made_of))
    write_swatches(sheet, out)
    tell({"out": str(out), "edge": edge, "swatches": rows}, json, f"Wrote {out}")


@group.command("pack", cls=Verb)
@verb()
def pack(
    out: Path,
    preset: str = "small",
    recordings: Path | None = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    json: JsonFlag = None,
) -> None:
    """Write what a training machine needs: it then needs torch, numpy and safetensors only.\f

    Args:
        out: The .npz to write.
        preset: Training whose data is packed; `pb4u train --help` lists them.
        recordings: Folder of recordings to pack as well, as for `pb4u train`.
        set_: Replace a field of the preset, as in data.shapes=8.
        json: file for the result.

    Raises:
        InputError: the file cannot be written or is no .npz, or a preset, a setting or a recording cannot be used.
    """
    from pb4u.training.collection import collect
    from pb4u.training.configuration import TRAININGS, with_settings
    from pb4u.training.packed_data import save_training_data

    if out.suffix.lower() != ".npz":
        raise InputError(f"A training pack is written as .npz; {out} has another suffix.")
    check_writable(out, "the pack")
    check_json_target(json)
    configuration = with_settings(TRAININGS.named(preset).configuration, set_ or ())
    with progress_bar("pack") as progress:
        data = collect(configuration.data, recordings, configuration.seed, progress)
    save_training_data(data, out)
    counts = {"bodies": len(data.bodies), "garments": len(data.outfits), "clips": len(data.clips)}
    size = out.stat().st_size
    tell(
        {"out": str(out), "preset": preset, **counts, "bytes": size},
        json,
        f"Wrote {out}: {', '.join(f'{count} {what}' for what, count in counts.items())}, {size / 1e6:.1f} MB; train "
        f"with `pb4u train --pack {out.name} --preset {preset} --out RUN`, and the same --set.",
    )
