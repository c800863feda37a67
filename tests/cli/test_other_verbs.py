"""`check`, `convert`, `assets` and `info`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pb4u.scene.trajectory import Trajectory

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def walk(pb4u: Callable, tmp_path: Path) -> Path:
    path = tmp_path / "walk.npz"
    ended = pb4u("simulate", "--model", "skinning", "--triangles", 1000, "--lead-in", 0, "--frames", 6, "--out", path)
    assert ended.code == 0, ended.err
    return path


def test_convert_selects_frames(pb4u: Callable, walk: Path, tmp_path: Path) -> None:
    ended = pb4u("convert", walk, tmp_path / "b.npz", "--range", "1:6", "--every", 2, "--json", "-")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["frames"] == 3
    before, after = Trajectory.open(walk), Trajectory.open(tmp_path / "b.npz")
    np.testing.assert_array_equal(after.positions, before.positions[1:6:2])
    assert after.fps == 15.0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("walk.npz", "b.xyz"), "end it in one of"),
        (("absent.npz", "b.obj"), "no trajectory file"),
        (("walk.npz", "absent/b.obj"), "does not exist"),
        (("walk.npz", "b.obj", "--range", "9:12"), "frames 0 to 5"),
        (("walk.npz", "b.obj", "--range", "3"), "A:B"),
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


def test_assets_lists_every_name_of_the_contract(pb4u: Callable) -> None:
    found = json.loads(pb4u("assets", "--json", "-").out)
    names = {kind: [row["name"] for row in rows] for kind, rows in found.items()}
    assert set(names["garments"]) == {
        "tshirt", "tanktop", "longsleeve", "dress", "fitted_dress", "cardigan", "trousers", "skirt",
    }  # fmt: skip
    assert set(names["motions"]) == {"walk", "run", "jump", "arms", "twist", "squat", "turn", "dance"}
    assert {"woman", "man"} <= set(names["bodies"])
    assert {"default", "cotton", "silk", "denim", "wool", "leather"} <= set(names["materials"])
    assert {"solver", "skinning", "newton"} <= set(names["models"])


def test_written_assets_can_be_used_as_input(pb4u: Callable, tmp_path: Path) -> None:
    assert pb4u("assets", "write", "tshirt", tmp_path / "t.obj", "--triangles", 1000).code == 0
    assert pb4u("assets", "write", "walk", tmp_path / "w.npz", "--frames", 4).code == 0
    assert pb4u("assets", "write", "silk", tmp_path / "m.json").code == 0
    ended = pb4u(
        "simulate", "--garment", tmp_path / "t.obj", "--motion", "walk", "--material", tmp_path / "m.json",
        "--model", "skinning", "--frames", 2, "--out", tmp_path / "a.npz",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    assert Trajectory.open(tmp_path / "a.npz").metadata["material"]["density"] == pytest.approx(0.06)
    wrong = pb4u("assets", "write", "tshirt", tmp_path / "t.fbx")
    assert wrong.code == 1
    assert ".obj" in wrong.err


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


def test_info_lists_extras(pb4u: Callable) -> None:
    found = json.loads(pb4u("info", "--json", "-").out)
    assert {"pb4u", "device", "threads", "extras"} <= set(found)
    assert isinstance(found["extras"]["newton"], bool)
