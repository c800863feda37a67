"""The garments of a run: loaded, remeshed, held up, and in the order they are worn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.collision.remeshing import remesh
from pb4u.errors import InputError, InputNote, warn
from pb4u.garment.diagnosis import require_fine, require_near, require_worn
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment, SourceMap
from pb4u.garment.garment_file import nearest_places, read_garment
from pb4u.garment.layering import worn_order
from pb4u.garment.library import DICTIONARIES, SEWN, build_garment, garment_names
from pb4u.garment.limbs_inside import with_limbs_inside
from pb4u.garment.material import Material, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.garment.repair import push_out
from pb4u.garment.support import Support, find_support
from pb4u.garment.tacks import tacked
from pb4u.geometry.appearance import read_image
from pb4u.run import WornGarment

DEFAULT_MATERIAL = "default"


def load_garments(
    specified: Sequence[WornGarment], body: ShapedBody | VertexSequence, as_recorded: bool
) -> tuple[list[Garment], list[WornGarment]]:
    """The garments, pinned, and how each was specified, in the order they are worn, inner first.

    Args:
        specified: which, inner first but for what is tucked into another.
        body: who wears them.
        as_recorded: whether a recording is played as it is, with garments as coarse as its authors had them.

    Raises:
        InputError: one cannot be read, or does not fit.
    """
    garments = []
    for each in specified:
        garment = load_garment(each, body)
        if each.texture is not None:
            garment = garment.with_texture(read_image(Path(each.texture)))
        # A recording is replayed as its authors did, on the meshes that they did it with.
        require_fine(garment, body, accepted=as_recorded or _is_own_count(each, garment))
        garments.append(garment if each.pins is None else garment.with_pins(resolve_pins(each.pins, garment)))
    order = worn_order(garments, [each.tucked for each in specified])
    return [garments[k] for k in order], [specified[k] for k in order]


def _is_own_count(worn: WornGarment, garment: Garment) -> bool:
    """Whether the user wants just as many triangles as the garment was made with."""
    is_built_in = str(worn.garment) in garment_names()
    return worn.triangles == garment.triangle_count and garment.is_authors_mesh and not is_built_in


def load_garment(worn: WornGarment, body: ShapedBody | VertexSequence) -> Garment:
    """The garment in its material, without the pins of the worn.

    Args:
        worn: which garment, in what material and at how many triangles.
        body: who wears it.

    Raises:
        InputError: it cannot be read, or does not fit.
    """
    garment, triangles = worn.garment, worn.triangles
    if isinstance(garment, Garment):
        if len(loose := garment.topology.isolated_vertices):
            raise InputError(
                f"garment {garment.name}: {len(loose)} of its {len(garment.vertices)} vertices are in no face, first "
                f"{loose[:5].tolist()}; no cloth would carry them, so leave them out."
            )
        require_near(garment, body)
        cloth = garment.material if worn.material is None else _load_material(worn.material)
        own = tacked(_remeshed(garment, triangles), worn.tacks).with_material(cloth)
        return own if garment.skinning is not None else with_limbs_inside(own, body)
    if not isinstance(garment, str | Path):
        raise InputError(f"The garment must be a name, a path or a Garment, not {garment!r}.")
    cloth = _load_material(worn.material or DEFAULT_MATERIAL)
    entry = DictionaryEntry.parse(garment)
    if entry is not None:
        read = DICTIONARIES.named(entry.path.suffix.lower())
        return _worn(tacked(_remeshed(read(entry, cloth), triangles), worn.tacks), body)
    if loader := SEWN.get(Path(garment).suffix.lower()):
        loaded = tacked(resolve_name(loader)(Path(garment), body, cloth, triangles), worn.tacks)
        return _held(loaded, body)[0] if worn.pins is None else loaded
    if Path(garment).suffix:
        loaded = read_garment(Path(garment), cloth, triangles=triangles)
        if triangles is not None:
            loaded = _outside_as_made(loaded, RestBody.of(body))
        loaded = tacked(loaded, worn.tacks)
        support = None
        if worn.pins is None:
            loaded, support = _held(loaded, body)
        require_worn(loaded, body, garment, None if loaded.pinned.any() else support)
        return with_limbs_inside(loaded, body)
    if not isinstance(body, ShapedBody):
        near = ", ".join(garment_names())
        raise InputError(
            f"The built-in garments ({near}) are cut from a body with bones; {body.name} is a sequence of vertices: "
            "give the garment as a mesh file that fits its first frame."
        )
    options = {} if triangles is None else {"triangles": triangles}
    return tacked(build_garment(str(garment), body, **options), worn.tacks).with_material(cloth)


def _worn(garment: Garment, body: ShapedBody | VertexSequence) -> Garment:
    """A garment of a dictionary, which stands where SMPL's own origin is, at the height of the body that wears it."""
    if isinstance(body, ShapedBody):
        garment = replace(garment, vertices=garment.vertices + np.array([0.0, body.lift, 0.0]))
        if garment.skinning is not None and garment.skinning.bone_count == body.skeleton.bone_count:
            return garment  # its file says how this body wears it
    places, faces = garment.vertices, garment.faces
    support = None if garment.pinned.any() else find_support(places, faces, RestBody.of(body))
    require_worn(garment, body, garment.name, support)
    return garment


