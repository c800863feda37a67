"""Where a garment sits on the resting body, and how to move a file there that was made in other units or axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.geometry.nearest_surface import PosedSurface, TriangleSurface
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import area_weighted_normals, face_areas

# Vertices of a garment that are looked at to place it, and every how many of them for a first look at its height:
# hundreds of placements are compared, and the time grows with both.
_SAMPLES, _COARSE = 400, 4
# Step [m] of the first look at heights, less than the width of a dip in the misfit.
_SHIFT_STEP = 0.03
# Distances to the body count up to this [m]: farther is nowhere, and a train must not outweigh a bodice.
_FARTHEST = 0.3
WHOLLY_INSIDE = 0.95
"""Share of vertices inside the body from which a garment counts as inside it."""
# A garment made around the body model's own origin reaches at least so far [m] below the ground, if it is long.
_BELOW_GROUND = 0.1
# Heights [m] that differ by less are one place on the body.
_SAME_HEIGHT = 0.05
# Share of the body's height above which cloth counts: feet face up as well, but a garment that lies there fell.
_LEAST_HEIGHT = 0.6
# Least upward part of the skin's unit normal where cloth can lie; hips and chest slope more than that.
_FACING_UP = 0.75
# Greatest distance [m] between the skin and the cloth that comes to lie on it.
_RESTING = 0.1
LEAST_AREA = 5e-4
"""Cloth [m^2] over such skin that is a rest: a few square centimetres, as of a strap."""
_UP = np.array([0.0, 1.0, 0.0])

UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
UPRIGHT = "Y up, facing +Z"
AXES = {
    UPRIGHT: np.eye(3),
    "Z up, facing -Y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "Z up, facing +Y": np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "Y up, facing -Z": np.diag([-1.0, 1.0, -1.0]),
}
"""Name of a file's axes -> rotation (3, 3) that takes them to the world's."""


@dataclass(frozen=True, eq=False)
class RestBody:
    """The surface that a garment is fitted to.

    Args:
        name: what the user called the body.
        vertices: (vertices, 3) float64 [m].
        faces: (faces, 3) int64.
        contact: (vertices,) bool.
        lift: height of the body model's own origin above the ground [m].
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    contact: np.ndarray
    lift: float = 0.0

    @classmethod
    def of(cls, body: ShapedBody | AnimatedBody) -> RestBody:
        """A shaped body at rest, or frame 0 of a body without a skeleton."""
        if isinstance(body, ShapedBody):
            return cls(body.name, body.vertices, body.faces, body.contact, body.lift)
        return cls(body.name, body.positions(0, 1)[0].numpy().astype(np.float64), body.faces, body.contact)

    @cached_property
    def surface(self) -> PosedSurface:
        """The part of the surface that contact is answered on."""
        return TriangleSurface(self.faces, len(self.vertices), self.contact).at(self.vertices)

    @cached_property
    def is_closed(self) -> bool:
        """Whether inside has a meaning."""
        return Topology(self.faces, len(self.vertices)).is_closed

    def signed_distances(self, points: np.ndarray) -> np.ndarray:
        """Distances of points to the surface, negative inside; without a sign when the body is not closed.

        Args:
            points: (points, 3) [m].

        Returns:
            (points,) [m].
        """
        distances: np.ndarray = self.surface.nearest(points).signed_distance.numpy()
        return distances if self.is_closed else np.abs(distances)

    @cached_property
    def _tree(self) -> tuple[cKDTree, np.ndarray]:
        touchable = np.flatnonzero(self.contact)
        return cKDTree(self.vertices[touchable]), area_weighted_normals(self.vertices, self.faces)[touchable]

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """Mean distance (...) [m] of `points` (..., points, 3) to the body, depth inside it counted five times.

        Roughly, by the nearest body vertex: for comparing hundreds of placements.
        """
        tree, normals = self._tree
        distance, nearest = tree.query(points)
        offset = points - tree.data[nearest]
        inside = np.einsum("...d,...d->...", offset, normals[nearest]) < 0.0
        cost: np.ndarray = (np.minimum(distance, _FARTHEST) * np.where(inside, 5.0, 1.0)).mean(axis=-1)
        return cost


