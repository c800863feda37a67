"""What is measured of a trajectory, frame by frame: energies, strain, penetration, and when it diverged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.crossings import crossings, self_crossings
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.garment.trims import SewnPart, Trims
from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import area_weighted_normals, vertex_areas
from pb4u.measures.divergence import first_lost
from pb4u.measures.overlaps import buried, overlapping_faces
from pb4u.measures.released_energies import released_potential
from pb4u.physics.contact.skin_cover import SkinCover
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.progress import Progress, no_progress
from pb4u.scene.colliders import ColliderFrame, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader

ENERGIES = (*(term.name for term in IncrementalPotential().terms), "total")
"""The terms of the potential [J] by their own names, and their sum."""

STRAINS = ("strain_p95", "strain_max")
GEOMETRY = (
    *STRAINS, "penetration_percent", "penetration_depth_max", "visible_skin_percent", "self_intersections",
    "body_intersections", "body_intersections_pinched",
)  # fmt: skip
OF_A_CLIP = (*ENERGIES, *GEOMETRY, "limbs_through_cloth")
"""Metrics of each frame of a clip; the last needs the skeletons of its scene."""

PENETRATION_TOLERANCE = 1e-3
"""Depth [m] beyond which a vertex counts as inside the body: less is within the accuracy of a body's triangles."""

SKIN_UNDER_CLOTH = 0.05
"""Distance [m] of cloth from skin up to which it covers it; a hem that flares covers more, which is left out."""


def measure(
    trajectory: Trajectory,
    skinned: np.ndarray | None = None,
    progress: Progress = no_progress,
    contact: bool = True,
) -> dict[str, Any]:
    """Metrics of a trajectory, as the command line reports them.

    Args:
        trajectory: frames as written; the energies of a frame are those of the step that led to it. The first frame has
            none and is measured as if at rest: its inertia and friction are 0.
        skinned: as `skinned_centres`, or (frames, 3) of one garment [m]; without it falling off is not detected.
        progress: called with (frames done, frames in all).
        contact: whether to measure penetration, visible skin and crossings, which takes most of the time.

    Returns:
        `metrics` and `metrics_paper`, the energies by the released convention: name -> {per_frame, mean, max};
        energies of several garments are summed, strains are taken over all faces. `diverged` and the frame
        `diverged_at` (or None) of the garment that diverges first. `garments`, one entry a garment in the order of
        the file: its `name`, `metrics` (energies and strains), `diverged` and `diverged_at`.

    Raises:
        InputError: it is not a trajectory, or its metadata lack the materials of the garments.
    """
    if not isinstance(trajectory, Trajectory):
        raise InputError(
            f"measure takes a Trajectory, which simulator.simulate(scene) gives, not a {type(trajectory).__name__}."
        )
    ruler = Ruler(trajectory)
    frames = []
    for t in range(trajectory.frame_count):
        frames.append(ruler.frame(t, contact))
        progress(t + 1, trajectory.frame_count)
    by_garment = [frame.garments for frame in frames]
    diverged_at = first_lost(trajectory, ruler.garments, by_garment, skinned)
    garments = []
    for garment, rows, at in zip(ruler.garments.garments, zip(*by_garment, strict=True), diverged_at, strict=True):
        measured = _series(rows, (*ENERGIES, *STRAINS))
        garments.append({"name": garment.name, "metrics": measured, "diverged": at is not None, "diverged_at": at})
    first = _earliest(diverged_at)
    return {
        "metrics": _series([frame.metrics for frame in frames], OF_A_CLIP),
        "metrics_paper": _series([frame.paper for frame in frames], ENERGIES),
        "diverged": first is not None,
        "diverged_at": first,
        "garments": garments,
    }


def _earliest(frames: Iterable[int | None]) -> int | None:
    return min((t for t in frames if t is not None), default=None)


def _series(rows: Sequence[dict[str, float]], names: Iterable[str]) -> dict[str, dict[str, Any]]:
    columns = {name: [row.get(name, float("nan")) for row in rows] for name in names}
    return {
        name: {"per_frame": values, "mean": float(np.mean(values)), "max": float(np.max(values))}
        for name, values in columns.items()
        if not np.isnan(values).all() or name in ENERGIES
    }


