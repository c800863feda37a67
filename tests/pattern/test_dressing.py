from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.pattern.patterns import skirt, trousers, vest

import pb4u
from pb4u.body.library import load_body
from pb4u.cli.check import check
from pb4u.dataset.planning import footprints
from pb4u.errors import InputError, InputWarning
from pb4u.garment.body_form import BodyForm
from pb4u.garment.fit import RestBody
from pb4u.garment.material import MATERIALS
from pb4u.garment.repair import repair
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import read_obj, write_obj
from pb4u.measures.job_planner import JobPlanner
from pb4u.pattern import files
from pb4u.pattern.body_measurements import shoulder_height, trunk_girths
from pb4u.pattern.dressing import Dressed, dress
from pb4u.pattern.files import load_worn, read_dressed, write_worn
from pb4u.pattern.fit_checks import refuse_slipped
from pb4u.pattern.mesh import mesh_pattern
from pb4u.pattern.pattern import Panel, Pattern, Seam
from pb4u.pattern.placement import around, crotch_height
from pb4u.pattern.sewing import Sewing, carried
from pb4u.pattern.thin_body import SewingBody
from pb4u.run import Run, WornGarment

TRIANGLES = 300


@pytest.fixture(scope="module")
def body():
    return load_body("woman", {})


@pytest.fixture(scope="module")
def dressed(body) -> Dressed:
    return dress(skirt(), body, TRIANGLES)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "pb4u" / "dressed"


