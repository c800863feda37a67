"""`pb4u simulate`: a garment on a moving body, to files."""

from __future__ import annotations

import math
import warnings
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pb4u.cli.console import (
    FORMATS,
    SHAPE_EXAMPLES,
    BodyShape,
    FrameRange,
    check_json_target,
    progress_bar,
    write_json,
    wrote,
)
from pb4u.errors import InputError, InputWarning, Pb4uError

if TYPE_CHECKING:
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.simulator import RunRecord, Simulator


class Switch(str, Enum):
    """On or off."""

    on = "on"
    off = "off"


class Device(str, Enum):
    """Where networks and newton compute."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("simulate")(simulate)


def simulate(
    garment: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE", help="Built-in garment, or a mesh file in metres that fits the body at rest."
        ),
    ] = "tshirt",
    body: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE", help="woman, man, anny (extra), SMPL-family model file, or a sequence of vertices."
        ),
    ] = "woman",
    body_shape: Annotated[
        BodyShape | None,
        typer.Option(parser=BodyShape.parse, metavar="KEY=VALUE,..", help=f"Shape of the body, {SHAPE_EXAMPLES}."),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Built-in motion, or .amc, .bvh, AMASS .npz, VTO .pkl. Default: walk, or the sequence's own.",
            show_default=False,
        ),
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second; networks run at their own.")] = 30.0,
    lead_in: Annotated[
        int, typer.Option(help="Frames from the rest pose into the motion, simulated but not written.")
    ] = 30,
    keep_lead_in: Annotated[bool, typer.Option("--keep-lead-in", help="Write the lead-in frames as well.")] = False,
    crop: Annotated[
        FrameRange | None,
        typer.Option(parser=FrameRange.parse, metavar="A:B", help="Frames A to B-1 of a recording, at its own rate."),
    ] = None,
    arms_away: Annotated[float, typer.Option(help="Hold hanging arms this many degrees away from the torso.")] = 0.0,
    pins: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Vertices that follow the body: none, waist (highest border), hem (lowest), loop:N (border with the "
            "N-th most vertices), or a file of indices. Default: the garment's own.",
        ),
    ] = None,
    triangles: Annotated[
        int | None, typer.Option(help="Triangles to simulate; default the file's own, or 2,500 of a built-in garment.")
    ] = None,
    material: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Built-in material or a JSON file in SI units.")
    ] = "default",
    frames: Annotated[
        int | None, typer.Option(help="Frames to write; default the whole recording, or 60 of a built-in motion.")
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help="solver, skinning, newton, or a network by name or .safetensors file. Default: pb4u-small.",
        ),
    ] = "auto",
    propagation_steps: Annotated[
        int | None, typer.Option(metavar="K", help="Override the number of propagation steps of a network.")
    ] = None,
    passes: Annotated[
        int | None,
        typer.Option(help="How often a network is asked in each step. Default: its own number, or 1 with --refine."),
    ] = None,
    refine: Annotated[int, typer.Option(metavar="N", help="Solver iterations after each step of a network.")] = 5,
    contact: Annotated[Switch, typer.Option(help="Push the garment out of the body after each step.")] = Switch.on,
    device: Annotated[
        Device, typer.Option(help="Where a network or newton computes; the solver always runs on the CPU.")
    ] = Device.auto,
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help=f"File to write, repeatable: {FORMATS} Default: GARMENT_MOTION with .npz, .glb, .png and .mp4.",
        ),
    ] = None,
    json: Annotated[
        str | None,
        typer.Option(metavar="FILE|-", help="Write counts, timing and metrics as JSON; '-' is standard output."),
    ] = None,
) -> None:
    """Simulate a garment on a moving body. Without options: the T-shirt on a walk, animated, in this folder."""
    from pb4u.export.registry import check_target
    from pb4u.scene.assembly import make_scene
    from pb4u.simulation.models import load_simulator
    from pb4u.simulation.simulator import RunRecord

    targets = list(out) if out else _default_targets(garment, body, motion)
    for target in targets:
        check_target(target)
    check_json_target(json)
    if not 1.0 <= fps <= 1000.0:
        raise InputError(f"Frames per second must lie between 1 and 1000, not {fps:g}.")
    simulator = load_simulator(
        model,
        contact=contact is Switch.on,
        refine=refine,
        propagation_steps=propagation_steps,
        passes=passes,
        device=device.value,
    )
    if device is Device.cuda and simulator.settings().get("device", "cpu") == "cpu":
        _warn(f"{simulator.name} always runs on the CPU; --device cuda is for networks.")
    asked_frames, simulated_fps = frames, simulator.fps or fps
    if frames is not None and keep_lead_in:
        asked_frames = frames + lead_in
    if not math.isclose(simulated_fps, fps):
        _warn(f"{simulator.name} runs at {simulated_fps:g} frames per second; the result is resampled to {fps:g}.")
        frames = None if frames is None else math.ceil((frames - 1) * simulated_fps / fps) + 1
        lead_in = round(lead_in * simulated_fps / fps)
    scene = make_scene(
        garment, body, motion, triangles=triangles, material=material, pins=pins, body_shape=body_shape,
        frames=frames, lead_in=lead_in, keep_lead_in=keep_lead_in, crop=crop, fps=simulated_fps, arms_away=arms_away,
        seed=seed,
    )  # fmt: skip
    record = RunRecord()
    left = list(targets)
    trajectory = _run(simulator, scene, left, record, fps, asked_frames)
    _export(trajectory, left)
    if json != "-":
        print(wrote(targets, trajectory.frame_count))
    diverged = None
    if json:
        report = _report(trajectory, simulator, scene, record)
        write_json(report, json)
        diverged = report["diverged_at"]
    elif record.failed_at is None:
        from pb4u.evaluation.metrics import first_diverged, skinned_centres

        diverged = first_diverged(trajectory, skinned_centres(scene, trajectory))
    if record.failed_at is not None:
        raise Pb4uError(
            f"The state stopped being finite at frame {record.failed_at}; the {trajectory.frame_count} frames "
            "before it were written. Try --model solver, or --refine 10."
        )
    if diverged is not None:
        mend = "look at it with `pb4u view`" if simulator.name == "solver" else "try --model solver, or --refine 10"
        _warn(
            f"The run diverged at frame {diverged}: the cloth is stretched by more than 60 %, or over 0.5 m from where "
            f"the body carries it; {mend}."
        )


def _warn(sentence: str) -> None:
    warnings.warn(sentence, InputWarning, stacklevel=2)


def _default_targets(garment: str, body: str, motion: str | None) -> list[Path]:
    from importlib.util import find_spec

    # A body of the user's own may be a sequence, which moves by itself.
    moves = motion or (body if Path(body).exists() else "walk")
    stem = f"{Path(garment).stem}_{Path(moves).stem}"
    suffixes = [".npz", ".glb", ".png", ".mp4" if find_spec("cv2") else ".gif"]
    return [Path(stem + suffix) for suffix in suffixes]


def _run(
    simulator: Simulator, scene: Scene, targets: list[Path], record: RunRecord, fps: float, frames: int | None
) -> Trajectory:
    """Stream into the first .npz asked for; into memory without one, or where frames have to be resampled.

    What is streamed into is taken off `targets`.
    """
    from pb4u.export.selection import resampled
    from pb4u.scene.trajectory import Trajectory

    streamed = next((t for t in targets if t.suffix.lower() == ".npz"), None)
    label = f"{scene.garments[0].garment.triangle_count:,} triangles, {simulator.name}"
    with progress_bar(label) as progress:
        if not math.isclose(scene.fps, fps):
            simulated = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record, progress))
            return resampled(simulated, fps, frames)
        if streamed is not None:
            targets.remove(streamed)
            return simulator.simulate_to(scene, streamed, record, progress)
        return Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record, progress))


def _export(trajectory: Trajectory, targets: list[Path]) -> None:
    from pb4u.export.registry import export

    for target in targets:
        with progress_bar(f"writing {target.name}") as progress:
            export(trajectory, target, progress)


def _report(trajectory: Trajectory, simulator: Simulator, scene: Scene, record: RunRecord) -> dict[str, Any]:
    """The --json payload of the contract."""
    from pb4u.evaluation.metrics import measure, skinned_centres

    with progress_bar("measuring") as progress:
        measured = measure(trajectory, skinned=skinned_centres(scene, trajectory), progress=progress)
    return {
        "garment": trajectory.metadata["garment"],
        "body": trajectory.metadata["body"],
        "motion": trajectory.metadata["motion"],
        "model": trajectory.metadata["model"],
        "triangles": len(trajectory.faces),
        "vertices": trajectory.positions.shape[1],
        "mean_edge_length": trajectory.metadata["mean_edge_length"],
        "propagation_steps": simulator.propagation_steps(scene),
        "frames": trajectory.frame_count,
        "fps": trajectory.fps,
        "device": simulator.settings().get("device", "cpu"),
        "ms_per_step": record.ms_per_step,
        "solver_iterations": record.solver_iterations,
        "unsolved_steps": record.unsolved,
        "notes": list(scene.notes),
        **measured,
    }
