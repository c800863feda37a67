"""Where a garment sits on the resting body, and how to move a file there that was made in other units or axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.length_units import UNITS
from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import area_weighted_normals, face_cross_products

# Vertices of a garment that are looked at to place it, and every how many of them for a first look: thousands of
# placements are compared, and the time grows with both.
_SAMPLES, _COARSE = 400, 4
WORST_MISFIT, SURELY_WORN = 0.08, 0.048
"""Mean distance to the body [m] above which a garment that would fit elsewhere is not taken to be worn, and up to which
one that may belong anywhere is."""
# Step [m] of the first look at heights, less than the width of a dip in the misfit, and times that a garment is drawn
# towards the body from each.
_SHIFT_STEP, _DRAWN = 0.06, 4
# Distances to the body count up to this [m] in a first look, so that a garment far off is drawn towards it; and up to
# that where fits are compared, so that a hem that flares does not outweigh a waist that sits.
_FARTHEST, _NEAR = 0.3, 0.05
# Places refined of each unit and axes and of all, and how much worse than the best in the first look they may be.
_REFINED, _REFINED_IN_ALL, _HOPELESS = 2, 6, 1.8
# A garment stays where it is, and as it is turned, unless another fit has less than 1 / (this share) of the misfit,
# this [m] aside: clothes hang loose by a few millimetres, and real ones fit where they are twice as well as 3 cm away.
_CLEARLY, _LOOSELY = 1.12, 1e-3
_WIDE = 1.25
"""How many times the best misfit the body model's own origin may have, where a wide shape does not show its place."""
# Front and back, or two sides, fit alike where one has not this many times the misfit of the other; of shirts, trousers
# and shorts made by others the wrong way round has twice.
_ALIKE = 1.35
WHOLLY_INSIDE = 0.95
"""Share of vertices inside the body from which a garment counts as inside it."""
# A garment made around the body model's own origin reaches at least so far [m] below the ground, if it is long.
_BELOW_GROUND = 0.1
# Share of the wearer's height that a garment spans: any, any in a unit that is rare, and most; and how many times its
# misfit one has beyond that, and one in a unit that is rare. A garment at a third of its size fits as well, around an
# arm.
_SPANS, _RARE_SPANS, _USUAL_SPANS = (0.08, 1.5), (0.2, 1.5), (0.3, 1.05)
_RARE, _ODD, _ODD_UNIT = ("inches", "decimetres", "feet"), 1.5, 1.2
# Share of the misfit that a garment where its file places it, in one of the units, has of that in any other.
_IN_PLACE = 0.9
# Heights [m] that differ by less are one place on the body.
_SAME_HEIGHT = 0.05
_UP = np.array([0.0, 1.0, 0.0])

UPRIGHT = "Y up, facing +Z"


def _axes(up: str, facing: str) -> np.ndarray:
    """Rotation (3, 3) that takes a file's axes to the world's, in which Y is up and a body faces +Z."""
    vectors = {sign + name: float(f"{sign}1") * np.eye(3)["XYZ".index(name)] for sign in "+-" for name in "XYZ"}
    above, front = vectors[f"+{up}"], vectors[facing]
    return np.stack([np.cross(above, front), above, front])


AXES = {
    f"{up} up, facing {facing}": _axes(up, facing)
    for up, facing in (
        ("Y", "+Z"), ("Z", "-Y"), ("Z", "+Y"), ("Y", "-Z"), ("Y", "+X"), ("Y", "-X"), ("Z", "+X"), ("Z", "-X")
    )
}  # fmt: skip
"""Name of a file's axes -> rotation (3, 3) that takes them to the world's; the likelier come first."""


