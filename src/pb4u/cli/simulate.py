"""`pb4u simulate`: garments on a moving body, to files."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pb4u.cli.console import check_json_target, keep_inputs, say, verb, write_json, wrote
from pb4u.cli.outputs import OUTPUT_FLAGS, Outputs
from pb4u.cli.picture_flags import PICTURE_FLAGS, view_of
from pb4u.cli.record_flags import given_values
from pb4u.cli.run_flags import run_flags, run_of
from pb4u.cli.verbs import HelpAllFlag
from pb4u.errors import InputError, Interrupted, Pb4uError, noted, warn
from pb4u.export.registry import check_bones, check_target, export, is_drawn
from pb4u.io.atomic_file import check_writable
from pb4u.progress import announced, progress_bar
from pb4u.run import Run

if TYPE_CHECKING:
    import numpy as np

    from pb4u.export.view import View
    from pb4u.measures.limbs import LimbWatch
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader
    from pb4u.simulation.simulator import RunRecord, Simulator


@verb(flags=run_flags(), outputs=OUTPUT_FLAGS, picture=PICTURE_FLAGS)
def simulate(
    scene: Annotated[Path | None, typer.Argument(metavar="SCENE.toml")] = None,
    *,
    flags: Mapping[str, Any],
    outputs: Mapping[str, Any],
    picture: Mapping[str, Any],
    help_all: HelpAllFlag = False,
) -> None:
    """Simulate garments on a moving body. Without options: the T-shirt on a walk, animated, in this folder.\f

    Args:
        scene: Scene file to run, as --save-scene writes it. Flags win over it: --garment replaces all its garments with
            their materials, pins and triangles, --body its shape and clip too, --motion crop and clip.
        flags: the fields of `Run`.
        outputs: the fields of `Outputs`.
        picture: the fields of `PictureRequest`.
        help_all: shows all options.

    Raises:
        InputError: the arguments contradict each other, or something they name is unknown or unusable.
    """
    from pb4u.simulation.models import refuse_useless

    if scene is not None:
        _refuse_garment(scene)
    run = run_of(Run() if scene is None else Run.open(scene), flags)
    refuse_useless(run, [name for name, value in flags.items() if value is not None])
    options = Outputs(**given_values(Outputs, outputs))
    if (options.measure or options.reference) and not options.json:
        raise InputError("--measure and --reference add to the report of --json; give --json FILE too.")
    targets = list(options.out) or _default_targets(run)
    for target in targets:
        check_target(target)
    others = [("--save-scene", options.save_scene), ("--json", options.json)]
    keep_inputs([scene, options.reference, *run.files], others, targets)
    baked = [target for target in targets if target.suffix.lower() == ".glb"]
    if options.bones is not None:
        for target in baked or targets[:1]:
            check_bones(target, options.bones)
    _simulate(run, options, targets, view_of(targets, picture))


def _refuse_garment(scene: Path) -> None:
    """Refuse what is given in the place of a scene file and is none."""
    from pb4u.garment.library import SEWN, garment_names
    from pb4u.geometry.mesh_file import READERS

    if str(scene) in garment_names() or (scene.suffix.lower() in (*READERS, *SEWN) and scene.suffix.lower() != ".toml"):
        also = f"; pb4u view {scene} plays it if it is a trajectory" if scene.suffix.lower() == ".npz" else ""
        raise InputError(f"{scene} is not a scene file; if it is a garment, give it as --garment {scene}{also}.")


def _default_targets(run: Run) -> list[Path]:
    from pb4u.export.video_writer import writes_mp4
    from pb4u.scene.moving_body import DEFAULT_MOTION

    moves: object = "alone"
    if run.body is not None:
        # A body of the user's own may be a sequence, which moves by itself.
        moves = run.motion or (run.body if Path(str(run.body)).exists() else DEFAULT_MOTION)
    stem = f"{'+'.join(garment.name for garment in run.garments)}_{Path(str(moves)).stem}"
    suffixes = [".npz", ".glb", ".png", ".mp4" if writes_mp4() else ".gif"]
    return [Path(stem + suffix) for suffix in suffixes]


def _simulate(run: Run, options: Outputs, targets: list[Path], view: View | None) -> None:
    from pb4u.export.live_caches import check_live_folder

    check_json_target(options.json)
    if options.save_scene is not None:
        check_writable(options.save_scene, "--save-scene")
    if options.live is not None:
        check_live_folder(options.live)
    with noted() as notes:
        _simulated(run, options, targets, view, notes)


def _simulated(run: Run, options: Outputs, targets: list[Path], view: View | None, warnings: list[str]) -> None:
    """Simulate and write; `warnings` gets what is warned of meanwhile."""
    from pb4u.measures.overstretch import overstretched_sentences
    from pb4u.scene.trajectory_file import interrupted_path
    from pb4u.simulation.models import simulator_of
    from pb4u.simulation.run_simulation import scene_for
    from pb4u.simulation.simulator import RunRecord

    simulator = simulator_of(run)
    if run.device == "cuda" and simulator.settings().get("device", "cpu") == "cpu":
        warn(f"{simulator.name} always runs on the CPU; --device cuda is for networks.")
    scene = scene_for(run, simulator)
    against = _reference(options.reference, run, simulator, scene)
    if options.save_scene is not None:
        run.save(options.save_scene)
    record = RunRecord()
    file = next((target for target in targets if target.suffix.lower() == ".npz"), None)
    rescue = interrupted_path(file or targets[0])
    trajectory, watched = _trajectory(run, simulator, scene, file, rescue, options.live, record)
    _export(trajectory, [target for target in targets if target is not file], file, view, options.bones)
    if options.json != "-":
        print(wrote(targets, trajectory.frame_count))
    diverged, through, through_cloth = None, None, None
    if options.json:
        from pb4u.measures.run_report import run_report

        with progress_bar("measuring") as progress:
            limbs = watched.over(trajectory)
            # Limbs are told of once, by all frames.
            notes = [sentence for sentence in warnings if sentence not in watched.told]
            report = run_report(
                trajectory, simulator, scene, record, progress, bool(options.measure), against, limbs, notes
            )
        write_json(report, options.json)
        diverged, through = report["diverged_at"], report.get("limbs_through_cloth")
    elif record.failed_at is None:
        from pb4u.measures.divergence import skinned_centres
        from pb4u.measures.limbs import limbs_through_cloth
        from pb4u.measures.metrics import first_diverged

        diverged = first_diverged(trajectory, skinned_centres(scene, trajectory))
        through = limbs_through_cloth(*watched.over(trajectory))
    if through:
        from pb4u.measures.limbs import limbs_sentence

        through_cloth = limbs_sentence(through, trajectory)
    _say_how_it_ended(simulator.name, trajectory.frame_count, record.failed_at, diverged, through_cloth)
    for sentence in overstretched_sentences(trajectory):
        warn(sentence)


def _say_how_it_ended(
    model: str, frames: int, failed_at: int | None, diverged: int | None, through_cloth: str | None
) -> None:
    """Refuse a run that was lost, and warn where it diverged or limbs came through cloth."""
    if failed_at is not None:
        raise Pb4uError(
            f"The state stopped being finite at frame {failed_at}; the {frames} frames before it were written; "
            f"{_advice(model)}."
        )
    if diverged == 0:
        raise Pb4uError(
            "The run was broken at its first frame: the cloth is stretched by more than 60 %, or lies over 0.5 m from "
            "where the body's motion alone puts it. The written file shows it; look at the garment with `pb4u check`, "
            "or ask for more --triangles."
        )
    if diverged is not None:
        warn(
            f"The run diverged at frame {diverged}: the cloth is stretched by more than 60 %, or lies over 0.5 m from "
            f"where the body's motion alone puts it; {_advice(model)}."
        )
    if through_cloth:
        warn(through_cloth)


def _reference(path: Path | None, run: Run, simulator: Simulator, scene: Scene) -> Trajectory | None:
    """Trajectory to measure the distance from, refused before any work where it does not fit."""
    if path is None:
        return None
    from pb4u.measures.excess import require_reference
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.run_simulation import frame_count

    reference = Trajectory.open(path)
    require_reference(reference, simulator.header(scene).faces, run.fps, frame_count(run, scene))
    return reference


def _advice(model: str) -> str:
    """What to try where a model lost the cloth."""
    if model == "solver":
        return "look at it with `pb4u view`"
    return "try --model solver" if model == "skinning" else "try --model solver, or --refine 10"


def _trajectory(
    run: Run,
    simulator: Simulator,
    scene: Scene,
    file: Path | None,
    rescue: Path,
    live: Path | None,
    record: RunRecord,
) -> tuple[Trajectory, _LimbWarnings]:
    """Simulate into `file`, else into memory, of which an interrupt leaves what there is in `rescue`."""
    from pb4u.export.live_caches import LiveCaches
    from pb4u.simulation.run_simulation import frame_count, roll_out

    count = sum(dressed.garment.triangle_count for dressed in scene.garments)
    with ExitStack() as opened:
        label = f"{count:,} triangles, {simulator.name}"
        announce = opened.enter_context(announced(label, "step", say))
        header = simulator.header(scene)
        if file is not None and file.exists():
            _say_what_is_replaced(file, header, frame_count(run, scene))
        watched = _LimbWarnings(scene, header, run)
        if live is None:
            return roll_out(run, simulator, scene, file, record, announce, rescue, watched), watched
        caches = opened.enter_context(LiveCaches(live, header, run.fps, run.written_frames))

        def stepped(frames: int, total: int) -> None:
            announce(frames, total)
            caches.progress(frames, total)

        def seen(frame: Frame) -> None:
            caches.append(frame)
            watched(frame)

        return roll_out(run, simulator, scene, file, record, stepped, rescue, seen), watched


def _say_what_is_replaced(file: Path, header: TrajectoryHeader, frames: int) -> None:
    """Say so where a trajectory of another scene will be written over."""
    from pb4u.scene.trajectory import Trajectory

    try:
        old = Trajectory.open(file)
    except InputError:  # another kind of file, which nobody asked about
        return

    def told(of: TrajectoryHeader, count: int) -> str:
        return f"{' + '.join(garment['name'] for garment in of.garments)}, {of.metadata.get('motion')}, {count} frames"

    before, after = told(old.header, old.frame_count), told(header, frames)
    if before != after:
        say(f"note: {file} holds another scene ({before}) and will be replaced by this one ({after}).")


class _LimbWarnings:
    """Warns of each limb that comes through cloth in the frame in which it does."""

    def __init__(self, scene: Scene, header: TrajectoryHeader, run: Run) -> None:
        from pb4u.measures.limbs import Bones, LimbWatch

        self.scene, self.run = scene, run
        self.watch = LimbWatch(Bones.of(scene, scene.frames, scene.fps), header)
        self.rows: list[np.ndarray] = []
        self.said: dict[str, int] = {}
        #: What was warned of so far.
        self.told: list[str] = []

    def __call__(self, frame: Frame) -> None:
        bones, number = set(self.watch.needs), len(self.rows)
        self.rows.append(self.watch.through(number, frame.positions, frame.body_positions))
        # Named as it will be written, at the rate that was asked for.
        written = round(number * self.run.fps / self.scene.fps)
        for sentence in self.watch.sentences(
            [bone for bone in self.watch.needs if bone not in bones], written, self.said
        ):
            warn(sentence)
            self.told.append(sentence)

    def over(self, trajectory: Trajectory) -> tuple[np.ndarray, LimbWatch]:
        """Which bones are through cloth in the frames of `trajectory`, as `watched` gives it."""
        import numpy as np

        from pb4u.measures.limbs import Bones, watched

        if trajectory.fps == self.scene.fps and trajectory.frame_count == len(self.rows):
            return np.array(self.rows), self.watch
        # Resampled: its frames were never seen.
        return watched(Bones.of(self.scene, trajectory.frame_count, trajectory.fps), trajectory)


def _export(
    trajectory: Trajectory, targets: list[Path], saved: Path | None, view: View | None, bones: int | None
) -> None:
    """Write the files asked for; `saved` is the trajectory's; `view` is for pictures, `bones` for GLB."""
    from pb4u.scene.trajectory_file import interrupted_path

    try:
        for target in targets:
            with progress_bar(f"writing {target.name}") as progress:
                of_glb = bones if target.suffix.lower() == ".glb" else None
                export(trajectory, target, progress, view if is_drawn(target) else None, say, of_glb)
    except KeyboardInterrupt as error:
        path = saved or trajectory.save(interrupted_path(targets[0]))
        raise Interrupted(f"all {trajectory.frame_count} frames are in {path}", getattr(error, "signal", 2)) from error
