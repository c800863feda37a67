"""Parts of a garment by name: pieces that its file or its pattern names, and bands along its borders.

A band is all cloth within a width of a border. Borders are told apart by where they are as worn at rest, whatever the
garment comes from: an opening beside the middle is that of a limb, the others go round neck, waist or the lower end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pb4u.errors import InputError, refuse_unknown
from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS, Material
from pb4u.garment.trims import SewnPart, Trims
from pb4u.geometry.topology import connected_labels, uv_islands
from pb4u.geometry.triangle_mesh import both_below, carried_directions, nearest_segments, shares_below

WAIST, BORDER = "waist", "border"

WIDTHS = {"hem": 0.02, WAIST: 0.035, "cuff": 0.03, "collar": 0.02, BORDER: 0.01}
"""Names of bands, and their usual widths [m]."""

WEBBING = "elastic"
"""Fabric of elastic that gathers cloth."""

_BESIDE = 0.2
"""Share of half a garment's width by which the border round a limb lies beside its middle."""

_OPEN = 0.5
"""Share of a garment's height that the border of an open front spans."""

_END = 0.1
"""Share of a garment's height up to which such a border is hem or collar."""

_LEGS = 0.15
"""Share of a garment's height up to which borders of legs reach down; those of arms end above."""


@dataclass(frozen=True, eq=False)
class Part:
    """Some cloth of a garment that has a name.

    Args:
        name: of the part.
        is_band: whether it lies along a border.
        beyond: (faces, 3) float64 at the corners of the faces, linear between, positive beyond it.
        along: (faces, 3) direction of the nearest border of the worn garment that the part reaches; None if it reaches
            none.
    """

    name: str
    is_band: bool
    beyond: np.ndarray
    along: np.ndarray | None

    @cached_property
    def share(self) -> np.ndarray:
        """Share (faces,) of each face's area that belongs to the part."""
        return shares_below(self.beyond, 0.0)


