"""The cloth of a pattern while it is sewn around a resting body, and hangs there."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pb4u.body.body_model import ShapedBody
from pb4u.collision.crossings import self_crossings
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.environment import UP, Environment
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.material import MATERIALS, Material
from pb4u.garment.source_map import nearest_places
from pb4u.garment.support import find_support
from pb4u.garment.tangles import untangled_start
from pb4u.pattern.mesh import PatternMesh
from pb4u.pattern.pattern import FALL
from pb4u.pattern.placement import around, off_body, sleeve_points
from pb4u.pattern.thin_body import SewingBody
from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import implicit_steps
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.terms.collision import STIFF_CONTACT_WEIGHT, Collision
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame, ColliderPose, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State
from pb4u.threads import without_library_threads

_SHARES = (0.7, 0.5, 0.3)
"""Shares of a body's girth around its bones with which sewing may begin."""

_SHALLOW = 0.01
"""Depth [m] in the body at which cloth may start: contact leads it out on the side that it came from."""

_LIFTS = (0.0, 0.02, 0.04, 0.06)
"""Heights [m] by which the pattern may be raised for that: shoulder seams are often placed a little within the body."""

_GROWTH_STEPS = 5
"""Steps in which the body fills out: 1 or 2 cm at the waist in each."""

_BENDING_STEPS = 20
"""The same where there are sleeves: wrists move by a centimetre in each as arms bend, and stay in their cuffs."""

_NEAR = 0.1
"""Distance [m] from the skin within which cloth begins a step by moving with it, less and less towards it."""

_SOFTNESS = (0.03, 0.3, 1.0, 1.0)
"""Stiffness of the cloth while its seams close, as a share of its own: stiff cloth would jump through a shoulder."""

_SEWING_DT = 1.0 / 30.0
"""Time [s] of a step while the seams close and the body grows: with longer ones the garment turns around the neck."""

_HANGING_DT = 0.2
"""Time [s] of a step while it settles under gravity."""

_ITERATIONS = 15
"""Most iterations of the solver in a step of dressing."""

_STILL = 1e-3
"""Rms displacement [m] of a step at which the garment hangs."""

_OVER = 0.005
"""Distance [m] from the cloth beneath at which what is turned over it begins."""

_LEFT_INSIDE = 1e-3
"""Depth [m] from which on cloth that hangs is pushed out of the body."""


def sewn_garment(mesh: PatternMesh, places: np.ndarray, material: Material) -> Garment:
    """The garment of a mesh with its vertices at `places` (vertices, 3) [m], flat at rest, with the pattern as UVs.

    Args:
        mesh: mesh of the pattern.
        places: (vertices, 3) [m] positions.
        material: of the cloth.
    """
    panels = tuple(panel.name for panel in mesh.pattern.panels)
    falls = np.array([panel.label == FALL for panel in mesh.pattern.panels])[mesh.face_panel]
    return Garment(
        mesh.pattern.name, places, mesh.sewn_faces, material,
        uvs=mesh.uvs, uv_faces=mesh.faces, rest_uv=mesh.rest_uv, panels=panels,
        pressed=falls if falls.any() else None,
    )  # fmt: skip


def carried(source: PatternMesh, places: np.ndarray, target: PatternMesh) -> np.ndarray:
    """Vertex positions that give `target` the shape that `source`, a mesh of the same panels, has at `places`.

    Args:
        source: mesh of the panels.
        places: (vertices, 3) of its garment [m].
        target: the other mesh.

    Returns:
        (vertices, 3) of its garment [m].
    """
    result = np.empty((len(target.points), 3))
    flat = [np.column_stack([mesh.points, np.zeros(len(mesh.points))]) for mesh in (source, target)]
    for panel in range(len(source.pattern.panels)):
        faces, points = source.faces[source.face_panel == panel], np.flatnonzero(target.panel == panel)
        face, shares = nearest_places(flat[1][points], flat[0], faces)
        result[points] = np.einsum("pc,pcx->px", shares, places[source.vertex[faces[face]]])
    return target.sewn(result)


