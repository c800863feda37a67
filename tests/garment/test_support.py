from dataclasses import replace

import numpy as np
import pytest
from cloth_shapes import saved

from pb4u.body.library import load_body
from pb4u.errors import InputWarning
from pb4u.garment import support
from pb4u.garment.cuts import CUTS
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_source
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS
from pb4u.garment.support import LEAST_AREA, find_support
from pb4u.garment.tacks import tacked
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment

FALLS = {"skirt", "trousers", "cardigan"}


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


def source_of(garment):
    return PolygonMesh(garment.vertices, tuple(garment.faces))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in ("tanktop", "skirt") else [pytest.mark.slow]) for name in CUTS],
)
def test_what_is_pinned_is_told_once_a_file_has_lost_its_pins(name, woman, tmp_path):
    built = build_garment(name, woman, 600)
    exported = read_source(saved(tmp_path, source_of(built)))
    # So few triangles are told of besides.
    found = diagnose(exported, woman)
    assert set(found.codes) - {"coarse"} == ({"unsupported"} if name in FALLS else set())
    own = {"skirt": "waistband", "trousers": "waistband", "cardigan": "collar"}
    assert found.held_by == own.get(name, "shoulders")
    assert set(diagnose(built, woman).codes) <= {"coarse"}


@pytest.mark.slow
def test_what_holds_a_garment_up_is_looked_for_once(woman, tmp_path, monkeypatch):
    looked, asked = support._closing, []
    monkeypatch.setattr(support, "_closing", lambda *given: asked.append(1) or looked(*given))
    source = source_of(build_garment("tshirt", woman, 2000))
    for call in (diagnose, lambda source, body: load_garment(WornGarment(saved(tmp_path, source)), body)):
        asked.clear()
        call(source, woman)
        assert len(asked) == 1


@pytest.mark.parametrize(
    ("body", "weight"),
    [
        ("woman", 1.0),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("woman", 0.0), ("man", 0.0), ("man", 1.0))),
    ],
)
def test_straps_and_waists_lie_far_on_either_side_of_the_limit(body, weight):
    wearer = load_body(body, {"height": 0.0, "weight": weight})  # the least area of straps, and hips that face up most
    rest = RestBody.of(wearer)
    straps = build_garment("tanktop", wearer, 200)
    assert find_support(straps.vertices, straps.faces, rest).area > 5 * LEAST_AREA
    skirt = build_garment("skirt", wearer, 600)
    assert find_support(skirt.vertices, skirt.faces, rest).area < 0.2 * LEAST_AREA


def test_a_top_cut_off_below_the_shoulders_is_not_held_up(woman):
    rest = RestBody.of(woman)
    top = build_garment("tanktop", woman, 600)
    centres = top.vertices[top.faces].mean(axis=1)
    assert find_support(top.vertices, top.faces, rest).area >= LEAST_AREA
    assert find_support(top.vertices, top.faces[centres[:, 1] < 0.8 * woman.height], rest).area < LEAST_AREA


def test_cloth_on_the_feet_does_not_hold(woman):
    rest = RestBody.of(woman)
    feet = (woman.vertices[:, 1] < 0.12) & woman.contact
    faces = woman.faces[feet[woman.faces].all(axis=1)]
    socks = woman.vertices + np.array([0.0, 0.005, 0.0])
    normals = np.cross(socks[faces[:, 1]] - socks[faces[:, 0]], socks[faces[:, 2]] - socks[faces[:, 0]])
    assert np.maximum(normals[:, 1], 0.0).sum() / 2 > 10 * LEAST_AREA
    assert find_support(socks, faces, rest).area < LEAST_AREA


def test_the_place_of_body_and_ground_does_not_matter(woman):
    rest = RestBody.of(woman)
    raised = replace(rest, vertices=rest.vertices + np.array([0.3, 1.0, -0.2]))
    top = build_garment("tanktop", woman, 600)
    area = find_support(top.vertices, top.faces, rest).area
    moved = find_support(top.vertices + np.array([0.3, 1.0, -0.2]), top.faces, raised).area
    assert moved == pytest.approx(area, rel=1e-6)


def test_a_waistband_and_straps_are_found_as_what_holds(woman):
    rest = RestBody.of(woman)
    skirt = build_garment("skirt", woman, 1000)
    holder = find_support(skirt.vertices, skirt.faces, rest)
    assert holder.name == "waistband"
    assert skirt.vertices[holder.held, 1].min() > 0.95 * skirt.vertices[:, 1].max()
    shirt = build_garment("tshirt", woman, 1000)
    assert find_support(shirt.vertices, shirt.faces, rest).held is None
    # The tank top with its shoulders cut down to a strip: straps.
    top = build_garment("tanktop", woman, 4000)
    high = top.vertices[top.faces].mean(axis=1)[:, 1] > 0.8 * woman.height
    middle = np.abs(np.abs(top.vertices[top.faces].mean(axis=1)[:, 0]) - 0.11) < 0.012
    cut = top.faces[~high | middle]
    straps = find_support(top.vertices, cut, rest)
    assert straps.name == "straps"
    # Legs alone are round no waist.
    leg = skirt.vertices * [0.4, 1.0, 0.4] + [0.3, -0.3, 0.0]
    assert find_support(leg, skirt.faces, rest).held is None


