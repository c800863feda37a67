"""The garments of a run. Whatever a garment comes from, it goes through the same stages in the same order:

1. **Read**: its mesh, in the material of the run. Names of pieces, flat panels (`rest_uv`), UVs, images, pins and
   skinning are those of its source, and come from nowhere else. Built-in garments and patterns are made here, on the
   body that wears them and with as many triangles as are asked for.
2. **Place**: a garment that stands around the own origin of a body's model is moved to where that body stands. Other
   units, axes and places are refused, here or in the check.
3. **Remesh**: parts, pins, skinning and the map to the author's mesh are found again on other triangles. What is sewn
   of flat panels is refused: its triangles are theirs.
4. **Tack**: vertices are sewn together. The triangles keep their shapes at rest, which no remeshing could keep.
5. **Hold**: the pins that are asked for; else its own; else the straps, waistband or collar that are found.
6. **Check**: what the body does not wear is refused or told of, and limbs that go through the cloth go inside it.
7. **Grain**: of what has none of its own, that which is given, or that of UVs in metres, those of its author's mesh.
8. **Parts**: fabrics, further layers, interfacing and elastic on pieces that its source names and bands along borders.
9. **Button**: vertices of an open front are sewn together, once its parts are found by that front.
   Built-in garments that are cut flat have some of their own, and elastic in the place of pins at a waist.

Without a body a garment is used as its file has it: what is made on a body is refused, and the rest is not compared
with one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import NamedTuple, TypeAlias

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.errors import InputError, InputNote, warn
from pb4u.garment.cuts import CUTS
from pb4u.garment.diagnosis import require_clothes, require_fine, require_metres, require_near, require_worn
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import MOST_SIMULATED, authors_garment
from pb4u.garment.grain import grained
from pb4u.garment.layering import worn_order
from pb4u.garment.library import DICTIONARIES, LEVELS, SEWN, RestShape, build_garment, garment_names
from pb4u.garment.limbs_inside import with_limbs_inside
from pb4u.garment.material import Material, load_material
from pb4u.garment.parts import BORDER, WAIST, Parts, with_parts
from pb4u.garment.pins import resolve_pins
from pb4u.garment.repair import push_out
from pb4u.garment.source_map import remeshed
from pb4u.garment.support import Support, find_support
from pb4u.garment.tacks import buttoned, tacked
from pb4u.garment.texture import textured
from pb4u.geometry.appearance import read_image
from pb4u.geometry.mesh_file import MOST_READ
from pb4u.options import NONE
from pb4u.run import REST, Run, WornGarment

DEFAULT_MATERIAL = "default"

Body: TypeAlias = ShapedBody | VertexSequence | None


def load_garments(
    specified: Sequence[WornGarment], body: Body, as_recorded: bool, rest_shape: RestShape
) -> tuple[list[Garment], list[WornGarment]]:
    """The garments, and how each was specified, in the order they are worn, inner first.

    Args:
        specified: the garments, inner first except for tucked ones.
        body: the body that wears them.
        as_recorded: whether a recording is played unchanged, with garments as coarse as its authors used.
        rest_shape: of the built-in garments.

    Raises:
        InputError: a garment cannot be read, or does not fit.
    """
    garments = []
    for spec in specified:
        garment = load_garment(spec, body, rest_shape)
        # A recording is replayed as its authors did, on the meshes that they did it with.
        if body is not None:
            require_fine(garment, body, accepted=as_recorded or _is_own_count(spec, garment))
        garments.append(garment)
    order = worn_order(garments, [spec.tucked for spec in specified])
    return [garments[k] for k in order], [specified[k] for k in order]


def _is_own_count(spec: WornGarment, garment: Garment) -> bool:
    """Whether the user wants just as many triangles as the garment was made with."""
    is_built_in = kind_of(spec.garment) is KINDS["built-in"]
    return spec.triangles == garment.triangle_count and garment.is_authors_mesh and not is_built_in


def load_garment(spec: WornGarment, body: Body, rest_shape: RestShape = Run.rest_shape) -> Garment:
    """One garment, through all stages; its texture comes last.

    Args:
        spec: the garment and its options.
        body: the body that wears it.
        rest_shape: of a built-in one.

    Raises:
        InputError: it cannot be read, or does not fit.

    Warns:
        InputWarning: its file is unusual, it starts inside the body, or nothing holds it up.
    """
    kind = kind_of(spec.garment)
    if kind is KINDS["built-in"] and rest_shape == "flat":
        spec = _banded(spec)
    garment = read(spec, body, rest_shape)
    garment = place(garment, body, kind)
    garment = remesh(garment, body, kind, spec.triangles)
    garment = tacked(garment, spec.tacks)
    garment, support = hold(garment, body, kind, spec.pins)
    garment = grained(check(garment, body, kind, support, spec.garment), spec.grain)
    materials = {name: _material(cloth) for name, cloth in spec.materials.items() if name != REST}
    garment = with_parts(garment, materials, spec.band_width, spec.layers, spec.interfacing, spec.elastic)
    garment = buttoned(garment, spec.buttons)
    if not garment.has_grain and any(cloth.has_grain for cloth in garment.materials or (garment.material,)):
        warn(
            f"{garment.name} has no grain, so its cloth is the same in all directions; --grain 0,1,0 makes its warp "
            "run upwards.",
            InputNote,
        )
    return garment if spec.texture is None else textured(garment, read_image(Path(spec.texture)))


def fabrics_of_parts(name: str, garment: Garment) -> dict[str, str | None]:
    """The parts of a garment that may have a material of their own, and the fabric of each.

    Args:
        name: built-in name or file.
        garment: as read from it.

    Returns:
        By name; None for parts of the same cloth as the rest.
    """
    fabrics = _banded(WornGarment(name)).materials
    return {part: None if part not in fabrics else str(fabrics[part]) for part in Parts(garment).names}


def _banded(spec: WornGarment) -> WornGarment:
    """A built-in garment with the bands that it is cut with, unless the run names others in their place.

    Elastic takes the place of a pinned waistband, unless the run names pins. A garment of a material that the run names
    has no cloth of other parts.
    """
    cut = CUTS.get(str(spec.garment))
    named_parts = {*spec.materials, *spec.layers, *spec.interfacing, *spec.elastic}
    if cut is None or BORDER in named_parts:
        return spec
    bands = cut.bands
    holds_by_pins = spec.pins is not None or spec.pin_stiffness is not None or spec.pins_until is not None
    elastic = {name: ratio for name, ratio in bands.elastic.items() if name != WAIST or not holds_by_pins}
    fabrics = {} if REST in spec.materials else bands.fabrics
    if not fabrics:
        # Of cloth that does not give, cuffs are not gathered.
        elastic = {name: ratio for name, ratio in elastic.items() if name == WAIST}
    used = {*bands.layers, *fabrics, *elastic, *named_parts}
    widths = {name: width for name, width in bands.widths.items() if name in used}
    pins = "none" if WAIST in elastic and not holds_by_pins else spec.pins
    return replace(
        spec, material={**fabrics, **spec.materials}, layers={**bands.layers, **spec.layers}, pins=pins,
        elastic={**elastic, **spec.elastic}, band_width={**widths, **spec.band_width},
    )  # fmt: skip


class Kind(NamedTuple):
    """The reader of a kind of garment, and properties of this kind.

    Args:
        read: makes the named garment for a body, with a material and, if built in, a rest shape.
        is_file: whether it comes from a file, so that its support and its fit to the body must be checked.
        is_fitted: whether it is made on the body that wears it, with the requested number of triangles.
        is_at_origin: whether it is placed around the origin of the body's model.
    """

    read: Callable[[WornGarment, Body, Material, RestShape], Garment]
    is_file: bool = False
    is_fitted: bool = False
    is_at_origin: bool = False


def kind_of(garment: str | Path | Garment) -> Kind:
    """The kind of a garment, one of `KINDS`, from its name.

    Args:
        garment: name, path, or Garment made in Python.

    Raises:
        InputError: it is none of these.
    """
    if isinstance(garment, Garment):
        return KINDS["object"]
    if not isinstance(garment, str | Path):
        raise InputError(f"The garment must be a name, a path or a Garment, not {garment!r}.")
    if DictionaryEntry.parse(garment):
        return KINDS["dictionary"]
    suffix = Path(garment).suffix.lower()
    return KINDS["pattern" if suffix in SEWN else "mesh" if suffix else "built-in"]


def _built_in(spec: WornGarment, body: Body, material: Material, rest_shape: RestShape) -> Garment:
    assert body is not None
    if not isinstance(body, ShapedBody):
        near = ", ".join(garment_names())
        raise InputError(
            f"The built-in garments ({near}) are cut from a body with bones; {body.name} is a sequence of vertices: "
            "give the garment as a mesh file that fits its first frame."
        )
    triangles = LEVELS["base"] if spec.triangles is None else spec.triangles
    garment = build_garment(str(spec.garment), body, triangles, rest_shape)
    return garment.with_material(material) if REST in spec.materials else garment


def _mesh(spec: WornGarment, body: Body, material: Material, rest_shape: RestShape) -> Garment:
    most = MOST_SIMULATED if spec.triangles is None else MOST_READ
    garment = authors_garment(str(spec.garment), material, most)
    if body is not None:
        require_clothes(garment, body)
    require_metres(garment, body, str(spec.garment))
    return garment


def _pattern(spec: WornGarment, body: Body, material: Material, rest_shape: RestShape) -> Garment:
    file = Path(str(spec.garment))
    return resolve_name(SEWN[file.suffix.lower()])(file, body, material, spec.triangles)


def _dictionary(spec: WornGarment, body: Body, material: Material, rest_shape: RestShape) -> Garment:
    entry = DictionaryEntry.parse(str(spec.garment))
    assert entry is not None
    return DICTIONARIES.named(entry.path.suffix.lower())(entry, material)


def _object(spec: WornGarment, body: Body, material: Material, rest_shape: RestShape) -> Garment:
    garment = spec.garment
    assert isinstance(garment, Garment)
    if len(loose := garment.topology.isolated_vertices):
        raise InputError(
            f"garment {garment.name}: {len(loose)} of its {len(garment.vertices)} vertices are in no face, the first "
            f"of them {loose[:5].tolist()}; leave them out."
        )
    if body is not None:
        require_near(garment, body)
    return garment.with_material(material) if REST in spec.materials else garment


KINDS = {
    "built-in": Kind(_built_in, is_fitted=True),
    "mesh": Kind(_mesh, is_file=True),
    "pattern": Kind(_pattern, is_file=True, is_fitted=True),
    "dictionary": Kind(_dictionary, is_file=True, is_at_origin=True),
    "object": Kind(_object),
}
"""Name of a kind -> what reads it and what is known of it; an object is a Garment made in Python."""


def read(spec: WornGarment, body: Body, rest_shape: RestShape = Run.rest_shape) -> Garment:
    """A garment from its source, in the material of the run; else in its own, or in the default one.

    Args:
        spec: which garment.
        body: the body that wears it.
        rest_shape: of a built-in one.

    Raises:
        InputError: it cannot be read, or is not for this body.
    """
    kind = kind_of(spec.garment)
    if body is None and kind.is_fitted:
        raise InputError(
            f"{spec.name} is fitted to the body that wears it, but --body {NONE} gives none; give a mesh file."
        )
    return kind.read(spec, body, _material(spec.materials.get(REST, DEFAULT_MATERIAL)), rest_shape)


def _material(material: str | Path | Material) -> Material:
    if not isinstance(material, str | Path | Material):
        raise InputError(f"The material must be a name, a path or a Material, not {material!r}.")
    return material if isinstance(material, Material) else load_material(material)


def place(garment: Garment, body: Body, kind: Kind) -> Garment:
    """The garment moved to the position of the body.

    Args:
        garment: as read.
        body: the body that wears it.
        kind: of the garment.
    """
    if not (kind.is_at_origin and isinstance(body, ShapedBody)):
        return garment
    return replace(garment, vertices=garment.vertices + np.array([0.0, body.lift, 0.0]))


def remesh(garment: Garment, body: Body, kind: Kind, triangles: int | None) -> Garment:
    """The garment with about `triangles` triangles, outside the body where its author's mesh is.

    Args:
        garment: as worn at rest.
        body: the body that wears it.
        kind: of the garment.
        triangles: wanted number; None for its own.

    Raises:
        InputError: it has a grain.
    """
    if kind.is_fitted or triangles is None:
        return garment
    other = remeshed(garment, triangles)
    if body is None:
        return other
    rest = RestBody.of(body)
    if other.is_skinned_for(body) or not rest.is_closed or (rest.signed_distances(garment.vertices) < 0.0).any():
        return other
    if (rest.signed_distances(other.vertices) >= 0.0).all():
        return other
    # The chords of a coarser mesh dip into the skin.
    return replace(other, vertices=push_out(other.vertices, other.topology, rest))


def hold(
    garment: Garment, body: Body, kind: Kind, pins: str | Path | Sequence[int] | None
) -> tuple[Garment, Support | None]:
    """The garment, pinned, and its support if it has no pins; None if this is not searched for.

    Args:
        garment: as worn at rest.
        body: the body that wears it.
        kind: of the garment.
        pins: as for `resolve_pins`; None for its own pins, or for a support that is found.

    Raises:
        InputError: pins that it does not have.
    """
    if pins is not None:
        return garment.with_pins(resolve_pins(pins, garment)), None
    if body is None or garment.pinned.any() or not kind.is_file or garment.is_skinned_for(body):
        return garment, None
    support = find_support(garment.vertices, garment.faces, RestBody.of(body))
    if support.held is None:
        return garment, support
    warn(
        f"{garment.name}: its {support.name}, {int(support.held.sum())} vertices, was found and is pinned to the "
        "body; --pins none releases it.",
        InputNote,
    )
    return garment.with_pins(support.held), None


def check(garment: Garment, body: Body, kind: Kind, support: Support | None, file: object) -> Garment:
    """The garment with the limbs of the body inside it, if the body wears it.

    Args:
        garment: with its pins.
        body: the body that wears it.
        kind: of the garment.
        support: what holds it up; None if this is not reported.
        file: what the user named, for the cures.

    Raises:
        InputError: the body does not wear it.
    """
    if body is None:
        require_metres(garment)
        return garment
    if kind.is_fitted or garment.is_skinned_for(body):
        return garment
    if kind.is_file:
        require_worn(garment, body, str(file), support)
    return with_limbs_inside(garment, body)
