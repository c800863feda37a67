"""Rigged characters as glTF files, made of the built-in bodies (CC0), and a slow twin of what moves them."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.skeleton import PoseSequence, joint_positions
from pb4u.body.skinning import SkinningWeights
from pb4u.geometry.rotation import conjugate, multiply
from pb4u.motion.library import load_motion
from pb4u.motion.smpl_recording import nominal_skeleton

_KINDS = {"float32": 5126, "uint16": 5123, "uint32": 5125, "uint8": 5121}
_TYPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


@dataclass
class GltfWriter:
    """A glTF document under construction, all arrays in one buffer."""

    document: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
    )
    content: bytearray = field(default_factory=bytearray)

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append to one of the lists; the number it has there."""
        self.document.setdefault(kind, []).append(entry)
        return len(self.document[kind]) - 1

    def array(self, values: np.ndarray, normalized: bool = False) -> int:
        """An accessor of an array."""
        self.content += b"\0" * (-len(self.content) % 4)
        view = self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.content), "byteLength": values.nbytes})
        columns = values.transpose(0, 2, 1) if values.ndim == 3 else values
        self.content += np.ascontiguousarray(columns).tobytes()
        entry = {
            "bufferView": view,
            "componentType": _KINDS[str(values.dtype)],
            "count": len(values),
            "type": _TYPES[values.shape[1:]],
        }
        if values.dtype == np.float32 and values.ndim < 3:
            entry |= {
                "min": np.atleast_1d(values.min(axis=0)).tolist(),
                "max": np.atleast_1d(values.max(axis=0)).tolist(),
            }
        return self.add("accessors", entry | ({"normalized": True} if normalized else {}))

    def save(self, path: Path) -> Path:
        """Write a .glb, or a .gltf with its buffer beside it."""
        self.content += b"\0" * (-len(self.content) % 4)
        self.document["buffers"] = [{"byteLength": len(self.content)}]
        if path.suffix == ".gltf":
            self.document["buffers"][0]["uri"] = path.stem + ".bin"
            path.with_suffix(".bin").write_bytes(self.content)
            path.write_text(json.dumps(self.document))
            return path
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        path.write_bytes(
            struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(self.content))
            + struct.pack("<II", len(text), 0x4E4F534A)
            + text
            + struct.pack("<II", len(self.content), 0x004E4942)
            + self.content
        )
        return path


def write_woman(
    path: Path,
    unit: float = 1.0,
    split: int = 1,
    clips: tuple[str, ...] = ("walk", "arms"),
    frames: int = 12,
    rename: Any = None,
    change: Any = None,
    mirrored: bool = False,
    extra: Sequence[tuple[str, str, np.ndarray, np.ndarray, str | None]] = (),
) -> Path:
    """The built-in woman as a rigged character with hair, eyes, two clips and two morph targets.

    Args:
        path: the file.
        unit: length of the file's unit [m]; its armature scales it to metres.
        split: number of meshes with a skin of their own that the body is cut into by height, up to 3.
        clips: built-in motions.
        frames: key frames of each clip, at 30 a second.
        rename: function of the name of a bone.
        change: function of the writer before it is saved.
        extra: meshes beside it: name, material, (vertices, 3) [m], (faces, 3), and the bone that they hang on; None for
            those of the body's own vertices.
        mirrored: whether the armature mirrors the scene, which the bones then have been made for.
    """
    body = load_body("woman")
    assert isinstance(body, ShapedBody)
    writer = GltfWriter()
    skeleton = body.skeleton
    flip = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0]) / unit
    joints, vertices = skeleton.joints * flip, body.vertices * flip
    armature = writer.add("nodes", {"name": "Armature", "scale": (1.0 / flip).tolist(), "children": []})
    writer.document["scenes"][0]["nodes"].append(armature)
    first = len(writer.document["nodes"])
    for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        offset = joints[bone] - (joints[parent] if parent >= 0 else 0.0)
        writer.add("nodes", {"name": rename(name) if rename else name, "translation": offset.tolist()})
        above = writer.document["nodes"][first + parent if parent >= 0 else armature]
        above.setdefault("children", []).append(first + bone)
    inverse = np.tile(np.eye(4, dtype=np.float32), (skeleton.bone_count, 1, 1))
    inverse[:, :3, 3] = -joints
    heights = body.height * np.array([0.0, 0.35, 0.87])  # thighs and neck, away from what is morphed
    torso = min(split - 1, 1)
    middle = body.vertices[body.faces, 1].mean(axis=1)
    for k in range(split):
        inside = (middle >= heights[k]) & (middle < (heights[k + 1] if k < split - 1 else np.inf))
        _add_mesh(
            writer, armature, f"Body{k}", "Skin", body, vertices, body.faces[inside], inverse, first, morphs=k == torso
        )
    top = vertices[:, 1] > 0.93 * vertices[:, 1].max()
    for name, material in (("HairCap", "Hair"), ("Eyes", "EyeIris")):
        faces = body.faces[top[body.faces].all(axis=1)]
        lifted = vertices + np.array([0.0, 0.02, 0.0]) / unit
        _add_mesh(writer, armature, name, material, body, lifted, faces, inverse, first, morphs=False)
    mesh = next(n for n, node in enumerate(writer.document["nodes"]) if node.get("name") == f"Body{torso}")
    for name in clips:
        poses = load_motion(name).poses(body, 30.0, frames)
        _add_clip(writer, name, poses, body, flip, first, mesh)
    for name, material, places, of_faces, bone in extra:
        count = len(places)
        carrier = body
        if bone is not None:
            owner = np.full((count, 1), skeleton.index(bone))
            carrier = replace(body, weights=SkinningWeights(owner, np.ones((count, 1), dtype=np.float32)))
        _add_mesh(writer, armature, name, material, carrier, places * flip, of_faces, inverse, first, morphs=False)
    if change:
        change(writer)
    return writer.save(path)


