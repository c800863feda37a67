"""The document and the arrays of a glTF 2.0 file: .glb, .vrm, or .gltf with its buffers beside it or within.

Source: Khronos, glTF 2.0 specification, 3.6 (accessors) and 4.4 (GLB).
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import parse_json, refusing

SUFFIXES = (".glb", ".gltf", ".vrm")
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5121, 5123, 5125, 5126
"""Types of the components of an array."""
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""Uses of an array: by vertex, and as indices."""
_TYPES = {5120: "<i1", UNSIGNED_BYTE: "<u1", 5122: "<i2", UNSIGNED_SHORT: "<u2", UNSIGNED_INT: "<u4", FLOAT: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# Vertices and indices are packed by these in ways that are not read.
_PACKED = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}


@dataclass(frozen=True, eq=False)
class GltfFile:
    """A document and the buffers that contain its arrays.

    Args:
        path: the file.
        document: its JSON.
        buffers: bytes of each of its buffers.
    """

    path: Path
    document: dict[str, Any]
    buffers: tuple[bytes, ...]

    def entries(self, name: str) -> list[dict[str, Any]]:
        """The objects of one of its lists, such as "nodes"; empty where it has none.

        Args:
            name: of a list, such as "nodes".
        """
        entries = self.document.get(name, [])
        return entries if isinstance(entries, list) else []

    def array(self, index: int) -> np.ndarray:
        """The array of an accessor, sparse values put in, normalised whole numbers as shares.

        Args:
            index: number of the accessor.

        Returns:
            (count, components), or (count,) of scalars: float64 of decimal or normalised numbers, else whole numbers.

        Raises:
            LookupError, ValueError, TypeError: it is damaged.
        """
        accessor = self.entries("accessors")[index]
        kind, width, count = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]], accessor["count"]
        if not isinstance(count, int) or count < 0:
            raise ValueError(f"accessor {index} has the count {count!r}")
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), kind, count, width)
        elif count * width * kind.itemsize > self.path.stat().st_size and "sparse" not in accessor:
            raise ValueError(f"accessor {index} is empty")
        else:
            values = np.zeros((count, width), dtype=kind)
        if sparse := accessor.get("sparse"):
            places, changed = sparse["indices"], sparse["values"]
            integer = np.dtype(_TYPES[places["componentType"]])
            rows = self._view(places["bufferView"], places.get("byteOffset", 0), integer, sparse["count"], 1)[:, 0]
            replaced = self._view(changed["bufferView"], changed.get("byteOffset", 0), kind, sparse["count"], width)
            values = values.copy()
            values[rows] = replaced
        if kind.kind == "f" or accessor.get("normalized"):
            scale = 1.0 if kind.kind == "f" else float(np.iinfo(kind).max)
            values = np.maximum(values.astype(np.float64) / scale, -np.inf if kind.kind == "f" else -1.0)
        return values[:, 0] if width == 1 else values

    def image(self, index: int) -> bytes:
        """Content of an image, within the file or beside it.

        Args:
            index: number of the image.

        Raises:
            InputError: it is not beside the file.
            LookupError, ValueError, TypeError: it is damaged.
        """
        entry = self.entries("images")[index]
        if "bufferView" not in entry:
            return _beside(self.path, entry["uri"], b"")
        view = self.entries("bufferViews")[entry["bufferView"]]
        start = view.get("byteOffset", 0)
        return self.buffers[view["buffer"]][start : start + view["byteLength"]]

    def _view(self, index: int, offset: int, kind: np.dtype, count: int, width: int) -> np.ndarray:
        view = self.entries("bufferViews")[index]
        start = view.get("byteOffset", 0) + offset
        step = view.get("byteStride") or kind.itemsize * width
        content = self.buffers[view["buffer"]]
        if min(start, step, offset) < 0 or (
            count and start + (count - 1) * step + kind.itemsize * width > len(content)
        ):
            raise ValueError(f"buffer view {index} is cut short")
        if not count:
            return np.zeros((0, width), dtype=kind)
        flat = np.frombuffer(content, dtype=np.uint8)[start:]
        rows = np.lib.stride_tricks.as_strided(flat, (count, kind.itemsize * width), (step, 1), writeable=False)
        return np.ascontiguousarray(rows).view(kind)


