"""Fabrics of parts of a garment, by flags, scene files and Python, from files that name the parts."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.garment.cloth_shapes import CLOTH
from tests.pattern.patterns import skirt as pattern_of_a_skirt

import pb4u as package
from pb4u.body.library import load_body
from pb4u.cli.run_flags import GarmentValue, run_of
from pb4u.garment.drafted import DRAFTED
from pb4u.garment.library import build_garment
from pb4u.garment.material import FABRICS, MATERIALS
from pb4u.geometry.obj_file import read_obj
from pb4u.measures.metrics import garments_of
from pb4u.pattern.dressing import dress
from pb4u.pattern.files import write_worn
from pb4u.run import Run, WornGarment
from pb4u.scene.loaded_garments import load_garment
from pb4u.scene.trajectory import Trajectory

SMALL = ("--frames", 1, "--lead-in", 0, "--model", "skinning")


@pytest.fixture(scope="module")
def skirt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A skirt as an OBJ whose upper faces are called waistband, and the others skirt."""
    garment = build_garment("skirt", load_body("woman"), 1200)
    heights = garment.vertices[garment.faces][:, :, 1].mean(axis=1)
    upper = heights > heights.max() - 0.08
    folder = tmp_path_factory.mktemp("skirt")
    vertices = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in garment.vertices]
    faces = [
        f"usemtl {name}\n" + "\n".join("f {} {} {}".format(*(face + 1)) for face in garment.faces[chosen])
        for name, chosen in (("cloth", ~upper), ("waistband", upper))
    ]
    (folder / "two.mtl").write_text("newmtl cloth\nKd 0.2 0.3 0.8\nnewmtl waistband\nKd 0.1 0.1 0.1\n")
    (folder / "two.obj").write_text("\n".join(["mtllib two.mtl", *vertices, *faces, ""]))
    return folder / "two.obj"


def share(trajectory: Trajectory, density: float) -> float:
    """Share of the triangles whose material has a density."""
    listed = [each for each in trajectory.metadata["materials"] if each["density"] == density]
    return sum(stop - first for each in listed for first, stop in each["faces"]) / len(trajectory.header.faces)