def strain_percentile(garments: PackedGarments, positions: Tensor) -> Tensor:
    """Area-weighted 95th percentile () [1] of the strains of all faces of packed garments; 0 at rest.

    Args:
        garments: the garments, with (faces, 3) corners.
        positions: (vertices, 3) of all garments [m], in the dtype of the garments.
    """
    strains = face_strains(positions, garments.faces, garments.inverse_rest_shape)
    return weighted_percentile(strains, garments.face_areas, 95.0)


def _strains(garments: PackedGarments, x: Tensor) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Strains over all faces, and those of each garment; not a number where a position is none."""
    strains = face_strains(x, garments.faces, garments.inverse_rest_shape)

    def over(vertices: Tensor | slice, faces: Tensor | slice) -> dict[str, float]:
        if not bool(torch.isfinite(x[vertices]).all()):
            return dict.fromkeys(STRAINS, float("nan"))
        percentile = weighted_percentile(strains[faces], garments.face_areas[faces], 95.0)
        return {"strain_p95": float(percentile), "strain_max": float(strains[faces].max())}

    total = over(slice(None), slice(None))
    if garments.garment_count == 1:
        return total, [total]
    rows = [over(garments.vertex_garment == g, garments.face_garment == g) for g in range(garments.garment_count)]
    return total, rows


def first_diverged(trajectory: Trajectory, skinned: np.ndarray | None = None) -> int | None:
    """The frame `diverged_at` of `measure`, or None, without the energies: milliseconds a frame.

    Args:
        trajectory: frames as written.
        skinned: as `skinned_centres`, or (frames, 3) of one garment [m]; without it falling off is not detected.

    Raises:
        InputError: the metadata lack the materials of the garments.
    """
    garments = packed_garments(trajectory)
    strains = [_strains(garments, _tensor(positions))[1] for positions in trajectory.positions]
    return _earliest(first_lost(trajectory, garments, strains, skinned))


def garments_of(trajectory: Trajectory) -> list[Garment]:
    """The garments of a trajectory, from its own record, in the order of its vertices.

    Args:
        trajectory: the trajectory.

    Raises:
        InputError: the metadata lack their materials.
    """
    try:
        return [_garment(trajectory.header, entry) for entry in trajectory.header.garments]
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError("The metadata of the trajectory do not say what its garments are made of.") from error


def packed_garments(trajectory: Trajectory) -> PackedGarments:
    """The garments of a trajectory in one world, float64.

    Args:
        trajectory: the trajectory.

    Raises:
        InputError: the metadata lack their materials.
    """
    garments = garments_of(trajectory)
    return pack(garments, worlds=[0] * len(garments))


def _garment(header: TrajectoryHeader, entry: dict[str, Any]) -> Garment:
    vertices, triangles = slice(*entry["vertices"]), slice(*entry["triangles"])
    rest = np.asarray(header.rest_positions[vertices], dtype=np.float64)
    faces = header.faces[triangles] - vertices.start
    flat = None if header.rest_uv is None else np.asarray(header.rest_uv[triangles], dtype=np.float64)
    if flat is not None and not np.isfinite(flat).all():
        flat = None
    materials: list[Material] = []
    places = np.zeros(len(header.faces), dtype=np.int64)
    for material in header.metadata.get("materials", ()):
        if any(triangles.start <= first < triangles.stop for first, _ in material["faces"]):
            for first, stop in material["faces"]:
                places[first:stop] = len(materials)
            materials.append(Material.of(material))
    garment = Garment(
        str(entry["name"]),
        rest,
        faces,
        Material.of(entry["material"]),
        header.pinned[vertices],
        rest_uv=flat,
        grainless=not entry.get("has_grain", True),
        sewn=tuple(_sewn(part) for part in entry.get("parts", ())),
        trims=None if header.trims is None else Trims(*np.asarray(header.trims[triangles], dtype=np.float64).T),
    )
    if header.material_layers is not None:
        layers = np.asarray(header.material_layers[triangles], dtype=np.float64)
        rows = np.flatnonzero(layers.any(axis=0))
        materials = [Material.of(header.metadata["materials"][k]) for k in rows]
        return replace(garment, materials=tuple(materials), material_layers=layers[:, rows])
    return replace(garment, materials=tuple(materials), face_material=places[triangles]) if materials else garment


def _sewn(part: dict[str, Any]) -> SewnPart:
    material = part["material"]
    return SewnPart(**{**part, "material": None if material is None else Material.of(material)})


def visible_skin(
    body: np.ndarray, body_faces: np.ndarray, cloth: np.ndarray, cloth_faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of the body's vertices show where cloth should cover them, and which are covered.

    At each vertex the nearest cloth that faces the same way and lies along the body's normal, not at a border of the
    cloth, decides: above the skin it covers the vertex, below it the skin shows.

    Args:
        body: (body vertices, 3) [m].
        body_faces: (body faces, 3) int64, of the parts that cloth may touch.
        cloth: (vertices, 3) of all garments [m].
        cloth_faces: (faces, 3) int64.

    Returns:
        Two masks (body vertices,) bool, covered and visible, and the faces (visible vertices,) int64 of the cloth under
        the visible ones.
    """
    shown, covered = np.zeros(len(body), dtype=bool), np.zeros(len(body), dtype=bool)
    vertices = np.unique(body_faces)
    normals = area_weighted_normals(body, body_faces)[vertices]
    cover = SkinCover.at(body[vertices], normals, TriangleSurface(cloth_faces, len(cloth)).at(cloth))
    shown[vertices] = cover.shown
    covered[vertices] = cover.belongs & (cover.heights >= 0.0) & (cover.distances < SKIN_UNDER_CLOTH)
    return shown, covered, cover.faces[cover.shown]