@dataclass(frozen=True, eq=False)
class RestBody:
    """The surface that a garment is fitted to.

    Args:
        name: of the body, as given by the user.
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
        """A shaped body at rest, or frame 0 of a body without a skeleton.

        Args:
            body: any body.
        """
        if isinstance(body, ShapedBody):
            return body.kept(
                "rest body", lambda body: cls(body.name, body.vertices, body.faces, body.contact, body.lift)
            )
        return cls(body.name, body.positions(0, 1)[0].numpy().astype(np.float64), body.faces, body.contact)

    @cached_property
    def surface(self) -> PosedSurface:
        """The part of the surface that takes part in contact."""
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

    def offsets_from(self, points: np.ndarray) -> np.ndarray:
        """From points to the body's nearest vertices.

        Args:
            points: (..., points, 3) [m].

        Returns:
            (..., points, 3) [m].
        """
        tree, _ = self._tree
        return tree.data[tree.query(points)[1]] - points

    def misfit(self, points: np.ndarray, farthest: float = _FARTHEST) -> np.ndarray:
        """Mean distance to the body, depth inside it counted five times.

        Roughly, by the nearest body vertex: for comparing thousands of placements.

        Args:
            points: (..., points, 3) [m].
            farthest: distance [m] that counts as far as any above it.

        Returns:
            (...) [m].
        """
        tree, normals = self._tree
        distance, nearest = tree.query(points)
        offset = points - tree.data[nearest]
        inside = np.einsum("...d,...d->...", offset, normals[nearest]) < 0.0
        return (np.minimum(distance, farthest) * np.where(inside, 5.0, 1.0)).mean(axis=-1)


@dataclass(frozen=True, eq=False)
class Fit:
    """A similarity transform that puts a garment on the body: x -> scale R x + shift.

    Args:
        unit: name of the file's unit, a key of `UNITS`.
        axes: name of the file's axes, a key of `AXES`.
        shift: (3,) [m].
        misfit: of the moved garment, see `RestBody.misfit` [m].
        searched: whether the position was found by a search, without information from the body model.
        alike: other axes under which it fits about as well.
    """

    unit: str
    axes: str
    shift: np.ndarray
    misfit: float
    searched: bool = False
    alike: tuple[str, ...] = ()

    @classmethod
    def identity(cls, misfit: float | np.ndarray) -> Fit:
        """The fit without any change; `misfit` is one number [m].

        Args:
            misfit: distance by which the garment does not fit [m].
        """
        return cls("metres", UPRIGHT, np.zeros(3), float(misfit))

    def apply(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices (n, 3) of the file where the body expects them [m].

        Args:
            vertices: (n, 3) in the unit of the file.
        """
        return UNITS[self.unit] * vertices @ AXES[self.axes].T + self.shift

    @property
    def is_unsure(self) -> bool:
        """Whether the position was found by a search and most rotations of the garment fit equally well, so that its
        place is unknown."""
        return self.searched and len(self.alike) >= len(AXES) // 2

    @property
    def front_alike(self) -> tuple[str, ...]:
        """Other turns about the vertical in which the garment fits about as well, as where front and back are alike."""
        return tuple(axes for axes in self.alike if axes[0] == self.axes[0])

    @property
    def move(self) -> str:
        """The shift in words, such as "+3.0 cm in x and -1.2 cm in y"."""
        parts = [f"{100 * d:+.1f} cm in {axis}" for axis, d in zip("xyz", self.shift, strict=True) if abs(d) > 5e-4]
        return " and ".join(parts) or "0 cm"

    @property
    def is_identity(self) -> bool:
        """Whether nothing moves."""
        return self.unit == "metres" and self.axes == UPRIGHT and not self.shift.any()