def turned_over(mesh: PatternMesh, places: np.ndarray) -> np.ndarray:
    """Positions (vertices, 3) [m] with panels labelled `FALL` folded down over the cloth below their seam.

    Args:
        mesh: mesh of the pattern.
        places: (vertices, 3) of its garment [m], with these panels standing up from that seam.
    """
    is_fall = np.array([panel.label == FALL for panel in mesh.pattern.panels])
    falls = is_fall[mesh.panel]
    if not falls.any():
        return places
    fold, turned = falls & np.isin(mesh.vertex, mesh.vertex[~falls]), places.copy()
    for panel in np.unique(mesh.panel[fold]):
        rows, along = np.flatnonzero(mesh.panel == panel), np.flatnonzero(fold & (mesh.panel == panel))
        far = cKDTree(mesh.points[along]).query(mesh.points[rows])[0][:, None]
        out = (places[mesh.vertex[rows]] - places[mesh.vertex[fold]].mean(axis=0)) * (1.0 - np.array(UP))
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        slope = np.radians(40.0 + 30.0 * np.maximum(out[:, 2:], 0.0))
        turned[mesh.vertex[rows]] = places[mesh.vertex[rows]] + far * (
            np.cos(slope) * out - (1.0 + np.sin(slope)) * np.array(UP)
        )
    loose = np.setdiff1d(mesh.vertex[falls], mesh.vertex[~falls])
    beneath = TriangleSurface(mesh.sewn_faces[~is_fall[mesh.face_panel]], len(places)).at(places).nearest(turned[loose])
    turned[loose] += np.maximum(_OVER - beneath.signed_distance.numpy(), 0.0)[:, None] * beneath.normals.numpy()
    return turned