def pinched(
    pairs: np.ndarray, cloth: np.ndarray, cloth_faces: np.ndarray, body: np.ndarray, folds: np.ndarray
) -> np.ndarray:
    """Which crossings (pairs,) bool of cloth with the body are where the body is inside itself.

    The circumscribed circle of the cloth's face decides, since no cloth fits between two parts of a body that pass
    through each other.

    Args:
        pairs: (pairs, 2) int64 a face of cloth and one of the body.
        cloth: (vertices, 3) [m].
        cloth_faces: (faces, 3) int64.
        body: (body vertices, 3) [m].
        folds: (folds, 3) int64 faces of the body that overlap others.
    """
    if not len(pairs) or not len(folds):
        return np.zeros(len(pairs), dtype=bool)
    corners = cloth[cloth_faces[pairs[:, 0]]]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    # The faces themselves: on a coarse body their vertices are farther away than the cloth's faces are wide.
    near: np.ndarray = np.abs(TriangleSurface(folds, len(body)).at(body).nearest(centres).signed_distance.numpy())
    return near <= radii


class FrameMetrics(NamedTuple):
    """Metrics of one frame; NaN where a position is not finite.

    Args:
        metrics: energies [J] summed over garments, strains over all faces, and penetration where the body has an
            inside: percent of the vertices, and the greatest depth [m]; percent of the skin under cloth that shows;
            pairs of triangles that cross, of cloth with cloth and of cloth with the body.
        paper: the energies [J] by the released convention.
        garments: energies [J] and strains of each garment.
    """

    metrics: dict[str, float]
    paper: dict[str, float]
    garments: list[dict[str, float]]