@pytest.mark.parametrize("body", ["woman", pytest.param("man", marks=pytest.mark.slow)])
def test_the_collar_of_an_open_front_is_found_where_the_built_in_one_is_pinned(body):
    wearer = load_body(body)
    rest = RestBody.of(wearer)
    cardigan = build_garment("cardigan", wearer, 1000)
    collar = find_support(cardigan.vertices, cardigan.faces, rest)
    assert collar.name == "collar"
    np.testing.assert_array_equal(collar.held, cardigan.pinned)
    # Off the neck it is not worn by its collar.
    assert find_support(cardigan.vertices + [0.0, 0.06, -0.04], cardigan.faces, rest).held is None


def strapped(body, gap):
    """The tank top with its shoulders cut down to straps that end unsewn, `gap` [m] before the back they belong to."""
    top = build_garment("tanktop", body, 4000)
    centres = top.vertices[top.faces].mean(axis=1)
    high = centres[:, 1] > 0.8 * body.height
    strap = high & (np.abs(np.abs(centres[:, 0]) - 0.11) < 0.012)
    gone = strap & (np.abs(centres[:, 1] - 0.8 * body.height - 0.03) < gap / 2) & (centres[:, 2] < 0.0)
    used, faces = np.unique(top.faces[(~high | strap) & ~gone], return_inverse=True)
    return PolygonMesh(top.vertices[used], tuple(faces.reshape(-1, 3)))


@pytest.mark.parametrize("gap", [0.02, pytest.param(0.05, marks=pytest.mark.slow)])
def test_straps_that_end_unsewn_hold_nothing_and_are_sewn_where_they_end_near(woman, gap, tmp_path):
    source, rest = strapped(woman, gap), RestBody.of(woman)
    faces = np.stack(source.polygons)
    straps = find_support(source.vertices, faces, rest).loose
    assert len(straps) == 2
    assert find_support(source.vertices, faces, rest).held is None
    (found,) = diagnose(source, woman).findings
    assert found.code == "unsupported"
    assert found.severity.value == "warning"
    assert f"2 of its straps have loose ends, {100 * max(strap.gap for strap in straps):.1f} cm" in found.sentence
    if gap > 0.03:
        assert found.tacks == ()
        return
    # Two straps, each sewn to the back: their vertices lie within 3 cm, and once sewn they hold.
    assert len(found.tacks) >= 2
    a, b = source.vertices[np.array(found.tacks)].swapaxes(0, 1)
    assert np.linalg.norm(a - b, axis=1).max() < 0.03
    assert " ".join(f"`--tack {a}:{b}`" for a, b in found.tacks) in found.fix
    sewn = tacked(Garment("top", source.vertices, faces, MATERIALS["default"]), found.tacks)
    assert find_support(sewn.vertices, sewn.faces, rest).loose == ()
    assert find_support(sewn.vertices, sewn.faces, rest).name == "straps"
    # It is said before a simulation, and no more once they are sewn.
    file = saved(tmp_path, source, "top.obj")
    with pytest.warns(InputWarning, match="2 of its straps"):
        load_garment(WornGarment(file), woman)
    with pytest.warns(InputWarning, match=r"straps, .* vertices"):
        load_garment(WornGarment(file, tacks=found.tacks), woman)


@pytest.mark.slow
def test_a_strap_that_ends_upon_a_panel_is_sewn_to_it(woman):
    """The straps let down over the back, 1 cm outside of it, so that they end within the panel."""
    source, rest = strapped(woman, 0.02), RestBody.of(woman)
    faces, vertices = np.stack(source.polygons), source.vertices.copy()
    ends = np.concatenate([strap.end for strap in find_support(vertices, faces, rest).loose])
    panel = vertices[(vertices[:, 2] < 0.0) & (vertices[:, 1] < 0.72 * woman.height)]
    for vertex in ends:
        below = panel[np.linalg.norm(panel[:, :2] - vertices[vertex, :2] * [1.0, 0.0] - [0.0, 1.18], axis=1).argmin()]
        vertices[vertex] = below - [0.0, 0.0, 0.01]
    straps = find_support(vertices, faces, rest).loose
    assert [len(strap.tacks) > 0 for strap in straps] == [True, True]
    border = Topology(faces, len(vertices)).border_vertices
    assert not border[[inner for strap in straps for _, inner in strap.tacks]].any()
