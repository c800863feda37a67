"""The floor of a recording, told by the feet: found where it slopes or drifts, and nothing else taken for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import about_axis, angle_between, multiply, rotate
from pb4u.motion.correspondences import SMPL
from pb4u.motion.ground import on_level_ground, stances
from pb4u.motion.procedural import ProceduralMotion
from pb4u.motion.recording import Recording
from pb4u.motion.retargeting import RecordedMotion, lowest_heights

FPS = 60.0
Perform = Callable[..., Recording]


@pytest.fixture
def perform(smpl_body) -> Perform:
    """A built-in clip as if it had been recorded."""
    body = smpl_body("smpl")

    def recorded(clip: str, seconds: float = 8.0) -> Recording:
        poses = ProceduralMotion(clip).poses(body, FPS, round(seconds * FPS))
        return Recording(clip, SMPL, body.skeleton, poses)

    return recorded


def raised(recording: Recording, height: np.ndarray) -> Recording:
    roots = recording.poses.root_positions + height[:, None] * np.array([0.0, 1.0, 0.0])
    return replace(recording, poses=replace(recording.poses, root_positions=roots))


def levels(recording: Recording) -> np.ndarray:
    return np.array([stance.place[1] for stance in stances(recording)])


def test_feet_that_walk_stand_in_turn(perform: Perform) -> None:
    found = stances(perform("walk"))
    steps = np.diff([stance.place[2] for stance in found])
    assert len(found) > 8
    assert (np.abs(steps) > 0.2).all()
    assert all(stance.stop - stance.first > 0.1 * FPS for stance in found)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_floor_that_slopes_is_turned_level(perform: Perform, axis: str) -> None:
    walk = perform("walk")
    if axis == "z":
        # Walking along x, so that the floor rises on the way.
        walk = turned(walk, about_axis("y", np.deg2rad(90.0)))
    sloping = turned(walk, about_axis(axis, np.deg2rad(1.5)))
    assert np.ptp(levels(sloping)) > 0.05
    found = on_level_ground(sloping)
    assert np.ptp(levels(found)) < 0.012
    assert np.rad2deg(angle_between(found.poses.rotations, walk.poses.rotations)).max() < 0.15
    assert "slopes by 1.5 degrees" in found.notes[-1]


def turned(recording: Recording, turn: np.ndarray) -> Recording:
    poses = recording.poses
    return replace(
        recording,
        poses=PoseSequence(multiply(turn, poses.rotations), rotate(turn, poses.root_positions), poses.fps),
    )


@pytest.mark.parametrize("clip", ["walk", "arms", "dance"])
def test_a_height_that_drifts_is_taken_out(perform: Perform, clip: str) -> None:
    still = perform(clip, seconds=16.0)
    t = np.arange(len(still.poses)) / FPS
    # Up and down again, so that no slope explains it.
    drift = 0.06 * np.sin(np.pi * t / t[-1]) ** 2
    found = on_level_ground(raised(still, drift))
    left = found.poses.root_positions[:, 1] - still.poses.root_positions[:, 1]
    assert np.ptp(left) < 0.02
    assert "drifts by 6 cm" in found.notes[-1]


def stairs(recording: Recording, rise: float, most: int) -> np.ndarray:
    """Height (frames,) that goes up or down by a step between two stances, at most so often."""
    height = np.zeros(len(recording.poses))
    found = stances(recording)
    for before, after in list(pairwise(found[1:]))[:most]:
        middle = 0.5 * (before.stop + after.first)
        height += rise / (1.0 + np.exp(-(np.arange(len(height)) - middle) / 2.0))
    return height


@pytest.mark.parametrize(("rise", "most"), [(-0.17, 99), (0.12, 1), (-0.06, 1), (0.04, 99)])
def test_stairs_and_kerbs_stay(perform: Perform, rise: float, most: int) -> None:
    walk = perform("walk")
    down = raised(walk, stairs(walk, rise, most))
    assert on_level_ground(down) is down


def test_a_ramp_stays(perform: Perform) -> None:
    ramp = turned(perform("walk"), about_axis("x", np.deg2rad(5.0)))
    assert on_level_ground(ramp) is ramp


@pytest.mark.parametrize("clip", ["walk", "run", "jump", "squat", "dance", "turn", "twist"])
def test_a_clip_on_a_level_floor_stays_as_it_is(perform: Perform, clip: str) -> None:
    recording = perform(clip, seconds=12.0)
    assert on_level_ground(recording) is recording


def test_one_who_lies_down_is_not_lifted(perform: Perform) -> None:
    walk = perform("walk")
    half, frames = len(walk.poses) // 2, len(walk.poses)
    # Tipped over backwards in a second, the hips at 12 cm, and the feet moving on.
    share = np.clip((np.arange(frames) - half) / FPS, 0.0, 1.0)
    tipped = about_axis("x", np.deg2rad(-90.0) * share)
    poses = walk.poses
    roots = poses.root_positions.copy()
    roots[:, 1] += share * (0.12 - roots[:, 1])
    lying = replace(
        walk, poses=replace(poses, rotations=multiply(tipped[:, None], poses.rotations), root_positions=roots)
    )
    assert all(stance.first < half + 0.5 * FPS for stance in stances(lying))
    assert on_level_ground(lying) is lying


def test_low_moments_do_not_leave_the_rest_afloat(perform: Perform, woman) -> None:
    walk = perform("walk")
    dips = np.zeros(len(walk.poses))
    # A tenth of the time, between the stances that tell the floor.
    for before, after in pairwise(stances(walk)):
        dips[(before.stop + after.first) // 2 - 1 : (before.stop + after.first) // 2 + 2] = -0.15
    recording = raised(walk, dips)
    poses = RecordedMotion(recording).poses(woman, 30.0, 200)
    assert abs(np.median(lowest_heights(woman, poses))) < 0.01


def test_the_lowest_of_several_levels_is_the_ground(perform: Perform, woman) -> None:
    walk = perform("walk")
    down = raised(walk, stairs(walk, -0.17, 4))
    motion = RecordedMotion(down)
    lowest = lowest_heights(woman, motion.poses(woman, 30.0, motion.available_frames(30.0)))
    assert abs(np.median(lowest[-90:])) < 0.02
    assert np.median(lowest[:15]) > 0.5