class Ruler:
    """Measures single frames; stores the data of a trajectory that all measurements share.

    Args:
        trajectory: to measure.

    Attributes:
        garments: the garments, packed in float64.
        surface: the body's surface, or None where it is open or nothing may touch it.
        faces: (faces, 3) of the bodies.
        touched: (faces, 3) of the bodies that cloth may touch.

    Raises:
        InputError: the metadata lack the materials of the garments.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        header = trajectory.header
        self.trajectory = trajectory
        self.potentials = IncrementalPotential(), released_potential()
        self.dt = 1.0 / trajectory.fps
        self.environment = Environment.of_metadata(header.metadata)
        self.garments = packed_garments(trajectory)
        faces, contact = np.array(header.body_faces), np.array(header.body_contact)
        self.colliders = pack_colliders([torch.from_numpy(faces)], [torch.from_numpy(contact)], [0])
        # A step has three poses, and shares two of them with the next.
        self._pose = lru_cache(maxsize=3)(lambda t: self.colliders.pose(self._body(t)))
        closed = Topology(faces, len(contact)).is_closed
        touchable = closed and bool(contact[faces].all(axis=1).any())
        # As contact knows it: what is in a hand or finger, which it leaves out, is not in the arm.
        self.surface = TriangleSurface(faces, len(contact), contact, capped=True) if touchable else None
        self.faces = faces
        self.touched = faces[contact[faces].all(axis=1)]

    def frame(self, t: int, contact: bool = True) -> FrameMetrics:
        """Metrics of frame t.

        Args:
            t: number of the frame.
            contact: see `measure`.
        """
        x = _tensor(self.trajectory.positions[t])
        strains, each_strains = _strains(self.garments, x)
        if not bool(torch.isfinite(x).all()):
            lost = dict.fromkeys(ENERGIES, float("nan"))
            measures = lost | dict.fromkeys(GEOMETRY, float("nan"))
            return FrameMetrics(measures, lost, [lost | strains for strains in each_strains])
        step = self.step(t, x)
        ours, paper = (_energies(potential.of(step).energies(x).terms) for potential in self.potentials)
        metrics = _summed(ours) | strains
        if contact:
            metrics |= self._contact(t, x)
        garments = [energies | strains for energies, strains in zip(ours, each_strains, strict=True)]
        return FrameMetrics(metrics, _summed(paper), garments)

    def _contact(self, t: int, x: Tensor) -> dict[str, float]:
        """Penetration, skin and crossings of frame t, where `x` (vertices, 3) [m] is finite."""
        metrics = {}
        if self.surface is not None:
            distance = self.surface.at(self._body(t)).nearest(x).signed_distance
            metrics["penetration_percent"] = 100.0 * float((distance < -PENETRATION_TOLERANCE).double().mean())
            metrics["penetration_depth_max"] = max(0.0, -float(distance.min()))
        cloth = self.garments.faces.numpy()
        metrics["self_intersections"] = float(len(self_crossings(x.numpy(), cloth)))
        if len(self.touched):
            body = self._body(t).numpy()
            shown, covered, _ = visible_skin(body, self.touched, x.numpy(), cloth)
            crossing = crossings(x.numpy(), cloth, body, self.touched)
            folds = self.faces[:0]
            if shown.any() or len(crossing):
                folds = self.faces[overlapping_faces(body, self.faces)]
                shown &= ~buried(shown, body, self.faces, folds)
            areas = vertex_areas(body, self.touched)
            under = float(areas[shown | covered].sum())
            metrics["visible_skin_percent"] = 100.0 * float(areas[shown].sum()) / under if under else 0.0
            metrics["body_intersections"] = float(len(crossing))
            metrics["body_intersections_pinched"] = float(pinched(crossing, x.numpy(), cloth, body, folds).sum())
        return metrics

    def step(self, t: int, x: Tensor) -> TimeStep:
        """The step that led to frame t and `x` (vertices, 3) [m]; frame 0 is measured as if at rest.

        Args:
            t: number of the frame.
            x: (vertices, 3) [m] positions in that frame.
        """
        state = State(x, torch.zeros_like(x), -1)
        if t:
            positions, velocities = (_tensor(e[t - 1]) for e in (self.trajectory.positions, self.trajectory.velocities))
            state = State(torch.nan_to_num(positions), torch.nan_to_num(velocities), t - 1)
        collider = ColliderFrame(*(self._pose(max(s, 0)) for s in (t - 2, t - 1, t)))
        return TimeStep(self.garments, state, collider, self.dt, self.environment)

    def _body(self, t: int) -> Tensor:
        return _tensor(self.trajectory.body_positions[t])


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))


def _energies(terms: Mapping[str, Tensor]) -> list[dict[str, float]]:
    """Energies [J] and their total for each garment, from term -> (garments,)."""
    by_garment = torch.stack(list(terms.values()), dim=1).tolist()
    garments = [dict(zip(terms, values, strict=True)) for values in by_garment]
    return [{**energies, "total": sum(energies.values())} for energies in garments]


def _summed(garments: list[dict[str, float]]) -> dict[str, float]:
    first, *others = garments
    return {name: sum((other[name] for other in others), value) for name, value in first.items()}
