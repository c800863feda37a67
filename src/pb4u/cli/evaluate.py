"""`pb4u evaluate`: the paper's tables and figures, as a run that can stop at any time."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from pb4u.cli.console import RayFlag, Switch, WorkersFlag, check_json_target, keep_inputs, pool_of, say, tell
from pb4u.errors import InputError, Pb4uError
from pb4u.progress import announced


def evaluate(
    protocol: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="resolution, unseen (garments), depth (propagation steps), efficiency (time and loss), ablation, "
            "controls (what the network is worth), or robustness (drawn scenes).",
        ),
    ] = "resolution",
    models: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="solver, quick-solver, skinning, networks by name or .safetensors files. Default: protocol's.",
        ),
    ] = None,
    garments: Annotated[
        str | None, typer.Option(metavar="A,B", help="Built-in garments or mesh files. Default: protocol's.")
    ] = None,
    motions: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Built-in motions (walk, walk-7 with a seed), CMU trials (07_02) or files."),
    ] = None,
    bodies: Annotated[str | None, typer.Option(metavar="A,B", help="Bodies, by name or file. Default: woman.")] = None,
    levels: Annotated[
        str | None, typer.Option(metavar="A,B", help="Resolutions: base, 11K, .. 38K, or numbers of triangles.")
    ] = None,
    propagation_steps: Annotated[
        str | None, typer.Option(metavar="K,K", help="Numbers of propagation steps to set. Default: protocol's.")
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Frames of each rollout, at 30 a second. Default: 30.")] = None,
    lead_in: Annotated[
        int, typer.Option(help="Frames from the rest pose into the motion, simulated but not measured.")
    ] = 30,
    recordings: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of CMU recordings, SUBJECT/TRIAL.amc beside SUBJECT.asf; they replace built-in motions.",
        ),
    ] = None,
    refine: Annotated[int, typer.Option(metavar="N", help="Solver iterations after each step of a network.")] = 0,
    contact: Annotated[Switch, typer.Option(help="Push the garment out of the body after each step.")] = "off",
    device: Annotated[str, typer.Option(help="Where networks compute: auto, cpu or cuda.")] = "auto",
    floors: Annotated[
        Literal["run", "stored"],
        typer.Option(help="Reference energies: run the solver on scenes that lack a stored one, or use stored ones."),
    ] = "run",
    measure: Annotated[
        Literal["excess"] | None,
        typer.Option(
            help="Also measure excess, what single steps leave above their minimum, and the distance from the solver's "
            "rollout: two solves a frame for each scene. `controls` always does."
        ),
    ] = None,
    scenes: Annotated[int | None, typer.Option(help="Scenes that robustness draws. Default: 64.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the scenes that robustness draws.")] = 0,
    workers: WorkersFlag = 1,
    ray: RayFlag = None,
    retry: Annotated[bool, typer.Option("--retry", help="Try rollouts again that failed before.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run. Default: evaluate_PROTOCOL.")
    ] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Also put the plots into this folder.")] = None,
    json: Annotated[
        str | None, typer.Option(metavar="FILE|-", help="Also write results.json there; '-' is standard output.")
    ] = None,
) -> None:
    """Run a protocol of the paper: tables, plots and one page, beside the paper's own figures.

    A command that was killed at any instant goes on where it stopped when it is given again. Other flags with the same
    --out narrow or extend it. The resolution protocol without flags is 512 rollouts, most of a day on two cores.\f

    Each argument is described by its `help`.

    Raises:
        InputError: a number is out of range, or something is unknown or unusable.
    """
    from pb4u.paper.evaluation import evaluate as run
    from pb4u.paper.protocol_plan import EvaluationRequest
    from pb4u.paper.report import PAGE, PLOTS

    check_json_target(json)
    read = [name for names in (models, garments, motions, bodies) for name in _names(names) or ()]
    keep_inputs(read, [("--json", json)])
    pool = pool_of(workers, ray)
    if refine < 0:
        raise InputError(f"The number of refining iterations must be 0 or more, not {refine}.")
    request = EvaluationRequest(
        protocol=protocol, models=_names(models), garments=_names(garments), motions=_names(motions),
        bodies=_names(bodies), levels=_names(levels), steps=_counts(propagation_steps), frames=frames, lead_in=lead_in,
        recordings=recordings, refine=refine, contact=contact == "on", device=device,
        floors=floors == "run", scenes=scenes, seed=seed,
        excess=measure is not None,
    )  # fmt: skip

    folder = out or Path(f"evaluate_{protocol}")
    progress = partial(announced, part="rollout", say=say, alike=False)
    results = run(request, folder, pool, retry, say=say, progress=progress)
    if plots is not None:
        plots.mkdir(parents=True, exist_ok=True)
        for picture in (folder / PLOTS).iterdir():
            shutil.copy2(picture, plots / picture.name)
    tell(results, json, f"Report: {folder / PAGE}")
    if failures := results["failures"]:
        raise Pb4uError(
            f"{len(failures)} of {len(failures) + _done(results)} rollouts failed; the first: {failures[0]['job']}: "
            f"{failures[0]['sentence']} The report lists them; --retry tries them again."
        )


def _done(results: dict) -> int:
    return sum(row["result"] is not None for row in results["rollouts"])


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(entry.strip() for entry in text.split(",") if entry.strip())


def _counts(text: str | None) -> tuple[int, ...] | None:
    names = _names(text)
    for name in names or ():
        if not name.isdecimal():
            raise InputError(f"--propagation-steps takes whole numbers such as 5,15,30; {name!r} is none.")
    return None if names is None else tuple(int(name) for name in names)
