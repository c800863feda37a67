"""How rollouts of the released research code begin: the frames before its networks go on by themselves.

Every frame of a recording is written; the first two are skinned, and what the released code writes follows from 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.scene.colliders import ColliderFrame, ColliderPose
from pb4u.scene.state import State
from pb4u.simulation.first_frame import FIRST_FRAMES, FirstFrame, untangled
from pb4u.simulation.step import StepMethod, Taken, take
from pb4u.simulation.timeline import SETTLING_DT, Timeline

CLEARANCE = 2e-3
"""Distance from the body that cloth is pushed to before a rollout [m]."""


@dataclass(frozen=True)
class StandingStart(FirstFrame):
    """Pb4U-GNet and HOOD: one long step with the body fixed at frame 2; its displacement becomes the velocity.

    Args:
        push: factor on the push out of the body before it; 1.5 in the code of Pb4U-GNet, 1 in HOOD's.
    """

    push: float = 1.5

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        yield from (Taken(untangled(timeline, method, timeline.skinned_state(frame))) for frame in (0, 1))
        begun = timeline.skinned_state(2)
        pushed = pushed_out(begun.positions, timeline.pose(2), self.push)
        begun = untangled(timeline, method, replace(begun, positions=pushed))
        settled, last_move = take(timeline.settling_from(begun), method)
        state = State(settled.positions, settled.velocities * (SETTLING_DT / timeline.dt), 2)
        yield Taken(state, last_move)
        step = timeline.step_from(state)
        standing = ColliderFrame(step.collider.now, step.collider.now, step.collider.following)
        yield take(replace(step, collider=standing), method, last_move)


class MovingStart(FirstFrame):
    """MeshGraphNet and the HOOD of the paper: one long step from frame 1 to 2, after which the cloth is at rest."""

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        yield Taken(untangled(timeline, method, timeline.skinned_state(0)))
        skinned = timeline.skinned(1)
        pushed = pushed_out(skinned, timeline.pose(1), 1.0)
        begun = untangled(timeline, method, State(pushed, torch.zeros_like(skinned), 1))
        yield Taken(begun)
        after, last_move = take(replace(timeline.step_from(begun), dt=SETTLING_DT), method)
        yield Taken(State(after.positions, torch.zeros_like(after.velocities), after.frame), last_move)


class SkinnedStart(FirstFrame):
    """ContourCraft: two skinned frames, whose velocity is kept; no push and no long step."""

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        for frame in (0, 1):
            yield Taken(untangled(timeline, method, timeline.skinned_state(frame)))


def pushed_out(positions: Tensor, body: ColliderPose, factor: float) -> Tensor:
    """Positions (vertices, 3) [m], each pushed along the normal of the body face with the nearest centre.

    Source: the released code (reference 1.8). One world; without a body nothing moves.

    Args:
        positions: (vertices, 3) [m].
        body: pose of the bodies.
        factor: on the missing distance to `CLEARANCE`.
    """
    (surface,) = body.whole_surfaces
    if surface is None:
        return positions
    face, _ = surface.nearest_face_centre(positions)
    corners = body.positions.to(positions)[body.colliders.faces[face]]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    height = ((positions - corners.mean(dim=1)) * normal).sum(dim=1, keepdim=True)
    return positions - factor * (height - CLEARANCE).clamp_max(0.0) * normal


FIRST_FRAMES["release"] = StandingStart()
FIRST_FRAMES["hood"] = StandingStart(push=1.0)
FIRST_FRAMES["mgn"] = MovingStart()
FIRST_FRAMES["contourcraft"] = SkinnedStart()
