"""Simulates a run: its simulator, its scene, and the frames at the rate that was asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.collision.crossings import self_crossings
from pb4u.errors import InputError, InputNote, Interrupted, warn
from pb4u.export.selection import resampled, resampled_count
from pb4u.garment.tangles import untangled_start
from pb4u.progress import Progress, no_progress, progress_or_bar
from pb4u.run import Run
from pb4u.scene.assembly import build_scene
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.scene.trajectory import Frame, Trajectory
from pb4u.scene.trajectory_file import interrupted_path, kept_sentence
from pb4u.simulation.models import simulator_of
from pb4u.simulation.simulator import RunRecord, Simulator


def simulate(run: Run, path: str | Path | None = None, progress: Progress | None = None) -> Trajectory:
    """Simulate a whole run; the frames at the scene's own rate, fewer than asked for where they stopped being finite.

    Args:
        run: what is simulated.
        path: trajectory file to write as frames come; None keeps the frames in memory.
        progress: called with (frames done, frames in all), lead-in included; by default a bar on standard error where
            that is a terminal. `pb4u.progress.no_progress` is quiet.

    Raises:
        InputError: something of the run cannot be used.
        Interrupted: the frames until an interrupt are in a file beside `path`, which it names.
    """
    simulator = simulator_of(run)
    scene = scene_for(run, simulator)
    with progress_or_bar(progress, simulator.name) as heard:
        interrupted = None if path is None else interrupted_path(Path(path))
        return roll_out(run, simulator, scene, path, progress=heard, interrupted=interrupted)


def scene_for(run: Run, simulator: Simulator) -> Scene:
    """Scene of a run, loaded, at the frame rate that its simulator has to run at.

    Args:
        run: what is simulated.
        simulator: what `simulator_of` gives for it.

    Raises:
        InputError: something of the scene cannot be used.

    Warns:
        InputWarning: that rate is another than the scene's, or the scene has something unusual.
    """
    return build_scene(run.at_rate(simulated_fps(run, simulator)), run.fps)


def simulated_fps(run: Run, simulator: Simulator) -> float:
    """Frames per second [1/s] that a run is simulated at.

    Args:
        run: what is simulated.
        simulator: what `simulator_of` gives for it.

    Raises:
        InputError: a step is to be shorter than the one that a network was trained on.

    Warns:
        InputWarning: they are those of a network, and others than the run's.
    """
    if run.substeps > 1 and simulator.fps is not None:
        raise InputError(
            f"The network {simulator.name} keeps the time step of its training, 1/{simulator.fps:g} s: leave out "
            "--substeps, or use --model solver or quick-solver."
        )
    simulated = simulator.fps or run.fps * run.substeps
    if simulator.fps is not None and not math.isclose(simulated, run.fps):
        sentence = f"{simulator.name} runs at {simulated:g} frames per second; the result is resampled to {run.fps:g}."
        warn(sentence, InputNote)
    return simulated


def frame_count(run: Run, scene: Scene) -> int:
    """Number of frames that a run writes where it is not lost: those of its scene, at the run's own rate.

    Args:
        run: what is simulated.
        scene: what `scene_for` gives for it.
    """
    if math.isclose(scene.fps, run.fps):
        return scene.frames
    count = resampled_count(scene.frames, scene.fps, run.fps)
    return count if run.written_frames is None else min(count, run.written_frames)


def roll_out(
    run: Run,
    simulator: Simulator,
    scene: Scene,
    path: str | Path | None = None,
    record: RunRecord | None = None,
    progress: Progress = no_progress,
    interrupted: Path | None = None,
    seen: Callable[[Frame], None] | None = None,
    simulated: Iterable[State] | None = None,
) -> Trajectory:
    """Frames of a scene that `scene_for` made of a run, at the run's own rate.

    Args:
        run: what is simulated.
        simulator: what `simulator_of` gives for it.
        scene: what `scene_for` gives for it.
        path: trajectory file to write; as frames come, where they need no resampling. None keeps them in memory.
        record: receives the cost of the run and how it ended.
        progress: called with (frames done, frames in all), lead-in included.
        interrupted: trajectory file for the frames until an interrupt, where they were kept in memory.
        seen: called with every frame, at the rate it is simulated at.
        simulated: states of the scene, where they are there already; without a `path`.

    Raises:
        Pb4uError: the state stopped being finite before the first frame to write.
        Interrupted: the frames until an interrupt are in a file, which it names.

    Warns:
        InputWarning: cloth crosses cloth in frames between those that were simulated.
    """
    record = record or RunRecord()
    is_resampled = not math.isclose(scene.fps, run.fps)
    if path is not None and not is_resampled:
        return simulator.simulate_to(scene, path, record, progress, seen)
    header, rows = simulator.header(scene), list[Frame]()
    if is_resampled:
        led = round(scene.lead_in * run.fps / scene.fps)
        header = replace(header, metadata={**header.metadata, "lead_in": led})
    # Of several steps in a frame the last is kept; between others frames are interpolated.
    steps = round(scene.fps / run.fps)
    is_interpolated = not math.isclose(scene.fps, max(steps, 1) * run.fps)
    if not is_interpolated:
        header = replace(header, fps=run.fps)
    try:
        for number, frame in enumerate(simulator.written_frames(scene, record, progress, simulated)):
            if is_interpolated or number % steps == 0:
                rows.append(frame)
            if seen is not None:
                seen(frame)
    except KeyboardInterrupt as error:
        if rows and interrupted is not None:
            rescue = Trajectory.collect(header, rows).save(interrupted)
            raise Interrupted(kept_sentence(len(rows), rescue), getattr(error, "signal", 2)) from error
        raise
    if not rows:
        raise record.lost_early()
    trajectory = Trajectory.collect(header, rows)
    if is_interpolated:
        trajectory = resampled(trajectory, run.fps, run.written_frames)
        if header.metadata.get("self_contact"):
            trajectory = _untangled(trajectory, scene)
    if is_resampled and record.failed_at is not None:
        record.failed_at = trajectory.frame_count
    if path is not None:
        trajectory.save(path)
    return trajectory


def _untangled(trajectory: Trajectory, scene: Scene) -> Trajectory:
    """A resampled trajectory whose frames cross nowhere: straight lines between two that do not may lead through cloth.

    Frames without crossings stay as they are; a warning counts those that cannot be untangled, which stay too.
    """
    garments = [dressed.garment for dressed in scene.garments]
    positions, hits = np.array(trajectory.positions), list[int]()
    for frame in positions:
        if pairs := len(self_crossings(frame, trajectory.faces, sharing=True)):
            try:
                frame[:] = untangled_start(garments, frame)
            except InputError:
                hits.append(pairs)
    if hits:
        warn(
            f"Between simulated frames cloth crosses cloth in {len(hits)} of {len(positions)} frames, in {sum(hits)} "
            f"pairs of triangles, and cannot be untangled; --fps {scene.fps:g} writes the frames that were simulated."
        )
    return replace(trajectory, positions=positions)
