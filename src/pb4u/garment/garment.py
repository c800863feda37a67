"""A garment at rest: everything about it that never changes during a simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError
from pb4u.garment.material import DirectionalBending, Material
from pb4u.garment.trims import SewnPart, Trims
from pb4u.geometry.appearance import Appearances
from pb4u.geometry.mesh_arrays import as_numbers, checked_faces, checked_places, checked_uvs, checked_vertices
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology, uv_islands
from pb4u.geometry.triangle_mesh import edge_lengths, face_areas, laid_flat

_CREASE = 1e-3
"""Share of its bending stiffness that cloth has along a pressed edge: some, as a network reads its logarithm."""


@dataclass(frozen=True, eq=False)
class SourceMap:
    """Positions of the author's vertices on the simulated mesh, as triangles and barycentric coordinates.

    Args:
        source: the author's mesh.
        triangle: (source vertices,) int64 simulated face.
        barycentric: (source vertices, 3) float64, rows sum to 1.
    """

    source: PolygonMesh
    triangle: np.ndarray
    barycentric: np.ndarray


@dataclass(frozen=True, eq=False)
class GarmentSkinning:
    """Skinning of a garment by an SMPL-family body, from its own file; in the model's own axes and height.

    Args:
        vertices: (vertices, 3) float64 in the body's rest pose, average shape [m].
        shape_directions: (vertices, 3, shape parameters) float64 displacement a shape parameter [m].
        pose_directions: (vertices, 3, pose features) float64 displacement a pose feature [m]; the features are the
            entries of the local rotations minus identity of all bones but the root.
        weights: bones of each vertex.
        bone_count: number of bones of the body that it was made for.
    """

    vertices: np.ndarray
    shape_directions: np.ndarray
    pose_directions: np.ndarray
    weights: SkinningWeights
    bone_count: int

    def at(self, corners: np.ndarray, barycentric: np.ndarray) -> GarmentSkinning:
        """Skinning of other vertices, each interpolated from the corners of a triangle.

        Args:
            corners: (vertices, 3) int64, corners of the triangle that each lies on.
            barycentric: (vertices, 3) its coordinates there, rows sum to 1.
        """

        def mixed(values: np.ndarray) -> np.ndarray:
            return np.einsum("vc,vc...->v...", barycentric, values[corners])

        return GarmentSkinning(
            mixed(self.vertices), mixed(self.shape_directions), mixed(self.pose_directions),
            self.weights.at(corners, barycentric, self.bone_count), self.bone_count,
        )  # fmt: skip


@dataclass(frozen=True)
class PinSprings:
    """Springs between the pins of a garment and where skinning puts them.

    Args:
        stiffness: total of all springs [N/m], so that it does not depend on the number of triangles.
        until: time since the start of the simulation at which they release the vertices [s].
    """

    stiffness: float
    until: float = math.inf


@dataclass(frozen=True, eq=False)
class Garment:
    """A single-layer triangle mesh in its rest shape, worn by a body in its rest pose.

    Args:
        name: as given by the user.
        vertices: (vertices, 3) float64 rest positions [m], where they sit on the resting body.
        faces: (faces, 3) int64, counter-clockwise from outside.
        material: cloth of all faces; of several materials, the one of the largest area.
        pinned: (vertices,) bool, vertices that follow the body; by default none.
        uvs: (uv points, 2) float64 of the simulated mesh, or None.
        uv_faces: (faces, 3) int64 into `uvs`, or None.
        source: map to the author's mesh, or None where that is the simulated mesh itself.
        loose: whether it hangs away from the nearest limb (dresses, skirts): skinning weights are then averaged widely.
        coarse_edges: (edges, 2) int64 of each coarse level from fine to coarse, if its file has them.
        skinning: its skinning weights from its file; None to take weights from the body.
        rest_uv: (faces, 3, 2) float64 corners of each face lying flat [m], of cloth that was cut flat and sewn. These
            triangles are then the rest shape, and `vertices` is only the position on the body. None where `vertices` is
            the rest shape.
        grainless: whether the axes of `rest_uv` are arbitrary; otherwise its second axis is the warp.
        appearances: colours and images of the faces, or None.
        panels: names of the pattern's panels, where it was sewn of one: each is an island of `uv_faces`, in the order
            of their first UV points.
        materials: cloths of its parts; by default only `material`.
        face_material: (faces,) int64 index in `materials` of each face, or of most of its area; None for at most one
            material.
        material_layers: (faces, materials) float64 number of layers of each of the `materials` on each face, averaged
            over its area; by default each face is one layer of one material.
        trims: interfacing and elastic of its faces; None for none.
        sewn: materials, layers and trims of its parts that the rest of it does not have.
        pieces: names of parts of its file, each once; by default those of its `appearances`.
        piece_of_face: (faces,) int64 which of the `pieces` each face belongs to, -1 for none; or None.
        springs: springs of its pins; None if pins hold exactly and are never released.
        pressed: (faces,) bool, faces that are ironed over: along edges between them and other faces cloth bends almost
            freely; None for none.
        buttons: (buttons,) int64 vertices that buttons close; None for none.

    Raises:
        InputError: an array has another shape, or unusable values. Lists are converted to arrays.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    material: Material
    pinned: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    source: SourceMap | None = None
    loose: bool = False
    coarse_edges: tuple[np.ndarray, ...] = ()
    skinning: GarmentSkinning | None = None
    rest_uv: np.ndarray | None = None
    grainless: bool = False
    appearances: Appearances | None = None
    panels: tuple[str, ...] = ()
    materials: tuple[Material, ...] = ()
    face_material: np.ndarray | None = None
    material_layers: np.ndarray | None = None
    trims: Trims | None = None
    sewn: tuple[SewnPart, ...] = ()
    pieces: tuple[str, ...] = ()
    piece_of_face: np.ndarray | None = None
    springs: PinSprings | None = None
    pressed: np.ndarray | None = None
    buttons: np.ndarray | None = None

    def __post_init__(self) -> None:
        owner = f"garment {self.name}"
        vertices = checked_vertices(owner, self.vertices)
        checked: dict[str, np.ndarray] = {
            "vertices": vertices,
            "faces": checked_faces(owner, self.faces, len(vertices)),
            "pinned": np.asarray(self.pinned) if len(self.pinned) else np.zeros(len(vertices), dtype=bool),
        }
        if checked["pinned"].shape != (len(vertices),) or checked["pinned"].dtype != bool:
            raise InputError(
                f"{owner}: pinned must hold one bool for each of its {len(vertices)} vertices; make_scene(pins=[..]) "
                "pins vertices by number."
            )
        for material in (self.material, *self.materials):
            if not isinstance(material, Material):
                raise InputError(
                    f'{owner}: a material must be a Material, such as pb4u.Material.named("cotton"), not {material!r}.'
                )
        if (self.uvs is None) != (self.uv_faces is None):
            raise InputError(f"{owner}: uvs and uv_faces belong together; give both or neither.")
        if self.uvs is not None and self.uv_faces is not None:
            uvs, uv_faces = checked_uvs(owner, self.uvs, self.uv_faces, len(checked["faces"]))
            checked |= {"uvs": uvs, "uv_faces": uv_faces}
        for name, array in checked.items():
            object.__setattr__(self, name, array)
        if self.material_layers is not None:
            layers = as_numbers(owner, "material_layers", self.material_layers)
            shape = len(self.faces), len(self.materials)
            if layers.shape != shape or (layers < 0.0).any() or not layers.any(axis=1).all():
                raise InputError(
                    f"{owner}: its material_layers must be numbers (faces, materials), {shape[0]} by {shape[1]}, none "
                    "below zero and each row with one above it."
                )
            object.__setattr__(self, "material_layers", layers)
            object.__setattr__(self, "face_material", layers.argmax(axis=1))
        if self.trims is not None and self.trims.columns.shape != (len(self.faces), 2):
            raise InputError(f"{owner}: its trims must hold numbers for each of its {len(self.faces)} faces.")
        if len(self.materials) == 1 and self.face_material is None:
            object.__setattr__(self, "face_material", np.zeros(len(self.faces), dtype=np.int64))
        if self.face_material is not None:
            places = checked_places(owner, "face_material", self.face_material, len(self.faces), len(self.materials))
            object.__setattr__(self, "face_material", places)
            object.__setattr__(self, "material", self.materials[int((self.face_areas @ self.layers).argmax())])
        elif len(self.materials) > 1:
            raise InputError(
                f"{owner}: it has {len(self.materials)} materials, so face_material must say which of "
                "them each face has."
            )
        object.__setattr__(self, "materials", tuple(self.materials) if self.face_material is not None else ())

    @property
    def mesh(self) -> PolygonMesh:
        """The simulated mesh for writing to a file, with its UV points and colours."""
        uv_faces = None if self.uv_faces is None else tuple(self.uv_faces)
        return PolygonMesh(self.vertices, tuple(self.faces), self.uvs, uv_faces, self.appearances)

    @cached_property
    def topology(self) -> Topology:
        return Topology(self.faces, len(self.vertices))

    @cached_property
    def rest_shape(self) -> np.ndarray:
        """Corners (faces, 3, 2) [m] of the faces at rest, flat, their second axis along the warp where it is known."""
        return laid_flat(self.vertices[self.faces]) if self.rest_uv is None else self.rest_uv

    @property
    def has_grain(self) -> bool:
        """Whether the direction of its warp is known; otherwise its cloth is the same in all directions."""
        return self.rest_uv is not None and not self.grainless

    @property
    def has_elastic(self) -> bool:
        """Whether elastic gathers one of its parts."""
        return self.trims is not None and bool((self.trims.elastic < 1.0).any())

    @cached_property
    def face_areas(self) -> np.ndarray:
        """Rest areas (faces,) [m^2] of the faces."""
        if self.rest_uv is None:
            return face_areas(self.vertices, self.faces)
        along, across = self.rest_uv[:, 1] - self.rest_uv[:, 0], self.rest_uv[:, 2] - self.rest_uv[:, 0]
        return 0.5 * np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])

    @cached_property
    def vertex_areas(self) -> np.ndarray:
        """Rest areas (vertices,) [m^2] that belong to the vertices: a third of each incident face."""
        return self.at_vertices(self.face_areas)

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """Faces (faces,) bool by the name of a part: materials named in its file, and panels of its pattern."""
        masks: dict[str, np.ndarray] = {}
        if self.piece_of_face is not None:
            masks |= {name: self.piece_of_face == number for number, name in enumerate(self.pieces)}
        elif self.appearances is not None:
            of_face = self.appearances.of_face
            for number, look in enumerate(self.appearances.listed):
                masks[look.name] = masks.get(look.name, False) | (of_face == number)
        if self.panels and self.uv_faces is not None:
            island = uv_islands(self.uv_faces)
            masks |= {name: island == number for number, name in enumerate(self.panels)}
        return masks

    def of_faces(self, name: str) -> np.ndarray:
        """A property of the cloth of each face, (faces,) or (faces, numbers) in its unit; of several the mean by area.

        Density, membrane stiffness, bending stiffness and thickness of layers add up.

        Args:
            name: attribute of `Material`.
        """
        of_each = np.array([getattr(cloth, name) for cloth in self._cloths], dtype=np.float64)
        values = self.layers @ of_each
        if self.material_layers is not None and name == "stiffening":
            # Each cloth's limit counts by how much stiffer it grows there.
            limits, growth = self.layers @ of_each.prod(axis=1), values[:, 1]
            values[:, 0] = np.divide(limits, growth, out=np.zeros(len(values)), where=growth > 0.0)
        elif self.material_layers is not None and name not in ("density", "membrane", "bending", "thickness"):
            values /= self.layers.sum(axis=1)
        return values if self.trims is None else self.trims.changed(name, values)

    @cached_property
    def layers(self) -> np.ndarray:
        """Number of layers (faces, materials) of each material on each face, in the mean of its area."""
        if self.material_layers is not None:
            return self.material_layers
        places = np.zeros(len(self.faces), dtype=np.int64) if self.face_material is None else self.face_material
        return np.eye(max(len(self.materials), 1))[places]

    @cached_property
    def _cloths(self) -> tuple[Material, ...]:
        """Its materials as they act: alike in all directions where there is no grain."""
        materials = self.materials or (self.material,)
        return materials if self.has_grain else tuple(material.without_grain for material in materials)

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums (vertices,) of a third of the values of the incident faces, in their unit.

        Args:
            values: (faces,) of any unit.
        """
        return np.bincount(self.faces.ravel(), weights=np.repeat(values / 3.0, 3), minlength=len(self.vertices))

    @cached_property
    def hinge_bending(self) -> np.ndarray:
        """Bending coefficients (hinges,) [J]: two materials bend in series, each as wide as its face.

        Within bands it is the area-weighted mean, since a band runs through both faces side by side.
        """
        hinge_faces = self.topology.hinge_faces
        bending, areas = self._side_bending(hinge_faces), self.face_areas[hinge_faces]
        if self.pressed is not None:
            bending = np.where(np.diff(self.pressed[hinge_faces]), _CREASE * bending, bending)
        with np.errstate(divide="ignore", invalid="ignore"):
            series = areas.sum(axis=1) / (areas / bending).sum(axis=1)
        series = np.where(bending[:, 0] == bending[:, 1], bending[:, 0], series)
        if self.material_layers is None and self.trims is None:
            return series
        is_band = (self.layers.max(axis=1) < 1.0) | (self.layers.sum(axis=1) > 1.0)
        if self.trims is not None:
            is_band |= self.trims.interfacing > 0.0
        return np.where(is_band[hinge_faces].any(axis=1), (areas * bending).sum(axis=1) / areas.sum(axis=1), series)

    def _side_bending(self, hinge_faces: np.ndarray) -> np.ndarray:
        """Bending coefficients (hinges, 2) [J] of both sides, each by the edge's direction in its own panel."""
        if not any(isinstance(cloth.bending_stiffness, DirectionalBending) for cloth in self._cloths):
            return self.of_faces("bending")[hinge_faces]
        ends = self.topology.hinges[:, None, :2, None] == self.faces[hinge_faces][:, :, None]
        corners = np.take_along_axis(self.rest_shape[hinge_faces], ends.argmax(axis=3)[..., None], axis=2)
        edges = corners[:, :, 1] - corners[:, :, 0]
        along_weft = edges[..., 0] ** 2 / (edges**2).sum(axis=2)
        of_each = np.stack([cloth.hinge_coefficients(along_weft) for cloth in self._cloths], axis=2)
        bending = (of_each * self.layers[hinge_faces]).sum(axis=2)
        return bending if self.trims is None else self.trims.at(hinge_faces).changed("bending", bending)

    @cached_property
    def vertex_masses(self) -> np.ndarray:
        """Masses (vertices,) [kg] of the vertices."""
        if self.face_material is None and self.trims is None:
            return self.material.density * self.vertex_areas
        return self.at_vertices(self.of_faces("density") * self.face_areas)

    @cached_property
    def edge_lengths(self) -> np.ndarray:
        """Rest lengths (edges,) [m] of `topology.edges`; at a seam the mean of its two sides."""
        if self.rest_uv is None:
            return edge_lengths(self.vertices, self.topology.edges)
        sides = np.linalg.norm(np.roll(self.rest_uv, -1, axis=1) - self.rest_uv, axis=2)
        edges = self.topology.face_edges.ravel()
        return np.bincount(edges, weights=sides.ravel()) / np.bincount(edges)

    @cached_property
    def mean_edge_length(self) -> float:
        """Mean rest edge length [m]: the garment's resolution."""
        return float(self.edge_lengths.mean())

    @property
    def is_authors_mesh(self) -> bool:
        """Whether its vertices are the author's own, not those of a remeshing."""
        if self.source is None:
            return True
        source_vertices = np.count_nonzero(self.source.barycentric.max(axis=1) == 1.0)
        return bool(source_vertices >= len(self.vertices))

    def is_skinned_for(self, body: ShapedBody | AnimatedBody) -> bool:
        """Whether its file has skinning for this body: weights for as many bones as the body has.

        Args:
            body: any body.
        """
        skinning = self.skinning
        return skinning is not None and isinstance(body, ShapedBody) and body.skeleton.bone_count == skinning.bone_count

    @property
    def triangle_count(self) -> int:
        return len(self.faces)

    def with_material(self, material: Material) -> Garment:
        sewn = tuple(replace(part, material=None) for part in self.sewn)
        other = replace(self, material=material, materials=(), face_material=None, material_layers=None, sewn=sewn)
        return other if self.material_layers is None else other.with_layers((material,), self.layers.sum(1)[:, None])

    def with_part(self, material: Material, faces: np.ndarray) -> Garment:
        """With another material on some faces.

        Args:
            material: of those faces.
            faces: (faces,) bool.
        """
        materials = self.materials or (self.material,)
        layers = np.column_stack([np.where(faces[:, None], 0.0, self.layers), faces])
        return self.with_layers((*materials, material), layers)

    def with_layers(self, materials: Sequence[Material], layers: np.ndarray) -> Garment:
        """Made of other materials.

        Args:
            materials: of its faces.
            layers: (faces, materials) number of layers of each on each face, in the mean of its area.
        """
        is_plain = bool((layers.max(axis=1) == 1.0).all() and (layers.sum(axis=1) == 1.0).all())
        return replace(
            self, materials=tuple(materials), face_material=layers.argmax(axis=1),
            material_layers=None if is_plain else layers,
        )  # fmt: skip

    def with_pins(self, pinned: np.ndarray) -> Garment:
        return replace(self, pinned=pinned)