def find_fit(vertices: np.ndarray, body: RestBody) -> Fit:
    """The transform with which a garment of any unit, axes and position fits the body best.

    Units, quarter turns about the vertical and shifts in all three directions are compared. The unit comes first: one
    in which the garment fits at its present position, else one in which it fits best and has a usual size. Among
    transforms that fit about equally well the smallest change wins: first none, then a shift by the body model's origin
    if the garment reaches below the ground or fits best there, then any position. A garment that is wholly inside the
    body is not moved elsewhere.

    Args:
        vertices: (vertices, 3) of the garment, in its own unit and axes [file units].
        body: the resting body.
    """
    picked = np.linspace(0, len(vertices) - 1, min(_SAMPLES, len(vertices))).astype(np.int64)
    sample = vertices[picked]
    if (body.signed_distances(sample) < 0.0).mean() > WHOLLY_INSIDE:
        return Fit.identity(body.misfit(sample, _NEAR))
    height = float(np.ptp(body.vertices[:, 1]))
    span = float(np.ptp(vertices, axis=0).max())
    posed = {
        (unit, axes): scale * sample @ rotation.T
        for unit, scale in UNITS.items()
        for least, most in [_RARE_SPANS if unit in _RARE else _SPANS]
        if least * height < scale * span < most * height
        for axes, rotation in AXES.items()
    }
    odds = {unit: _odds(unit, scale * span / height) for unit, scale in UNITS.items()}
    usual = {key: points for key, points in posed.items() if odds[key[0]] < _ODD}
    if (in_place := _unit_in_place(usual, body)) is not None:
        posed = {key: points for key, points in posed.items() if key[0] == in_place}
    starts = [(key, *start) for key, points in posed.items() for start in _starts(points, body)]
    if not starts:
        return Fit.identity(body.misfit(sample, _NEAR))
    starts.sort(key=lambda start: start[1])
    fits = []
    for k, (key, misfit, shift) in enumerate(starts):
        place = shift
        if k < _REFINED_IN_ALL and misfit <= _HOPELESS * starts[0][1]:
            place = _refined(posed[key], shift, body)
        fits.append(Fit(*key, place, float(body.misfit(posed[key] + place, _NEAR)), searched=True))
    for key, points in posed.items():
        fits += [
            Fit(*key, shift, float(body.misfit(points + shift, _NEAR))) for shift in _given(points, fits, key, body)
        ]
    fits = _of_likeliest_unit(fits, odds)
    best = min(fit.misfit for fit in fits)
    chosen = _compared(min((f for f in fits if f.misfit <= _CLEARLY * best + _LOOSELY), key=_change), fits)
    if chosen.is_unsure:
        # So wide that its shape says little: the model's own origin is likelier than any place where it fits a little
        # better.
        limit = min(_WIDE * best + 3 * _LOOSELY, 0.95 * _NEAR)
        loosely = [f for f in fits if not f.searched and f.shift.any() and f.misfit <= limit]
        chosen = _compared(min(loosely, key=_change), fits) if loosely else chosen
    if chosen.is_unsure and float(body.misfit(sample)) <= SURELY_WORN:
        return Fit.identity(body.misfit(sample, _NEAR))
    return chosen


def _odds(unit: str, span: float) -> float:
    """How many times its misfit a garment has in a unit in which it spans so many heights of its wearer."""
    least, most = _USUAL_SPANS
    return (1.0 if least <= span <= most else _ODD) * (_ODD_UNIT if unit in _RARE else 1.0)


def _unit_in_place(posed: Mapping[tuple[str, str], np.ndarray], body: RestBody) -> str | None:
    """The unit in which a garment is worn where its file places it; None where there is none, or more than one.

    What would be small near the origin is as near to the feet as clothes are to what they cover.
    """
    misfits, shifts = dict[str, float](), np.array([0.0, body.lift])[:, None, None] * _UP
    for (unit, _), points in posed.items():
        best = float(body.misfit(points + shifts, _NEAR).min())
        misfits[unit] = min(best, misfits.get(unit, np.inf))
    first, *others = sorted(misfits, key=misfits.__getitem__) or [""]
    if not first or misfits[first] > 0.9 * _NEAR:
        return None
    return first if all(misfits[first] < _IN_PLACE * misfits[other] for other in others) else None


def _of_likeliest_unit(fits: list[Fit], odds: Mapping[str, float]) -> list[Fit]:
    """The fits in the likeliest unit in which a garment fits about as well as in any."""
    misfits = [odds[fit.unit] * fit.misfit for fit in fits]
    limit = _CLEARLY * min(misfits) + _LOOSELY
    units = [fit.unit for fit, misfit in zip(fits, misfits, strict=True) if misfit <= limit]
    unit = min(units, key=list(UNITS).index)
    return [fit for fit in fits if fit.unit == unit]


