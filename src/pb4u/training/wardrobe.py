"""Garments and bodies on the training device; data shared by the samples are made once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from pb4u.body.skeleton import PoseSequence
from pb4u.body.skinning import SkinningWeights, bone_transforms, skin
from pb4u.collision.capacities import Capacities
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.garment.material import Material
from pb4u.scene.colliders import PackedColliders, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.training.packed_data import TrainingData

_INDICES = ("faces", "edges", "hinges")
_PACKS = 64
"""Packs of bodies that are kept."""
_OWNERS = ("vertex_garment", "face_garment", "hinge_garment", "edge_garment")


class Wardrobe:
    """Packs of outfits in any material, and posed vertices of bodies and outfits.

    Args:
        data: bodies, outfits and clips.
        device: device of all arrays.
        dtype: data type of floating arrays.

    Attributes:
        capacities: fixed numbers of what searches of the bodies find on an accelerator; None on a processor.
    """

    def __init__(self, data: TrainingData, device: torch.device | str, dtype: torch.dtype = torch.float32) -> None:
        self.data, self.device, self.dtype = data, torch.device(device), dtype
        self.capacities = None if self.device.type == "cpu" else Capacities()
        self._colliders = lru_cache(maxsize=_PACKS)(self._make_colliders)
        self._outfit = lru_cache(maxsize=None)(self._make_outfit)
        self._skin = lru_cache(maxsize=None)(self._make_skin)
        self._surface = lru_cache(maxsize=None)(self._make_surface)

    def packed(self, outfits: Sequence[int], materials: Sequence[Material]) -> PackedGarments:
        """Pack of outfits, each in a material.

        Args:
            outfits: index of each outfit.
            materials: material of each.
        """
        return joined([_in_material(self._outfit(o), m) for o, m in zip(outfits, materials, strict=True)])

    def transforms(self, body: int, poses: PoseSequence) -> Tensor:
        """Rest-to-world transforms (frames, bones, 3, 4) on the processor: rotations [1] and translations [m].

        Args:
            body: index of the body.
            poses: poses of that body.
        """
        return bone_transforms(self.data.bodies[body].skeleton, poses).to(self.dtype)

    def body_positions(self, body: int, transforms: Tensor) -> Tensor:
        """Body vertices (frames, vertices, 3) [m].

        Args:
            body: index of the body.
            transforms: (frames, bones, 3, 4) rotations [1] and translations [m] of its bones.
        """
        return skin(*self._skin("body", body), transforms)

    def outfit_positions(self, outfit: int, transforms: Tensor) -> Tensor:
        """Garment vertices (frames, vertices, 3) [m] under skinning alone.

        Args:
            outfit: index of the outfit.
            transforms: (frames, bones, 3, 4) rotations [1] and translations [m] of its body's bones.
        """
        return skin(*self._skin("outfit", outfit), transforms)

    def colliders(self, bodies: Sequence[int]) -> PackedColliders:
        """Pack of bodies, each in a world of its own; the search structures of each are built once.

        Args:
            bodies: index of each body.
        """
        return self._colliders(tuple(bodies))

    def _make_colliders(self, bodies: tuple[int, ...]) -> PackedColliders:
        faces, contact, surfaces = zip(*(self._surface(body) for body in bodies), strict=True)
        packed = pack_colliders(faces, contact, range(len(bodies)), surfaces)
        if self.capacities is None:
            return packed
        at_rest = torch.cat([torch.from_numpy(self.data.bodies[body].vertices) for body in bodies])
        packed.surface_groups(len(bodies), at_rest)
        packed.vertex_groups(at_rest)
        return packed.to(self.device, self.capacities)

    def _make_outfit(self, outfit: int) -> PackedGarments:
        return pack([self.data.outfits[outfit].garment], self.dtype, self.device)

    def _make_skin(self, kind: str, index: int) -> tuple[Tensor, Tensor, Tensor]:
        weights: SkinningWeights
        if kind == "body":
            vertices, weights = self.data.bodies[index].vertices, self.data.bodies[index].weights
        else:
            outfit = self.data.outfits[index]
            vertices, weights = outfit.garment.vertices, outfit.weights
        return (
            torch.as_tensor(vertices, dtype=self.dtype, device=self.device),
            torch.as_tensor(weights.bones, device=self.device),
            torch.as_tensor(weights.weights, dtype=self.dtype, device=self.device),
        )

    def _make_surface(self, body: int) -> tuple[Tensor, Tensor, TriangleSurface | None]:
        figure = self.data.bodies[body]
        faces, contact = torch.as_tensor(figure.faces), torch.as_tensor(figure.contact)
        return faces, contact, pack_colliders([faces], [contact], [0]).surfaces[0]


def _in_material(packed: PackedGarments, material: Material) -> PackedGarments:
    """A pack of one garment, made of `material`."""
    return replace(
        packed,
        membrane=packed.membrane.new_tensor(material.membrane).expand_as(packed.membrane),
        stiffening=packed.stiffening.new_tensor(material.stiffening).expand_as(packed.stiffening),
        bending=torch.full_like(packed.bending, material.bending),
        friction=torch.full_like(packed.friction, material.friction),
        vertex_masses=material.density * packed.vertex_areas,
        garments=tuple(garment.with_material(material) for garment in packed.garments),
    )


def joined(packs: Sequence[PackedGarments]) -> PackedGarments:
    """Pack of several packs in sequence, each with its own worlds.

    Args:
        packs: packs of garments.
    """
    if len(packs) == 1:
        return packs[0]
    offsets, garments = [0], 0
    worlds: list[int] = []
    parts: dict[str, list[Tensor]] = {}
    for packed in packs:
        for entry in fields(packed):
            value = getattr(packed, entry.name)
            if isinstance(value, Tensor):
                shift = offsets[-1] if entry.name in _INDICES else garments if entry.name in _OWNERS else 0
                parts.setdefault(entry.name, []).append(value + shift if shift else value)
        offsets += [offsets[-1] + end for end in packed.vertex_offsets[1:]]
        garments += packed.garment_count
        first = worlds[-1] + 1 if worlds else 0
        worlds += [first + world for world in packed.worlds]
    tensors: dict[str, Any] = {name: torch.cat(values) for name, values in parts.items()}
    return PackedGarments(
        **tensors,
        vertex_offsets=tuple(offsets),
        mean_edge_lengths=tuple(length for packed in packs for length in packed.mean_edge_lengths),
        garments=tuple(garment for packed in packs for garment in packed.garments),
        worlds=tuple(worlds),
    )