@dataclass(frozen=True, eq=False)
class Fit:
    """A similarity transform that puts a garment on the body: x -> scale R x + shift.

    Args:
        unit: name of the file's unit, a key of `UNITS`.
        axes: name of the file's axes, a key of `AXES`.
        shift: (3,) [m].
        misfit: of the moved garment, see `RestBody.misfit` [m].
        searched: whether the height was searched for, with nothing in the body model to say it.
    """

    unit: str
    axes: str
    shift: np.ndarray
    misfit: float
    searched: bool = False

    @classmethod
    def identity(cls, misfit: float | np.ndarray) -> Fit:
        """The fit that moves nothing; `misfit` is one number [m]."""
        return cls("metres", UPRIGHT, np.zeros(3), float(misfit))

    def apply(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices (n, 3) of the file where the body expects them [m]."""
        moved: np.ndarray = UNITS[self.unit] * vertices @ AXES[self.axes].T + self.shift
        return moved

    @property
    def is_identity(self) -> bool:
        """Whether nothing moves."""
        return self.unit == "metres" and self.axes == UPRIGHT and not self.shift.any()


def find_fit(vertices: np.ndarray, body: RestBody) -> Fit:
    """The transform under which a garment, in whatever unit and axes, fits the body best.

    What needs less change wins among those that fit about as well: first as it is, then by the body model's own origin
    where it reaches below the ground or fits best there, then any height. A garment that lies wholly inside the body is
    not looked for elsewhere.

    Args:
        vertices: (vertices, 3) of the garment, in its own unit and axes [file units].
        body: the resting body.
    """
    picked = np.linspace(0, len(vertices) - 1, min(_SAMPLES, len(vertices))).astype(np.int64)
    sample = vertices[picked]
    if (body.signed_distances(sample) < 0.0).mean() > WHOLLY_INSIDE:
        return Fit.identity(body.misfit(sample))
    height = float(np.ptp(body.vertices[:, 1]))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    fits: list[Fit] = []
    for unit, scale in UNITS.items():
        if not 0.08 * height < scale * float((high - low).max()) < 1.5 * height:
            continue
        for axes, rotation in AXES.items():
            fits += _fits_at(unit, axes, scale * sample @ rotation.T, body)
    if not fits:
        return Fit.identity(body.misfit(sample))
    best = 1.25 * min(fit.misfit for fit in fits) + 0.003
    return min((fit for fit in fits if fit.misfit <= best), key=_change)


def _fits_at(unit: str, axes: str, points: np.ndarray, body: RestBody) -> list[Fit]:
    """Fits of turned and scaled `points` (points, 3): unmoved, by the model's origin, and at the best height."""
    searched = _best_height(points, body)
    tried = [(0.0, False)]
    # At most heights a wide garment fits about as well, over the head too: the model's origin has to be likely.
    if points[:, 1].min() < -_BELOW_GROUND or (searched is not None and abs(searched - body.lift) < _SAME_HEIGHT):
        tried.append((body.lift, False))
    if searched is not None:
        tried.append((searched, True))
    return [Fit(unit, axes, h * _UP, float(body.misfit(points + h * _UP)), is_searched) for h, is_searched in tried]


def _best_height(points: np.ndarray, body: RestBody) -> float | None:
    """Height [m] to move `points` (points, 3) by; of several that fit about as well, the smallest move.

    None where there is no room between the ground and the top of the head.
    """
    top = float(body.vertices[:, 1].max())
    heights = np.arange(-float(points[:, 1].min()), top - float(points[:, 1].max()) + _SHIFT_STEP, _SHIFT_STEP)
    if not len(heights):
        return None
    coarse = np.array([float(body.misfit(points[::_COARSE] + h * _UP)) for h in heights])
    framed = np.pad(coarse, 1, constant_values=np.inf)
    dips = (coarse <= framed[:-2]) & (coarse <= framed[2:]) & (coarse <= 1.05 * coarse.min() + 0.001)
    nearest = heights[dips][np.argmin(np.abs(heights[dips]))]
    around = nearest + np.linspace(-_SHIFT_STEP, _SHIFT_STEP, 13)
    fine = [float(body.misfit(points + h * _UP)) for h in around]
    return float(around[int(np.argmin(fine))])


def _change(fit: Fit) -> tuple[int, int, bool, bool, float]:
    """Order of preference among fits that are about as good."""
    unmoved = fit.axes == UPRIGHT and not fit.shift.any()
    return list(UNITS).index(fit.unit), list(AXES).index(fit.axes), not unmoved, fit.searched, fit.misfit


def resting_area(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> float:
    """Area [m^2] of the cloth that lies on the body's shoulders, or on other skin of its upper part that faces up.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    ground, top = float(body.vertices[:, 1].min()), float(body.vertices[:, 1].max())
    centres = vertices[faces].mean(axis=1)
    high = centres[:, 1] > ground + _LEAST_HEIGHT * (top - ground)
    if not high.any():
        return 0.0
    below = body.surface.nearest(centres[high])
    rests = (below.normals.numpy()[:, 1] > _FACING_UP) & (np.abs(below.signed_distance.numpy()) < _RESTING)
    return float(face_areas(vertices, faces[high])[rests].sum())


def is_held_up(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> bool:
    """Whether enough cloth lies on the shoulders to hold a garment up.

    Cloth stretches over hips that are wider than the waist, so a waist alone is not taken to hold. A bodice that fits
    closely far above the waist can hold without shoulders all the same; that is not seen here.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    return resting_area(vertices, faces, body) >= LEAST_AREA
