"""Bodies in the place of garments, or among them, are refused by name, in whatever unit, shape and pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.body_pieces import body_faces
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.fit import RestBody
from pb4u.garment.garment_file import read_source
from pb4u.garment.library import build_garment
from pb4u.garment.repair import push_out
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import write_obj
from pb4u.geometry.topology import Topology
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment


def shaped(name: str) -> ShapedBody:
    body = load_body(name)
    assert isinstance(body, ShapedBody)
    return body


@pytest.mark.parametrize("by", [1.0, 100.0, 39.37, 10.0])
@pytest.mark.parametrize("name", ["woman", "man"])
def test_a_body_is_one_in_any_unit_shape_and_pose(by: float, name: str) -> None:
    rest, avatar = RestBody.of(shaped("woman")), shaped(name)
    assert body_faces(by * avatar.vertices, avatar.faces, rest).all()
    arms = np.abs(avatar.vertices[:, 0]) > 0.25
    raised = avatar.vertices + np.outer(arms, [0.0, 0.3, 0.0])
    turned = by * raised[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    assert body_faces(turned, avatar.faces, rest).all()


def test_a_suit_from_head_to_foot_is_a_garment() -> None:
    body = shaped("woman")
    rest = RestBody.of(body)
    # Bare at the face and at the hands.
    bare = (body.vertices[:, 1] > 1.5) & (body.vertices[:, 2] > 0.02) | (np.abs(body.vertices[:, 0]) > 0.5)
    faces = body.faces[~bare[body.faces].any(axis=1)]
    worn = push_out(body.vertices, Topology(faces, len(body.vertices)), rest)
    assert not body_faces(worn, faces, rest).any()
    inside = worn - 0.003 * (worn - body.vertices) / np.linalg.norm(worn - body.vertices, axis=1, keepdims=True).clip(
        1e-9
    )
    shell = np.concatenate([faces, faces[:, ::-1] + len(worn)])
    assert not body_faces(np.concatenate([worn, inside]), shell, rest).any()


def test_an_avatar_among_clothes_is_refused_by_its_name(tmp_path: Path) -> None:
    body = shaped("woman")
    shirt, count = build_garment("tshirt", body, 600), len(body.vertices)
    both = PolygonMesh(np.concatenate([body.vertices, shirt.vertices]), (*body.faces, *(shirt.faces + count)))
    path = tmp_path / "both.obj"
    write_obj(path, both)
    lines = path.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("f "))
    lines[first + len(body.faces) : first + len(body.faces)] = ["o Tee"]
    lines[first:first] = ["o My Avatar"]
    path.write_text("\n".join(lines) + "\n")
    source = read_source(path)
    assert source.object_of is not None
    assert [source.objects[k] for k in source.object_of[[0, -1]]] == ["My Avatar", "Tee"]
    found = diagnose(source, body, path, "woman").findings[0]
    assert found.code == "body"
    assert found.sentence.startswith("Its object My Avatar is a body, no garment")
    with pytest.raises(InputError, match=r"^both: Its object My Avatar is a body.*export only the clothes"):
        load_garment(WornGarment(path), body)
    alone = tmp_path / "alone.obj"
    write_obj(alone, PolygonMesh(body.vertices, tuple(body.faces)))
    with pytest.raises(InputError, match=r"The garment is a body, no garment.*give it as --body"):
        load_garment(WornGarment(alone), body)