def _compared(chosen: Fit, fits: list[Fit]) -> Fit:
    """A fit with the axes under which the garment fits about as well."""
    # Only the best of each counts: a garment fits worse turned the wrong way than anywhere else turned the right one.
    turned = {axes: min((fit.misfit for fit in fits if fit.axes == axes), default=np.inf) for axes in AXES}
    best = turned.pop(chosen.axes)
    return replace(chosen, alike=tuple(axes for axes, misfit in turned.items() if misfit < _ALIKE * best))


def _starts(points: np.ndarray, body: RestBody) -> list[tuple[float, np.ndarray]]:
    """Places worth refining: misfit in a first look [m], and shift (3,) [m].

    The points are let down on to the body at every height between the ground and the top of the head: each is drawn to
    the body's nearest vertex, and all move by the mean of that.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    top = float(body.vertices[:, 1].max())
    heights = np.arange(-float(low[1]), top - float(high[1]) + _SHIFT_STEP, _SHIFT_STEP)
    if not len(heights):
        return []
    middle = 0.5 * (body.vertices.min(axis=0) + body.vertices.max(axis=0) - low - high) * [1.0, 0.0, 1.0]
    few = points[::_COARSE]
    shifts = middle + heights[:, None] * _UP
    for _ in range(_DRAWN):
        shifts = shifts + body.offsets_from(few + shifts[:, None]).mean(axis=1)
    misfits = body.misfit(few + shifts[:, None], _NEAR)
    starts: list[tuple[float, np.ndarray]] = []
    for k in np.argsort(misfits).tolist():
        if all(np.linalg.norm(shifts[k] - shift) > _SHIFT_STEP for _, shift in starts):
            starts.append((float(misfits[k]), shifts[k]))
    return starts[:_REFINED]


def _refined(points: np.ndarray, shift: np.ndarray, body: RestBody) -> np.ndarray:
    """Shift (3,) [m] near `shift` at which `points` (points, 3) [m] fit best, by smaller and smaller steps."""
    steps = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.float64)
    for points_used, step, farthest in (
        (points[::_COARSE], 0.03, _FARTHEST / 3), (points[::_COARSE], 0.012, _NEAR), (points, 0.005, _NEAR),
        (points, 0.002, _NEAR),
    ):  # fmt: skip
        for _ in range(6):
            tried = shift + step * steps
            best = int(np.argmin(body.misfit(points_used + tried[:, None], farthest)))
            shift = tried[best]
            if not steps[best].any():
                break
    return shift


def _given(points: np.ndarray, fits: list[Fit], key: tuple[str, str], body: RestBody) -> list[np.ndarray]:
    """Shifts (3,) [m] of turned and scaled `points` (points, 3) that need no search: none, and the model's origin."""
    shifts = [np.zeros(3)]
    # At most heights a wide garment fits about as well, over the head too: the model's origin has to be likely.
    origin = body.lift * _UP
    near = [fit for fit in fits if (fit.unit, fit.axes) == key and np.abs(fit.shift - origin).max() < _SAME_HEIGHT]
    if points[:, 1].min() < -_BELOW_GROUND or near:
        shifts.append(origin)
    return shifts


def _change(fit: Fit) -> tuple[int, int, bool, bool, float]:
    """Order of preference among fits that are about as good."""
    unmoved = fit.axes == UPRIGHT and not fit.shift.any()
    return list(UNITS).index(fit.unit), list(AXES).index(fit.axes), not unmoved, fit.searched, fit.misfit


def is_inside_out(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> bool:
    """Whether most of the cloth's area has its normal towards the body.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    near = body.surface.nearest(vertices[faces].mean(axis=1))
    return float(np.einsum("ij,ij->i", face_cross_products(vertices, faces), near.normals.numpy()).sum()) < 0.0
