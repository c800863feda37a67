"""A mesh with a colour at every vertex, as the smallest GLB that a browser can take thirty times a second."""

from __future__ import annotations

import json
import struct

import numpy as np

_FLOAT, _UNSIGNED_BYTE, _UNSIGNED_SHORT, _UNSIGNED_INT = 5126, 5121, 5123, 5125


class ColouredMesh:
    """Makes GLB files of one mesh that moves and changes colour.

    Args:
        faces: (faces, 3) int.
        vertices: number of vertices.
        transparent: whether the alpha of the colours counts.
    """

    def __init__(self, faces: np.ndarray, vertices: int, transparent: bool = False) -> None:
        short = vertices < 65536
        self._indices = np.ascontiguousarray(faces, dtype="<u2" if short else "<u4").tobytes()
        self._index_kind = _UNSIGNED_SHORT if short else _UNSIGNED_INT
        self._alpha = {"alphaMode": "BLEND"} if transparent else {}
        self._corners, self._vertices = int(np.size(faces)), vertices

    def glb(self, positions: np.ndarray, colours: np.ndarray) -> bytes:
        """One frame.

        Args:
            positions: (vertices, 3) float [m].
            colours: (vertices, 4) uint8 linear RGBA.
        """
        points = np.ascontiguousarray(positions, dtype="<f4")
        parts = [points.tobytes(), np.ascontiguousarray(colours, dtype=np.uint8).tobytes(), self._indices]
        sizes = [len(part) for part in parts]
        offsets = [0, sizes[0], sizes[0] + sizes[1]]
        count = self._vertices
        matt = {"metallicFactor": 0, "roughnessFactor": 0.9}
        attributes = {"POSITION": 0, "COLOR_0": 1, "NORMAL": 3}
        document = {
            "asset": {"version": "2.0", "generator": "pb4u"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            # Normals are named but not sent (zeros, by the format): the browser computes them from the positions,
            # and without the name it would shade every triangle flat.
            "meshes": [{"primitives": [{"attributes": attributes, "indices": 2, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": matt, "doubleSided": True, **self._alpha}],
            "buffers": [{"byteLength": sum(sizes)}],
            "bufferViews": [
                {"buffer": 0, "byteOffset": offset, "byteLength": size}
                for offset, size in zip(offsets, sizes, strict=True)
            ],
            "accessors": [
                {
                    "bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3",
                    "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist(),
                },
                {
                    "bufferView": 1, "componentType": _UNSIGNED_BYTE, "normalized": True, "count": count,
                    "type": "VEC4",
                },
                {"bufferView": 2, "componentType": self._index_kind, "count": self._corners, "type": "SCALAR"},
                {"componentType": _FLOAT, "count": count, "type": "VEC3"},
            ],
        }  # fmt: skip
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(parts)
        binary += b"\0" * (-len(binary) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
        return b"".join(
            [head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
        )
