"""`pb4u simulate`: garments on a moving body, to files."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pb4u.cli.console import (
    FORMATS,
    BodyShape,
    CropFlag,
    ShapeFlag,
    Switch,
    check_json_target,
    check_writable,
    keep_inputs,
    say,
    write_json,
    wrote,
)
from pb4u.cli.garment_flags import GarmentFlag, MaterialFlag, PinsFlag, TrianglesFlag, TuckFlag, dressed
from pb4u.cli.picture_flags import (
    BackgroundFlag,
    ColourFlag,
    ElevationFlag,
    SideFlag,
    SizeFlag,
    TurntableFlag,
    view_of,
)
from pb4u.errors import InputError, InputWarning, Interrupted, Pb4uError
from pb4u.export.registry import check_target, export, is_drawn
from pb4u.progress import announced, progress_bar
from pb4u.scene.specification import SceneSpecification
from pb4u.simulation.run_specification import Device, FirstFrameChoice, Precision, RunSpecification

if TYPE_CHECKING:
    from pb4u.export.view import View
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.simulator import RunRecord, Simulator


def simulate(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE.toml",
            help="Scene file to run, as --save-scene writes it. Flags win over it: --garment replaces all its garments "
            "with their materials, pins and triangles, --body its shape too, --motion its crop too.",
            show_default=False,
        ),
    ] = None,
    garment: GarmentFlag = None,
    tuck: TuckFlag = None,
    body: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="woman, man, anny (extra), SMPL-family model file, or a sequence of vertices. "
            f"Default: {SceneSpecification.body}.",
        ),
    ] = None,
    body_shape: ShapeFlag = None,
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Built-in motion, or .amc, .bvh, AMASS .npz, VTO .pkl. Default: walk, or the sequence's own.",
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help=f"Frames per second; networks run at their own. Default: {SceneSpecification.fps:g}."),
    ] = None,
    lead_in: Annotated[
        int | None,
        typer.Option(
            help="Frames from the rest pose into the motion, simulated but not written. "
            f"Default: {SceneSpecification.lead_in}."
        ),
    ] = None,
    keep_lead_in: Annotated[
        bool | None,
        typer.Option("--keep-lead-in/--drop-lead-in", help="Write the lead-in frames as well. Default: drop."),
    ] = None,
    crop: CropFlag = None,
    arms_away: Annotated[
        float | None,
        typer.Option(
            help="Hold hanging arms this many degrees away from the torso. Default: arms of a recording by as much as "
            "they would go into the body; 0 leaves them as recorded."
        ),
    ] = None,
    as_recorded: Annotated[
        bool | None,
        typer.Option(
            "--as-recorded/--retargeted",
            help="Play an SMPL recording (.pkl, AMASS .npz) as it is, on the shape, place and height that it has; "
            "--arms-away 20 is the released code's separate_arms. Default: retargeted.",
        ),
    ] = None,
    omitted: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="Body vertices left out of contact: smpl_aux.pkl, or a list. Default: the body's own."
        ),
    ] = None,
    pins: PinsFlag = None,
    triangles: TrianglesFlag = None,
    material: MaterialFlag = None,
    frames: Annotated[
        int | None, typer.Option(help="Frames to write. Default: the whole recording, or 60 of a built-in motion.")
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="solver, quick-solver (its first iterations: the fastest on a processor), skinning, newton, or a "
            "network by name, .safetensors file or .pth of the released code. "
            "Default: pb4u-wide.",
        ),
    ] = None,
    propagation_steps: Annotated[
        int | None,
        typer.Option(metavar="K", help="Propagation steps of a network. Default: as many as the mesh calls for."),
    ] = None,
    passes: Annotated[
        int | None,
        typer.Option(
            help="How often a network is asked in each step. Default: its own number, more where a step needs it, or 1 "
            "with --refine."
        ),
    ] = None,
    refine: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Most solver iterations after each step of a network, or of the quick solver; what they leave torn "
            f"is made anew. Default: {RunSpecification.refine}.",
        ),
    ] = None,
    contact: Annotated[
        Switch | None, typer.Option(help="Push the garment out of the body after each step. Default: on.")
    ] = None,
    self_contact: Annotated[
        Switch | None,
        typer.Option(
            help="Cloth feels cloth, within a garment and between garments. Default: on for the solver and networks; "
            "skinning and newton cannot."
        ),
    ] = None,
    body_surface: Annotated[
        Switch | None,
        typer.Option(
            help="Cloth stays clear of faces and edges of the body too, not at its vertices alone: no limb comes "
            "through between them; takes about half as long again. Default: off."
        ),
    ] = None,
    device: Annotated[
        Device | None,
        typer.Option(help="Where a network or newton computes; the solver always runs on the CPU. Default: auto."),
    ] = None,
    first_frame: Annotated[
        FirstFrameChoice | None,
        typer.Option(
            "--first-frame",
            "--start",
            help="How frame 0 is made: settled by the solver, in one long step of the method itself, as in the paper, "
            "or as the released code begins: release (Pb4U-GNet), hood, mgn, contourcraft. Default: auto, which is "
            "settled wherever the solver takes part.",
        ),
    ] = None,
    precision: Annotated[
        Precision | None,
        typer.Option(
            help="Precision of a network's matrix products. Default: auto, which is bfloat16 where the device "
            "multiplies faster in it and --refine is above 0."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help=f"Seed of everything random. Default: {SceneSpecification.seed}.")
    ] = None,
    save_scene: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also write a scene file, to run the same again: `pb4u simulate FILE`."),
    ] = None,
    live: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Also write each frame there as it is computed: NAME.pc2 of each garment on its author's own mesh, "
            "and a line of progress.jsonl a step.",
        ),
    ] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help=f"File to write, repeatable: {FORMATS} Default: GARMENT_MOTION with .npz, .glb, .png and .mp4.",
        ),
    ] = None,
    view: SideFlag = None,
    elevation: ElevationFlag = None,
    turntable: TurntableFlag = None,
    size: SizeFlag = None,
    colour: ColourFlag = None,
    background: BackgroundFlag = None,
    json: Annotated[
        str | None,
        typer.Option(metavar="FILE|-", help="Write counts, timing and metrics as JSON; '-' is standard output."),
    ] = None,
) -> None:
    """Simulate garments on a moving body. Without options: the T-shirt on a walk, animated, in this folder.\f

    Each argument is described by its `help`.

    Raises:
        InputError: the arguments contradict each other, or something they name is unknown or unusable.
    """
    described = RunSpecification() if scene is None else RunSpecification.open(scene)
    run = replace(
        described,
        scene=replace(
            described.scene,
            garments=dressed(
                described.scene.garments, garment, tuck, material=material, pins=pins, triangles=triangles
            ),
            body_shape={**({} if body else described.scene.body_shape), **BodyShape.of(body_shape)},
            crop=crop or (None if motion else described.scene.crop),
            **_given(
                body=body, motion=motion, fps=fps, lead_in=lead_in, keep_lead_in=keep_lead_in, arms_away=arms_away,
                frames=frames, seed=seed, as_recorded=as_recorded, omitted=omitted,
            ),
        ),
        **_given(
            model=model, propagation_steps=propagation_steps, passes=passes, refine=refine,
            contact=contact and contact == "on", self_contact=self_contact and self_contact == "on",
            body_surface=body_surface and body_surface == "on", device=device,
            first_frame=first_frame, precision=precision,
        ),
    )  # fmt: skip
    _refuse_useless(
        str(run.model),
        propagation_steps=propagation_steps,
        passes=passes,
        precision=precision,
        refine=refine,
        contact=contact,
        body_surface=body_surface,
    )
    keep_inputs([scene], [("--save-scene", save_scene), ("--json", json)])
    targets = list(out) if out else _default_targets(run.scene)
    for target in targets:
        check_target(target)
    seen = view_of(targets, view, elevation, turntable, size, colour, background)
    _simulate(run, targets, seen, save_scene, live, json)


def _refuse_useless(model: str, **flags: Any) -> None:
    """Refuse flags that the model would not look at."""
    from pb4u.simulation.models import default_model, looks_at

    chosen = default_model() if model == "auto" else model
    for name, value in flags.items():
        if value is not None and not looks_at(chosen, name):
            raise InputError(f"--{name.replace('_', '-')} does nothing with --model {chosen}; leave it out.")


def _given(**flags: Any) -> dict[str, Any]:
    return {name: value for name, value in flags.items() if value is not None}


def _default_targets(scene: SceneSpecification) -> list[Path]:
    from importlib.util import find_spec

    # A body of the user's own may be a sequence, which moves by itself.
    moves = scene.motion or (scene.body if Path(str(scene.body)).exists() else "walk")
    stem = f"{'+'.join(garment.name for garment in scene.garments)}_{Path(str(moves)).stem}"
    suffixes = [".npz", ".glb", ".png", ".mp4" if find_spec("cv2") else ".gif"]
    return [Path(stem + suffix) for suffix in suffixes]


def _simulate(
    run: RunSpecification,
    targets: list[Path],
    view: View | None,
    save_scene: Path | None,
    live: Path | None,
    json: str | None,
) -> None:
    from pb4u.export.live_caches import check_live_folder
    from pb4u.simulation.simulator import RunRecord

    check_json_target(json)
    if save_scene is not None:
        check_writable(save_scene, "--save-scene")
    if live is not None:
        check_live_folder(live)
    keep_inputs(run.files(), [("--save-scene", save_scene), ("--json", json)], targets)
    simulator = run.simulator()
    if run.device == "cuda" and simulator.settings().get("device", "cpu") == "cpu":
        _warn(f"{simulator.name} always runs on the CPU; --device cuda is for networks.")
    scene = run.assemble(simulator)
    if save_scene is not None:
        run.save(save_scene)
    record = RunRecord()
    left = list(targets)
    trajectory = _trajectory(run, simulator, scene, left, live, record)
    _export(trajectory, left, next((target for target in targets if target not in left), None), view)
    if json != "-":
        print(wrote(targets, trajectory.frame_count))
    diverged, through = None, None
    if json:
        from pb4u.evaluation.run_report import run_report

        with progress_bar("measuring") as progress:
            report = run_report(trajectory, simulator, scene, record, progress)
        write_json(report, json)
        diverged, through = report["diverged_at"], report.get("limbs_through_cloth")
    elif record.failed_at is None:
        from pb4u.evaluation.divergence import skinned_centres
        from pb4u.evaluation.limbs import Bones, limbs_through_cloth
        from pb4u.evaluation.metrics import first_diverged

        diverged = first_diverged(trajectory, skinned_centres(scene, trajectory))
        bones = Bones.of(scene, trajectory)
        through = limbs_through_cloth(bones.names, bones.through_cloth(trajectory))
    if record.failed_at is not None:
        raise Pb4uError(
            f"The state stopped being finite at frame {record.failed_at}; the {trajectory.frame_count} frames "
            f"before it were written; {_advice(simulator.name)}."
        )
    if diverged == 0:
        raise Pb4uError(
            "The run was broken at its first frame: the cloth is stretched by more than 60 %, or over 0.5 m from where "
            "the body carries it. What was written shows it; look at the garment with `pb4u check`, or ask for more "
            "--triangles."
        )
    if diverged is not None:
        _warn(
            f"The run diverged at frame {diverged}: the cloth is stretched by more than 60 %, or over 0.5 m from where "
            f"the body carries it; {_advice(simulator.name)}."
        )
    if through:
        from pb4u.evaluation.limbs import limbs_sentence

        _warn(f"{limbs_sentence(through, trajectory.frame_count)}")


def _advice(model: str) -> str:
    """What to try where a model lost the cloth."""
    if model == "solver":
        return "look at it with `pb4u view`"
    return "try --model solver" if model in ("skinning", "newton") else "try --model solver, or --refine 10"


def _warn(sentence: str) -> None:
    warnings.warn(sentence, InputWarning, stacklevel=2)


def _trajectory(
    run: RunSpecification,
    simulator: Simulator,
    scene: Scene,
    targets: list[Path],
    live: Path | None,
    record: RunRecord,
) -> Trajectory:
    """Simulate into the first .npz asked for, which is taken off `targets`, else into memory; `live` as frames come."""
    from pb4u.export.live_caches import LiveCaches
    from pb4u.scene.trajectory import interrupted_path

    file = next((target for target in targets if target.suffix.lower() == ".npz"), None)
    kept = interrupted_path(file or targets[0])
    if file is not None:
        targets.remove(file)
    count = sum(dressed.garment.triangle_count for dressed in scene.garments)
    with ExitStack() as opened:
        told = opened.enter_context(announced(f"{count:,} triangles, {simulator.name}", "step", say))
        if live is None:
            return run.roll_out(simulator, scene, file, record, told, kept)
        header = simulator.header(scene)
        caches = opened.enter_context(LiveCaches(live, header, run.scene.fps, run.scene.written_frames))

        def stepped(done: int, total: int) -> None:
            told(done, total)
            caches.progress(done, total)

        return run.roll_out(simulator, scene, file, record, stepped, kept, caches.append)


def _export(trajectory: Trajectory, targets: list[Path], saved: Path | None, view: View | None) -> None:
    """Write the files asked for; `saved` is the trajectory's, where it has one already; `view` is for pictures."""
    from pb4u.scene.trajectory import interrupted_path

    try:
        for target in targets:
            with progress_bar(f"writing {target.name}") as progress:
                export(trajectory, target, progress, view if is_drawn(target) else None, say)
    except KeyboardInterrupt as error:
        kept = saved or trajectory.save(interrupted_path(targets[0]))
        raise Interrupted(f"all {trajectory.frame_count} frames are in {kept}", getattr(error, "signal", 2)) from error
