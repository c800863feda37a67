"""Contact response: vertices that a step leaves inside a body or the ground are pushed out without gaining speed.

docs/design/body_contact.md says what else was tried against cloth that stays inside.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from pb4u.environment import UP
from pb4u.physics.contact.contact_set import ContactPlanes, nearest_planes
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.contact.penetration_cleanup import FaceClearance
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame, ColliderPose
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State

_PIN_CLEARANCE = 2e-3
"""Distance [m] that pins keep from the body: where contact begins."""
_CLEARANCE = 5e-4
"""Distance [m] to the surface that pushed vertices end at."""
_LARGEST_PUSH = 0.02
"""Largest displacement [m] of a vertex in one step."""
_CLEAN_UP, _PINS_CLEAR = FaceClearance(), FaceClearance(clearance=_PIN_CLEARANCE)


class ContactResponse:
    """Pushes vertices out of the true surface along its normal and removes the speed that would take them back in.

    A push is at most 2 cm per step; what remains, `depth` tells. Of the velocity only the inward normal
    component relative to the body is removed; the push itself never becomes speed. Regions of the body left out of
    contact do not push, nor do pinned vertices move. Where the nearest surface has become the far side of a thin part
    (an arm), the vertex is pushed back to the side that it came from; a push that would go deeper into another part is
    not made.

    Output frames have edges and faces moved out of the body too. This clean-up stays out of the simulation: coarse
    cloth would ride above the reach of friction and slide off.
    """

    def respond(self, step: TimeStep, state: State) -> State:
        """State with vertices pushed out of the bodies; the push never becomes speed.

        Args:
            step: the time step that was taken.
            state: at the end of it.
        """
        x, v = state.positions, state.velocities
        movable = ~step.garments.pinned
        if step.bodies is not None:
            x, v = self._out_of_bodies(step, step.bodies, x, v, movable)
        if step.environment.ground is not None:
            depth = (_CLEARANCE - (x[:, 1] - step.environment.ground)).clamp(0.0, _LARGEST_PUSH)
            up = x.new_tensor(UP)
            touched = (depth > 0) & movable
            x = torch.where(touched[:, None], x + depth[:, None] * up, x)
            v = torch.where(touched[:, None], v + (-v[:, 1]).clamp_min(0.0)[:, None] * up, v)
        return replace(state, positions=x, velocities=v)

    def with_pins_clear(self, step: TimeStep) -> TimeStep:
        """`step` with the places of its pins outside the bodies: contact wins against a pin.

        Args:
            step: that is to be taken.
        """
        garments, pins = step.garments, step.pin_positions
        if step.bodies is None or pins is None or not bool(garments.pinned.any()):
            return step
        return replace(step, pin_positions=_PINS_CLEAR.pins_clear(garments, step.bodies.following, pins))

    def cleared(self, step: TimeStep, state: State, cloth: CollisionFree | None) -> State:
        """State in which cloth that a body pierces between vertices is moved off it, as far as cloth can go there.

        Args:
            step: the time step that was taken.
            state: at the end of it.
            cloth: keeps it from passing through cloth, and tells whether bodies count.
        """
        if step.bodies is None or cloth is None or not cloth.feels_bodies:
            return state
        obstacle = Obstacle.at(step.garments, step.bodies.following, state.positions)
        if obstacle is None or not obstacle.passed.any():
            return state
        lifted = _CLEAN_UP.lift(step.garments, state, step.bodies.following, cloth)
        # Moved past them, cloth is through nothing more than it was.
        obstacle.reached(step.garments, step.bodies.following, lifted.positions)
        return lifted

    def depth(self, step: TimeStep, x: Tensor) -> float:
        """How deep [m] the deepest vertex that may be pushed is inside the bodies or the ground, 0 where none is.

        Args:
            step: the time step.
            x: (vertices, 3) [m] at its end.
        """
        return float(torch.where(step.garments.pinned, 0.0, _depths(step, x)).max()) if len(x) else 0.0

    def present(self, garments: PackedGarments, state: State, pose: ColliderPose, cloth: CollisionFree | None) -> State:
        """State as it is written; the simulation goes on from `state`.

        Args:
            garments: static quantities.
            state: at one frame.
            pose: the bodies at that frame.
            cloth: keeps it from passing through cloth.
        """
        return _CLEAN_UP.lift(garments, state, pose, cloth)

    def _out_of_bodies(
        self, step: TimeStep, bodies: ColliderFrame, x: Tensor, v: Tensor, movable: Tensor
    ) -> tuple[Tensor, Tensor]:
        planes = _planes(bodies.following, step.garments, x)
        normal, depth = planes.normals, _CLEARANCE - planes.distance
        if not bool((depth > 0).any()):
            return x, v
        came_from = _planes(bodies.now, step.garments, step.state.positions)
        normal, depth = self._near_side(planes, came_from, x, bodies.following, depth)
        push = torch.where(planes.touchable & movable, depth.clamp(0.0, _LARGEST_PUSH), 0.0)
        pushed = x + push[:, None] * normal
        check = _planes(bodies.following, step.garments, pushed)
        worse = check.touchable & (check.distance < torch.minimum(planes.distance, torch.zeros_like(planes.distance)))
        push = torch.where(worse, 0.0, push)
        touched = (push > 0)[:, None]
        body_velocity = planes.interpolated(bodies.motion, bodies.colliders.contact_faces).to(v) / step.dt
        inward = ((v - body_velocity) * normal).sum(1, keepdim=True).clamp_max(0.0)
        return torch.where(touched, x + push[:, None] * normal, x), torch.where(touched, v - inward * normal, v)

    def _near_side(
        self, planes: ContactPlanes, came_from: ContactPlanes, x: Tensor, following: ColliderPose, depth: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Normals and depths, measured from the side that a vertex came from where that faces the other way."""
        point = came_from.transported(following).to(x)
        facing = came_from.transported_normals(following).to(x)
        was_outside = came_from.touchable & (came_from.distance > -_CLEARANCE)
        crossed = (depth > 0) & was_outside & ((facing * planes.normals).sum(1) < 0)
        height = ((x - point) * facing).sum(1)
        crossed = crossed & (height < 0)
        normal = torch.where(crossed[:, None], facing, planes.normals)
        return normal, torch.where(crossed, _CLEARANCE - height, depth)


def _planes(pose: ColliderPose, garments: PackedGarments, x: Tensor) -> ContactPlanes:
    """The planes at `x` (vertices, 3) [m], of far vertices too.

    Where a body overlaps itself a vertex comes inside one part from outside the other, without ever being near.
    """
    return nearest_planes(pose, garments, x, within=math.inf)


def _depths(step: TimeStep, x: Tensor) -> Tensor:
    """How deep (vertices,) [m] each vertex is inside the bodies or the ground at the end of a step, at least 0."""
    depths = torch.zeros_like(x[:, 0])
    if step.bodies is not None:
        planes = _planes(step.bodies.following, step.garments, x)
        depths = torch.where(planes.touchable, -planes.distance, 0.0).clamp_min(0.0)
    if step.environment.ground is not None:
        depths = torch.maximum(depths, (step.environment.ground - x[:, 1]).clamp_min(0.0))
    return depths