@pytest.mark.parametrize("triangles", [None, 900])
def test_a_waistband_of_denim_by_flags(pb4u: Callable, skirt: Path, tmp_path: Path, triangles: int | None) -> None:
    flags = ("--material", "silk", "--material", "two.waistband=denim", "--save-scene", tmp_path / "s.toml")
    size = () if triangles is None else ("--triangles", triangles)
    ended = pb4u("simulate", "--garment", skirt, *flags, *size, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    trajectory = Trajectory.open(tmp_path / "a.npz")
    denim, silk = MATERIALS["denim"].density, MATERIALS["silk"].density
    assert share(trajectory, denim) + share(trajectory, silk) == pytest.approx(1.0)
    assert 0.05 < share(trajectory, denim) < 0.4
    assert trajectory.metadata["material"]["density"] == silk
    written = Run.open(tmp_path / "s.toml")
    assert written.garments[0].material == {"body": "silk", "waistband": "denim"}
    again = pb4u("simulate", tmp_path / "s.toml", "--material", "two.cloth=wool", "--out", tmp_path / "b.npz")
    assert again.code == 0, again.err
    other = Trajectory.open(tmp_path / "b.npz")
    assert share(other, MATERIALS["wool"].density) == pytest.approx(share(trajectory, silk))
    assert share(other, denim) == share(trajectory, denim)


def test_a_file_of_a_material_is_found_from_the_scene_file(pb4u: Callable, skirt: Path, tmp_path: Path) -> None:
    (tmp_path / "felt.json").write_text('{"density": 0.33, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-4}')
    text = f'[[garments]]\ngarment = "{skirt.as_posix()}"\nmaterial = {{ body = "silk", waistband = "felt.json" }}\n'
    (tmp_path / "scene.toml").write_text(text)
    ended = pb4u("simulate", tmp_path / "scene.toml", *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    assert share(Trajectory.open(tmp_path / "a.npz"), 0.33) > 0.05


def test_parts_that_are_not_there_are_named(pb4u: Callable, skirt: Path, tmp_path: Path) -> None:
    ended = pb4u("simulate", "--garment", skirt, "--material", "two.belt=denim", *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert "'belt'" in ended.err
    assert "waistband" in ended.err
    ended = pb4u("simulate", "--garment", skirt, "--material", "one.waistband=denim", *SMALL, "--out", tmp_path / "a")
    assert ended.code == 1
    assert "'one'" in ended.err


def test_parts_of_a_garment_made_in_python(skirt: Path) -> None:
    scene = package.make_scene(skirt, material={"waistband": CLOTH}, motion="walk", frames=1, lead_in=0)
    garment = scene.garments[0].garment
    assert set(np.unique(garment.of_faces("density"))) == {CLOTH.density, MATERIALS["default"].density}
    assert list(garment.parts) == ["cloth", "waistband"]


def test_bands_by_flags_and_scene_file(pb4u: Callable, skirt: Path, tmp_path: Path) -> None:
    flags = ("--elastic", "two.waist=0.9", "--layers", "two.hem=2", "--band-width", "two.hem=0.04")
    flags += ("--material", "two.hem=denim", "--interfacing", "two.waistband=1e-4", "--save-scene", tmp_path / "s.toml")
    ended = pb4u("simulate", "--garment", skirt, *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    written = Run.open(tmp_path / "s.toml").garments[0]
    assert (written.elastic, written.layers) == ({"waist": 0.9}, {"hem": 2})
    assert (written.band_width, written.interfacing) == ({"hem": 0.04}, {"waistband": 1e-4})
    trajectory = Trajectory.open(tmp_path / "a.npz")
    (garment,) = garments_of(trajectory)
    # Elastic without a fabric is of webbing.
    webbing = garment.materials.index(FABRICS["elastic"])
    waist, hem = garment.layers[:, webbing], 0.5 * garment.layers[:, 3 - webbing]
    assert 0.0 < hem.mean() < 0.2
    np.testing.assert_allclose(garment.layers[:, 0], 1.0 - hem - waist)
    plain, denim = MATERIALS["default"].density, MATERIALS["denim"].density
    assert garment.trims is not None
    expected = plain + hem * (2.0 * denim - plain) + waist * (FABRICS["elastic"].density - plain)
    expected /= garment.trims.elastic
    np.testing.assert_allclose(garment.of_faces("density"), expected, rtol=1e-9)
    assert garment.trims.elastic.min() == pytest.approx(0.9, abs=1e-3)
    flag = GarmentValue.parse_part("two.waistband=3")
    (changed,) = run_of(Run.open(tmp_path / "s.toml"), {"layers": [flag]}).garments
    assert (changed.layers, changed.elastic) == ({"hem": 2, "waistband": 3}, {"waist": 0.9})


@pytest.mark.parametrize(
    ("flags", "code", "said"),
    [
        (("--elastic", "skirt.belt=0.8"), 1, "'belt'; there are waist, hem, border."),
        (("--elastic", "skirt.waist=0.2"), 1, "elastic of waist must be a number from 0.5 to 1.5, not 0.2."),
        (("--elastic", "skirt.waist=3"), 1, "elastic of waist must be a number from 0.5 to 1.5, not 3."),
        (("--band-width", "skirt.hem=0.9"), 1, "its hem of 0.9 m is wider than its panel"),
        (("--layers", "skirt.hem=3", "--layers", "skirt.border=2"), 1, "hem and border share"),
        (("--elastic", "0.8"), 2, "it takes a number for a part, NAME.PART=N"),
        (("--layers", "skirt.hem=two"), 2, "it takes a number for a part, NAME.PART=N"),
        (("--layers", "shirt.hem=2"), 1, "'shirt'"),
    ],
)
def test_bands_that_are_not_there_are_refused(
    pb4u: Callable, tmp_path: Path, flags: tuple[str, ...], code: int, said: str
) -> None:
    ended = pb4u("simulate", "--garment", "skirt", "--triangles", 900, *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == code
    assert said in " ".join(ended.err.split())


@pytest.mark.parametrize("triangles", [None, 900])
def test_parts_without_colours_are_parts(skirt: Path, tmp_path: Path, triangles: int | None) -> None:
    bare = tmp_path / "bare.obj"
    bare.write_text("".join(line for line in skirt.read_text().splitlines(True) if not line.startswith("mtllib")))
    asked = {"material": {"waistband": CLOTH}, "triangles": triangles, "pins": "none"}
    own, other = (
        load_garment(WornGarment(file, **asked), None).of_faces("density")  # type: ignore[arg-type]
        for file in (bare, skirt)
    )
    assert np.array_equal(own, other)
    assert len(np.unique(own)) == 2


def test_primitives_of_gltf_are_parts_by_material_or_mesh(skirt: Path, tmp_path: Path) -> None:
    mesh = read_obj(skirt)
    upper = mesh.vertices[np.stack(mesh.polygons)][:, :, 1].mean(axis=1) > mesh.vertices[:, 1].max() - 0.08
    scene = trimesh.Scene()
    for name, chosen in (("sash", upper), ("cloth", ~upper)):
        shape = trimesh.Trimesh(mesh.vertices, np.stack(mesh.polygons)[chosen], process=False)
        scene.add_geometry(shape, geom_name=name, node_name=name)
    document = json.loads(scene.export(file_type="gltf")["model.gltf"])
    document["materials"] = [{"name": "ribbon"}]
    document["meshes"][0]["primitives"][0]["material"] = 0
    for name, content in (scene.export(file_type="gltf")).items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "two.gltf").write_text(json.dumps(document))
    garment = load_garment(WornGarment(tmp_path / "two.gltf", pins="none"), None)
    assert set(garment.parts) == {"ribbon", "cloth"}
    assert np.array_equal(garment.parts["ribbon"], ~garment.parts["cloth"])


def test_check_tells_parts_that_simulate_takes(pb4u: Callable, skirt: Path, tmp_path: Path) -> None:
    ended = pb4u("check", skirt, "--json", tmp_path / "found.json")
    assert ended.code == 0, ended.err
    assert "cloth, waistband, waist, hem, border" in ended.out
    told = json.loads((tmp_path / "found.json").read_text())["garment"]["parts"]
    assert told == dict.fromkeys(["cloth", "waistband", "waist", "hem", "border"])
    flags = ("--material", "two.waistband=denim", "--material", "two.hem=wool")
    ended = pb4u("simulate", "--garment", skirt, *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    ended = pb4u("check", "tshirt", "--triangles", 2500, "--json", "-")
    assert json.loads(ended.out)["garment"]["parts"] == {"collar": "rib", "hem": None, "cuff": None, "border": None}


def test_info_tells_fabrics_of_a_trajectory(pb4u: Callable, skirt: Path, tmp_path: Path) -> None:
    (tmp_path / "felt.json").write_text('{"density": 0.33, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-4}')
    flags = ("--material", "silk", "--material", "two.waistband=denim")
    flags += (
        "--material",
        f"two.hem={tmp_path / 'felt.json'}",
        "--material",
        "cardigan=wool",
        "--buttons",
        "cardigan=4",
    )
    garments = ("--garment", skirt, "--garment", "cardigan", "--triangles", "cardigan=900")
    ended = pb4u("simulate", *garments, *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    ended = pb4u("info", "--trajectory", tmp_path / "a.npz", "--json", tmp_path / "told.json")
    assert ended.code == 0, ended.err
    assert "4 buttons" in ended.out
    two, cardigan = json.loads((tmp_path / "told.json").read_text())["garments"]
    assert (two["buttons"], cardigan["buttons"], cardigan["fabrics"]) == (0, 4, {"wool": 1.0})
    assert list(two["fabrics"]) == ["silk", "denim", "another of 0.33 kg/m2"]
    assert sum(two["fabrics"].values()) == pytest.approx(1.0, abs=1e-3)
    assert two["parts"] == {
        "waistband": {"material": "denim"}, "hem": {"material": "another of 0.33 kg/m2", "width": 0.02},
    }  # fmt: skip
    assert "waistband (denim)" in ended.out
    assert cardigan["parts"] == {}
    (tmp_path / "no.npz").write_text("no")
    assert pb4u("info", "--trajectory", tmp_path / "no.npz").code == 1


def test_info_tells_what_is_sewn_to_built_in_garments(pb4u: Callable, tmp_path: Path) -> None:
    flags = ("--triangles", 900, "--elastic", "skirt.waist=0.8", "--interfacing", "skirt.hem=1e-4")
    ended = pb4u("simulate", "--garment", "skirt", *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    (told,) = json.loads(pb4u("info", "--trajectory", tmp_path / "a.npz", "--json", "-").out)["garments"]
    assert told["parts"] == {
        "waist": {"material": "elastic", "elastic": 0.8, "width": 0.035},
        "hem": {"layers": 2, "interfacing": 1e-4, "width": 0.02},
    }


def test_what_is_sewn_on_drafted_parts_stays_under_another_fabric(pb4u: Callable, tmp_path: Path) -> None:
    flags = ("--triangles", 1200, "--material", "jeans.band=linen")
    ended = pb4u("simulate", "--garment", "jeans", *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    (told,) = json.loads(pb4u("info", "--trajectory", tmp_path / "a.npz", "--json", "-").out)["garments"]
    assert told["parts"] == {"band": {"material": "linen", "layers": 2, "interfacing": DRAFTED["jeans"].parts["band"]}}


def test_a_panel_of_a_pattern_has_a_fabric_of_its_own(pb4u: Callable, tmp_path: Path) -> None:
    body = load_body("woman")
    write_worn(tmp_path / "sewn.npz", dress(pattern_of_a_skirt(), body, 300), body)
    flags = ("--material", "sewn=silk", "--material", "sewn.front left=denim")
    ended = pb4u("simulate", "--garment", tmp_path / "sewn.npz", *flags, *SMALL, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    ended = pb4u("info", "--trajectory", tmp_path / "a.npz", "--json", "-")
    (told,) = json.loads(ended.out)["garments"]
    assert told["panels"] == ["front left", "back left", "front right", "back right"]
    areas = {panel.name: abs(panel.area) for panel in pattern_of_a_skirt().panels}
    share = areas["front left"] / sum(areas.values())
    assert told["fabrics"] == pytest.approx({"silk": 1.0 - share, "denim": share}, abs=1e-3)
    ended = pb4u("check", tmp_path / "sewn.npz", "--json", "-")
    assert {*areas, "hem"} <= {*json.loads(ended.out)["garment"]["parts"]}
