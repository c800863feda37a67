"""The ground of a recording, found from the feet that stand on it over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.body.skeleton import branch, joint_positions
from pb4u.motion.recording import Recording

# Lengths are for the leg of an average adult [m], since files have units of their own.
# A foot stands where its ball moves slower than this [m/s] for so long [s], and nothing of the body is lower. At the
# top of a jump it is as slow for a few hundredths of a second.
_STANDS, _HOLDS = 0.25, 0.1
# So few stances tell nothing of a slope, nor do stances that lie closer together [m].
_LEAST_STANCES, _LEAST_SPREAD = 4, 0.8
# Before anything is seen a slope is this [m/m], and the ball of a foot that stands varies by so much [m].
_USUAL_SLOPE, _USUAL_ERROR = 0.02, 0.01
# A floor leaves no more than this [m] of all but the worst tenth of stances: steps and objects leave more.
_LEFT_OVER = 0.02
# A slope that raises the floor by less [m] is not worth mending; of a drift as little may be the dancer's own.
_LEAST_RISE, _LEAST_DRIFT = 0.02, 0.035
# A height that drifts does so slowly [m/s]; a step of 4 cm, smoothed over so long [s], is faster.
_FASTEST_DRIFT, _DRIFT_TIME = 0.015, 1.0


@dataclass(frozen=True)
class Stance:
    """A time span in which the ball of a foot stands still.

    Args:
        first: first frame.
        stop: frame after the last.
        place: (3,) where the ball stands [m], of an average adult.
    """

    first: int
    stop: int
    place: np.ndarray


def stances(recording: Recording) -> list[Stance]:
    """The stances of both feet in the order of time; none where the lowest part of the body is never a foot at rest.

    Args:
        recording: Y up.
    """
    poses = recording.poses
    if len(poses) < 3:
        return []
    joints = recording.metres * joint_positions(recording.skeleton, poses)
    lowest = joints[..., 1].argmin(axis=1)
    # Over a twentieth of a second, so that a tremble is not a movement.
    reach = max(1, round(0.025 * poses.fps))
    before = np.maximum(np.arange(len(poses)) - reach, 0)
    after = np.minimum(np.arange(len(poses)) + reach, len(poses) - 1)
    stands = []
    for ball in {recording.joint_index(f"toes.{side}") for side in "LR"}:
        path = joints[:, ball]
        speed = np.linalg.norm(path[after] - path[before], axis=1) * poses.fps / (after - before)
        # Joints beyond the ball, where a skeleton has them, are of the same foot.
        rests = (speed < _STANDS) & branch(recording.skeleton.parents, (ball,))[lowest]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], rests, [False]])))
        for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            if stop - first >= _HOLDS * poses.fps:
                stands.append(Stance(first, stop, np.median(path[first:stop], axis=0)))
    return sorted(stands, key=lambda stance: stance.first)


def on_level_ground(recording: Recording) -> Recording:
    """The recording on a level floor: turned upright where its floor slopes, and shifted in height where that drifts.

    Both are computed from the stances alone, and only if a floor explains them: jumps, stairs, ramps, objects that are
    stepped on, and lying bodies are unchanged. `Recording.notes` reports what is done.

    Args:
        recording: Y up.
    """
    recording = _with_upright_floor(recording)
    return _without_drift(recording)


def _with_upright_floor(recording: Recording) -> Recording:
    stands = stances(recording)
    places = np.array([stance.place for stance in stands]).reshape(-1, 3)
    if len(stands) < _LEAST_STANCES or np.linalg.norm(np.ptp(places[:, [0, 2]], axis=0)) < _LEAST_SPREAD:
        return recording
    slope, residual = _plane(places)
    risen = float(np.ptp(places[:, [0, 2]] @ slope))
    steepness = float(np.linalg.norm(slope))
    if (
        risen < _LEAST_RISE
        or steepness > np.tan(np.deg2rad(recording.askew))
        or np.percentile(np.abs(residual), 90) > _LEFT_OVER
    ):
        return recording
    up = np.array([-slope[0], 1.0, -slope[1]]) / np.hypot(1.0, steepness)
    note = (
        f"{recording.name}: the feet stand on a floor that slopes by {np.rad2deg(np.arctan(steepness)):.1f} degrees "
        f"and rises by {100 * risen:.0f} cm; the recording is turned upright."
    )
    return replace(recording.stood_up(up), notes=(*recording.notes, note))


def _plane(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slope (2,) along x and z [m/m] of the plane through places (stances, 3), and what it leaves of each."""
    ground = places[:, [0, 2]] - np.median(places[:, [0, 2]], axis=0)
    height = places[:, 1]
    weight = np.ones(len(places))
    prior = np.diag([0.0, 1.0, 1.0]) * (_USUAL_ERROR / _USUAL_SLOPE) ** 2
    system = np.column_stack([np.ones(len(places)), ground])
    for _ in range(20):
        # Huber's weights: a stance far off, such as one on an object, counts by its number and not by its height.
        normal = system.T @ (weight[:, None] * system) + prior
        plane = np.linalg.solve(normal, system.T @ (weight * height))
        residual = height - system @ plane
        weight = 1.0 / np.maximum(1.0, np.abs(residual) / _USUAL_ERROR)
    return plane[1:], residual


def _without_drift(recording: Recording) -> Recording:
    stands = stances(recording)
    if len(stands) < _LEAST_STANCES:
        return recording
    fps = recording.poses.fps
    drift = _drift(stands, np.arange(len(recording.poses)) / fps, fps)
    if drift is None:
        return recording
    roots = recording.poses.root_positions - drift[:, None] / recording.metres * np.array([0.0, 1.0, 0.0])
    note = (
        f"{recording.name}: standing feet show that the floor drifts by {100 * np.ptp(drift):.0f} cm over the "
        "recording; the drift is removed."
    )
    return replace(recording, poses=replace(recording.poses, root_positions=roots), notes=(*recording.notes, note))


def _drift(stands: list[Stance], times: np.ndarray, fps: float) -> np.ndarray | None:
    """Height (frames,) [m] by which the floor has drifted at `times` [s]; None where it does not, or is not a floor."""
    middle = np.array([0.5 * (stance.first + stance.stop - 1) / fps for stance in stands])
    height = np.array([stance.place[1] for stance in stands])
    # A long stance is better known than one that was nearly a step.
    weight = np.array([(stance.stop - stance.first) / fps for stance in stands])
    near = weight * np.exp(-0.5 * ((middle[:, None] - middle) / _DRIFT_TIME) ** 2)
    # Nearly straight lines through the neighbours in time; means would flatten both ends.
    total = near.sum(axis=1)
    mean_time, mean_height = (near @ middle) / total, (near @ height) / total
    spread = (near @ middle**2) / total - mean_time**2
    together = (near @ (middle * height)) / total - mean_time * mean_height
    smooth = mean_height + together / (spread + 0.1 * _DRIFT_TIME**2) * (middle - mean_time)
    if np.ptp(smooth) < _LEAST_DRIFT or np.percentile(np.abs(height - smooth), 90) > _LEFT_OVER:
        return None
    if np.abs(np.diff(smooth) / np.maximum(np.diff(middle), _HOLDS)).max() > _FASTEST_DRIFT:
        return None
    return np.interp(times, middle, smooth - np.median(smooth))
