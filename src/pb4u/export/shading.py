"""How the two surfaces of a trajectory look in the formats that carry a material: colours and normals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import torch

from pb4u.garment.material import BUILT_IN, Material
from pb4u.geometry.triangle_mesh import vertex_normals

if TYPE_CHECKING:
    from pb4u.scene.trajectory import TrajectoryHeader

Colour: TypeAlias = tuple[float, float, float]
"""Red, green and blue, sRGB [0 to 1]."""

SKIN = (0.93, 0.80, 0.72)

LIGHTS = (((-4.0, 5.0, 3.0), 1.0), ((5.0, 2.0, 4.0), 0.36), ((2.0, 4.0, -6.0), 0.45))
"""Where the key, fill and rim lights stand as seen from the camera [m], and their intensities [1].

The key light from the side and from above leaves the far side of each fold in the dark.
"""


class Look(NamedTuple):
    """How cloth of a material looks.

    Args:
        colour: sRGB [0 to 1].
        threads: pattern of the threads, one of `pb4u.export.threads.THREADS`; "" if they are not visible.
        gloss: share of the light that it mirrors [1].
    """

    colour: Colour
    threads: str
    gloss: float = 0.03


UNDYED = (0.84, 0.81, 0.75)
"""Of the threads across the dyed ones of denim."""

PLAIN = Look((0.80, 0.80, 0.79), "knit")
"""Of what is made of numbers alone."""

LOOKS = {
    "default": PLAIN,
    "cotton": Look((0.90, 0.87, 0.81), "plain"),
    "cotton-poplin": Look((0.91, 0.92, 0.93), "plain"),
    "cotton-voile": Look((0.92, 0.87, 0.85), "plain"),
    "viscose": Look((0.52, 0.40, 0.47), "plain", 0.05),
    "cotton-twill": Look((0.68, 0.60, 0.47), "twill"),
    "linen": Look((0.82, 0.77, 0.67), "slub"),
    "silk": Look((0.92, 0.88, 0.79), "", 0.20),
    "silk-crepe": Look((0.62, 0.36, 0.38), "", 0.07),
    "silk-charmeuse": Look((0.90, 0.80, 0.74), "", 0.40),
    "denim": Look((0.30, 0.38, 0.51), "denim"),
    "denim-11oz": Look((0.41, 0.50, 0.63), "denim"),
    "denim-14oz": Look((0.25, 0.31, 0.43), "denim"),
    "wool": Look((0.38, 0.38, 0.40), "twill", 0.0),
    "wool-flannel": Look((0.50, 0.50, 0.52), "twill", 0.0),
    "wool-coat": Look((0.61, 0.48, 0.34), "felt", 0.0),
    "jersey": Look((0.63, 0.68, 0.71), "knit"),
    "cotton-jersey": Look((0.70, 0.72, 0.66), "knit"),
    "ponte": Look((0.38, 0.50, 0.52), "knit"),
    "wool-knit": Look((0.60, 0.52, 0.43), "rib", 0.0),
    "sweatshirt-knit": Look((0.66, 0.66, 0.65), "knit", 0.0),
    "swimwear": Look((0.22, 0.36, 0.42), "", 0.14),
    "blanket-knit": Look((0.70, 0.62, 0.55), "felt", 0.0),
    "interlock": Look((0.78, 0.72, 0.72), "knit"),
    "rib": Look((0.55, 0.59, 0.55), "rib"),
    "fleece": Look((0.58, 0.60, 0.63), "felt", 0.0),
    "leather": Look((0.28, 0.19, 0.15), "", 0.40),
    "garment-leather": Look((0.32, 0.22, 0.16), "", 0.40),
    "polyester-plain": Look((0.72, 0.76, 0.74), "plain", 0.06),
    "jacket-polyester": Look((0.36, 0.42, 0.36), "plain", 0.10),
    "wool-suiting": Look((0.44, 0.46, 0.51), "twill", 0.0),
    "tulle": Look((0.88, 0.80, 0.81), ""),
    "neoprene": Look((0.24, 0.26, 0.28), "", 0.12),
    "elastic": Look((0.24, 0.24, 0.26), "rib", 0.0),
}
"""By the name of the material."""

_TRIMMINGS = ("rib", "elastic")
"""Materials of collars, cuffs and waistbands, which are dyed as the cloth that they are sewn to."""

_FURTHER_CLOTHS = ((0.62, 0.34, 0.27), (0.80, 0.66, 0.38), (0.42, 0.53, 0.44), (0.47, 0.40, 0.54))
"""Colours of garments that are made of what one below them is, in turn, so that layers can be distinguished."""


def fabric_names(header: TrajectoryHeader) -> np.ndarray:
    """Name of the built-in material of each face, (faces,) object; "" of materials of other numbers.

    Args:
        header: of the trajectory.
    """
    names = np.full(len(header.faces), "", dtype=object)
    for numbers, faces in header.materials:
        names[faces] = next((name for name, material in BUILT_IN.items() if _is_of(numbers, material)), "")
    return names


def _is_of(numbers: Mapping[str, Any], material: Material) -> bool:
    """Whether what is written of a material are the numbers of this one, as far as it has those."""
    values = {**material.five_numbers, **vars(material)}
    shared = [name for name in values if isinstance(numbers.get(name), float)]
    return "density" in shared and all(np.isclose(numbers[name], values[name], rtol=1e-9, atol=0.0) for name in shared)


def garment_colours(fabrics: Sequence[str], chosen: Sequence[Colour] = ()) -> list[Colour]:
    """Colours of the garments, sRGB [0 to 1]: the chosen ones, else that of its material unless another garment has
    this colour.

    Args:
        fabrics: name of the material of each garment.
        chosen: colours of the first garments.
    """
    colours: list[Colour] = []
    for number, name in enumerate(fabrics):
        usual = LOOKS.get(name, PLAIN).colour
        free = (colour for colour in (usual, *_FURTHER_CLOTHS) if colour not in colours)
        further = _FURTHER_CLOTHS[number % len(_FURTHER_CLOTHS)]
        colours.append(chosen[number] if number < len(chosen) else next(free, further))
    return colours


@dataclass(frozen=True, eq=False)
class ClothPart:
    """Faces of one garment that look the same.

    Args:
        name: of the part.
        faces: (n,) int64 indices of its faces.
        colour: sRGB [0 to 1]; multiplies the image.
        image: content of a PNG or JPEG file that the UVs lay on, or None.
        fabric: how its material looks, apart from the colour.
    """

    name: str
    faces: np.ndarray
    colour: Colour
    image: bytes | None = None
    fabric: Look = PLAIN


def cloth_parts(header: TrajectoryHeader, chosen: Sequence[Colour] = ()) -> list[ClothPart]:
    """The garments of a trajectory, each in its colour, or in the colours and images of its author.

    Args:
        header: of the trajectory.
        chosen: colours of the first garments, which replace the colours and images of their authors.
    """
    owner, looks = np.asarray(header.vertex_garment)[header.faces[:, 0]], header.appearances
    count, fabrics = int(owner.max(initial=0)) + 1, fabric_names(header)
    of_face = np.full(len(owner), -1) if looks is None else np.where(owner < len(chosen), -1, looks.of_face)
    main = [Counter(fabrics[owner == k]).most_common(1)[0][0] if (owner == k).any() else "" for k in range(count)]
    colours, parts = garment_colours(main, chosen), list[ClothPart]()
    for k, look, fabric_name in sorted(set(zip(owner.tolist(), of_face.tolist(), fabrics.tolist(), strict=True))):
        faces = np.flatnonzero((owner == k) & (of_face == look) & (fabrics == fabric_name))
        fabric = LOOKS.get(fabric_name, PLAIN)
        if looks is not None and look >= 0:
            entry = looks.listed[look]
            parts.append(ClothPart(entry.name, faces, entry.colour, entry.image, fabric))
            continue
        name = "garment" if count == 1 else f"garment {k + 1}"
        if 1 < count == len(header.garments):
            name = str(header.garments[k]["name"])
        if fabric_name == main[k]:
            parts.append(ClothPart(name, faces, colours[k], None, fabric))
        else:
            dyed = colours[k] if k < len(chosen) or fabric_name in _TRIMMINGS else fabric.colour
            parts.append(ClothPart(f"{name}, {fabric_name}", faces, dyed, None, fabric))
    return parts


def unit_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit vertex normals; up where a vertex has no area around it.

    Args:
        positions: (..., vertices, 3) [m].
        faces: (faces, 3) int.

    Returns:
        (..., vertices, 3) float32 [1].
    """
    normals = vertex_normals(
        torch.from_numpy(np.array(positions, dtype=np.float64)), torch.from_numpy(np.array(faces, dtype=np.int64))
    ).numpy()
    flat = np.abs(np.linalg.norm(normals, axis=-1) - 1) > 1e-3
    normals[flat] = (0.0, 1.0, 0.0)
    return normals.astype(np.float32)
