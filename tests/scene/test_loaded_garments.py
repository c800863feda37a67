"""One mesh is loaded alike from whatever it comes: each stage is the same for all kinds of garments."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.garment.cloth_shapes import CLOTH, saved

from pb4u.body.body_model import ShapedBody
from pb4u.body.length_units import UNITS
from pb4u.body.library import load_body
from pb4u.errors import InputError, InputNote, InputWarning
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_source
from pb4u.garment.library import build_garment
from pb4u.garment.limbs_inside import limbs_outside
from pb4u.garment.material import MATERIALS, DirectionalBending, Material
from pb4u.garment.source_map import remeshed
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.run import WornGarment
from pb4u.scene.assembly import make_scene
from pb4u.scene.loaded_garments import kind_of, load_garment

PINS = tuple(range(20, 40))


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    return load_body("woman")


@pytest.fixture(scope="module")
def leggings(woman: ShapedBody) -> Garment:
    """Trousers 1.5 mm off the skin, into which the chords of coarser triangles dip."""
    loose = build_garment("trousers", woman, 1600)
    skin = RestBody.of(woman).surface.nearest(loose.vertices)
    return Garment("leggings", (skin.positions + 1.5e-3 * skin.normals).numpy().round(6), loose.faces, CLOTH)


@pytest.fixture(scope="module")
def dented(woman: ShapedBody) -> Garment:
    """A T-shirt that is dented at its back, beyond the spine."""
    shirt = build_garment("tshirt", woman, 1500)
    vertices = shirt.vertices.round(6)
    back = (np.abs(vertices[:, 0]) < 0.08) & (vertices[:, 2] < 0.0) & (np.abs(vertices[:, 1] - 1.2) < 0.06)
    vertices[back, 2] += 0.14
    assert limbs_outside(vertices, shirt.faces, woman)
    return Garment("dented", vertices, shirt.faces, CLOTH)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "metres"])
def test_check_and_simulate_say_the_same_of_a_unit(woman: ShapedBody, tmp_path: Path, unit: str) -> None:
    shirt = build_garment("tshirt", woman, 300)
    mesh = PolygonMesh(shirt.vertices / UNITS[unit], tuple(shirt.faces))
    file = saved(tmp_path, mesh)
    found = diagnose(read_source(file), woman, file, "woman")
    (units,) = (finding for finding in found.findings if finding.code == "units")
    assert f"The garment is in {unit}" in units.sentence
    with pytest.raises(InputError) as refused:
        load_garment(WornGarment(file), woman)
    assert str(refused.value) == f"{file.stem}: {units.sentence[:-1]}; {units.fix}."
    assert f"scale it by {UNITS[unit]:g} with" in units.fix


def sources(garment: Garment, body: ShapedBody, folder: Path) -> dict[str, str | Path | Garment]:
    """The garment as a file, in a dictionary around the body model's own origin, and as it is."""
    fields = {
        "rest_pos": garment.vertices - [0.0, body.lift, 0.0],
        "faces": garment.faces,
        "node_type": np.zeros((len(garment.vertices), 1), dtype=np.int64),
    }
    (folder / "all.pkl").write_bytes(pickle.dumps({garment.name: fields}))
    file = saved(folder, PolygonMesh(garment.vertices, tuple(garment.faces)), f"{garment.name}.obj")
    return {"mesh": file, "dictionary": f"{folder}/all.pkl:{garment.name}", "object": garment}


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
@pytest.mark.parametrize(("name", "triangles"), [("leggings", 1200), ("dented", 1300)])
def test_one_mesh_is_loaded_alike_from_all_sources(
    name: str, triangles: int | None, woman: ShapedBody, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    loaded = [
        load_garment(WornGarment(source, material="silk", pins=PINS, triangles=triangles), woman)
        for source in sources(request.getfixturevalue(name), woman, tmp_path).values()
    ]
    for garment in loaded:
        np.testing.assert_allclose(garment.vertices, loaded[0].vertices, atol=1e-9)
        np.testing.assert_array_equal(garment.faces, loaded[0].faces)
        np.testing.assert_array_equal(garment.pinned, loaded[0].pinned)
        assert garment.material == MATERIALS["silk"]
        assert (RestBody.of(woman).signed_distances(garment.vertices) > 0.0).all()
    assert loaded[0].pinned.any()


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_chords_that_dip_into_the_skin_are_moved_out_where_the_author_s_mesh_is(
    woman: ShapedBody, leggings: Garment
) -> None:
    body, coarse = RestBody.of(woman), remeshed(leggings, 1200)
    worn = load_garment(WornGarment(leggings, triangles=1200), woman)
    assert (body.signed_distances(leggings.vertices) > 0.0).all()
    assert (body.signed_distances(coarse.vertices) < 0.0).any()
    assert (body.signed_distances(worn.vertices) > 0.0).all()
    assert np.linalg.norm(worn.vertices - coarse.vertices, axis=1).max() < 0.01


@pytest.mark.parametrize("triangles", [None, 1200])
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_parts_of_other_materials_stay_until_one_is_given_for_all(
    triangles: int | None, woman: ShapedBody, leggings: Garment
) -> None:
    def upper(garment: Garment) -> np.ndarray:
        return garment.vertices[garment.faces].mean(axis=1)[:, 1] > 0.8

    parted = leggings.with_part(MATERIALS["denim"], upper(leggings))
    worn = load_garment(WornGarment(parted, triangles=triangles), woman)
    assert worn.materials == (CLOTH, MATERIALS["denim"])
    assert ((worn.face_material == 1) == upper(worn)).mean() > 0.97
    given = load_garment(WornGarment(parted, material="silk", triangles=triangles), woman)
    assert (given.material, given.materials) == (MATERIALS["silk"], ())


@pytest.mark.parametrize("source", ["mesh", "dictionary"])
def test_what_comes_from_a_file_without_pins_is_held_by_its_waistband(
    source: str, woman: ShapedBody, leggings: Garment, tmp_path: Path
) -> None:
    file = sources(leggings, woman, tmp_path)[source]
    with pytest.warns(
        InputNote, match="^leggings: its waistband, 20 vertices, was found and is pinned to the body"
    ) as told:
        held = load_garment(WornGarment(file), woman)
    assert len(told) == 1
    waist = load_garment(WornGarment(file, pins="waist"), woman)
    np.testing.assert_array_equal(held.pinned, waist.pinned)


@pytest.mark.filterwarnings("error")
def test_of_pins_that_are_refused_nothing_is_told(woman: ShapedBody, leggings: Garment, tmp_path: Path) -> None:
    for source in sources(leggings, woman, tmp_path).values():
        assert not load_garment(WornGarment(source, pins="none"), woman).pinned.any()


@pytest.mark.parametrize(("pins", "says"), [("loop:9", "no border"), ([9999], "out of range")])
def test_pins_that_are_not_there_are_refused_of_all_kinds(
    pins: str | Sequence[int], says: str, woman: ShapedBody, leggings: Garment, tmp_path: Path
) -> None:
    for source in sources(leggings, woman, tmp_path).values():
        with pytest.raises(InputError, match=says):
            load_garment(WornGarment(source, pins=pins), woman)


def test_a_limb_through_the_cloth_is_told_of_each_source(woman: ShapedBody, dented: Garment, tmp_path: Path) -> None:
    for source in sources(dented, woman, tmp_path).values():
        with pytest.warns(InputWarning, match="dented: the trunk went through it at rest; it was pushed out"):
            garment = load_garment(WornGarment(source, pins="none"), woman)
        assert limbs_outside(garment.vertices, garment.faces, woman) == ()


def test_the_kind_is_told_by_the_name_alone(leggings: Garment) -> None:
    kinds = [kind_of(each) for each in ("tshirt", Path("a.OBJ"), "a.png", "a.json", "a.toml", "a.npz", "a.pkl:b@3")]
    assert kinds[1] == kinds[2]
    assert kinds[3] == kinds[4] == kinds[5]
    assert len({*kinds, kind_of(leggings)}) == 5


def test_woven_cloth_without_grain_is_the_same_in_all_directions_and_a_note_says_so(woman) -> None:
    cloth = Material(0.1, 900.0, 300.0, 60.0, 20.0, DirectionalBending(2e-5, 1e-5, 8e-6))
    with pytest.warns(InputNote, match="has no grain, so its cloth is the same in all directions; --grain 0,1,0"):
        moulded = load_garment(WornGarment("tanktop", material=cloth, triangles=400), woman, "moulded")
    membrane = moulded.of_faces("membrane")
    assert membrane[:, 0] == pytest.approx(membrane[:, 1], rel=1e-12)
    assert len(np.unique(moulded.hinge_bending)) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputNote)
        flat = load_garment(WornGarment("tanktop", material=cloth, triangles=400), woman, "flat")
        given = load_garment(WornGarment("tanktop", cloth, triangles=400, grain=(0, 1, 0)), woman, "moulded")
    for garment in (flat, given):
        assert set(garment.of_faces("membrane")[garment.layers.sum(1) == 1.0, 1]) == {900.0}
        assert len(np.unique(garment.hinge_bending)) > 100


def test_all_that_is_said_of_a_garment_is_among_the_notes_of_its_scene(woman: ShapedBody, tmp_path: Path) -> None:
    shirt = build_garment("tshirt", woman, 600)
    loose = PolygonMesh(np.concatenate([shirt.vertices, [[0.0, 1.0, 0.3]]]), (*shirt.faces, shirt.faces[0]))
    file = saved(tmp_path, loose)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = make_scene(file, woman, frames=1, lead_in=0)
    said = [str(each.message) for each in caught]
    assert any("1 face(s) exist twice" in sentence for sentence in said)
    assert any("1 vertices belong to no face" in sentence for sentence in said)
    assert list(scene.notes) == list(dict.fromkeys(said))
