"""How rollouts of the released code begin, on a sheet over a ball that moves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import torch
from ball_scene import ball_scene, sheet
from torch import Tensor

from pb4u.collision.crossings import self_crossings
from pb4u.compat.first_frames import CLEARANCE, MovingStart, SkinnedStart, StandingStart, pushed_out
from pb4u.garment.dressing import AttachedPlacement
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import pack_colliders
from pb4u.scene.scene import DressedGarment
from pb4u.simulation.step import StepMethod
from pb4u.simulation.timeline import SETTLING_DT, Timeline


@dataclass
class Raised:
    """A network that raises every vertex by a centimetre a step, and keeps what it was asked."""

    passes: int = 1
    further: int = 0
    asked: list[TimeStep] = field(default_factory=list)

    def correction(self, step: TimeStep, accelerations: Tensor) -> Tensor:
        self.asked.append(step)
        return torch.zeros_like(accelerations) + torch.tensor([0.0, 0.01, 0.0])


def begun(start: Any) -> tuple[Timeline, list[Any], list[TimeStep]]:
    timeline, network = Timeline.of(ball_scene(frames=8, lead_in=0)), Raised()
    return timeline, [made.state for made in start.states(timeline, StepMethod(network=network))], network.asked


def body(step: TimeStep) -> tuple[Tensor, Tensor, Tensor]:
    return tuple(pose.positions for pose in (step.collider.previous, step.collider.now, step.collider.following))  # type: ignore[return-value]


def test_a_standing_start_settles_at_frame_2_and_carries_the_displacement_on() -> None:
    timeline, states, asked = begun(StandingStart(push=1.0))
    assert [state.frame for state in states] == [0, 1, 2, 3]
    for frame in (0, 1):
        assert torch.equal(states[frame].positions, timeline.skinned(frame))
    assert [step.dt for step in asked] == [SETTLING_DT, pytest.approx(1 / 30)]
    still, moving = asked
    assert all(torch.equal(at, timeline.body(2)) for at in body(still))
    assert not still.state.velocities.any()
    before, now, following = body(moving)
    assert torch.equal(before, now), "the body is shown without velocity once"
    assert torch.equal(following, timeline.body(3))
    # A centimetre in the long step, and as a velocity that again in the next, besides the network's own.
    raised = states[2].positions - still.state.positions
    np.testing.assert_allclose(raised[:, 1], 0.01, atol=1e-12)
    np.testing.assert_allclose((states[3].positions - states[2].positions)[:, 1], 0.02, atol=1e-12)


def test_a_moving_start_steps_from_frame_1_to_2_and_rests() -> None:
    timeline, states, asked = begun(MovingStart())
    assert [state.frame for state in states] == [0, 1, 2]
    (step,) = asked
    assert step.dt == SETTLING_DT
    assert torch.equal(body(step)[1], timeline.body(1))
    assert torch.equal(body(step)[2], timeline.body(2))
    assert not states[2].velocities.any()


def test_a_skinned_start_keeps_the_velocity_of_skinning() -> None:
    timeline, states, asked = begun(SkinnedStart())
    assert [state.frame for state in states] == [0, 1]
    assert not asked
    assert torch.equal(states[1].velocities, (timeline.skinned(1) - timeline.skinned(0)) * 30.0)
    assert states[1].velocities.any()


@pytest.mark.parametrize("start", [StandingStart(), MovingStart(), SkinnedStart()])
def test_frames_that_are_skinned_cross_nowhere_where_cloth_feels_cloth(start: Any) -> None:
    scene, flat = ball_scene(frames=8, lead_in=0), sheet(2, side=0.1, height=0.0)
    upright = replace(flat, vertices=flat.vertices[:, [1, 0, 2]] + [0.117, 0.71, 0.013])
    worn = (*scene.garments, DressedGarment(upright, AttachedPlacement(upright, scene.colliders[0])))
    timeline = Timeline.of(replace(scene, garments=worn))
    faces = timeline.garments.faces.numpy()
    assert len(self_crossings(timeline.skinned(0).numpy(), faces)) > 0
    apart = IncrementalPotential().with_self_contact()
    for state, _ in start.states(timeline, StepMethod(network=Raised(), potential=apart)):
        assert len(self_crossings(state.positions.numpy(), faces, sharing=True)) == 0, state.frame


def test_a_push_takes_vertices_to_the_clearance_of_the_face_with_the_nearest_centre() -> None:
    corners = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], dtype=torch.float64)
    face = pack_colliders([torch.tensor([[0, 1, 2]])], [torch.ones(3, dtype=torch.bool)], [0])
    points = torch.tensor([[0.3, -0.01, 0.3], [0.3, 0.001, 0.3], [0.3, 0.05, 0.3]], dtype=torch.float64)
    for factor in (1.0, 1.5):
        heights = pushed_out(points, face.pose(corners), factor)[:, 1]
        missing = CLEARANCE - points[:, 1]
        np.testing.assert_allclose(heights, points[:, 1] + factor * missing.clamp_min(0.0), atol=1e-15)
