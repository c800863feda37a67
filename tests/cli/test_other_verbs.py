"""`check`, `convert`, `assets` and `info`."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.body.characters import write_doll
from tests.garment.cloth_shapes import saved, triangle_tube

import pb4u as package
from pb4u.body import character_file
from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.sequence_files import write_vertex_sequence
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import read_obj, write_obj
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import default_model
from pb4u.simulation.simulator import SkinningSimulator

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture(scope="module")
def simulated() -> Trajectory:
    return SkinningSimulator().simulate(make_scene(triangles=1000, lead_in=0, frames=6))


@pytest.fixture
def walk(simulated: Trajectory, tmp_path: Path) -> Path:
    return simulated.save(tmp_path / "walk.npz")


def test_convert_selects_frames(pb4u: Callable, walk: Path, tmp_path: Path) -> None:
    ended = pb4u("convert", walk, tmp_path / "b.npz", "--range", "1:6", "--every", 2, "--json", "-")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["frames"] == 3
    before, after = Trajectory.open(walk), Trajectory.open(tmp_path / "b.npz")
    np.testing.assert_array_equal(after.positions, before.positions[1:6:2])
    assert after.fps == 15.0


@pytest.mark.parametrize(
    ("out", "frames", "says"),
    [
        ("b.obj", "0:6", "b_0000.obj to b_0005.obj"),
        ("b.obj", "0:2", "b_0000.obj, b_0001.obj"),
        ("b.pc2", "0:6", "b.pc2, b.obj"),
        ("b.mdd", "0:6", "b.mdd, b.obj"),
        ("b.glb", "0:6", "b.glb"),
    ],
)
def test_convert_tells_the_files_that_it_wrote(
    pb4u: Callable, walk: Path, monkeypatch: pytest.MonkeyPatch, out: str, frames: str, says: str
) -> None:
    monkeypatch.chdir(walk.parent)
    assert pb4u("convert", "walk.npz", out, "--range", frames).out == f"Wrote {says}\n"


def test_convert_warns_of_a_range_beyond_the_end(pb4u: Callable, walk: Path, tmp_path: Path) -> None:
    ended = pb4u("convert", walk, tmp_path / "b.npz", "--range", "4:100")
    assert ended.code == 0
    assert ended.err == "pb4u: warning: The trajectory has 6 frames; of the range 4:100, only 4:6 exists.\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("walk.npz", "b.fbx"), "for Blender, Maya, Unreal or Houdini write .usdc, .abc or .glb"),
        (("walk.npz", "b.xyz"), "give the file one of the suffixes"),
        (("absent.npz", "b.obj"), "no trajectory file"),
        (("walk.npz", "absent/b.obj"), "does not exist"),
        (("walk.npz", "b.obj", "--range", "9:12"), "frames 0 to 5"),
        (("walk.npz", "b.obj", "--every", "-1"), "must be 1 or more, not -1"),
        (("walk.npz", "b.obj", "--every", "999999"), "Every 999999th of 6 frames is a single frame"),
        (("walk.npz", "b.obj", "--json", "absent/r.json"), "absent for --json does not exist"),
    ],
)
def test_convert_refuses(
    pb4u: Callable, walk: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
) -> None:
    monkeypatch.chdir(walk.parent)
    ended = pb4u("convert", *arguments)
    assert ended.code == 1
    assert says in ended.err
    assert sorted(p.name for p in walk.parent.iterdir()) == ["walk.npz"]


def test_a_range_that_is_none_ends_with_2(pb4u: Callable, walk: Path) -> None:
    assert pb4u("convert", walk, walk.with_suffix(".obj"), "--range", "3").code == 2


def test_a_damaged_trajectory_is_refused_in_one_sentence(pb4u: Callable, walk: Path, tmp_path: Path) -> None:
    with np.load(walk) as archive:
        np.savez(tmp_path / "damaged.npz", **{**archive, "faces": archive["faces"] + 1})
    ended = pb4u("convert", tmp_path / "damaged.npz", tmp_path / "b.obj")
    assert ended.code == 1
    assert "faces has indices beyond its" in ended.err
    assert len(ended.err.strip().splitlines()) == 1


def test_assets_lists_every_name_of_the_contract(pb4u: Callable) -> None:
    found = json.loads(pb4u("assets", "--json", "-").out)
    names = {kind: [row["name"] for row in rows] for kind, rows in found.items()}
    assert set(names["garments"]) == {
        "tshirt", "tanktop", "longsleeve", "dress", "fitted_dress", "cardigan", "trousers", "skirt", "shirt",
        "jeans", "circle_dress",
    }  # fmt: skip
    assert set(names["motions"]) == {"walk", "run", "jump", "arms", "twist", "squat", "turn", "dance"}
    assert {"woman", "man"} <= set(names["bodies"])
    assert "height 0 to 1: 1.22 to 2.31 m; weight 0 to 1: thin to fat" in found["bodies"][0]["description"]
    assert {"default", "cotton", "silk", "denim", "wool", "leather"} <= set(names["materials"])
    assert names["models"][:4] == [default_model(), "quick-solver", "solver", "skinning"]
    assert all(name.startswith("comparison-") for name in names["models"][-7:]), "what most users want comes first"
    assert all(row["description"] for rows in found.values() for row in rows)


def test_written_assets_can_be_used_as_input(pb4u: Callable, tmp_path: Path) -> None:
    assert pb4u("assets", "write", "tshirt", tmp_path / "t.obj", "--triangles", 1000).code == 0
    assert pb4u("assets", "write", "walk", tmp_path / "w.npz", "--frames", 4).code == 0
    assert pb4u("assets", "write", "silk", tmp_path / "m.json").code == 0
    np.testing.assert_array_equal(load_body(tmp_path / "w.npz").contact, load_body("woman").contact)
    ended = pb4u(
        "simulate", "--garment", tmp_path / "t.obj", "--motion", "walk", "--material", tmp_path / "m.json",
        "--model", "skinning", "--frames", 2, "--out", tmp_path / "a.npz",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    assert Trajectory.open(tmp_path / "a.npz").metadata["material"]["density"] == pytest.approx(0.06)
    wrong = pb4u("assets", "write", "tshirt", tmp_path / "t.fbx")
    assert wrong.code == 1
    assert ".obj" in wrong.err


def test_a_body_of_ones_own_is_written_as_garments_are_fitted_to_it(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(character_file, "reachable", lambda v, f, candidates, rays: candidates)
    doll = write_doll(tmp_path / "doll.glb")
    ended = pb4u("assets", "write", doll, tmp_path / "rest.obj")
    assert (ended.code, ended.out) == (0, f"Wrote {tmp_path / 'rest.obj'}\n")
    body = load_body(doll)
    assert isinstance(body, ShapedBody)
    np.testing.assert_allclose(read_obj(tmp_path / "rest.obj").vertices, body.vertices, atol=1e-6)


def test_assets_write_tells_what_it_wrote(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("assets", "write", "skirt", tmp_path / "s.obj", "--triangles", 1000, "--json", "-")
    told = json.loads(ended.out)
    assert {"name": "skirt", "kind": "garment", "body": "woman", "out": str(tmp_path / "s.obj")}.items() <= told.items()
    assert told["triangles"] == len(read_obj(tmp_path / "s.obj").polygons)
    refused = pb4u("assets", "write", "man", tmp_path / "man.obj", "--json", tmp_path / "absent" / "r.json")
    assert refused.code == 1
    assert not (tmp_path / "man.obj").exists()


def test_what_stays_after_a_mend_is_said_and_ends_with_1(pb4u: Callable, tmp_path: Path) -> None:
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    extra = (np.array([500, 501, 0]), mesh.polygons[7])
    file = saved(tmp_path, PolygonMesh(mesh.vertices, (*mesh.polygons, *extra)))
    ended = pb4u("check", file, "--fix", tmp_path / "m.obj", "--json", tmp_path / "r.json")
    assert ended.code == 1
    assert "m.obj was not written: it would still be refused" in ended.err
    assert "stays: 1 edge(s) are shared by three or more faces" in ended.out
    assert "tried: Dropped 1 face(s)" in ended.out
    assert "repaired:" not in ended.out
    garment = json.loads((tmp_path / "r.json").read_text())["garment"]
    assert "Dropped 1 face(s)" in garment["mended"][0]
    assert {f["code"] for f in garment["findings"]} >= {"non-manifold", "duplicate"}
    assert [f["code"] for f in garment["remaining"]["findings"] if f["severity"] == "refused"] == ["non-manifold"]
    assert "duplicate" not in {f["code"] for f in garment["remaining"]["findings"]}
    assert not (tmp_path / "m.obj").exists()


@pytest.mark.slow
def test_what_a_mended_file_is_without_is_said(pb4u: Callable, tmp_path: Path) -> None:
    file = saved(tmp_path, triangle_tube(low=0.6, high=1.0, radius=0.22))
    plain = pb4u("check", file, "--fix", tmp_path / "m.obj", "--json", "-")
    assert json.loads(plain.out)["garment"]["left"] == []
    named = "o Skirt\ng front\nusemtl silk\n" + file.read_text().replace("\n", " 1 0 0\n", 1)
    file.write_text(named)
    ended = pb4u("check", file, "--fix", tmp_path / "m.obj", "--json", "-")
    assert json.loads(ended.out)["garment"]["left"] == [
        "Its groups, object names, vertex colours, materials without an MTL are not in the repaired file."
    ]


@pytest.mark.parametrize("flags", [(), ("--fix", "m.obj")], ids=["looked at", "mended"])
def test_a_garment_without_area_is_refused(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("point.obj").write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\nf 1 1 1\n")
    ended = pb4u("check", "point.obj", *flags)
    assert ended.code == 1
    assert "None of its 2 faces has an area" in ended.out
    assert "would" in ended.err
    assert "be refused" in ended.err
    assert [p.name for p in tmp_path.iterdir()] == ["point.obj"]


def test_a_mend_that_leaves_nothing_ends_with_0(pb4u: Callable, tmp_path: Path) -> None:
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    file = saved(tmp_path, PolygonMesh(100.0 * mesh.vertices, mesh.polygons))
    ended = pb4u("check", file, "--body", "man", "--fix", tmp_path / "m.obj")
    assert ended.code == 0, ended.err
    lines = ended.out.splitlines()
    assert lines[0].startswith("repaired: Scaled by 0.01")
    assert lines[-1] == f"written: {tmp_path / 'm.obj'}"
    assert {line.partition(":")[0] for line in lines} <= {"repaired", "not repaired", "stays", "written"}


def test_the_command_that_mends_is_said_once(pb4u: Callable, tmp_path: Path) -> None:
    mesh = triangle_tube(low=0.6, high=1.0, radius=0.22)
    turned = 100.0 * mesh.vertices @ [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    file = saved(tmp_path, PolygonMesh(turned, mesh.polygons))
    ended = pb4u("check", file, "--body", "man", "--json", tmp_path / "r.json")
    assert "refused: The garment is in centimetres" in ended.out
    assert "Fix: scale it by 0.01." in ended.out
    command = f"`pb4u check {file} --body man --fix OUT.obj`"
    assert ended.out.count(command) == 1
    assert ended.out.splitlines()[-1].endswith(f"safely: {command}.")
    found = json.loads((tmp_path / "r.json").read_text())["garment"]["findings"]
    assert sum(command in each["fix"] for each in found) > 1, "a report for programs keeps it with each"


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--crop", "0:9"), "of --motion; give that as well"),
        (("--fix", "m.ply"), "writes an .obj"),
        (("--fix", "absent/m.obj"), "does not exist"),
        (("--fix", "taken.obj"), "is a folder"),
        (("--json", "absent/r.json"), "does not exist"),
        (("--json", "taken.obj"), "is a folder"),
    ],
)
def test_check_looks_at_its_targets_before_any_work(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: tuple[str, str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.obj").mkdir()
    monkeypatch.setattr("pb4u.garment.garment_file.read_source", lambda *_: pytest.fail("the garment was read"))
    ended = pb4u("check", "shirt.obj", *flags)
    assert ended.code == 1
    assert says in ended.err


@pytest.mark.parametrize("out", ["shirt.obj", "./shirt.obj", "linked.obj"])
def test_the_author_s_file_is_not_mended_over(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("shirt.obj").write_text(CUBE)
    Path("linked.obj").symlink_to("shirt.obj")
    monkeypatch.setattr("pb4u.garment.garment_file.read_source", lambda *_: pytest.fail("the garment was read"))
    ended = pb4u("check", "shirt.obj", "--fix", out)
    assert ended.code == 1
    assert ended.err == f"pb4u: --fix {Path(out)} would overwrite shirt.obj, which is read; give another name.\n"
    assert Path("shirt.obj").read_text() == CUBE


def test_check_says_that_it_leaves_the_triangles_of_a_file(pb4u: Callable, tmp_path: Path) -> None:
    file = saved(tmp_path, triangle_tube(low=0.6, high=1.0, radius=0.22))
    assert "warning: --triangles is for a built-in garment" in pb4u("check", file, "--triangles", 500).err
    assert "--triangles" not in pb4u("check", "tshirt", "--triangles", 500).err


def test_check_refuses_a_built_in_garment_on_a_body_without_bones(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("check", "skirt", "--body", saved(tmp_path, triangle_tube()))
    assert ended.code == 1
    assert "are cut from a body with bones; tube is a sequence of vertices" in ended.err


def test_check_says_once_that_a_body_is_open(pb4u: Callable, tmp_path: Path) -> None:
    cap = trimesh.creation.capsule(1.0, 0.2)
    vertices = cap.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [0.0, 0.2, 0.0]
    write_vertex_sequence(tmp_path / "open.npz", vertices[None], cap.faces[:-9], 30.0)
    file = saved(tmp_path, triangle_tube(low=0.6, high=1.0, radius=0.22))
    ended = pb4u("check", file, "--body", tmp_path / "open.npz")
    assert (ended.out + ended.err).count("penetration is not reported") == 1


def test_a_built_in_garment_is_not_mended(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("check", "tshirt", "--fix", tmp_path / "m.obj")
    assert ended.code == 1
    assert "repairs only a garment from a mesh file" in ended.err


def test_check_names_faults_and_ends_with_1(pb4u: Callable, tmp_path: Path) -> None:
    file = tmp_path / "cube.obj"
    file.write_text(CUBE)
    ended = pb4u("check", file, "--json", tmp_path / "r.json")
    assert ended.code == 1
    assert json.loads((tmp_path / "r.json").read_text())["garment"]["refused"] is True
    assert "Fix:" in ended.out


def test_check_of_a_built_in_garment_finds_nothing_refusable(pb4u: Callable) -> None:
    assert pb4u("check", "tshirt", "--motion", "walk").code == 0
    assert pb4u("check").code == 1


@pytest.mark.slow
def test_check_of_an_outfit_says_what_crosses_as_made_and_as_worn(pb4u: Callable, tmp_path: Path) -> None:
    outfit = ("--garment", "tanktop", "--garment", "cardigan", "--triangles", 600)
    ended = pb4u("check", *outfit, "--json", tmp_path / "r.json")
    assert ended.code == 0, ended.err
    report = json.loads((tmp_path / "r.json").read_text())
    assert [each["name"] for each in report["garments"]] == ["tanktop", "cardigan"]
    (tangle,) = report["crossings"]["as_made"]
    assert tangle["garments"] == ["tanktop", "cardigan"]
    assert tangle["pairs"] > 50
    assert 0.8 < tangle["place"][1] < 1.6
    assert report["crossings"]["as_worn"] == []
    assert "the garments cross nowhere" in ended.out

    ended = pb4u("check", "--garment", "dress", "--garment", "trousers", "--triangles", 500, "--json", "-")
    assert ended.code == 1
    assert json.loads(ended.out)["crossings"]["as_worn"][0]["garments"] == ["dress", "trousers"]
    assert "dress with trousers would be refused" in ended.err


def test_info_lists_extras(pb4u: Callable) -> None:
    found = json.loads(pb4u("info", "--json", "-").out)
    assert {"pb4u", "device", "threads", "extras"} <= set(found)
    assert isinstance(found["extras"]["ray"], bool)
    assert isinstance(found["extras"]["ffmpeg"], bool)
    assert "ffmpeg (H.264 videos; its program is under the GPL" in " ".join(pb4u("info").out.split())
    assert "smpl" not in found["extras"]  # its files need none


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("export", "a.npz"), "did you mean 'convert'?"),
        (("dataset", "a.toml"), "did you mean 'batch'?"),
        (("studio",), "did you mean 'view'?"),
        (("sim",), "did you mean 'simulate'?"),
        (("chekc",), "did you mean 'check'?"),
        (("assets", "wirte"), "did you mean 'write'?"),
        (("simulate", "--garments", "tshirt"), "--garment)"),
        (("xyzzy",), "No such command"),
    ],
)
def test_an_unknown_verb_or_option_names_the_nearest_one(
    pb4u: Callable, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    ended = pb4u(*arguments)
    assert ended.code == 2
    assert says in ended.err


def test_the_version_is_told_before_anything_else(pb4u: Callable) -> None:
    ended = pb4u("--version")
    assert (ended.code, ended.out) == (0, f"pb4u {package.__version__}\n")


def test_check_reads_a_garment_of_a_dictionary_and_names_the_body_file(pb4u: Callable, tmp_path: Path) -> None:
    woman = load_body("woman")
    shirt = build_garment("tshirt", woman, 2500)
    fields = {"rest_pos": shirt.vertices - [0.0, woman.lift, 0.0], "faces": shirt.faces}
    (tmp_path / "all.pkl").write_bytes(pickle.dumps({"shirt": fields}))
    ended = pb4u("check", f"{tmp_path}/all.pkl:shirt")
    assert ended.code == 0, ended.err
    body = tmp_path / "my body.npz"
    write_vertex_sequence(body, woman.vertices[None], woman.faces, 30.0)
    far = tmp_path / "far.obj"
    write_obj(far, PolygonMesh(100.0 * shirt.vertices, tuple(shirt.faces)))
    ended = pb4u("check", far, "--body", body)
    assert f"--body '{body}'" in ended.out
    assert "--body BODY" not in ended.out


def test_swatches_are_drawn_as_pictures_alone(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("assets", "swatches", tmp_path / "sheet.txt")
    assert ended.code == 1
    assert "Swatches are drawn as .png or .jpg or .jpeg" in ended.err


@pytest.mark.slow
def test_a_swatch_of_a_fabric_stands_beside_what_is_published(pb4u: Callable, tmp_path: Path) -> None:
    from PIL import Image

    sheet = tmp_path / "sheet.png"
    ended = pb4u("assets", "swatches", sheet, "--material", "cotton-jersey", "--edge", "30", "--json", "-")
    assert ended.code == 0
    (row,) = json.loads(ended.out)["swatches"]
    assert (row["material"], row["published"]["highest"]) == ("cotton-jersey", 40)
    assert 0.0 < row["drape_coefficient"] < 60.0
    assert np.asarray(Image.open(sheet).convert("L"), dtype=float)[60:300].std() > 10.0


def test_a_report_has_all_that_was_said_and_the_share_of_skin_out_of_contact(pb4u: Callable, tmp_path: Path) -> None:
    box = trimesh.creation.box((50.0, 170.0, 30.0))
    write_obj(tmp_path / "scan.obj", PolygonMesh(np.asarray(box.vertices), tuple(np.asarray(box.faces))))
    file = saved(tmp_path, triangle_tube(low=-0.2, high=0.2, radius=0.3))
    ended = pb4u("check", file, "--body", tmp_path / "scan.obj", "--json", tmp_path / "r.json")
    report = json.loads((tmp_path / "r.json").read_text())
    (note,) = report["notes"]
    assert "it measures 170, so it is read in centimetres" in note
    assert note in ended.err
    assert report["body"] == {"name": "scan", "out_of_contact_percent": 0.0}
    ended = pb4u("check", file, "--body", tmp_path / "scan.obj", "--body-units", "metres")
    assert ended.code == 1
    assert "measures 170 metres, which is not the size of a person" in ended.err
