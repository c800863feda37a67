"""Fabrics of parts of a garment, by flags, scene files and Python, from files that name the parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.garment.cloth_shapes import CLOTH

import pb4u as package
from pb4u.body.library import load_body
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS
from pb4u.run import Run
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
