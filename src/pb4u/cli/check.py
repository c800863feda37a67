"""`pb4u check`: what is wrong with a garment, body or motion before it is simulated, and the mend."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.cli.console import (
    BodyShape,
    CropFlag,
    JsonFlag,
    ShapeFlag,
    check_json_target,
    keep_inputs,
    verb,
    with_notes,
    write_json,
)
from pb4u.errors import InputError, InputNote, InputWarning, Pb4uError, warn
from pb4u.io.atomic_file import check_writable


@verb()
def check(
    file: Annotated[str | None, typer.Argument(metavar="GARMENT")] = None,
    garment: Annotated[list[str] | None, typer.Option(metavar="NAME|FILE")] = None,
    body: Annotated[str, typer.Option(metavar="NAME|FILE")] = DEFAULT_BODY,
    body_shape: ShapeFlag = None,
    body_units: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    motion: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    crop: CropFlag = None,
    triangles: int | None = None,
    fix: Annotated[Path | None, typer.Option(metavar="OUT.obj")] = None,
    json: JsonFlag = None,
) -> None:
    """Diagnose a garment (and a body and a motion) before simulating; each fault with its fix.

    The exit code is 1 if a simulation would refuse the garment, or with --fix the repaired garment.\f

    Args:
        file: Built-in garment, mesh file, sewing pattern or FILE.pkl:NAME of a dictionary; the same as --garment.
        garment: Built-in garment, mesh file, sewing pattern or FILE.pkl:NAME of a dictionary. Repeatable, inner first:
            then it also reports where garments cross each other.
        body: Body that is to wear it.
        body_shape: shape of the body.
        body_units: Unit of length of the body's file. Default: recognised by the size of a person.
        motion: Motion to read and retarget as well.
        crop: frames of the recording.
        triangles: Triangles of a built-in garment or a pattern.
        fix: Write a new file with the garment, after all repairs that are safe.
        json: file for the result.

    Raises:
        InputError: the arguments contradict each other, or a file cannot be read or written.
    """
    from pb4u.body.contact_region import share_out_of_contact
    from pb4u.body.library import load_body
    from pb4u.body.vertex_sequence import VertexSequence

    names = _named_garments(file, garment, motion, crop, fix)
    only = names[0] if names else None
    check_json_target(json)
    keep_inputs([*names, body, motion], [("--fix", fix), ("--json", json)])
    if fix is not None:
        _check_fix(fix, only)
    if triangles is not None:
        _warn_of_triangles(names)
    with warnings.catch_warnings():
        if names:  # a finding of each garment says so
            warnings.filterwarnings("ignore", ".*the body is not closed", InputWarning)
        figure = load_body(body, BodyShape.of(body_shape), units=body_units)
    for note in getattr(figure, "notes", ()):
        warn(note, InputNote)
    out = share_out_of_contact(
        figure.rest_vertices if isinstance(figure, VertexSequence) else figure.vertices, figure.faces, figure.contact
    )
    report: dict[str, Any] = {"body": {"name": figure.name, "out_of_contact_percent": round(100.0 * out, 1)}}
    refused = False
    if len(names) > 1:
        report |= _check_outfit(names, figure, body, triangles)
        refused = any(entry["refused"] for entry in report["garments"]) or bool(report["crossings"]["as_worn"])
    elif only is not None:
        report["garment"] = _check_garment(only, figure, body, triangles, fix)
        refused = (report["garment"] if fix is None else report["garment"]["remaining"])["refused"]
    if motion is not None:
        report["motion"] = _check_motion(motion, figure, crop)
    write_json(with_notes(report), json)
    if json != "-":
        _print(report, fix, body)
    if refused and fix is not None:
        raise Pb4uError(
            f"{fix} was not written: it would still be refused; repair the rest in the program it comes from first."
        )
    if refused:
        raise Pb4uError(f"{' with '.join(names)} would be refused; the findings above say how to repair it.")


def _named_garments(
    file: str | None,
    garment: list[str] | None,
    motion: str | None,
    crop: tuple[int, int] | None,
    fix: Path | None,
) -> list[str]:
    """Names of the garments to check; flags that contradict each other are refused."""
    if file is not None and garment:
        raise InputError(f"Give {file} or --garment {garment[0]}, not both; of several garments each as --garment.")
    names = garment or ([] if file is None else [file])
    if len(names) > 1 and fix is not None:
        raise InputError("--fix repairs one garment at a time; give only that one.")
    if repeated := next((name for k, name in enumerate(names) if name in names[:k]), None):
        raise InputError(f"The garment {repeated} is worn twice, and both would lie in the same place.")
    if not names and motion is None:
        raise InputError("Nothing to check: give a garment file or name, or --motion.")
    if crop is not None and motion is None:
        raise InputError("--crop cuts the recording of --motion; give that as well.")
    return names


def _warn_of_triangles(names: list[str]) -> None:
    from pb4u.scene.loaded_garments import kind_of

    if not all(kind_of(name).is_fitted for name in names):
        warn(
            "--triangles is for a built-in garment or a pattern and is not used here; a mesh is checked as it is, and "
            "`pb4u simulate --triangles` remeshes it.",
        )


def _check_outfit(names: list[str], figure: Any, body: str, triangles: int | None) -> dict[str, Any]:
    """Findings of each garment, and where they cross, as made and as worn over each other."""
    from pb4u.garment.fit import RestBody
    from pb4u.garment.tangles import OutfitCrossings

    reports = [_check_garment(name, figure, body, triangles, None) for name in names]
    if any(report["refused"] for report in reports):
        # What is in other units or far away crosses nothing yet.
        return {"garments": reports, "crossings": {"as_made": [], "as_worn": []}}
    crossings = OutfitCrossings.of([_placed(name, figure, triangles) for name in names], RestBody.of(figure))
    tangles = {
        when: [tangle.to_json() | {"sentence": str(tangle)} for tangle in getattr(crossings, when)]
        for when in ("as_made", "as_worn")
    }
    return {"garments": reports, "crossings": tangles}


def _placed(name: str, figure: Any, triangles: int | None) -> Any:
    """A garment as it is read for the body, where the body stands."""
    from pb4u.run import WornGarment
    from pb4u.scene.loaded_garments import kind_of, place, read

    return place(read(WornGarment(name, triangles=triangles), figure), figure, kind_of(name))


def _is_mesh(name: str) -> bool:
    from pb4u.scene.loaded_garments import KINDS, kind_of

    return kind_of(name) is KINDS["mesh"]


def _check_fix(fix: Path, garment: str | None) -> None:
    if fix.suffix.lower() != ".obj":
        raise InputError(f"--fix writes an .obj; {fix} has another suffix.")
    if garment is None or not _is_mesh(garment):
        raise InputError("--fix repairs only a garment from a mesh file; give such a file as GARMENT.")
    check_writable(fix, "--fix")


def _check_garment(name: str, figure: Any, body: str, triangles: int | None, fix: Path | None) -> dict[str, Any]:
    """Findings of a garment, what was mended, and findings of the mended garment."""
    from pb4u.garment.diagnosis import diagnose
    from pb4u.garment.garment_file import read_source
    from pb4u.garment.repair import repair
    from pb4u.geometry.obj_file import left_out, write_obj
    from pb4u.scene.loaded_garments import fabrics_of_parts

    unmended: dict[str, Any] = {"mended": [], "left": [], "remaining": None}
    if not _is_mesh(name):
        garment = _placed(name, figure, triangles)
        report = {"name": name, **diagnose(garment, figure, name, body).to_json(), **unmended}
        return report | {"parts": fabrics_of_parts(name, garment)}
    source = read_source(Path(name))
    report = {"name": name, **diagnose(source, figure, name, body).to_json(), **unmended, "parts": {}}
    if not report["refused"]:
        # What is odd about the file, or cannot be simulated as it is, is among the findings.
        with warnings.catch_warnings(), contextlib.suppress(InputError):
            warnings.simplefilter("ignore")
            report["parts"] = fabrics_of_parts(name, _placed(name, figure, None))
    if fix is not None:
        mended, changes, remarks = repair(source, figure)
        if lost := left_out(Path(name), source) if Path(name).suffix.lower() == ".obj" else []:
            remarks = (*remarks, f"Its {', '.join(lost)} are not in the repaired file.")
        remaining = diagnose(mended, figure, fix, body)
        # A file of this name is taken for a garment that can be worn.
        if not remaining.is_refused:
            write_obj(fix, mended)
        report |= {"mended": list(changes), "left": list(remarks), "remaining": remaining.to_json()}
    return report


def _check_motion(name: str, figure: Any, crop: tuple[int, int] | None) -> dict[str, Any]:
    from pb4u.body.body_model import ShapedBody
    from pb4u.motion.library import load_motion

    clip = load_motion(name, crop)
    summary: dict[str, Any] = {"name": name, "seconds": clip.duration, "notes": list(clip.notes)}
    if isinstance(figure, ShapedBody):
        frames = clip.available_frames(30.0) or 60
        positions = figure.posed(clip.poses(figure, 30.0, frames)).positions(0, frames)
        speed = (positions[1:] - positions[:-1]).norm(dim=-1).amax() * 30.0 if frames > 1 else 0.0
        summary |= {
            "frames_at_30_fps": frames,
            "lowest_point": float(positions[..., 1].min()),
            "fastest_point": float(speed),
        }
    return summary


def _lines(garment: dict[str, Any], fix: Path | None, body: str) -> list[str]:
    """What is said of a garment; with --fix what was mended, what stays and what was written."""
    from pb4u.garment.garment_file import fix_command

    command = fix_command(garment["name"], body)

    def line_of(finding: dict[str, Any]) -> str:
        # The command stands once, at the end.
        return f"{finding['sentence']} Fix: {finding['fix'].replace(f' with {command}', '')}."

    if fix is None:
        lines = [f"{finding['severity']}: {line_of(finding)}" for finding in garment["findings"]]
        lines += [] if garment["held_by"] is None else [f"held up by its {garment['held_by']}."]
        if garment["parts"]:
            parts = [part if fabric is None else f"{part} ({fabric})" for part, fabric in garment["parts"].items()]
            lines.append(f"parts, for `--material NAME.PART=MATERIAL`: {', '.join(parts)}.")
        if any(finding["mendable"] for finding in garment["findings"]):
            lines.append(f"To repair what can be repaired safely: {command}.")
        return lines if garment["findings"] else [f"{garment['name']}: nothing to repair.", *lines]
    remaining = [finding for finding in garment["remaining"]["findings"] if finding["severity"] != "note"]
    command, refused = fix_command(fix, body), garment["remaining"]["refused"]
    # Nothing is mended in a file that was not written.
    lines = [f"{'tried' if refused else 'repaired'}: {sentence}" for sentence in garment["mended"]]
    lines += [f"not repaired: {sentence}" for sentence in garment["left"]]
    lines += [f"stays: {line_of(finding)}" for finding in remaining]
    return lines if refused else [*lines, f"written: {fix}"]


def _print(report: dict[str, Any], fix: Path | None, body: str) -> None:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    for garment in report.get("garments", [report["garment"]] if "garment" in report else []):
        for line in _lines(garment, fix, body):
            console.print(line, markup=False)
    if "crossings" in report:
        as_made, as_worn = report["crossings"]["as_made"], report["crossings"]["as_worn"]
        for tangle in as_made:
            console.print(f"as made: {tangle['sentence']}.", markup=False)
        for tangle in as_worn:
            console.print(
                f"refused: {tangle['sentence']} even after untangling. Fix: give the garments in another order.",
                markup=False,
            )
        if not as_worn:
            console.print("worn over each other in this order, the garments cross nowhere.", markup=False)
    if "motion" in report:
        motion = report["motion"]
        length = "without end" if motion["seconds"] is None else f"{motion['seconds']:.2f} s"
        console.print(f"{motion['name']}: {length}", markup=False)
        if "lowest_point" in motion:
            console.print(
                f"lowest point {round(1000 * motion['lowest_point']) + 0:d} mm above the ground, fastest point "
                f"{motion['fastest_point']:.1f} m/s",
                markup=False,
            )
        for note in motion["notes"]:
            console.print(f"note: {note}", markup=False)