def _outside_as_made(garment: Garment, body: RestBody) -> Garment:
    """A remeshed garment out of the body, where its author's mesh is: the chords of a coarser one dip into the skin."""
    source = garment.source
    if source is None or not body.is_closed or (body.signed_distances(source.source.vertices) < 0.0).any():
        return garment
    if (body.signed_distances(garment.vertices) >= 0.0).all():
        return garment
    return replace(garment, vertices=push_out(garment.vertices, garment.topology, body))


def _held(garment: Garment, body: ShapedBody | VertexSequence) -> tuple[Garment, Support]:
    """The garment, pinned by what was found to hold it, and that."""
    support = find_support(garment.vertices, garment.faces, RestBody.of(body))
    if support.held is None:
        return garment, support
    warn(
        f"{garment.name}: its {support.name}, {int(support.held.sum())} vertices, was found and holds it; --pins "
        "none lets it go.",
        InputNote,
    )
    return garment.with_pins(support.held), support


def _load_material(material: str | Path | Material) -> Material:
    if isinstance(material, Material):
        return material
    if not isinstance(material, str | Path):
        raise InputError(f"The material must be a name, a path or a Material, not {material!r}.")
    return load_material(material)


def _remeshed(garment: Garment, triangles: int | None) -> Garment:
    """A loaded garment with about `triangles` triangles; exports and pins follow the mesh it had."""
    if triangles is None or triangles == garment.triangle_count:
        return garment
    if garment.rest_uv is not None:
        raise InputError(
            f"{garment.name} is sewn of flat panels, and is not remeshed as it hangs; dress its pattern with "
            f"{triangles} triangles."
        )
    vertices, faces = remesh(garment.vertices, garment.faces, triangles)
    places = nearest_places(garment.vertices, vertices, faces)
    own = garment.skinning
    if own is not None:
        triangle, barycentric = nearest_places(vertices, garment.vertices, garment.faces)
        own = own.at(garment.faces[triangle], barycentric)
    remeshed = replace(
        garment, vertices=vertices, faces=faces, pinned=np.zeros(len(vertices), dtype=bool), uvs=None, uv_faces=None,
        appearances=None, source=SourceMap(garment.mesh, *places), coarse_edges=(), skinning=own,
    )  # fmt: skip
    if garment.pinned.any():
        remeshed = remeshed.with_pins(resolve_pins(np.flatnonzero(garment.pinned), remeshed))
    if garment.source is None:
        return remeshed
    author = garment.source.source
    return replace(remeshed, source=SourceMap(author, *nearest_places(author.vertices, vertices, faces)))
