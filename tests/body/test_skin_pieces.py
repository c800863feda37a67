"""What of a character's meshes is its skin, whatever else artists left in the file and whatever it is called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from tests.body.characters import GltfWriter, write_woman

from pb4u.body.body_model import ShapedBody
from pb4u.body.character import Character
from pb4u.body.contact_region import share_out_of_contact
from pb4u.body.library import load_body
from pb4u.errors import InputWarning
from pb4u.geometry.triangle_mesh import vertex_normals


def woman() -> ShapedBody:
    body = load_body("woman")
    assert isinstance(body, ShapedBody)
    return body


def shell(low: float, high: float, wide: float, over: float, two: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Cloth over a part of the skin, of one layer or of two; vertices as many as the body has for one."""
    body = woman()
    normals = vertex_normals(torch.from_numpy(body.vertices), torch.from_numpy(body.faces)).numpy()
    height, out = body.vertices[:, 1], np.abs(body.vertices[:, 0])
    kept = (height > low) & (height < high) & (out < wide)
    faces = body.faces[kept[body.faces].all(axis=1)]
    cloth = body.vertices + over * normals
    if not two:
        return cloth, faces
    return np.concatenate([cloth, cloth - 0.004 * normals]), np.concatenate([faces, faces[:, ::-1] + len(cloth)])


def skirt() -> tuple[np.ndarray, np.ndarray]:
    around, rows = 48, 24
    angle, level = np.meshgrid(np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(0.1, 1.05, rows))
    wide = 0.17 + 0.25 * (1.05 - level)
    places = np.stack([wide * np.cos(angle), level, wide * np.sin(angle)], axis=-1).reshape(-1, 3)
    row, column = np.divmod(np.arange(around * (rows - 1)), around)
    a, b = row * around + column, row * around + (column + 1) % around
    return places, np.concatenate([np.column_stack([a, b, a + around]), np.column_stack([b, b + around, a + around])])


def sphere(x: float, y: float, z: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(3, radius)
    return np.asarray(ball.vertices) + [x, y, z], np.asarray(ball.faces)


def cubes() -> tuple[np.ndarray, np.ndarray]:
    box, joints = trimesh.creation.box((0.012,) * 3), woman().skeleton.joints
    places = np.concatenate([np.asarray(box.vertices) + joint for joint in joints])
    return places, np.concatenate([np.asarray(box.faces) + 8 * k for k in range(len(joints))])


STRANGE = {
    "a sweater called Body": lambda: ("SweaterBody", "SweaterBody", *shell(0.9, 1.42, 0.5, 0.015), None),
    "a sweater of two layers": lambda: ("Top", "FaceOff", *shell(0.9, 1.42, 0.5, 0.02, two=True), "spine01"),
    "tights": lambda: ("Helper", "Skin", *shell(0.05, 1.3, 0.22, 0.006), None),
    "a skirt": lambda: ("Helper", "Skin", *skirt(), "root"),
    "joint cubes": lambda: ("Joints", "Skin", *cubes(), "root"),
    "a sphere at the feet": lambda: ("Prop", "Body", *sphere(0.5, 0.15, 0.2, 0.15), "root"),
    "a hull": lambda: ("Outline", "BodyLine", *shell(-1.0, 3.0, 2.0, 0.004), None),
}


@pytest.mark.parametrize("case", STRANGE)
def test_what_is_no_skin_is_left_out_and_named(tmp_path: Path, case: str) -> None:
    plain = load_body(write_woman(tmp_path / "plain.glb", clips=()))
    extra = STRANGE[case]()
    body = load_body(write_woman(tmp_path / "a.glb", clips=(), extra=[extra]))
    assert isinstance(body, Character)
    assert isinstance(plain, Character)
    assert len(body.vertices) == len(plain.vertices)
    np.testing.assert_allclose(np.sort(body.vertices, axis=0), np.sort(plain.vertices, axis=0), atol=1e-6)
    # Rays that look for folds are drawn anew each time.
    assert body.contact.sum() == pytest.approx(plain.contact.sum(), rel=0.02)
    first = body.notes[0]
    assert first.startswith("a.glb: the body is Skin; left out of the body: ")
    name = extra[0] if extra[1] == "Skin" else extra[1]
    assert name in first
    out = share_out_of_contact(body.vertices, body.faces, body.contact)
    assert 0.02 < out < 0.1
    assert any(f"{100 * out:.0f} % of its skin" in note for note in body.notes)


def test_skin_under_what_was_asked_for_is_told(tmp_path: Path) -> None:
    path = write_woman(tmp_path / "a.glb", clips=(), extra=[("Helper", "Cover", *shell(0.05, 1.3, 0.3, 0.006), None)])
    with pytest.warns(InputWarning, match=r"a.glb: \d\d % of its skin, hands not counted"):
        load_body(path, parts=("Skin", "Cover"))


def test_a_body_in_parts_is_whole(tmp_path: Path) -> None:
    # The head is a mesh of its own, drawn back from the neck by more than seams are.
    def draw_up(writer: GltfWriter) -> None:
        head = next(mesh for mesh in writer.document["meshes"] if mesh["name"] == "Body2")
        writer.document["accessors"][head["primitives"][0]["attributes"]["POSITION"]]["byteOffset"] = 0
        view = writer.document["bufferViews"][
            writer.document["accessors"][head["primitives"][0]["attributes"]["POSITION"]]["bufferView"]
        ]
        start, size = view["byteOffset"], view["byteLength"]
        places = np.frombuffer(bytes(writer.content[start : start + size]), dtype="<f4").reshape(-1, 3).copy()
        places[:, 1] += 0.03
        writer.content[start : start + size] = places.tobytes()

    body = woman()
    whole = load_body(write_woman(tmp_path / "a.glb", clips=(), split=3, change=draw_up))
    assert isinstance(whole, Character)
    assert whole.vertices[:, 1].max() == pytest.approx(body.vertices[:, 1].max() + 0.03, abs=0.01)
