from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.library import load_body
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.errors import InputError
from pb4u.garment.drafted import DRAFTED
from pb4u.garment.fit import RestBody
from pb4u.garment.library import build_garment
from pb4u.garment.material import FABRICS
from pb4u.geometry.topology import uv_islands
from pb4u.pattern.body_measurements import tailors_measures, trunk_girths
from pb4u.pattern.draft import FOLD, Draft, arc
from pb4u.pattern.drafts import DRAFTS, MEASURES, drafted
from pb4u.pattern.mesh import mesh_pattern
from pb4u.pattern.pattern import Pattern, signed_area
from pb4u.pattern.sewing import turned_over
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment

SHAPES = (
    ("woman", {}), ("man", {}), ("woman", {"height": 0.2}), ("woman", {"weight": 0.85}),
    ("woman", {"height": 0.85, "muscle": 0.7}), ("man", {"weight": 0.85}), ("man", {"height": 0.2, "weight": 0.3}),
    ("man", {"muscle": 0.85, "height": 0.75}),
)  # fmt: skip


def measures(body: str = "woman", **shape: float) -> dict[str, float]:
    return tailors_measures(load_body(body, shape))


def level_length(pattern: Pattern, panel: str, at: float) -> float:
    """Length [m] of the edges of a panel that lie at a height [m]."""
    own = pattern.panels[pattern.index[panel]]
    ends = np.stack([own.corners, np.roll(own.corners, -1, axis=0)], axis=1)
    return float(own.edge_lengths[(np.abs(ends[:, :, 1] - at) < 2e-3).all(axis=1)].sum())


def test_a_body_has_all_measures():
    found = measures()
    assert set(found) == set(MEASURES)
    assert found["crotch_height"] < found["hip_height"] < found["low_waist_height"] < found["waist_height"]
    assert trunk_girths(load_body("woman"), low=found["low_waist_height"])["low"][1] == pytest.approx(
        found["low_waist"]
    )


@pytest.mark.parametrize("name", DRAFTS)
@pytest.mark.parametrize(("body", "shape"), SHAPES)
def test_every_pattern_is_drafted_for_every_shape(name: str, body: str, shape: dict[str, float]):
    pattern = drafted(name, measures(body, **shape))
    for seam in pattern.seams:
        one, other = pattern.seam_lengths(seam)
        gathered = {side[0].partition("_")[0] for side in (seam.first, seam.second)} == {"sleeve", "cuff"}
        assert one == pytest.approx(other, rel=0.35 if gathered else 0.04), seam
    for triangles in (1900, 2500):
        assert len(mesh_pattern(pattern, triangles).faces) == pytest.approx(triangles, rel=0.1)


@pytest.mark.parametrize("body", ["woman", "man"])
def test_the_waist_of_jeans_is_the_measure_and_its_ease(body: str):
    taken = measures(body)
    pattern = drafted("jeans", taken)
    top = taken["low_waist_height"] + 0.02
    around = sum(level_length(pattern, f"band_{half}", top) for half in ("front", "back"))
    assert around == pytest.approx(taken["low_waist"] + 0.03, rel=0.01)
    front = pattern.panels[pattern.index["front_left"]]
    inner = [k for k in range(front.edge_count) if (front.corners[[k, (k + 1) % front.edge_count], 0] < 0.0).all()]
    rise = max(inner, key=lambda k: front.corners[[k, (k + 1) % front.edge_count], 1].max())
    inseam = sum(front.edge_lengths[k] for k in inner if k != rise)
    crotch, hem = taken["crotch_height"] - 0.015, 0.4 * taken["ankle_height"]
    assert inseam == pytest.approx(crotch - hem, rel=0.02)
    # From the crotch to the waist, without the fork.
    assert front.corners[:, 1].max() - crotch == pytest.approx(taken["low_waist_height"] - 0.02 - crotch, abs=1e-9)


@pytest.mark.parametrize("body", ["woman", "man"])
def test_a_sleeve_with_its_cuff_is_as_long_as_the_arm_and_its_ease(body: str):
    taken = measures(body)
    pattern = drafted("shirt", taken)
    panels = [pattern.panels[pattern.index[f"{part}_front_left"]] for part in ("sleeve", "cuff")]
    sleeve, cuff = (float(np.ptp(panel.corners[:, 1])) for panel in panels)
    assert sleeve + cuff == pytest.approx(taken["arm_length"] + 0.03, rel=0.01)
    assert 2.0 * float(np.ptp(panels[1].corners[:, 0])) == pytest.approx(taken["wrist"] + 0.06, rel=0.01)


@pytest.mark.parametrize("body", ["woman", "man"])
def test_a_circle_skirt_is_a_full_circle(body: str):
    taken = measures(body)
    gores = [panel for panel in drafted("circle_dress", taken).panels if panel.name.startswith("gore")]
    radius, long = (taken["waist"] + 0.03) / (2.0 * np.pi), taken["waist_height"] - taken["knee_height"]
    hems = [max(panel.edge_lengths[k] for k in panel.curves) for panel in gores]
    waists = [min(panel.edge_lengths[k] for k in panel.curves) for panel in gores]
    assert sum(hems) == pytest.approx(2.0 * np.pi * (radius + long), rel=1e-3)
    assert sum(waists) == pytest.approx(2.0 * np.pi * radius, rel=1e-3)
    assert sum(abs(panel.area) for panel in gores) == pytest.approx(
        np.pi * ((radius + long) ** 2 - radius**2), rel=1e-3
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"waist": None}, "measure waist, a number above 0"),
        ({"hips": -1.0}, "measure hips"),
        ({"wrist": float("nan")}, "measure wrist"),
        ({"knee_height": 2.0}, "knee_height is 2.000 m high, and crotch_height, which must be higher, 0.820 m"),
        ({"upper_arm": 9.0}, "cannot be drafted: no body has all of these measures"),
    ],
)
def test_bad_measures_are_refused_in_a_sentence(change: dict[str, float | None], told: str):
    with pytest.raises(InputError, match=told):
        drafted("shirt" if "upper_arm" in change else "jeans", {**measures(), **change})
    with pytest.raises(InputError, match="did you mean shirt"):
        drafted("shrt", measures())


