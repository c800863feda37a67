"""Dressing: a pattern sewn around a resting body by the solver.

The panels start where the pattern places them, in front of and behind a body that is drawn in towards its bones, and
welded along their seams: only the cloth beside the seams is stretched, and it pulls them together. The body then fills
out to its size, and gravity comes last. Cloth feels cloth and body all the while. This is done with as few triangles as
will do; the result is passed on, panel by panel, to the mesh that is wanted, and settles there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pb4u.body.body_model import ShapedBody
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.errors import InputError
from pb4u.garment.fit import is_inside_out
from pb4u.garment.garment import Garment
from pb4u.garment.material import MATERIALS, Material
from pb4u.geometry.principal_stretch import face_strains
from pb4u.pattern.fit_checks import refuse_far, refuse_narrow, refuse_slipped, refuse_tight
from pb4u.pattern.mesh import PatternMesh, mesh_pattern
from pb4u.pattern.pattern import Pattern
from pb4u.pattern.sewing import Sewing, carried
from pb4u.physics.contact.penetration_cleanup import FaceClearance
from pb4u.scene.packed import pack
from pb4u.scene.state import State

DEFAULT_TRIANGLES = 5000
"""Triangles of a garment that is dressed: enough for seams, darts and gathers to be seen."""

_COARSE_EDGE = 0.033
"""Edge length [m] of the cloth that is sewn: with longer ones the straps of a dress pass through the shoulders."""

_MOST_HANGING = 12
"""Steps after which it is taken as it hangs."""

_MOST_SETTLING = 3
"""The same of the mesh that is wanted, which begins where the coarse one hangs."""

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
        body_crossings: number of crossing pairs of a garment triangle and a body triangle.
        depth: how deep its deepest vertex is in the body [m].
        strain: largest principal strain of each face, averaged by area, before hanging cloth was moved off the skin.
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
        off = np.bincount(self.mesh.face_panel, self.garment.face_areas) / [abs(panel.area) for panel in pattern.panels]
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
) -> Dressed:
    """A pattern sewn around a resting body.

    Args:
        pattern: panels placed around a body in about this pose, and seams.
        body: the body that wears it.
        triangles: wanted number of triangles.
        material: the cloth; the default one by default.

    Raises:
        InputError: the pattern cannot be meshed so, or is too small for the body.
    """
    cloth = material or MATERIALS["default"]
    enough = max(round(pattern.area / (0.43 * _COARSE_EDGE**2)), 8 * len(pattern.panels))
    coarse = mesh_pattern(pattern, triangles if triangles < 1.5 * enough else enough)
    sewing = Sewing(coarse, body, cloth)
    refuse_far(coarse, body)
    refuse_narrow(coarse, body, sewing.placed)
    places = sewing.hung(sewing.sewn(), _MOST_HANGING)
    fine = coarse if triangles <= len(coarse.faces) else mesh_pattern(pattern, triangles)
    return _dressed(sewing, places) if fine is coarse else _on_mesh(sewing, fine, places)


def passed_on(
    mesh: PatternMesh, places: np.ndarray, body: ShapedBody, material: Material, triangles: int | None
) -> Garment:
    """A dressed garment in another cloth, or with another number of triangles: its panels are meshed again.

    Args:
        mesh: the mesh with which it was dressed.
        places: (vertices, 3) its positions on the body [m].
        body: the same body.
        material: the cloth.
        triangles: wanted number; None for the same mesh.

    Raises:
        InputError: so few triangles cannot mesh it.
    """
    sewing = Sewing(mesh, body, material)
    if triangles is None or triangles == len(mesh.faces):
        return sewing.garment(places)
    return _on_mesh(sewing, mesh_pattern(mesh.pattern, triangles), places).garment


def _on_mesh(sewing: Sewing, mesh: PatternMesh, places: np.ndarray) -> Dressed:
    """The garment of a sewing at `places` (vertices, 3) [m] with another mesh, settled there."""
    other = Sewing(mesh, sewing.body, sewing.material)
    return _dressed(other, other.hung(other.outside(carried(sewing.mesh, places, mesh)), _MOST_SETTLING))


def _dressed(sewing: Sewing, places: np.ndarray) -> Dressed:
    """The garment of a sewing that hangs at `places` (vertices, 3) [m], checked, and moved off the skin."""
    garment = sewing.garment(places)
    if is_inside_out(places, garment.faces, sewing.rest_body):
        raise InputError(f"{garment.name} comes out inside out: reverse the order of the corners of its panels.")
    refuse_slipped(sewing.mesh, sewing.body, sewing.placed, places)
    packed = pack([garment])
    x = torch.from_numpy(places)
    strains = face_strains(x, packed.faces, packed.inverse_rest_shape).numpy()
    strain = float(np.average(strains, weights=garment.face_areas))
    refuse_tight(sewing.mesh, sewing.body, places, strain, strains)
    # Contact is at vertices: between them the skin may be through the cloth, its waistband included.
    hanging, cloth = State(x, torch.zeros_like(x), 0), sewing.potential.self_contact
    x = FaceClearance(clearance=_CLEAR).lift(packed, hanging, sewing.rest_pose, cloth).positions
    places = x.numpy()
    skin = sewing.body.faces[sewing.body.contact[sewing.body.faces].all(axis=1)]
    return Dressed(
        sewing.garment(places),
        sewing.mesh,
        crossings=len(self_crossings(places.astype(np.float32), garment.faces, sharing=True)),
        body_crossings=len(crossings(places, garment.faces, sewing.body.vertices, skin)),
        depth=sewing.depth(x),
        strain=strain,
    )