class Parts:
    """The parts of a garment.

    Args:
        garment: as worn at rest.
    """

    def __init__(self, garment: Garment) -> None:
        self._garment = garment

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parts, those of its file or pattern first."""
        return tuple(dict.fromkeys((*self.pieces, *self.borders)))

    @property
    def pieces(self) -> dict[str, np.ndarray]:
        """Faces (faces,) bool of what its file calls materials and of the panels of its pattern, by name."""
        return self._garment.parts

    @cached_property
    def open_front(self) -> np.ndarray:
        """Edges (edges, 2) int64 of the border around an open front; empty if it is closed."""
        vertices, loops = self._garment.vertices, self._garment.topology.boundary_loops
        around = [loop for loop, beside in zip(loops, self._beside, strict=True) if not beside]
        top = max(around, key=lambda loop: vertices[loop, 1].max(), default=np.zeros(0, dtype=np.int64))
        if not len(top) or np.ptp(vertices[top, 1]) <= _OPEN * np.ptp(vertices[:, 1]):
            return np.zeros((0, 2), dtype=np.int64)
        return np.column_stack([top, np.roll(top, -1)])

    @cached_property
    def _beside(self) -> np.ndarray:
        """Which (borders,) bool of its borders lie beside its middle, as those round limbs do."""
        across = self._garment.vertices[:, 0]
        middle, half = 0.5 * (across.min() + across.max()), 0.5 * np.ptp(across)
        loops = self._garment.topology.boundary_loops
        return np.array([abs(across[loop].mean() - middle) > _BESIDE * half for loop in loops], dtype=bool)

    @cached_property
    def borders(self) -> dict[str, np.ndarray]:
        """Edges (edges, 2) int64 of its borders by the name of their band."""
        loops = self._garment.topology.boundary_loops
        if not loops:
            return {}
        edges, vertices = [np.column_stack([loop, np.roll(loop, -1)]) for loop in loops], self._garment.vertices
        lowest_end, tall = vertices[:, 1].min(), np.ptp(vertices[:, 1])
        level = np.array([vertices[loop, 1].mean() for loop in loops])
        around, limbs, front = np.flatnonzero(~self._beside), np.flatnonzero(self._beside), self.open_front
        borders: dict[str, list[np.ndarray]] = {}
        legs = limbs[:0]
        if len(around):
            top = max(around, key=lambda k: vertices[loops[k], 1].max())
            if len(around) == 1 and not len(front):
                reach = np.array([vertices[loop, 1].min() for loop in loops])
                legs = limbs[reach[limbs] < lowest_end + _LEGS * tall]
            upper = "waist" if len(legs) == len(limbs) else "collar"
            if len(front):
                ends = vertices[front]
                heights, ways = ends[..., 1].mean(axis=1), ends[:, 1] - ends[:, 0]
                is_level = np.abs(ways[:, 1]) < 0.5 * np.linalg.norm(ways, axis=1)
                borders[upper] = [front[heights > heights.max() - _END * tall]]
                borders["hem"] = [front[(heights < heights.min() + _END * tall) & is_level]]
            else:
                borders[upper] = [edges[top]]
                lowest = around[level[around].argmin()]
                borders["hem"] = [edges[k] for k in legs] if len(around) == 1 else [edges[lowest]]
            borders["cuff"] = [edges[k] for k in np.setdiff1d(limbs, legs)]
        borders["border"] = edges
        return {name: np.concatenate(group) for name, group in borders.items() if group}

    def named(self, name: str, width: float | None = None) -> Part:
        """A part by name.

        Args:
            name: one of `names`.
            width: of a band [m]; None for its default.

        Raises:
            InputError: there is no such part, a width is given for a piece, or a band is wider than its panels.
        """
        garment = self._garment
        refuse_unknown("part", [name], self.names, f"The garment {garment.name}")
        if name in self.pieces:
            if width is not None:
                raise InputError(
                    f"{garment.name}: {name} is a part of its file, which sets the width; leave out band_width."
                )
            faces = self.pieces[name]
            of_piece = garment.topology.edge_faces[:, 0]
            rim = garment.topology.edges[(garment.topology.edge_face_counts == 1) & faces[of_piece]]
            beyond = np.where(faces[:, None], [-1.0, -1.0, -1.0], 1.0)
            return Part(name, False, beyond, self._along(rim) if len(rim) else None)
        rim = self.borders[name]
        return Part(name, True, self._beyond(name, rim, WIDTHS[name] if width is None else width), self._along(rim))

    def _along(self, rim: np.ndarray) -> np.ndarray:
        """Direction (faces, 3) [m] of the nearest of some edges (edges, 2)."""
        vertices = self._garment.vertices
        starts, ends = vertices[rim].swapaxes(0, 1)
        middles = vertices[self._garment.faces].mean(axis=1)
        return (ends - starts)[nearest_segments(middles, starts, ends)[0]]

    def _beyond(self, name: str, rim: np.ndarray, width: float) -> np.ndarray:
        """How far [m] the corners (faces, 3) of the faces are beyond a width of some border edges (edges, 2)."""
        garment = self._garment
        distances = nearest_segments(garment.vertices, *garment.vertices[rim].swapaxes(0, 1))[1]
        self._refuse_wide(name, rim, distances, width)
        # What is near without being joined to the border by what is near is other cloth.
        one, other = garment.topology.edges.T
        near = np.minimum(distances[one], distances[other]) < width
        label = connected_labels(len(distances), one[near], other[near])
        joined = np.isin(label, label[rim])[garment.faces].all(axis=1)
        return np.where(joined[:, None], distances[garment.faces] - width, 1.0)

    def _refuse_wide(self, name: str, rim: np.ndarray, distances: np.ndarray, width: float) -> None:
        """Refuse a band that is wider than a panel along its border, or than the cloth where that has no panels."""
        garment = self._garment
        if garment.source is None and garment.uv_faces is not None:
            panel = uv_islands(garment.uv_faces)
        else:
            panel = garment.topology.piece_of_vertex[garment.faces[:, 0]]
        reach = np.zeros(int(panel.max()) + 1)
        np.maximum.at(reach, panel, distances[garment.faces].max(axis=1))
        on_rim = np.isin(garment.faces, rim).sum(axis=1) > 1
        narrowest = float(reach[panel[on_rim]].min())
        if width > narrowest:
            raise InputError(
                f"{garment.name}: its {name} of {width:g} m is wider than its panel, which is {narrowest:.3f} m wide "
                "there; give a smaller band_width."
            )


def with_parts(
    garment: Garment,
    materials: Mapping[str, Material],
    widths: Mapping[str, float],
    layers: Mapping[str, float],
    interfacing: Mapping[str, float],
    elastic: Mapping[str, float],
) -> Garment:
    """A garment with fabrics, further layers, interfacing and elastic on parts of it; bands lie over pieces.

    Args:
        garment: as worn at rest.
        materials: of parts by name; by default elastic that gathers its part is webbing.
        widths: of bands by name [m].
        layers: number of layers of parts by name.
        interfacing: bending stiffness that is added to parts by name [N m].
        elastic: rest length of parts along their border over that of the cloth, by name.

    Raises:
        InputError: a part is unknown or empty, a band is wider than its panel, two parts share a face, or elastic is
            given to a part that reaches no border.
    """
    webbing = {name: FABRICS[WEBBING] for name, ratio in elastic.items() if ratio < 1.0}
    materials = webbing | dict(materials)
    treatments = (materials, layers, interfacing, elastic)
    names = tuple(dict.fromkeys(name for treatment in (*treatments, widths) for name in treatment))
    if not names:
        return garment
    parts_of_garment = Parts(garment)
    parts = [parts_of_garment.named(name, widths.get(name)) for name in names]
    for name in widths:
        if not any(name in treatment for treatment in treatments):
            raise InputError(
                f"{garment.name}: its {name} has a band_width, but no material, layers, interfacing or elastic for "
                "the band."
            )
    cloths, cloth = list(garment.materials or (garment.material,)), garment.layers
    before = garment.trims or Trims.none(len(garment.faces))
    stiff, gathers = before.interfacing, [_Gather(cloth, _pull(before.elastic), np.tile([1.0, 0.0], (len(cloth), 1)))]
    for is_band in (False, True):
        chosen = [part for part in parts if part.is_band == is_band]
        _refuse_claims(garment, chosen)
        rest = np.maximum(1.0 - sum((part.share for part in chosen), np.zeros(len(stiff))), 0.0)
        count, beneath = cloth.sum(axis=1), (cloth, stiff, gathers)
        cloth, stiff, gathers = rest[:, None] * cloth, rest * stiff, [gather.times(rest) for gather in gathers]
        for part in chosen:
            added = part.share * layers.get(part.name, count)
            if part.name in materials:
                cloths.append(materials[part.name])
                columns = np.column_stack([np.zeros((len(added), len(cloths) - 1)), added])
                cloth = np.column_stack([cloth, added])
            else:
                columns = np.zeros_like(cloth)
                columns[:, : beneath[0].shape[1]] = (added / count)[:, None] * beneath[0]
                cloth = cloth + columns
            stiff += part.share * interfacing.get(part.name, beneath[1])
            if part.name in elastic:
                gathers.append(_Gather(columns, _pull(elastic[part.name]), _ways(garment, part)))
            else:
                gathers += [gather.times(part.share) for gather in beneath[2]]
    if materials or layers:
        garment = garment.with_layers(cloths, cloth)
    if interfacing or elastic:
        garment = replace(garment, trims=Trims(stiff, 1.0 / _stretches(_pulls(garment, cloths, cloth, gathers))))
    if garment.trims is not None and elastic:
        gathered = _gathered(
            garment, [part for part in parts if part.name in elastic], garment.trims.elastic / before.elastic
        )
        garment = replace(garment, rest_uv=gathered, grainless=not garment.has_grain)
    sewn = {part.name: part for part in garment.sewn}
    for part in parts:
        name, width = part.name, widths.get(part.name, WIDTHS[part.name]) if part.is_band else None
        sewn_part = SewnPart(
            name, materials.get(name), layers.get(name), interfacing.get(name), elastic.get(name), width
        )  # fmt: skip
        sewn[name] = sewn.get(name, sewn_part).with_all_of(sewn_part)
    return replace(garment, sewn=tuple(sewn.values()))


class _Gather(NamedTuple):
    """Elastic of a part, on the faces (faces,) of a garment.

    Args:
        layers: (faces, materials) of the cloths that it gathers, as in `Garment.layers`.
        pull: of it, as in `_pull`: one number, or (faces,).
        ways: (faces, 2) unit directions of it at rest.
    """

    layers: np.ndarray
    pull: Any
    ways: np.ndarray

    def times(self, share: np.ndarray) -> _Gather:
        """What is left of it on a share (faces,) of each face."""
        return self._replace(layers=share[:, None] * self.layers)


def _pulls(garment: Garment, cloths: Sequence[Material], layers: np.ndarray, gathers: list[_Gather]) -> np.ndarray:
    """The pull (faces,) of elastic of one ratio on all of each face that draws as those of its parts do together."""
    fabrics = [fabric if garment.has_grain else fabric.without_grain for fabric in cloths]
    forces, ways = np.zeros(len(layers)), gathers[0].ways
    for gather in gathers:
        pull = np.broadcast_to(gather.pull, len(layers))
        forces += pull * _moduli(fabrics, gather.layers, gather.ways)
        ways = np.where(((pull != 0.0) & gather.layers.any(axis=1))[:, None], gather.ways, ways)
    return forces / _moduli(fabrics, layers, ways)


def _moduli(cloths: Sequence[Material], layers: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Moduli (faces,) [N/m] of layers (faces, cloths) of cloths along unit directions (faces, 2)."""
    along_weft, along_warp = ways.T**2
    squares = np.stack([along_weft**2, along_warp**2, 2.0 * along_weft * along_warp, 4.0 * along_weft * along_warp])
    membranes = np.array([cloth.membrane for cloth in cloths[: layers.shape[1]]])
    return (layers * (membranes @ squares).T).sum(axis=1)