def test_a_skirt_is_worn_around_the_hips_outside_the_skin(dressed, body):
    assert dressed.crossings == dressed.body_crossings == 0
    assert dressed.depth == 0.0
    assert dressed.strain < 0.05
    garment = dressed.garment
    # One loop above and one below, both around the body.
    loops = sorted(garment.topology.boundary_loops, key=lambda loop: garment.vertices[loop, 1].mean())
    assert len(loops) == 2
    for loop in loops:
        angle = np.unwrap(np.arctan2(garment.vertices[loop, 2], garment.vertices[loop, 0]))
        assert abs(angle[-1] - angle[0]) > 1.8 * np.pi
    assert garment.vertices[loops[1], 1].min() > garment.vertices[loops[0], 1].max() + 0.3
    outwards = RestBody.of(body).surface.nearest(garment.vertices[garment.faces].mean(axis=1)).normals.numpy()
    corners = garment.vertices[garment.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", outwards, normals) > 0.0).mean() > 0.95


def test_its_rest_shape_is_the_flat_pattern(dressed):
    garment = dressed.garment
    assert garment.face_areas.sum() == pytest.approx(skirt().area, rel=1e-9)
    assert garment.vertex_masses.sum() == pytest.approx(skirt().area * garment.material.density, rel=1e-9)
    sides = np.linalg.norm(np.roll(garment.rest_uv, -1, axis=1) - garment.rest_uv, axis=2)
    # Both sides of the seams of this skirt are alike, so every edge has one length.
    assert garment.edge_lengths[garment.topology.face_edges] == pytest.approx(sides)


def test_it_walks_with_its_flat_rest_shape_in_the_file(dressed, body, tmp_path):
    scene = pb4u.make_scene(dressed.garment, body, "walk", frames=2, lead_in=2, pins="waist")
    file = tmp_path / "walk.npz"
    pb4u.load_simulator("solver").simulate(scene).save(file)
    trajectory = pb4u.Trajectory.open(file)
    assert trajectory.metadata["garments"][0]["rest_area"] == pytest.approx(skirt().area)
    assert trajectory.header.rest_uv == pytest.approx(dressed.garment.rest_uv)
    measured = pb4u.measure(trajectory)["metrics"]
    assert measured["self_intersections"]["max"] == 0
    assert measured["stretch"]["mean"] > 0.0
    with pytest.raises(InputError, match="400 triangles"):
        pb4u.make_scene(dressed.garment, body, "walk", triangles=400, frames=1)


def test_a_dressed_garment_is_kept_with_its_pattern(dressed, body, tmp_path, cache):
    file = tmp_path / "skirt.npz"
    write_worn(file, dressed, body)
    same = load_worn(file, body, MATERIALS["default"])
    assert (same.vertices == dressed.garment.vertices).all()
    assert (same.rest_uv == dressed.garment.rest_uv).all()
    finer = load_worn(file, body, MATERIALS["silk"], 600)
    assert len(finer.faces) == pytest.approx(600, rel=0.1)
    assert finer.material == MATERIALS["silk"]
    assert finer.face_areas.sum() == pytest.approx(skirt().area, rel=1e-9)
    with pytest.warns(InputWarning, match=r"dressed on woman.* man"):
        load_worn(file, load_body("man", {}), MATERIALS["default"])
    assert len(list(cache.glob("*.npz"))) == 1


def test_a_pattern_is_dressed_once_for_a_body(dressed, body, tmp_path, cache, monkeypatch):
    file = tmp_path / "skirt.json"
    write_worn(file, dressed, body)
    first = load_worn(file, body, MATERIALS["default"], TRIANGLES)
    monkeypatch.setattr(files, "dress", None)
    again = load_worn(file, body, MATERIALS["default"], TRIANGLES)
    assert (again.vertices == first.vertices).all()


def _chain(vertices: np.ndarray) -> list[tuple[int, int]]:
    return list(zip(vertices[:-1].tolist(), vertices[1:].tolist(), strict=True))


def test_meshes_and_pictures_are_written(dressed, body, tmp_path):
    for name in ("skirt.obj", "skirt.svg", "skirt.png"):
        write_worn(tmp_path / name, dressed, body)
        assert (tmp_path / name).stat().st_size > 1000
    text = (tmp_path / "skirt.obj").read_text()
    assert text.count("\nvt ") == len(dressed.mesh.points)
    lines = {tuple(int(k) - 1 for k in line.split()[1:]) for line in text.splitlines() if line.startswith("l ")}
    sewn = {tuple(sorted(edge)) for side, _ in dressed.mesh.sides for edge in _chain(dressed.mesh.vertex[side])}
    assert lines == sewn
    assert "\ng seams\n" in text
    with pytest.raises(InputError, match=r"\.npz, \.obj, \.json, \.svg or \.png"):
        write_worn(tmp_path / "skirt.fbx", dressed, body)


def test_a_welded_drape_in_centimetres_is_a_garment_as_well(dressed, body, tmp_path):
    # As GarmentCodeData keeps its drapes: one mesh, its seams welded, texture coordinates apart at them.
    garment, file, mended = dressed.garment, tmp_path / "drape.obj", tmp_path / "mended.obj"
    write_obj(file, PolygonMesh(100.0 * garment.vertices, tuple(garment.faces), garment.uvs, tuple(garment.uv_faces)))
    with pytest.raises(InputError, match=r"centimetres.*--fix"):
        pb4u.make_scene(file, body, "walk", frames=1)
    source, _, _ = repair(read_obj(file), body)
    write_obj(mended, source)
    scene = pb4u.make_scene(mended, body, "walk", frames=2, lead_in=1, pins="waist")
    assert np.abs(scene.garments[0].garment.vertices - garment.vertices).max() < 1e-4
    assert scene.garments[0].garment.rest_uv is None
    trajectory = pb4u.load_simulator("quick-solver").simulate(scene)
    assert pb4u.measure(trajectory)["metrics"]["self_intersections"]["max"] == 0


def test_other_archives_are_no_dressed_garments(dressed, body, tmp_path):
    file = tmp_path / "skirt.npz"
    np.savez(file, positions=np.zeros(3))
    with pytest.raises(InputError, match="it has no format_version"):
        read_dressed(file)
    write_worn(file, dressed, body)
    members = dict(np.load(file))
    for name, value in (("faces", members["faces"] + 10_000), ("panel", members["panel"] + 4)):
        np.savez(file, **members | {name: value})
        with pytest.raises(InputError, match="is not a dressed garment"):
            read_dressed(file)


def test_cloth_stays_where_it_is_on_another_mesh_of_its_panels(dressed):
    finer = mesh_pattern(skirt(), 4 * TRIANGLES)
    places = carried(dressed.mesh, dressed.garment.vertices, finer)
    back = carried(finer, places, dressed.mesh)
    assert np.linalg.norm(back - dressed.garment.vertices, axis=1).max() < 0.01


def test_a_pattern_too_small_for_the_body_is_refused(body):
    small = [Panel(p.name, 0.5 * p.corners, p.position + (0, 0.25, 0), label=p.label) for p in skirt().panels]
    panel, girth = r"and by \d+ % in panel (front|back)", r"(waist|hips): \d+ cm, cut for about \d+;"
    with pytest.raises(InputError, match=rf"small is too small for woman: .*, {panel}.*; {girth}"):
        dress(Pattern("small", small, skirt().seams), body, 200)


@pytest.mark.parametrize("pattern", [skirt(), vest(0.9)])
def test_a_pattern_three_times_too_small_is_refused(body, pattern: Pattern):
    small = [Panel(p.name, p.corners / 3.0, p.position + (0, 0.35, 0)) for p in pattern.panels]
    with pytest.raises(InputError, match=r"tiny is too small for woman: .*\d+ cm"):
        dress(Pattern("tiny", small, pattern.seams), body, 200)


def test_a_garment_that_slips_off_the_shoulders_is_refused(body):
    mesh = mesh_pattern(vest(0.9), 100)
    placed = around(mesh, body)
    worn = mesh.sewn(placed)
    refuse_slipped(mesh, body, placed, worn - (0, 0.02, 0))
    with pytest.raises(InputError, match=r"vest is too large for woman: .*2\d cm"):
        refuse_slipped(mesh, body, placed, worn - (0, 0.25, 0))


def test_a_waistband_that_does_not_close_is_refused(body):
    # A band of 60 cm in all around a waist of 73: most of the skirt below it is slack.
    bands = [Panel(f"band {k}", [(-0.15, 0), (0.15, 0), (0.15, 0.04), (-0.15, 0.04)][:: 1 - 2 * k],
                   position=(0.0, 1.1, 0.2 - 0.4 * k)) for k in range(2)]  # fmt: skip
    drops = [Panel(f"drop {k}", [(-0.4, -0.5), (0.4, -0.5), (0.3, 0), (-0.3, 0)][:: 1 - 2 * k],
                   position=(0.0, 1.08, 0.2 - 0.4 * k)) for k in range(2)]  # fmt: skip
    seams = [Seam(("band 0", 1), ("band 1", 1)), Seam(("band 0", 3), ("band 1", 3))]
    seams += [Seam(("drop 0", 1), ("drop 1", 1)), Seam(("drop 0", 3), ("drop 1", 3))]
    seams += [Seam(("band 0", 0), ("drop 0", 2)), Seam(("band 1", 2), ("drop 1", 0))]
    with pytest.raises(InputError, match=r"by \d\d % in panel (band [01]);.* \1: \d+ cm, cut for about 6\d;"):
        dress(Pattern("wide", [*bands, *drops], seams), body, 400)


def test_panels_far_from_the_body_are_refused(body):
    front, *others = vest(0.9).panels
    moved = Panel(front.name, front.corners, front.position + (40.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"vest .*front is 3\d\.\d m away"):
        dress(Pattern("vest", [moved, *others], vest(0.9).seams), body, 200)


def test_a_pattern_below_the_trunk_is_refused(body):
    low = [Panel(p.name, p.corners, p.position / 2.54) for p in skirt().panels]
    with pytest.raises(InputError, match=r"front left, .*74 cm"):
        dress(Pattern("low", low, skirt().seams), body, 200)


def test_a_top_is_brought_to_the_shoulders_of_its_body(body):
    worn = dress(vest(0.6), body, 400)
    assert worn.garment.vertices[:, 1].max() == pytest.approx(shoulder_height(body, 0.09), abs=0.02)
    assert worn.strain < 0.05


@pytest.mark.parametrize("height", [0.5, 1.0])
def test_trousers_are_lowered_to_the_crotch_of_their_body(body, height: float):
    mesh = mesh_pattern(trousers(height), 100)
    sewing = Sewing(mesh, body, MATERIALS["default"])
    crotch = body.kept("form", BodyForm).crotch
    assert crotch_height(mesh, mesh.placed) == pytest.approx(height)
    assert crotch_height(mesh, sewing.placed) == pytest.approx(min(height, crotch - 0.01), abs=1e-6)


@pytest.mark.parametrize("raised", [0.0, 0.3])
def test_a_skirt_that_would_begin_above_the_waist_is_lowered(body, raised: float):
    panels = [Panel(p.name, p.corners, p.position + (0, raised, 0)) for p in skirt().panels]
    mesh = mesh_pattern(Pattern("skirt", panels, skirt().seams), 100)
    waist = trunk_girths(body)["waist"][0]
    placed = Sewing(mesh, body, MATERIALS["default"]).placed
    assert placed[:, 1].max() == pytest.approx(min(1.1 + raised, waist + 0.05), abs=1e-6)


def test_the_body_fills_out_from_straight_arms_to_its_rest(body):
    sewing = SewingBody(body, np.zeros((0, 3)))
    assert sewing.between(0.5, 1.0) == pytest.approx(body.vertices)
    thin, straight = sewing.thin(0.1), sewing.thin(1.0)
    waist = np.abs(body.vertices[:, 1] - 1.1) < 0.02
    waist &= np.abs(body.vertices[:, 0]) < 0.2
    assert np.ptp(thin[waist, 0]) < 0.2 * np.ptp(straight[waist, 0])
    arms = body.kept("form", None).arms
    tips = [straight[arm.tip].mean(axis=0) for arm in arms]
    # The hand lies on the line of the arm, in the frontal plane through the shoulder.
    assert all(abs(tip[2] - arm.joints[0, 2]) < 0.02 for tip, arm in zip(tips, arms, strict=True))


def test_a_dressed_garment_is_checked_and_planned_by_its_own_triangles(dressed, body, tmp_path, cache):
    file = tmp_path / "skirt.npz"
    write_worn(file, dressed, body)
    check(file=str(file), json=str(tmp_path / "found.json"))
    found = json.loads((tmp_path / "found.json").read_text())["garment"]
    assert (found["refused"], found["held_by"]) == (False, "waistband")
    with pytest.raises(InputError, match="--fix"):
        check(file=str(file), fix=tmp_path / "mended.obj")
    job = JobPlanner().job(Run((WornGarment(str(file)),), frames=10, lead_in=0))
    own, twice = footprints([job, replace(job, run=job.run.with_entries({"triangles": 2 * len(dressed.mesh.faces)}))])
    assert own < twice
