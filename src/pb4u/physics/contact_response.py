"""What happens to vertices that a step leaves inside a body or the ground: pushed out, without gaining speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.physics.contact_planes import ContactPlanes, collider_surfaces
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True)
class ContactReport:
    """What a contact response did.

    Args:
        pushed: vertices moved.
        largest_push: [m].
        left: vertices still deeper than a millimetre.
        deepest: largest remaining depth [m], 0 where none.
    """

    pushed: int
    largest_push: float
    left: int
    deepest: float


@dataclass(frozen=True)
class ContactResponse:
    """Pushes vertices out of the true surface along its normal and removes the speed that would take them back in.

    A push is at most `largest_push` per step and what remains is reported. Of the velocity only the inward normal
    component relative to the body is removed; the push itself never becomes speed. Regions of the body left out of
    contact do not push, nor do pinned vertices move. Where the nearest surface has become the far side of a thin part
    (an arm), the vertex is pushed back to the side that it came from; a push that would go deeper into another part is
    not made.

    Args:
        clearance: distance to the surface that pushed vertices end at [m].
        largest_push: [m].
    """

    clearance: float = 5e-4
    largest_push: float = 0.02

    def respond(
        self, garments: PackedGarments, state: State, collider: ColliderFrame, dt: float, before: State | None = None
    ) -> tuple[State, ContactReport]:
        """`state`, at the end of a step of `dt` [s], with its vertices out of `collider.following`.

        Args:
            garments: static quantities.
            state: positions and velocities after the step, any dtype.
            collider: the bodies around the step.
            dt: length of the step [s].
            before: the state before the step, by which far sides are noticed.
        """
        x, v = state.positions, state.velocities
        movable = ~garments.pinned
        if len(collider.faces):
            x, v = self._out_of_bodies(garments, x, v, collider, dt, before, movable)
        if collider.ground_height is not None:
            depth = (self.clearance - (x[:, 1] - collider.ground_height)).clamp(0.0, self.largest_push)
            up = x.new_tensor([0.0, 1.0, 0.0])
            touched = (depth > 0) & movable
            x = torch.where(touched[:, None], x + depth[:, None] * up, x)
            v = torch.where(touched[:, None], v + (-v[:, 1]).clamp_min(0.0)[:, None] * up, v)
        return replace(state, positions=x, velocities=v), self._report(garments, state.positions, x, collider)

    def _out_of_bodies(
        self,
        garments: PackedGarments,
        x: Tensor,
        v: Tensor,
        collider: ColliderFrame,
        dt: float,
        before: State | None,
        movable: Tensor,
    ) -> tuple[Tensor, Tensor]:
        surfaces = collider_surfaces(garments, collider)
        body = surfaces.at(collider.following)
        planes = body.nearest(x)
        normal, depth = planes.normals, self.clearance - planes.distance
        if before is not None:
            came_from = surfaces.at(collider.now).nearest(before.positions, among=depth > 0)
            normal, depth = self._near_side(planes, came_from, x, collider, depth)
        push = torch.where(planes.touchable & movable, depth.clamp(0.0, self.largest_push), 0.0)
        pushed = x + push[:, None] * normal
        check = body.nearest(pushed, among=push > 0, otherwise=planes)
        worse = check.touchable & (check.distance < torch.minimum(planes.distance, torch.zeros_like(planes.distance)))
        push = torch.where(worse, 0.0, push)
        touched = (push > 0)[:, None]
        body_velocity = planes.carried(collider.following - collider.now, collider.faces).to(v) / dt
        inward = ((v - body_velocity) * normal).sum(1, keepdim=True).clamp_max(0.0)
        return torch.where(touched, x + push[:, None] * normal, x), torch.where(touched, v - inward * normal, v)

    def _near_side(
        self, planes: ContactPlanes, came_from: ContactPlanes, x: Tensor, collider: ColliderFrame, depth: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Normals and depths, measured from the side that a vertex came from where that faces the other way."""
        point = came_from.carried(collider.following, collider.faces).to(x)
        facing = came_from.carried_normals(collider.following, collider.faces).to(x)
        was_outside = came_from.touchable & (came_from.distance > -self.clearance)
        crossed = (depth > 0) & was_outside & ((facing * planes.normals).sum(1) < 0)
        height = ((x - point) * facing).sum(1)
        crossed = crossed & (height < 0)
        normal = torch.where(crossed[:, None], facing, planes.normals)
        return normal, torch.where(crossed, self.clearance - height, depth)

    def _report(self, garments: PackedGarments, old: Tensor, new: Tensor, collider: ColliderFrame) -> ContactReport:
        moved = (new - old).norm(dim=1)
        depth = torch.zeros_like(moved)
        if len(collider.faces):
            planes = collider_surfaces(garments, collider).at(collider.following).nearest(new)
            depth = torch.where(planes.touchable, -planes.distance, 0.0).clamp_min(0.0)
        if collider.ground_height is not None:
            depth = torch.maximum(depth, (collider.ground_height - new[:, 1]).clamp_min(0.0))
        if not len(moved):
            return ContactReport(0, 0.0, 0, 0.0)
        return ContactReport(int((moved > 0).sum()), float(moved.max()), int((depth > 1e-3).sum()), float(depth.max()))