class Sewing:
    """The cloth of one mesh of a pattern, and the body around which it is sewn.

    Args:
        mesh: the panels.
        body: the resting body.
        material: of the cloth.
    """

    def __init__(self, mesh: PatternMesh, body: ShapedBody, material: Material) -> None:
        self.mesh, self.body = mesh, body
        self.rest_body = RestBody.of(body)
        faces, contact = torch.from_numpy(body.faces), torch.from_numpy(body.contact)
        # Sleeves have to close around hands as well.
        self.whole = pack_colliders([faces], [torch.ones_like(contact)], [0])
        self.colliders = pack_colliders([faces], [contact], [0])
        self.potential = IncrementalPotential().with_self_contact(True)
        terms = tuple(term for term in self.potential.terms if "friction" not in term.name)
        self.smooth = replace(self.potential, terms=terms)
        self.material = material

    def garment(self, places: np.ndarray) -> Garment:
        """The garment with its vertices at given positions.

        Args:
            places: (vertices, 3) [m].
        """
        return sewn_garment(self.mesh, places, self.material)

    @cached_property
    def thin_body(self) -> SewingBody:
        """The body that the garment is sewn around."""
        return SewingBody(self.body, sleeve_points(self.mesh, self.placed))

    @cached_property
    def placed(self) -> np.ndarray:
        """Positions (points, 3) [m] of the panels around this body."""
        return around(self.mesh, self.body)

    def pose(self, share: float, blend: float) -> ColliderPose:
        """The whole body, hands included, thin or grown as in `SewingBody.between`.

        Args:
            share: share of its girth at the start.
            blend: growth from 0 (start) to 1 (its own size).
        """
        return self.whole.pose(torch.from_numpy(self.thin_body.between(share, blend)))

    @cached_property
    def rest_pose(self) -> ColliderPose:
        """The body in its size, as simulations touch it."""
        return self.colliders.pose(torch.from_numpy(self.body.vertices))

    def sewn(self) -> np.ndarray:
        """Positions (vertices, 3) [m] of the garment around the body in its own size, without gravity."""
        start, share = self.clear_start(off_body(self.mesh, self.placed, self.thin_body.thin(1.0)))
        # Stretched threads of stiff cloth would pull it through an arm.
        garment = replace(sewn_garment(self.mesh, start, MATERIALS["default"]), pressed=None)
        packed, x = pack([garment]), torch.from_numpy(start)
        solver = Solver(tolerance=1.0, max_iterations=_ITERATIONS)
        # Sleeves may be placed through the sides that they are sewn to; they part as the seams close.
        crosses = len(self_crossings(start.astype(np.float32), garment.faces, sharing=True)) > 0
        closing = self.smooth.without_self_contact() if crosses else self.smooth
        thin = self.pose(share, 0.0)
        for softness in _SOFTNESS:
            soft = packed if softness == 1.0 else softened(packed, softness)
            x = self.step(soft, x, solver, closing, (thin, thin))
        if crosses:
            x = torch.from_numpy(untangled_start([garment], x.numpy()))
        parts = _BENDING_STEPS if len(sleeve_points(self.mesh, self.placed)) else _GROWTH_STEPS
        for part in range(parts):
            poses = self.pose(share, part / parts), self.pose(share, (part + 1) / parts)
            x = self.step(packed, x, solver, self.smooth, poses)
        flapped = self.garment(turned_over(self.mesh, x.numpy()))
        packed, x = pack([flapped]), torch.from_numpy(untangled_start([flapped], flapped.vertices))
        return self.step(packed, x, solver, self.smooth, (poses[1], poses[1])).numpy()

    def clear_start(self, places: np.ndarray) -> tuple[np.ndarray, float]:
        """The garment (vertices, 3) [m] raised clear, and the share of its girth with which a body fits in.

        Args:
            places: (points, 3) [m] of the panels.
        """
        places = self.mesh.sewn(places)
        for share in _SHARES:
            surface = self.pose(share, 0.0).surfaces[0]
            assert surface is not None
            for lift in _LIFTS:
                raised = places + lift * np.array(UP)
                contact = surface.nearest(
                    torch.from_numpy(np.concatenate([raised, raised[self.mesh.sewn_faces].mean(1)]))
                )
                if not bool(((contact.signed_distance < -_SHALLOW) & ~contact.beyond_border).any()):
                    return raised, share
        return raised, share

    def outside(self, places: np.ndarray) -> np.ndarray:
        """Positions (vertices, 3) [m] near the given ones, outside the body and without crossing cloth.

        Args:
            places: (vertices, 3) [m].
        """
        from pb4u.garment.repair import push_out

        garment = self.garment(places)
        out = push_out(places, garment.topology, self.rest_body) if self.rest_body.is_closed else places
        return untangled_start([garment], out)

    def hung(self, places: np.ndarray, most: int) -> np.ndarray:
        """Positions (vertices, 3) [m] of the garment settled under gravity, with its waistband or straps pinned if they
        would hold it in life.

        Args:
            places: (vertices, 3) [m] from which it settles.
            most: largest number of steps.
        """
        garment = self.garment(places)
        support = find_support(places, garment.faces, self.rest_body)
        hanging_garment = garment if support.held is None else garment.with_pins(support.held)
        packed, x = pack([hanging_garment]), torch.from_numpy(places)
        solver = Solver(tolerance=0.05, max_iterations=_ITERATIONS)
        for _ in range(most):
            before, x = x, self.step(packed, x, solver, self.potential, (self.rest_pose, self.rest_pose), hangs=True)
            if float((x - before).square().sum(1).mean().sqrt()) < _STILL:
                break
        if self.depth(x) > _LEFT_INSIDE:
            firm = self.potential.with_term(Collision(weight=STIFF_CONTACT_WEIGHT))
            x = self.step(packed, x, solver, firm, (self.rest_pose, self.rest_pose), hangs=True)
        return x.numpy()

    def step(
        self,
        packed: PackedGarments,
        x: Tensor,
        solver: Solver,
        potential: IncrementalPotential,
        poses: tuple[ColliderPose, ColliderPose],
        hangs: bool = False,
    ) -> Tensor:
        """Positions (vertices, 3) [m] after a step from rest while the body moves.

        Args:
            packed: the garment.
            x: (vertices, 3) [m] at the start of the step.
            solver: solver for the step.
            potential: energies that it lowers.
            poses: of the body at the start and at the end of the step.
            hangs: whether the cloth has its weight, and time to settle.
        """
        before, after = poses
        collider, dt = ColliderFrame(before, before, after), _HANGING_DT if hangs else _SEWING_DT
        # Cloth near the skin goes with it, or a wrist that bends would come through a cuff between its vertices.
        near = nearest_planes(before, packed, x, within=_NEAR)
        moves = near.interpolated(collider.motion, self.whole.contact_faces) if before is not after else 0.0 * x
        share = torch.where(near.touchable, 1.0 - near.distance.abs() / _NEAR, 0.0).clamp(0.0, 1.0)
        around = Environment(Environment.gravity if hangs else (0.0, 0.0, 0.0), ground=None)
        state = State(x, share[:, None] * moves / dt, 0)
        step = TimeStep(packed, state, collider, dt, around, pin_positions=x)
        with without_library_threads():
            state, _ = implicit_steps(potential, solver, step, _ITERATIONS)
        return state.positions

    def depth(self, x: Tensor) -> float:
        """How deep [m] the deepest of the vertices is in the body that simulations touch.

        Args:
            x: (vertices, 3) [m].
        """
        surface = self.rest_pose.surfaces[0]
        if surface is None:
            return 0.0
        contact = surface.nearest(x)
        return max(0.0, -float(torch.where(contact.beyond_border, 0.0, contact.signed_distance).min()))


def softened(packed: PackedGarments, softness: float) -> PackedGarments:
    """Garments with reduced in-plane stiffness.

    Args:
        packed: the garments.
        softness: remaining share of their stiffness.
    """
    stiffening = packed.stiffening * packed.stiffening.new_tensor([1.0, softness])
    return replace(packed, membrane=softness * packed.membrane, stiffening=stiffening)
