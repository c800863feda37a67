"""Readers of what was written, after the specifications of the formats and without the package."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from pb4u.scene.trajectory import Trajectory


def pc2_frames(path: Path) -> np.ndarray:
    data = path.read_bytes()
    magic, version, points, first, sampling, samples = struct.unpack_from("<12s2i2fi", data)
    assert (magic, version, first, sampling) == (b"POINTCACHE2\0", 1, 0.0, 1.0)
    assert len(data) == 32 + 12 * points * samples
    return np.array(struct.unpack_from(f"<{3 * points * samples}f", data, 32)).reshape(samples, points, 3)


def mdd_frames(path: Path) -> tuple[np.ndarray, np.ndarray]:
    data = path.read_bytes()
    samples, points = struct.unpack_from(">2i", data)
    assert len(data) == 8 + 4 * samples + 12 * points * samples
    times = np.array(struct.unpack_from(f">{samples}f", data, 8))
    values = struct.unpack_from(f">{3 * points * samples}f", data, 8 + 4 * samples)
    return times, np.array(values).reshape(samples, points, 3)


def assert_obj(path: Path, trajectory: Trajectory, t: int) -> None:
    """Positions and UVs of every corner as trimesh reads them, and the order of the vertices in the file."""
    mesh = trimesh.load(path, process=False)
    expected = trajectory.positions[t]
    np.testing.assert_allclose(mesh.vertices[mesh.faces], expected[trajectory.faces], atol=1e-6)
    uvs, uv_faces = trajectory.header.uvs, trajectory.header.uv_faces
    np.testing.assert_allclose(mesh.visual.uv[mesh.faces], uvs[uv_faces], atol=1e-6)
    listed = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")]
    np.testing.assert_allclose(np.array(listed, dtype=float), expected, atol=1e-6)


class Glb:
    """A reader of what the tests need, after the specification."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        self.json: dict[str, Any] = json.loads(data[20 : 20 + size])
        self._binary = data[28 + size :]

    def array(self, accessor: int) -> np.ndarray:
        entry = self.json["accessors"][accessor]
        view = self.json["bufferViews"][entry["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
        dtype = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[entry["componentType"]]
        values = np.frombuffer(self._binary, dtype, entry["count"] * width, view["byteOffset"])
        return values.reshape(-1, width)

    def blended(self, node: int, attribute: str, frames: int) -> np.ndarray:
        """(frames, vertices, 3) an attribute of a node's mesh at each key of its weights."""
        primitive = self.json["meshes"][self.json["nodes"][node]["mesh"]]["primitives"][0]
        base = self.array(primitive["attributes"][attribute])
        targets = np.array([self.array(target[attribute]) for target in primitive.get("targets", [])])
        channels = self.json["animations"][0]["channels"]
        sampler = next(c["sampler"] for c in channels if c["target"] == {"node": node, "path": "weights"})
        output = self.json["animations"][0]["samplers"][sampler]["output"]
        weights = self.array(output).reshape(frames, len(targets))
        assert weights.min() >= 0
        assert weights.max() <= 1
        return base + np.einsum("tk,kvd->tvd", weights, targets)