def test_a_draft_mirrors_its_left_half_and_cuts_on_the_fold():
    draft = Draft("apron")
    half = (("top", (0.0, 0.4)), ("side", (0.2, 0.4), (0.3, 0.2)), ("hem", (0.2, 0.0)))
    draft.cut("front", *half, (FOLD, (0.0, 0.0)), depth=0.1)
    draft.cut("back", *half, ("centre", (0.0, 0.0)), depth=-0.1)
    draft.sew(("front.side", "back.side"), ("back.centre", "back.centre"))
    pattern = draft.pattern()
    assert [panel.name for panel in pattern.panels] == ["front", "back_left", "back_right"]
    # The outside shows forwards in front, backwards behind.
    assert [np.sign(signed_area(panel.corners)) for panel in pattern.panels] == [1.0, -1.0, -1.0]
    assert pattern.panels[0].area == pytest.approx(-sum(panel.area for panel in pattern.panels[1:]), rel=0.01)
    assert draft.length("front.top", "front.hem") == pytest.approx(0.4, abs=1e-5)
    mesh = mesh_pattern(pattern, 200)
    for one, other in mesh.sides:
        assert np.abs(mesh.placed[one][:, :2] - mesh.placed[other][:, :2]).max() < 1e-9


def test_an_arc_is_one():
    start, *controls = arc(0.3, 0.2, 0.2 + 0.5 * np.pi)
    end = arc(0.3, 0.2 + 0.5 * np.pi, 1.8)[0]
    t = np.linspace(0.0, 1.0, 50)[:, None]
    points = np.array([start, *controls, end])
    on = sum(
        weight * points[k] for k, weight in enumerate(((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3))
    )
    np.testing.assert_allclose(np.hypot(*on.T), 0.3, rtol=3e-4)


def test_a_collar_is_turned_over_its_stand():
    mesh = mesh_pattern(drafted("shirt", measures()), 2500)
    places = mesh.sewn(mesh.placed)
    turned = turned_over(mesh, places)
    falls = np.array([panel.name.startswith("fall") for panel in mesh.pattern.panels])[mesh.panel]
    loose = np.setdiff1d(mesh.vertex[falls], mesh.vertex[~falls])
    np.testing.assert_array_equal(turned[mesh.vertex[~falls]], places[mesh.vertex[~falls]])
    assert (turned[loose, 1] < places[loose, 1]).all()
    middle = places[mesh.vertex[falls]].mean(axis=0)
    away = [np.hypot(*(each[loose] - middle)[:, [0, 2]].T) for each in (places, turned)]
    assert (away[1] > away[0]).all()


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("jeans", "woman"), pytest.param("jeans", "man", marks=pytest.mark.slow),
        ("shirt", "man"), pytest.param("shirt", "woman", marks=pytest.mark.slow),
        ("circle_dress", "woman"), pytest.param("circle_dress", "man", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_each_is_sewn_and_hangs_on_both_bodies(name: str, body: str, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    wearer, kind = load_body(body), DRAFTED[name]
    garment = build_garment(name, wearer, 2000)
    assert not len(self_crossings(garment.vertices.astype(np.float32), garment.faces, sharing=True))
    skin = wearer.faces[wearer.contact[wearer.faces].all(axis=1)]
    assert not len(crossings(garment.vertices, garment.faces, wearer.vertices, skin))
    assert RestBody.of(wearer).signed_distances(garment.vertices).min() > 0.0
    assert garment.has_grain
    assert garment.material == FABRICS[kind.fabric]
    assert garment.pinned.any() == (kind.pins == "waist")
    assert build_garment(name, wearer, 2000) is garment
    twice = garment.layers.sum(axis=1) == 2.0
    named = np.array([panel.startswith(tuple(kind.parts) or "none") for panel in garment.panels])
    np.testing.assert_array_equal(twice, named[uv_islands(garment.uv_faces)])


@pytest.mark.slow
def test_the_points_of_a_collar_lie_down(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    garment = build_garment("shirt", load_body("man"), 6000)
    stands = [np.unique(garment.faces[garment.parts[f"stand_front_{side}"]]) for side in ("left", "right")]
    top = garment.vertices[np.intersect1d(*stands), 1].max()
    for side in ("left", "right"):
        fall = garment.parts[f"fall_front_{side}"]
        point = garment.faces[fall].ravel()[garment.rest_shape[fall][..., 1].ravel().argmax()]
        assert top - garment.vertices[point, 1] > 0.03


def test_it_is_never_moulded_and_wears_other_cloth():
    woman = load_body("woman")
    with pytest.raises(InputError, match="its rest shape is flat"):
        build_garment("jeans", woman, 2000, "moulded")
    worn = load_garment(WornGarment("jeans", material="denim-14oz", triangles=2000), woman)
    assert worn.material == FABRICS["denim-14oz"]
    assert worn.layers.sum(axis=1).max() == 2.0
