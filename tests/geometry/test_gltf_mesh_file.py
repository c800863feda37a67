"""glTF garments are read as their authors made them, however their numbers are packed."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pb4u.errors import InputError, InputNote
from pb4u.geometry.gltf_mesh_file import read_gltf_mesh
from pb4u.geometry.mesh_file import PolygonMesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
UVS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype="<f4")
FACES = np.array([0, 1, 2, 0, 2, 3], dtype="<u2")
KINDS = {"<f4": 5126, "<i2": 5122, "<u2": 5123}


def png(colour: tuple[int, int, int] = (9, 8, 7)) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (2, 2), colour).save(stream, "PNG")
    return stream.getvalue()


def written(
    folder: Path,
    positions: np.ndarray = CORNERS,
    uvs: np.ndarray | None = None,
    faces: np.ndarray = FACES,
    primitive: dict[str, Any] | None = None,
    buffer: str = "",
    **document: Any,
) -> Path:
    """A glTF of one primitive; whole numbers are normalised."""
    content, views, accessors = b"", [], []
    for values, kind in ((positions, "VEC3"), (faces, "SCALAR"), *([] if uvs is None else [(uvs, "VEC2")])):
        views.append({"buffer": 0, "byteOffset": len(content), "byteLength": values.nbytes})
        entry = {"bufferView": len(accessors), "componentType": KINDS[values.dtype.str], "type": kind}
        accessors.append({**entry, "count": len(values), "normalized": kind != "SCALAR" and values.dtype.kind != "f"})
        content += values.tobytes() + b"\0" * (-values.nbytes % 4)
    if buffer:
        (folder / buffer.replace("%20", " ")).write_bytes(content)
    uri = buffer or "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    attributes = {"POSITION": 0} if uvs is None else {"POSITION": 0, "TEXCOORD_0": 2}
    primitives = [{"attributes": attributes, "indices": 1, **(primitive or {})}]
    sound = {
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(content), "uri": uri}],
    }  # fmt: skip
    path = folder / "cloth.gltf"
    path.write_text(json.dumps(sound | document))
    return path


def polygons(mesh: PolygonMesh) -> list[list[int]]:
    return [polygon.tolist() for polygon in mesh.polygons]


def test_normalised_whole_numbers_are_shares(tmp_path: Path) -> None:
    packed = np.round(CORNERS * 32767).astype("<i2")
    mesh = read_gltf_mesh(
        written(
            tmp_path,
            packed,
            np.round(UVS * 65535).astype("<u2"),
            nodes=[{"mesh": 0, "scale": [0.5, 0.5, 0.5], "translation": [0, 1, 0]}],
            extensionsRequired=["KHR_mesh_quantization"],
        )
    )
    np.testing.assert_allclose(mesh.vertices, 0.5 * CORNERS + [0, 1, 0], atol=1e-7)
    # No material is needed for UVs to be kept; v is upward.
    assert mesh.uvs is not None
    np.testing.assert_allclose(mesh.uvs, CORNERS[:, :2], atol=1e-7)


def test_a_buffer_with_a_blank_in_its_name_is_found(tmp_path: Path) -> None:
    mesh = read_gltf_mesh(written(tmp_path, buffer="my%20buf.bin"))
    assert polygons(mesh) == [[0, 1, 2], [0, 2, 3]]


def test_packed_files_are_refused_by_what_packs_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="compressed by Draco"):
        read_gltf_mesh(written(tmp_path, extensionsRequired=["KHR_draco_mesh_compression"]))


def test_a_tint_is_kept_beside_its_image(tmp_path: Path) -> None:
    (tmp_path / "a b.png").write_bytes(png())
    looks = {
        "materials": [
            {
                "name": "silk",
                "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 1], "baseColorTexture": {"index": 0}},
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"uri": "a%20b.png"}],
    }
    found = read_gltf_mesh(written(tmp_path, uvs=UVS, primitive={"material": 0}, **looks)).appearances
    assert found is not None
    assert found.of_face.tolist() == [0, 0]
    assert found.listed[0].name == "silk"
    assert found.listed[0].image == png()
    assert found.listed[0].colour == pytest.approx((1.0, 0.5 ** (1 / 2.2), 0.0))
    (tmp_path / "a b.png").unlink()
    with pytest.warns(match=r"cloth\.gltf: .*b\.png"):
        found = read_gltf_mesh(written(tmp_path, uvs=UVS, primitive={"material": 0}, **looks)).appearances
    assert found is not None
    assert found.listed[0].image is None


def test_copies_at_a_seam_are_one_vertex_with_two_uvs(tmp_path: Path) -> None:
    positions, uvs = np.concatenate([CORNERS, CORNERS[[0, 2]]]), np.concatenate([UVS, UVS[[1, 3]]])
    mesh = read_gltf_mesh(written(tmp_path, positions, uvs, np.array([0, 1, 2, 4, 5, 3], dtype="<u2")))
    assert len(mesh.vertices) == 4
    assert polygons(mesh) == [[0, 1, 2], [0, 2, 3]]
    assert mesh.polygon_uvs is not None
    assert [corners.tolist() for corners in mesh.polygon_uvs] == [[0, 1, 2], [4, 5, 3]]


@pytest.mark.parametrize(
    ("mode", "row", "faces"),
    [(5, [0, 1, 3, 2], [[0, 1, 3], [3, 1, 2]]), (6, [0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]])],
)
def test_strips_and_fans_face_one_way(tmp_path: Path, mode: int, row: list[int], faces: list[list[int]]) -> None:
    mesh = read_gltf_mesh(written(tmp_path, faces=np.array(row, dtype="<u2"), primitive={"mode": mode}))
    assert polygons(mesh) == faces


def test_a_mirrored_mesh_keeps_its_outside(tmp_path: Path) -> None:
    mesh = read_gltf_mesh(written(tmp_path, nodes=[{"mesh": 0, "scale": [1, 1, -1]}]))
    assert polygons(mesh) == [[2, 1, 0], [3, 2, 0]]


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"nodes": [{"children": [1]}, {"children": [0], "mesh": 0}], "scenes": [{"nodes": [0]}]}, "two parents"),
        ({"nodes": [{"translation": [1e400, 0, 0], "mesh": 0}]}, "node 0 has no finite position"),
        ({"nodes": [{}]}, "no faces"),
        ({"nodes": [{"mesh": 7}]}, "cannot be read as a mesh"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, document: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_gltf_mesh(written(tmp_path, **document))


def turned(degrees: float) -> list[float]:
    half = np.deg2rad(degrees) / 2.0
    return [float(-np.sin(half)), 0.0, 0.0, float(np.cos(half))]


@pytest.mark.parametrize("case", ["armature scaled and turned", "mesh node moved", "two joints", "no inverse binds"])
def test_a_skin_is_read_by_the_standard_wherever_its_nodes_stand(tmp_path: Path, case: str) -> None:
    # A square in the world, bound to joints at its lower and upper edge below an armature in centimetres, Z up.
    armature, lower, upper = np.eye(4), np.eye(4), np.eye(4)
    armature[:3, :3] = 0.01 * np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    upper[:3, 3] = [0.0, 0.0, 100.0]
    to_world = [armature @ lower, armature @ lower @ upper]
    inverse = np.stack([np.linalg.inv(each) for each in to_world]).astype("<f4")
    positions, joints = CORNERS, np.array([0, 0, 1, 1])
    if case == "no inverse binds":
        # Bound where the joint has its origin: positions are in the space of the joint.
        positions, joints = ((CORNERS - to_world[1][:3, 3]) @ np.linalg.inv(to_world[1][:3, :3]).T).astype("<f4"), None
    path = written(tmp_path, positions)
    document = json.loads(path.read_text())
    content = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])

    def add(values: np.ndarray, kind: str, component: int) -> int:
        nonlocal content
        content += b"\0" * (-len(content) % 4)
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(content), "byteLength": values.nbytes})
        document["accessors"].append(
            {"bufferView": len(document["bufferViews"]) - 1, "componentType": component, "type": kind}
            | {"count": len(values)}
        )
        content += values.tobytes()
        return len(document["accessors"]) - 1

    places = np.zeros((4, 4), dtype="<u2")
    places[:, 0] = 1 if joints is None else joints
    weights = np.tile(np.array([1, 0, 0, 0], dtype="<f4"), (4, 1))
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    attributes |= {"JOINTS_0": add(places, "VEC4", 5123), "WEIGHTS_0": add(weights, "VEC4", 5126)}
    skin = {"joints": [1, 2]}
    if case != "no inverse binds":
        skin["inverseBindMatrices"] = add(np.ascontiguousarray(inverse.transpose(0, 2, 1)), "MAT4", 5126)
    mesh_node = {"mesh": 0, "skin": 0, **({"translation": [3, 4, 5]} if case == "mesh node moved" else {})}
    document |= {
        "skins": [skin],
        "nodes": [
            {"scale": [0.01] * 3, "rotation": turned(90.0), "children": [1]}, {"children": [2]},
            {"translation": [0, 0, 100]}, mesh_node,
        ],
        "buffers": [{
            "byteLength": len(content),
            "uri": "data:application/octet-stream;base64," + base64.b64encode(content).decode(),
        }],
    }  # fmt: skip
    path.write_text(json.dumps(document))
    mesh = read_gltf_mesh(path)
    np.testing.assert_allclose(mesh.vertices, CORNERS, atol=1e-6)
    assert polygons(mesh) == [[0, 1, 2], [0, 2, 3]]
    # A joint that stands elsewhere than it was bound takes its vertices along.
    document["nodes"][2]["translation"] = [0, 0, 150]
    path.write_text(json.dumps(document))
    raised = CORNERS + np.array([0.0, 0.5, 0.0]) * (np.ones((4, 1)) if joints is None else joints[:, None])
    np.testing.assert_allclose(read_gltf_mesh(path).vertices, raised, atol=1e-6)


def test_morph_targets_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = written(tmp_path, primitive={"targets": [{"POSITION": 0}]})
    with pytest.warns(InputNote, match=r"cloth\.gltf: its morph targets are not used"):
        mesh = read_gltf_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