def _ways(garment: Garment, part: Part) -> np.ndarray:
    """Unit directions (faces, 2) at rest along the border that a part reaches."""
    if part.along is None:
        raise InputError(
            f"{garment.name}: elastic runs along a border of the garment, and {part.name} reaches none; give elastic "
            "to a part that does."
        )
    ways = carried_directions(part.along, garment.vertices[garment.faces], garment.rest_shape)
    long = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.where(long > 0.0, ways / np.maximum(long, 1e-30), [1.0, 0.0])


def _pull(ratio: Any) -> Any:
    """Twice the share of its modulus by which elastic pulls where it is as long as its cloth, by its ratio to that."""
    return ratio**-3 - ratio**-1


def _stretches(pulls: np.ndarray) -> np.ndarray:
    """Stretches (n,) of elastic that pulls as `_pull` says, by that."""
    stretch = np.full(len(pulls), 2.0)
    # From above Newton's steps never pass the root.
    for _ in range(30):
        stretch -= (stretch**3 - stretch - pulls) / (3.0 * stretch**2 - 1.0)
    return np.where(pulls == 0.0, 1.0, stretch)


def _refuse_claims(garment: Garment, parts: list[Part]) -> None:
    """Refuse parts that lie over each other."""
    for k, one in enumerate(parts):
        for other in parts[:k]:
            both = np.count_nonzero(both_below(one.beyond, other.beyond))
            if both:
                raise InputError(
                    f"{garment.name}: {other.name} and {one.name} share {both} of its faces; leave one out, or "
                    "give a smaller band_width."
                )


def _gathered(garment: Garment, parts: list[Part], ratio: np.ndarray) -> np.ndarray:
    """Corners (faces, 3, 2) [m] of faces at rest that are shorter along the border, by a `ratio` (faces,)."""
    rest = garment.rest_shape
    gathered = rest.copy()
    for part in parts:
        at = part.share > 0.0
        ways = _ways(garment, part)[at]
        along = (rest[at] * ways[:, None]).sum(axis=2, keepdims=True)
        gathered[at] = rest[at] - (1.0 - ratio[at, None, None]) * along * ways[:, None]
    return gathered
