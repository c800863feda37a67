"""Dressing: a pattern sewn around a resting body by the solver.

The panels start where the pattern places them, in front of and behind a body that is drawn in towards its bones, and
welded along their seams: only the cloth beside the seams is stretched, and it pulls them together. The body then fills
out to its size, and gravity comes last. Cloth feels cloth and body all the while. This is done with as few triangles as
will do; the result is passed on, panel by panel, to the mesh that is wanted, and settles there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.body.body_model import ShapedBody
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.errors import InputError
from pb4u.garment.fit import RestBody, is_inside_out
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import nearest_places
from pb4u.garment.material import MATERIALS, Material
from pb4u.garment.support import find_support
from pb4u.garment.tangles import untangled_start
from pb4u.geometry.principal_stretch import face_strains
from pb4u.pattern.fit_checks import refuse_far, refuse_narrow, refuse_slipped, refuse_tight
from pb4u.pattern.mesh import PatternMesh, mesh_pattern
from pb4u.pattern.pattern import Pattern
from pb4u.pattern.placement import around, off_body, sleeve_points
from pb4u.pattern.thin_body import SewingBody
from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.physics.contact.penetration_cleanup import FaceClearance
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import implicit_steps
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.terms.collision import STIFF_CONTACT_WEIGHT, Collision
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame, ColliderPose, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.scene import STANDARD_GRAVITY, UP
from pb4u.scene.state import State
from pb4u.threads import without_library_threads

DEFAULT_TRIANGLES = 5000
"""Triangles of a garment that is dressed: enough for seams, darts and gathers to be seen."""

_COARSE_EDGE = 0.033
"""Edge length [m] of the cloth that is sewn: with longer ones the straps of a dress pass through the shoulders."""

_SHARES = (0.7, 0.5, 0.3)
"""Shares of a body's girth around its bones with which sewing may begin."""

_SHALLOW = 0.01
"""Depth [m] in the body at which cloth may start: contact leads it out on the side that it came from."""

_LIFTS = (0.0, 0.02, 0.04, 0.06)
"""Heights [m] by which the pattern may be raised for that: shoulder seams are often placed a little within the body."""

_GROWTH_STEPS = 5
"""Steps in which the body fills out: 1 or 2 cm at the waist in each."""

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

_MOST_HANGING = 12
"""Steps after which it is taken as it hangs."""

_MOST_SETTLING = 3
"""The same of the mesh that is wanted, which begins where the coarse one hangs."""

_LEFT_INSIDE = 1e-3
"""Depth [m] from which on cloth that hangs is pushed out of the body."""

_CLEAR = 2e-3
"""Distance [m] from the skin to which hanging cloth is moved: a waistband that is pinned there stays out of skin
that bends, though no step moves it."""


@dataclass(frozen=True, eq=False)
class Dressed:
    """A pattern worn by a resting body.

    Args:
        garment: the garment, flat at rest; `vertices` is where it hangs on the body.
        mesh: the panels that it is sewn of.
        crossings: pairs of its triangles that cross.
        body_crossings: pairs of a triangle of it and one of the body that cross.
        depth: how deep its deepest vertex is in the body [m].
        strain: largest principal strain of each face, averaged by area, as the cloth hung before it was moved off the
            skin.
    """

    garment: Garment
    mesh: PatternMesh
    crossings: int
    body_crossings: int
    depth: float
    strain: float

    def to_json(self) -> dict[str, Any]:
        """Measures of the dressed garment, lengths in [m] and areas in [m^2], for reports.

        Lengths are of both sides of all seams, by the pattern and in the rest shape; errors are relative, the largest.
        """
        pattern = self.mesh.pattern
        lengths = np.array([pattern.seam_lengths(seam) for seam in pattern.seams]).reshape(-1, 2)
        sewn = self.mesh.seam_lengths
        off = np.bincount(self.mesh.face_panel, self.garment.face_areas) / [abs(each.area) for each in pattern.panels]
        return {
            "garment": pattern.name,
            "panels": len(pattern.panels),
            "seams": len(pattern.seams),
            "seam_length": lengths.sum(axis=0).tolist(),
            "rest_seam_length": sewn.sum(axis=0).tolist(),
            "seam_length_error": float(np.abs(sewn / lengths - 1.0).max(initial=0.0)),
            "pattern_area": pattern.area,
            "triangles": len(self.garment.faces),
            "rest_area": float(self.garment.face_areas.sum()),
            "panel_area_error": float(np.abs(off - 1.0).max()),
            "crossings": self.crossings,
            "body_crossings": self.body_crossings,
            "depth": self.depth,
            "strain": self.strain,
        }


