"""The built-in garments: by name, for any body with arms and legs, at any triangle count."""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Literal, TypeAlias, get_args

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.collision.remeshing import remesh
from pb4u.errors import InputError, refuse_unknown
from pb4u.garment.body_form import form_of
from pb4u.garment.clearance import clear_of_body
from pb4u.garment.cuts import CUTS, Cut
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.drafted import DRAFTED
from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS, MATERIALS, Material
from pb4u.garment.panels import flat_panels
from pb4u.garment.pins import resolve_pins
from pb4u.garment.tailoring import tailor
from pb4u.geometry.implicit_surface import ImplicitSurface
from pb4u.registry import Registry

#: Triangle counts of the named levels of detail.
LEVELS: dict[str, int] = {"base": 2500, "11K": 11000, "18K": 18000, "25K": 25000, "38K": 38000}

DICTIONARIES: Registry[Callable[[DictionaryEntry, Material], Garment]] = Registry("dictionary of garments")
"""Suffix -> reader of one garment of a dictionary, in a material."""
SEWN: dict[str, str] = dict.fromkeys((".json", ".toml", ".npz"), "pb4u.pattern.files:load_worn")
"""Kinds of garment files that are fitted to a body by simulation -> what loads them (file, body, material, triangles).

It is named here and not imported: sewing needs the solver, which is built on garments."""

DRAFTED_BY = "pb4u.pattern.drafted_garments:drafted_garment"
"""What makes the garments of `DRAFTED` (name, body, triangles)."""

RestShape: TypeAlias = Literal["flat", "moulded"]
"""What a built-in garment is at rest: flat panels, or the shape that it has on the body."""

FEWEST_TRIANGLES, MOST_TRIANGLES = 200, 200_000


def garment_names() -> tuple[str, ...]:
    """Names of the built-in garments."""
    return (*CUTS, *DRAFTED)


def build_garment(
    name: str, body: ShapedBody, triangles: int = LEVELS["base"], rest_shape: RestShape = "flat"
) -> Garment:
    """A built-in garment fitted to the resting `body`, with about `triangles` triangles of even size.

    Every count approximates the same smooth surface. Surface and garment are cached as long as the body object exists.
    It is the plain cut: hems, cuffs and elastic are sewn to it by `make_scene`.

    Args:
        name: one of `garment_names()`.
        body: any body whose skeleton has shoulders, elbows, wrists, hips, knees and ankles.
        triangles: number of triangles, from 200 to 200,000; the result is within 5 % of it.
        rest_shape: "flat", cut of flat panels that have a grain, in a fabric of its own; or "moulded", with the shape
            that it has on the body, in the material that networks are trained on.

    Raises:
        InputError: an unknown name or rest shape, a count out of range, or a body without those joints.
    """
    refuse_unknown("garment", [name], garment_names())
    refuse_unknown("rest shape", [rest_shape], get_args(RestShape))
    if isinstance(triangles, bool) or not isinstance(triangles, (int, np.integer)):
        raise InputError(f"The number of triangles must be a whole number, not {triangles!r}.")
    if not FEWEST_TRIANGLES <= triangles <= MOST_TRIANGLES:
        raise InputError(
            f"A built-in garment has between {FEWEST_TRIANGLES} and {MOST_TRIANGLES} triangles, not {triangles}."
        )
    if name in DRAFTED:
        if rest_shape != "flat":
            raise InputError(f"{name} is sewn of flat panels and cannot be moulded; its rest shape is flat.")
        return body.kept(
            f"{name} of {triangles} triangles", lambda body: resolve_name(DRAFTED_BY)(name, body, triangles)
        )
    return body.kept(
        f"{rest_shape} {name} of {triangles} triangles",
        lambda body: _meshed(name, CUTS[name], _surface(name, body), body, triangles, rest_shape),
    )


def cut_garment(name: str, cut: Cut, body: ShapedBody, triangles: int) -> Garment:
    """A moulded garment of any cut, fitted and meshed as by `build_garment`, but not cached.

    Args:
        name: name of the garment.
        cut: of the garment.
        body: resting body, with the joints that `build_garment` asks for.
        triangles: number of triangles; the result is within 5 % of it.

    Raises:
        InputError: a body without those joints, or a surface that cannot be meshed with that many triangles.
    """
    return _meshed(name, cut, tailor(cut, form_of(body)), body, triangles, "moulded")


def _meshed(
    name: str, cut: Cut, surface: ImplicitSurface, body: ShapedBody, triangles: int, rest_shape: RestShape
) -> Garment:
    vertices, faces = remesh(*surface.mesh, triangles, surface)
    vertices = clear_of_body(vertices, faces, body)
    points, uv_faces = flat_panels(vertices, faces, form_of(body), cut)
    material, rest_uv = MATERIALS["default"], None
    if rest_shape == "flat":
        material, rest_uv = FABRICS[cut.fabric], points[uv_faces]
    garment = Garment(
        name, vertices, faces, material, uvs=points / points.max(), uv_faces=uv_faces, loose=cut.loose, rest_uv=rest_uv,
    )  # fmt: skip
    return garment if cut.pins == "none" else garment.with_pins(resolve_pins(cut.pins, garment))


def _surface(name: str, body: ShapedBody) -> ImplicitSurface:
    return body.kept(f"surface of {name}", lambda body: tailor(CUTS[name], form_of(body)))