def write_doll(path: Path) -> Path:
    """A character of a tetrahedron on each of SMPL's joints, with a clip of four key frames."""
    skeleton = nominal_skeleton("smpl")
    corners = 0.03 * np.array([[1.0, -1, 1], [-1, -1, 1], [0, -1, -1], [0, 1, 0]])
    owner = np.repeat(np.arange(skeleton.bone_count), 4)
    faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]) + 4 * np.arange(skeleton.bone_count)[:, None, None]
    vertices = (skeleton.joints[:, None] + corners).reshape(-1, 3)
    weights = SkinningWeights(owner[:, None], np.ones((len(owner), 1), dtype=np.float32))
    body = ShapedBody(
        "doll", "smpl", vertices, faces.reshape(-1, 3), skeleton, weights, np.ones(len(owner), dtype=bool)
    )
    writer = GltfWriter()
    armature = writer.add("nodes", {"name": "Armature", "children": []})
    writer.document["scenes"][0]["nodes"].append(armature)
    inverse = np.tile(np.eye(4, dtype=np.float32), (skeleton.bone_count, 1, 1))
    inverse[:, :3, 3] = -skeleton.joints
    for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        offset = skeleton.joints[bone] - (skeleton.joints[parent] if parent >= 0 else 0.0)
        writer.add("nodes", {"name": name, "translation": offset.tolist()})
        writer.document["nodes"][1 + parent if parent >= 0 else armature].setdefault("children", []).append(1 + bone)
    _add_mesh(writer, armature, "Body0", "Skin", body, vertices, body.faces, inverse, 1, morphs=True)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (4, skeleton.bone_count, 1))
    poses = PoseSequence(turns, np.outer(np.arange(4), [0.0, 0.0, 0.1]), 30.0)
    mesh = len(writer.document["nodes"]) - 1
    _add_clip(writer, "slide", poses, body, np.ones(3), 1, mesh)
    return writer.save(path)


