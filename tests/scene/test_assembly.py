"""What `make_scene` makes of names, files and loaded objects, and what it says of a garment that nothing holds up."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.garment.cloth_shapes import saved

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.collision.crossings import self_crossings
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputError, InputNote, InputWarning
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment
from pb4u.garment.library import RestShape, build_garment
from pb4u.garment.material import FABRICS, MATERIALS, Material
from pb4u.garment.parts import Parts
from pb4u.garment.pins import resolve_pins
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.motion.library import load_motion
from pb4u.run import Run, WornGarment
from pb4u.scene.assembly import build_scene, make_scene
from pb4u.scene.loaded_garments import load_garment
from pb4u.scene.scene import Scene


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    return load_body("woman")


def exported(name: str, body: ShapedBody, folder: Path) -> Path:
    """A built-in garment as a file, which has no pins."""
    garment = build_garment(name, body, 1600)
    return saved(folder, PolygonMesh(garment.vertices, tuple(garment.faces)), f"{name}.obj")


@pytest.mark.parametrize("name", ["skirt", pytest.param("trousers", marks=pytest.mark.slow)])
def test_the_waistband_of_a_file_is_found_and_holds_it(name: str, woman: ShapedBody, tmp_path: Path) -> None:
    file = exported(name, woman, tmp_path)
    with pytest.warns(InputWarning, match=rf"^{name}: its waistband, \d+ vertices") as told:
        worn = make_scene(file, woman, frames=2, lead_in=0).garments[0].garment
    assert len(told) == 1
    np.testing.assert_array_equal(worn.pinned, worn.with_pins(resolve_pins("waist", worn)).pinned)


@pytest.mark.parametrize("pins", ["waist", "none"])
def test_pins_that_were_given_are_not_questioned(pins: str, woman: ShapedBody, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = make_scene(exported("skirt", woman, tmp_path), woman, pins=pins, frames=2, lead_in=0)
    assert scene.garments[0].garment.pinned.any() == (pins == "waist")


def test_a_file_that_lies_on_the_shoulders_is_not_told(woman: ShapedBody, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_scene(exported("tanktop", woman, tmp_path), woman, frames=2, lead_in=0)


@pytest.mark.parametrize(
    ("held", "rest_shape", "by_pins"),
    [
        ({"pins": "waist"}, "flat", True),
        ({"pin_stiffness": 300.0}, "flat", True),
        ({}, "moulded", True),
        ({}, "flat", False),
    ],
)
def test_a_built_in_skirt_is_held_by_pins_or_elastic_and_not_told(
    woman: ShapedBody, held: dict, rest_shape: RestShape, by_pins: bool
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        worn = WornGarment("skirt", material="default", triangles=600, **held)
        scene = make_scene(worn, woman, rest_shape=rest_shape, frames=2, lead_in=0)
    (dressed,) = scene.garments
    assert dressed.garment.pinned.any() == by_pins
    assert dressed.garment.has_elastic != by_pins


def test_built_in_garments_have_bands_unless_others_are_asked_for(woman: ShapedBody) -> None:
    def cut(name: str, rest_shape: RestShape = "flat", **asked: object) -> Garment:
        return load_garment(WornGarment(name, triangles=900, **asked), woman, rest_shape)  # type: ignore[arg-type]

    shirt, plain = cut("tshirt"), build_garment("tshirt", woman, 900)
    assert {FABRICS["cotton-jersey"], FABRICS["rib"]} == set(shirt.materials)
    hem = Parts(plain).named("hem").share
    np.testing.assert_allclose(shirt.layers.sum(1)[hem > 0], 1.0 + hem[hem > 0])
    # A material for all of it leaves the rib out, and elastic with it.
    sleeve = cut("longsleeve", material="silk")
    assert sleeve.material_layers is None
    assert not sleeve.has_elastic
    single = cut("tshirt", material={"collar": "denim"}, layers={"hem": 1, "cuff": 1})
    np.testing.assert_allclose(single.layers.sum(1), 1.0)
    assert MATERIALS["denim"] in single.materials
    assert FABRICS["rib"] not in single.materials
    bound = cut("tshirt", layers={"border": 2})
    assert bound.materials == (FABRICS["cotton-jersey"],)
    assert cut("tshirt", "moulded").material_layers is None
    assert not cut("skirt", elastic={"waist": 1.0}).has_elastic


def test_folds_of_woven_cloth_that_a_mesh_is_too_coarse_for_are_told(woman: ShapedBody) -> None:
    """The count that is named has them, and cloth with soft threads is not told of."""
    silk = Material(0.06, 900.0, 700.0, 40.0, 12.0, 8e-7)
    assert silk.bending_length == pytest.approx(0.01108, rel=1e-3)
    coarse, short = build_garment("skirt", woman, 600).with_material(silk), {"frames": 2, "lead_in": 0}
    with pytest.warns(InputWarning, match="skirt: edges of .. mm are too long for the folds of this cloth") as caught:
        scene = make_scene(coarse, woman, **short)
    assert scene.notes == (str(caught[0].message),)
    enough = int(re.search(r"--triangles (\d+)", scene.notes[0])[1])  # type: ignore[index]
    limp = replace(silk, bending_stiffness=0.0)
    soft = replace(silk, warp_stiffness=40.0, weft_stiffness=40.0, coupling_stiffness=10.0)
    fine = build_garment("skirt", woman, enough).with_material(silk)
    for garment in (fine, coarse.with_material(soft), coarse.with_material(limp)):
        assert make_scene(garment, woman, **short).notes == ()


def assert_same(one: Scene, other: Scene) -> None:
    """Equal to the bit: garments, where skinning carries them, the body, and all numbers."""
    assert (one.frames, one.lead_in, one.fps, one.seed) == (other.frames, other.lead_in, other.fps, other.seed)
    # A loaded garment has no name or file that it came from.
    labels = [{key: value for key, value in scene.labels.items() if key != "sources"} for scene in (one, other)]
    assert labels[0] == labels[1]
    assert one.notes == other.notes
    for a, b in zip(one.garments, other.garments, strict=True):
        assert a.garment.material == b.garment.material
        for part in ("vertices", "faces", "pinned"):
            np.testing.assert_array_equal(getattr(a.garment, part), getattr(b.garment, part))
        np.testing.assert_array_equal(
            a.placement.positions(0, one.total_frames), b.placement.positions(0, one.total_frames)
        )
    for body, its in zip(one.colliders, other.colliders, strict=True):
        np.testing.assert_array_equal(body.positions(0, one.total_frames), its.positions(0, one.total_frames))


def test_names_loaded_objects_and_a_specification_make_the_same_scene() -> None:
    rest: dict[str, Any] = {"frames": 3, "lead_in": 2, "fps": 24.0, "seed": 3}
    named = make_scene(
        "skirt", "man", "dance", triangles=500, material="silk", pins="hem", body_shape={"height": 0.7}, **rest
    )
    worn = WornGarment("skirt", "silk", "hem", 500)
    scene = Run((worn,), body="man", body_shape={"height": 0.7}, motion="dance", **rest)
    assert_same(named, build_scene(scene))
    assert named.labels["body_shape"]["height"] == 0.7
    body = load_body("man", {"height": 0.7})
    garment = build_garment("skirt", body, 500).with_material(MATERIALS["silk"])
    loaded = make_scene(garment, body, load_motion("dance", seed=3), pins="hem", **rest)
    assert_same(named, loaded)


def test_a_kept_lead_in_is_written_and_still_leads(woman: ShapedBody) -> None:
    kept = make_scene("tanktop", woman, triangles=500, frames=2, lead_in=3, keep_lead_in=True)
    assert (kept.frames, kept.lead_in, kept.kept_lead_in, kept.led_frames, kept.total_frames) == (5, 0, 3, 3, 5)
    assert kept.notes[-1] == "The first 3 frames lead from the rest pose into the motion."
    faster = build_scene(Run((WornGarment("tanktop", triangles=500),), frames=2, lead_in=3, keep_lead_in=True), 60.0)
    assert faster.notes[-1] == "The first 6 frames lead from the rest pose into the motion."


def test_several_garments_are_worn_inner_first(woman: ShapedBody, tmp_path: Path) -> None:
    file = exported("skirt", woman, tmp_path)
    loaded = build_garment("cardigan", woman, 500, "moulded")
    scene = make_scene(
        ["tanktop", file, loaded], woman, "dance", triangles=[400, None, 1000], material=["silk", "denim", None],
        pins=[None, "waist", None], frames=2, lead_in=1,
    )  # fmt: skip
    assert scene.labels["garment"] == "tanktop+skirt+cardigan"
    garments = [dressed.garment for dressed in scene.garments]
    assert [garment.material for garment in garments] == [MATERIALS[n] for n in ("silk", "denim", "default")]
    assert [bool(garment.pinned.any()) for garment in garments] == [False, True, True]  # a cardigan by its collar
    for garment, wanted in zip(garments, (400, 1600, 1000), strict=True):
        assert abs(garment.triangle_count / wanted - 1) < 0.05
    alone = make_scene("tanktop", woman, "dance", triangles=400, material="silk", frames=2, lead_in=1)
    np.testing.assert_array_equal(garments[0].vertices, alone.garments[0].garment.vertices)
    # They lie over each other, whatever they were cut like.
    worn = torch.cat([dressed.placement.positions(0, 1)[0] for dressed in scene.garments]).numpy()
    firsts = np.cumsum([0, *(len(garment.vertices) for garment in garments)])
    faces = np.concatenate([garment.faces + first for garment, first in zip(garments, firsts, strict=False)])
    assert len(self_crossings(np.concatenate([garment.vertices for garment in garments]), faces)) > 100
    assert not len(self_crossings(worn, faces, sharing=True))


def test_what_is_given_once_holds_for_all_garments_that_leave_it_open(woman: ShapedBody) -> None:
    inner = WornGarment("tanktop", material="silk")
    scene = make_scene([inner, "skirt"], woman, triangles=400, material="wool", pins=[0, 1], frames=1, lead_in=0)
    garments = [dressed.garment for dressed in scene.garments]
    assert [garment.material for garment in garments] == [MATERIALS["silk"], MATERIALS["wool"]]
    assert [np.flatnonzero(garment.pinned).tolist() for garment in garments] == [[0, 1], [0, 1]]
    with pytest.raises(InputError, match="3 values for 2 garments"):
        make_scene(["tanktop", "skirt"], woman, material=["silk", "wool", "wool"])


def test_a_loaded_garment_keeps_its_material_until_another_is_given(woman: ShapedBody) -> None:
    garment = build_garment("tshirt", woman, 500).with_material(MATERIALS["denim"])
    for given, expected in ((None, "denim"), ("silk", "silk"), (MATERIALS["wool"], "wool")):
        scene = make_scene(garment, woman, material=given, frames=1, lead_in=0)
        assert scene.garments[0].garment.material == MATERIALS[expected]
        np.testing.assert_array_equal(scene.garments[0].garment.vertices, garment.vertices)


@pytest.mark.parametrize("from_file", [False, True])
def test_a_loaded_garment_is_remeshed_with_its_pins_and_its_author_s_mesh(
    woman: ShapedBody, tmp_path: Path, from_file: bool
) -> None:
    garment: Garment = build_garment("skirt", woman, 900, "moulded")
    if from_file:
        garment = read_garment(exported("skirt", woman, tmp_path), MATERIALS["silk"], pins="waist")
    worn = make_scene(garment, woman, triangles=400, frames=1, lead_in=0).garments[0].garment
    assert abs(worn.triangle_count / 400 - 1) < 0.05
    assert worn.material == garment.material
    # It is the same surface, held at the same border, and knows the author's vertices.
    near = TriangleSurface(garment.faces, len(garment.vertices)).at(garment.vertices).nearest(worn.vertices)
    assert np.linalg.norm(near.positions.numpy() - worn.vertices, axis=1).max() < 0.01
    waist = max(worn.topology.boundary_loops, key=lambda loop: float(worn.vertices[loop, 1].mean()))
    assert set(np.flatnonzero(worn.pinned)) == set(waist.tolist())
    author = garment.vertices if garment.source is None else garment.source.source.vertices
    assert worn.source is not None
    np.testing.assert_array_equal(worn.source.source.vertices, author)
    corners = worn.vertices[worn.faces[worn.source.triangle]]
    np.testing.assert_allclose(np.einsum("vk,vkd->vd", worn.source.barycentric, corners), author, atol=0.02)


def test_what_conflicts_with_a_loaded_object_is_refused(woman: ShapedBody) -> None:
    dance = load_motion("dance")
    for given, says in (
        ({"body_shape": {"height": 0.7}}, "woman is already loaded"),
        ({"motion": dance, "crop": (0, 9)}, "dance is a motion already loaded, so --crop"),
        ({"motion": dance, "arms_away": 5.0}, "dance is a motion already loaded, so --arms-away"),
        ({"motion": object()}, "motion must be a name, a path or a Motion"),
        ({"material": object()}, "material must be a name, a path or a Material"),
        ({"garment": object()}, "garment must be a name, a path or a Garment"),
        ({"body": object()}, "must be a shaped body or a vertex sequence"),
    ):
        with pytest.raises(InputError, match=says):
            make_scene(**{"garment": "tshirt", "body": woman, "triangles": 400, "frames": 1, **given})


def test_a_sequence_tells_of_a_loaded_motion_that_it_does_not_perform(woman: ShapedBody) -> None:
    positions = np.repeat(woman.vertices[None], 3, axis=0)
    body = VertexSequence("moving", positions, woman.faces, 30.0, woman.contact)
    garment = build_garment("tshirt", woman, 400)
    with pytest.warns(InputWarning, match="motion dance"):
        scene = make_scene(garment, body, load_motion("dance"), lead_in=0)
    assert (scene.frames, scene.labels["motion"]) == (3, "moving")


def test_a_mesh_without_bones_is_said_to_stand(woman: ShapedBody) -> None:
    body = VertexSequence("scan", woman.vertices[None], woman.faces, 30.0, woman.contact)
    garment = build_garment("tshirt", woman, 400)
    with pytest.warns(
        InputNote,
        match=r"scan is a mesh without bones, which does not move; give a rigged character, "
        "or",
    ):
        scene = make_scene(garment, body, frames=2, lead_in=0)
    assert any("does not move" in note for note in scene.notes)
    with pytest.warns(InputWarning, match="scan is a mesh without bones, which does not move; the motion dance is not"):
        make_scene(garment, body, load_motion("dance"), frames=2, lead_in=0)