def dress(
    pattern: Pattern,
    body: ShapedBody,
    triangles: int = DEFAULT_TRIANGLES,
    material: Material | None = None,
    watch: Callable[[np.ndarray, np.ndarray], None] | None = None,
) -> Dressed:
    """A pattern sewn around a resting body.

    Args:
        pattern: panels placed around a body in about this pose, and seams.
        body: the body that wears it.
        triangles: wanted number of triangles.
        material: the cloth; the default one by default.
        watch: called after every step with the vertices (vertices, 3) [m] of garment and body.

    Raises:
        InputError: the pattern cannot be meshed so, or is too small for the body.
    """
    cloth = material or MATERIALS["default"]
    enough = max(round(pattern.area / (0.43 * _COARSE_EDGE**2)), 8 * len(pattern.panels))
    coarse = mesh_pattern(pattern, triangles if triangles < 1.5 * enough else enough)
    sewing = _Sewing(coarse, body, cloth, watch)
    refuse_far(coarse, body)
    refuse_narrow(coarse, body, sewing.placed)
    places = sewing.hung(sewing.sewn(), _MOST_HANGING)
    fine = coarse if triangles <= len(coarse.faces) else mesh_pattern(pattern, triangles)
    return sewing.dressed(places) if fine is coarse else sewing.on_mesh(fine, places)


def passed_on(
    mesh: PatternMesh, places: np.ndarray, body: ShapedBody, material: Material, triangles: int | None
) -> Garment:
    """A dressed garment in another cloth, or with another number of triangles: its panels are meshed again.

    Args:
        mesh: what it was dressed with.
        places: (vertices, 3) of it on the body [m].
        body: the same body.
        material: the cloth.
        triangles: wanted number; None for the mesh as it is.

    Raises:
        InputError: so few triangles cannot mesh it.
    """
    sewing = _Sewing(mesh, body, material, None)
    if triangles is None or triangles == len(mesh.faces):
        return sewing.garment(places)
    return sewing.on_mesh(mesh_pattern(mesh.pattern, triangles), places).garment


def sewn_garment(mesh: PatternMesh, places: np.ndarray, material: Material) -> Garment:
    """The garment of a mesh with its vertices at `places` (vertices, 3) [m], flat at rest, its UVs the pattern.

    Args:
        mesh: mesh of the pattern.
        places: (vertices, 3) [m] positions.
        material: of the cloth.
    """
    panels = tuple(panel.name for panel in mesh.pattern.panels)
    return Garment(
        mesh.pattern.name, places, mesh.sewn_faces, material,
        uvs=mesh.uvs, uv_faces=mesh.faces, rest_uv=mesh.rest_uv, panels=panels,
    )  # fmt: skip


def carried(source: PatternMesh, places: np.ndarray, target: PatternMesh) -> np.ndarray:
    """Where another mesh of the same panels lies, if the cloth is where it was.

    Args:
        source: mesh of the panels.
        places: (vertices, 3) of its garment [m].
        target: the other mesh.

    Returns:
        (vertices, 3) of its garment [m].
    """
    moved = np.empty((len(target.points), 3))
    flat = [np.column_stack([mesh.points, np.zeros(len(mesh.points))]) for mesh in (source, target)]
    for panel in range(len(source.pattern.panels)):
        faces, own = source.faces[source.face_panel == panel], np.flatnonzero(target.panel == panel)
        face, shares = nearest_places(flat[1][own], flat[0], faces)
        moved[own] = np.einsum("pc,pcx->px", shares, places[source.vertex[faces[face]]])
    return target.sewn(moved)