def _add_mesh(
    writer: GltfWriter,
    armature: int,
    name: str,
    material: str,
    body: ShapedBody,
    vertices: np.ndarray,
    faces: np.ndarray,
    inverse: np.ndarray,
    first: int,
    morphs: bool,
) -> None:
    used, local = np.unique(faces, return_inverse=True)
    # Every third vertex twice, as at a seam of the texture.
    twice = used[::3]
    number = np.concatenate([used, twice])
    local = local.reshape(-1, 3)
    doubled = np.flatnonzero(np.isin(used[local], twice).all(axis=1) | (np.arange(len(local)) % 2 == 0))
    place = {int(v): len(used) + k for k, v in enumerate(twice)}
    local = local.copy()
    for face in doubled[:200]:
        local[face] = [place.get(int(used[v]), v) for v in local[face]]
    bones, weights = body.weights.bones[number], body.weights.weights[number]
    width = -(-weights.shape[1] // 4) * 4
    bones, weights = (np.pad(a, ((0, 0), (0, width - a.shape[1]))) for a in (bones, weights))
    attributes = {"POSITION": writer.array(vertices[number].astype(np.float32))}
    for k in range(width // 4):
        attributes[f"JOINTS_{k}"] = writer.array(bones[:, 4 * k : 4 * k + 4].astype(np.uint16))
        attributes[f"WEIGHTS_{k}"] = writer.array(weights[:, 4 * k : 4 * k + 4].astype(np.float32))
    primitive: dict[str, Any] = {
        "attributes": attributes,
        "indices": writer.array(local.reshape(-1).astype(np.uint32)),
        "material": writer.add("materials", {"name": material}),
    }
    mesh: dict[str, Any] = {"name": name, "primitives": [primitive]}
    if morphs:
        size = float(np.ptp(vertices[:, 1]))
        belly = np.exp(-(((vertices[number] - [0.0, 0.6 * size, 0.07 * size]) / (0.08 * size)) ** 2).sum(axis=1))
        broad = np.zeros((len(number), 3))
        broad[:, 2] = 0.015 * size * belly
        wide = np.zeros((len(number), 3))
        wide[:, 0] = 0.005 * size * np.sign(vertices[number, 0]) * belly
        primitive["targets"] = [{"POSITION": writer.array(each.astype(np.float32))} for each in (broad, wide)]
        mesh |= {"weights": [0.25, 0.0], "extras": {"targetNames": ["Belly", "Wide"]}}
    skin = writer.add(
        "skins",
        {
            "joints": list(range(first, first + len(inverse))),
            "inverseBindMatrices": writer.array(inverse),
            "skeleton": first,
        },
    )
    node = writer.add("nodes", {"name": name, "mesh": writer.add("meshes", mesh), "skin": skin})
    writer.document["nodes"][armature]["children"].append(node)


def _add_clip(
    writer: GltfWriter, name: str, poses: PoseSequence, body: ShapedBody, flip: np.ndarray, first: int, mesh: int
) -> None:
    times = writer.array((np.arange(len(poses)) / 30.0 + 0.5).astype(np.float32))
    clip: dict[str, Any] = {"name": name, "channels": [], "samplers": []}

    def channel(node: int, path: str, values: np.ndarray) -> None:
        clip["samplers"].append({"input": times, "output": writer.array(values.astype(np.float32))})
        sampler = len(clip["samplers"]) - 1
        clip["channels"].append({"sampler": sampler, "target": {"node": node, "path": path}})

    world = poses.rotations
    for bone, parent in enumerate(body.skeleton.parents.tolist()):
        local = world[:, bone] if parent < 0 else multiply(conjugate(world[:, parent]), world[:, bone])
        if flip[0] < 0.0:  # the mirror image of a turn
            local = local * np.array([1.0, 1.0, -1.0, -1.0])
        channel(first + bone, "rotation", local[:, [1, 2, 3, 0]])
    channel(first, "translation", joint_positions(body.skeleton, poses)[:, 0] * flip)
    swell = 0.5 + 0.5 * np.sin(np.arange(len(poses)) / 9.0)
    channel(mesh, "weights", np.stack([swell, 1.0 - swell], axis=1).reshape(-1))
    writer.add("animations", clip)


def slow_vertices(path: Path, clip: int, time: float, mesh_node: str) -> np.ndarray:
    """Vertices (vertices, 3) of a mesh at the time of a key, read and moved one by one as the specification says."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document, content = json.loads(data[20 : 20 + length]), data[28 + length :]

    def array(index: int) -> np.ndarray:
        entry = document["accessors"][index]
        view = document["bufferViews"][entry["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2", 5125: "<u4", 5121: "<u1"}[entry["componentType"]]
        count = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
        flat = np.frombuffer(
            content, kind, entry["count"] * count, view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        )
        return flat.reshape(entry["count"], count).astype(np.float64)

    nodes = [dict(node) for node in document["nodes"]]
    weights: dict[int, np.ndarray] = {}
    animation = document["animations"][clip]
    for each in animation["channels"]:
        sampler = animation["samplers"][each["sampler"]]
        frame = int(np.abs(array(sampler["input"])[:, 0] - time).argmin())
        values = array(sampler["output"])
        node, what = each["target"]["node"], each["target"]["path"]
        if what == "weights":
            weights[node] = values.reshape(len(array(sampler["input"])), -1)[frame]
        else:
            nodes[node][what] = values[frame].tolist()

    def local(node: dict[str, Any]) -> np.ndarray:
        matrix = np.eye(4)
        turn = Rotation.from_quat(node.get("rotation", [0.0, 0.0, 0.0, 1.0])).as_matrix()
        matrix[:3, :3] = turn @ np.diag(node.get("scale", [1.0, 1.0, 1.0]))
        matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
        return matrix

    above = {child: n for n, node in enumerate(nodes) for child in node.get("children", ())}

    def world(node: int) -> np.ndarray:
        return (world(above[node]) if node in above else np.eye(4)) @ local(nodes[node])

    number = next(n for n, node in enumerate(nodes) if node.get("name") == mesh_node and "mesh" in node)
    mesh = document["meshes"][nodes[number]["mesh"]]
    skin = document["skins"][nodes[number]["skin"]]
    inverse = array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    moved = [world(joint) @ inverse[k] for k, joint in enumerate(skin["joints"])]
    result = []
    for primitive in mesh["primitives"]:
        places = array(primitive["attributes"]["POSITION"])
        for k, target in enumerate(primitive.get("targets", ())):
            places = places + weights.get(number, np.array(mesh.get("weights", [])))[k] * array(target["POSITION"])
        sets = [n for n in primitive["attributes"] if n.startswith("JOINTS")]
        joints = np.concatenate([array(primitive["attributes"][n]) for n in sets], axis=1).astype(int)
        shares = np.concatenate([array(primitive["attributes"][n.replace("JOINTS", "WEIGHTS")]) for n in sets], axis=1)
        for place, bones, share in zip(places, joints, shares, strict=True):
            blended = sum(w * moved[b] for b, w in zip(bones, share / share.sum(), strict=True) if w)
            result.append((blended @ np.append(place, 1.0))[:3])
    return np.array(result)


def rewritten(source: Path, target: Path, change) -> Path:
    """A .glb whose JSON a function has changed."""
    data = source.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    header = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    target.write_bytes(header + text + rest)
    return target