def read_gltf(path: Path) -> GltfFile:
    """A glTF file with its buffers, but without decoding arrays.

    Args:
        path: the .glb, .vrm or .gltf.

    Raises:
        InputError: it is not a glTF file, is cut short, lacks a buffer, or is compressed by Draco or meshopt.
    """
    with refusing(path, "is not a complete glTF file"):
        content = path.read_bytes()
        document, binary = _parted(path, content)
        if not isinstance(document, dict) or not str(document.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError(f"{path} is not a glTF file of version 2; export it again.")
        for name in document.get("extensionsRequired", ()):
            if name in _PACKED:
                raise InputError(
                    f"{path} is compressed by {_PACKED[name]}, which pb4u does not read; export it without "
                    "compression, or unpack it with gltf-transform."
                )
        buffers = []
        for buffer in document.get("buffers", ()):
            data = _beside(path, buffer.get("uri"), binary)
            if len(data) < buffer["byteLength"]:
                raise InputError(f"{path} is cut short: a buffer has {len(data):,} of {buffer['byteLength']:,} bytes.")
            buffers.append(data)
        return GltfFile(path, document, tuple(buffers))


class GltfDocument:
    """A glTF file that is written: its JSON, and its arrays as they go to a binary file.

    Args:
        file: to write the arrays to, each a multiple of 4 bytes.

    Attributes:
        file: to write the arrays to.
        json: the JSON, with one scene.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "pb4u"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [],
            "meshes": [], "materials": [], "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def add_view(self, content: bytes, **more: Any) -> int:
        """Add bytes as a buffer view, and give its number.

        Args:
            content: the bytes.
            more: further entries of the view.
        """
        view = {"buffer": 0, "byteOffset": self.file.tell(), "byteLength": len(content), **more}
        self.file.write(content + b"\0" * (-len(content) % 4))
        self.json["bufferViews"].append(view)
        return len(self.json["bufferViews"]) - 1

    def add(self, values: np.ndarray, kind: str, component: int, target: int | None = None, **more: Any) -> int:
        """Add an array, and give the number of its accessor.

        Args:
            values: (count, ...) little-endian, of the component type.
            kind: "SCALAR", "VEC2" and so on.
            component: type of its components.
            target: its use; None if it has neither vertex attributes nor indices.
            more: further entries of the accessor.
        """
        view = self.add_view(values.tobytes(), **({} if target is None else {"target": target}))
        accessor = {"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more}
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def add_vectors(self, values: np.ndarray, bounded: bool = False) -> int:
        """Add a vector for each vertex, and give the number of their accessor.

        Args:
            values: (vertices, components) float.
            bounded: whether their bounds are written.
        """
        values = np.asarray(values, dtype="<f4")
        bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if bounded else {}
        return self.add(values, f"VEC{values.shape[1]}", FLOAT, ARRAY_BUFFER, **bounds)


def glb_head(document: dict[str, Any], size: int) -> bytes:
    """The bytes of a GLB before those of its buffer.

    Args:
        document: the JSON.
        size: bytes of the buffer, a multiple of 4.
    """
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<5I", _MAGIC, 2, 12 + 8 + len(text) + 8 + size, len(text), _JSON)
    return head + text + struct.pack("<2I", size, _BINARY)


def _parted(path: Path, content: bytes) -> tuple[Any, bytes]:
    """The JSON of a file, and the binary chunk behind it."""
    if content[:4] != struct.pack("<I", _MAGIC):
        return parse_json(content), b""
    document, binary, place = b"", b"", 12
    while place + 8 <= len(content):
        length, kind = struct.unpack_from("<II", content, place)
        chunk = content[place + 8 : place + 8 + length]
        if len(chunk) < length:
            raise InputError(f"{path} is cut short; copy or export it again.")
        if kind == _JSON and not document:
            document = chunk
        elif kind == _BINARY and not binary:
            binary = chunk
        place += 8 + length
    return parse_json(document), binary


def _beside(path: Path, uri: str | None, binary: bytes) -> bytes:
    if uri is None:
        return binary
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    beside = path.parent / unquote(uri)
    if "://" in uri or not beside.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f'{path} needs "{uri[:80]}", which is outside its folder; put it beside the file.')
    if not beside.is_file():
        raise InputError(f"{path} needs {beside.name} beside it.")
    return beside.read_bytes()