class _Sewing:
    """The cloth of one mesh of a pattern, and the body that it is sewn around.

    Args:
        mesh: the panels.
        body: the resting body.
        material: of the cloth.
        watch: as in `dress`.
    """

    def __init__(
        self,
        mesh: PatternMesh,
        body: ShapedBody,
        material: Material,
        watch: Callable[[np.ndarray, np.ndarray], None] | None,
    ) -> None:
        self.mesh, self.body, self.watch = mesh, body, watch
        self.rest_body = RestBody.of(body)
        faces, contact = torch.from_numpy(body.faces), torch.from_numpy(body.contact)
        # Sleeves have to close around hands as well.
        self.whole = pack_colliders([faces], [torch.ones_like(contact)], [0], ground_height=None)
        self.colliders = pack_colliders([faces], [contact], [0], ground_height=None)
        self.potential = IncrementalPotential().with_self_contact(True)
        terms = tuple(term for term in self.potential.terms if "friction" not in term.name)
        self.smooth = replace(self.potential, terms=terms)
        self.material = material

    def garment(self, places: np.ndarray) -> Garment:
        """The garment with its vertices at `places` (vertices, 3) [m]."""
        return sewn_garment(self.mesh, places, self.material)

    @cached_property
    def thin_body(self) -> SewingBody:
        """The body that the garment is sewn around."""
        return SewingBody(self.body, sleeve_points(self.mesh, self.placed))

    @cached_property
    def placed(self) -> np.ndarray:
        """Places (points, 3) [m] of the panels around this body."""
        return around(self.mesh, self.body)

    def pose(self, share: float, done: float) -> ColliderPose:
        """The whole body, hands included; see `SewingBody.between`."""
        return self.whole.pose(torch.from_numpy(self.thin_body.between(share, done)))

    @cached_property
    def rest_pose(self) -> ColliderPose:
        """The body in its size, as simulations touch it."""
        return self.colliders.pose(torch.from_numpy(self.body.vertices))

    def sewn(self) -> np.ndarray:
        """Places (vertices, 3) [m] of the garment around the body in its size, without weight."""
        start, share = self.clear_start(off_body(self.mesh, self.placed, self.thin_body.thin(1.0)))
        garment = self.garment(start)
        packed, x = pack([garment]), torch.from_numpy(start)
        solver = Solver(tolerance=1.0, max_iterations=_ITERATIONS)
        # Sleeves may be placed through the sides that they are sewn to; they part as the seams close.
        crosses = len(self_crossings(start.astype(np.float32), garment.faces, sharing=True)) > 0
        closing = self.smooth.without_self_contact() if crosses else self.smooth
        thin = self.pose(share, 0.0)
        for softness in _SOFTNESS:
            soft = packed if softness == 1.0 else replace(
                packed, lame_mu=softness * packed.lame_mu, lame_lambda=softness * packed.lame_lambda
            )  # fmt: skip
            x = self.step(soft, x, solver, closing, (thin, thin))
        if crosses:
            x = torch.from_numpy(untangled_start([garment], x.numpy()))
        for part in range(_GROWTH_STEPS):
            poses = self.pose(share, part / _GROWTH_STEPS), self.pose(share, (part + 1) / _GROWTH_STEPS)
            x = self.step(packed, x, solver, self.smooth, poses)
        return self.step(packed, x, solver, self.smooth, (poses[1], poses[1])).numpy()

    def clear_start(self, places: np.ndarray) -> tuple[np.ndarray, float]:
        """The garment (vertices, 3) [m] of panels at `places`, and the share of its girth with which a body fits in."""
        places = self.mesh.sewn(places)
        for share in _SHARES:
            surface = self.pose(share, 0.0).surfaces[0]
            assert surface is not None
            for lift in _LIFTS:
                raised = places + lift * np.array(UP)
                found = surface.nearest(
                    torch.from_numpy(np.concatenate([raised, raised[self.mesh.sewn_faces].mean(1)]))
                )
                if not bool(((found.signed_distance < -_SHALLOW) & ~found.beyond_border).any()):
                    return raised, share
        return raised, share

    def outside(self, places: np.ndarray) -> np.ndarray:
        """Places near the given ones (vertices, 3) [m] outside the body, where no cloth crosses."""
        from pb4u.garment.repair import push_out

        garment = self.garment(places)
        out = push_out(places, garment.topology, self.rest_body) if self.rest_body.is_closed else places
        return untangled_start([garment], out)

    def on_mesh(self, mesh: PatternMesh, places: np.ndarray) -> Dressed:
        """The garment at `places` (vertices, 3) [m] with another mesh, settled there."""
        other = _Sewing(mesh, self.body, self.material, self.watch)
        return other.dressed(other.hung(other.outside(carried(self.mesh, places, mesh)), _MOST_SETTLING))

    def hung(self, places: np.ndarray, most: int) -> np.ndarray:
        """Places (vertices, 3) [m] of the garment settled under gravity, held by what would hold it in life."""
        garment = self.garment(places)
        support = find_support(places, garment.faces, self.rest_body)
        held = garment if support.held is None else garment.with_pins(support.held)
        packed, x = pack([held]), torch.from_numpy(places)
        solver = Solver(tolerance=0.05, max_iterations=_ITERATIONS)
        for _ in range(most):
            before, x = x, self.step(packed, x, solver, self.potential, (self.rest_pose, self.rest_pose), hangs=True)
            if float((x - before).square().sum(1).mean().sqrt()) < _STILL:
                break
        if self._depth(x) > _LEFT_INSIDE:
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
        """Positions (vertices, 3) [m] after a step from rest at `x` while the body moves between two `poses`."""
        before, after = poses
        collider, dt = ColliderFrame(before, before, after), _HANGING_DT if hangs else _SEWING_DT
        # Cloth near the skin goes with it, or a wrist that bends would come through a cuff between its vertices.
        near = nearest_planes(before, packed, x, within=_NEAR)
        moved = near.interpolated(collider.motion, self.whole.contact_faces) if before is not after else 0.0 * x
        share = torch.where(near.touchable, 1.0 - near.distance.abs() / _NEAR, 0.0).clamp(0.0, 1.0)
        gravity = x.new_tensor(UP) * (-STANDARD_GRAVITY if hangs else 0.0)
        state = State(x, share[:, None] * moved / dt, 0)
        step = TimeStep(packed, state, collider, dt, gravity, pin_positions=x)
        with without_library_threads():
            state, _ = implicit_steps(potential, solver, step, _ITERATIONS)
        if self.watch:
            self.watch(state.positions.numpy(), after.positions.numpy())
        return state.positions

    def _depth(self, x: Tensor) -> float:
        """How deep [m] the deepest of the vertices at `x` (vertices, 3) [m] is in the body that simulations touch."""
        surface = self.rest_pose.surfaces[0]
        if surface is None:
            return 0.0
        found = surface.nearest(x)
        return max(0.0, -float(torch.where(found.beyond_border, 0.0, found.signed_distance).min()))

    def dressed(self, places: np.ndarray) -> Dressed:
        """The garment that hangs at `places` (vertices, 3) [m], checked, and moved off the skin."""
        garment = self.garment(places)
        if is_inside_out(places, garment.faces, self.rest_body):
            raise InputError(f"{garment.name} comes out inside out: run the corners of its panels the other way round.")
        refuse_slipped(self.mesh, self.body, self.placed, places)
        packed = pack([garment])
        x = torch.from_numpy(places)
        strains = face_strains(x, packed.faces, packed.inverse_rest_shape).numpy()
        strain = float(np.average(strains, weights=garment.face_areas))
        refuse_tight(self.mesh, self.body, places, strain, strains)
        # Contact is at vertices: between them the skin may be through the cloth, its waistband included.
        hanging, cloth = State(x, torch.zeros_like(x), 0), self.potential.self_contact
        x = FaceClearance(clearance=_CLEAR).lift(packed, hanging, self.rest_pose, cloth).positions
        places = x.numpy()
        skin = self.body.faces[self.body.contact[self.body.faces].all(axis=1)]
        return Dressed(
            self.garment(places),
            self.mesh,
            crossings=len(self_crossings(places.astype(np.float32), garment.faces, sharing=True)),
            body_crossings=len(crossings(places, garment.faces, self.body.vertices, skin)),
            depth=self._depth(x),
            strain=strain,
        )
