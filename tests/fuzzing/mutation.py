"""Damaged files: bytes, words of texts, members of archives, and the values that a format holds, changed at random."""

from __future__ import annotations

import io
import json
import math
import pickle
import random
import re
import struct
import sys
import warnings
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 127, 255, 65535, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**40, 2**63 - 1, -(2**63), 10**30,
    0.0, -0.0, 0.5, 1e-9, 1e-300, 1e9, 1e20, 1e38, 1e300, -1e300, math.nan, math.inf, -math.inf,
)  # fmt: skip
WORDS = (
    "", "x", "nan", "inf", "-inf", "1e300", "-1", "0", "1e-300", "1e999", "9" * 30, "9" * 5000, "-0", "0x10", "1_0",
    "1,5", "/", "//", "1//", "-1/-1", "{", "}", "[", "]", '"', "\\", "#", "\x00", "\ufeff", "ü", "٣", "a" * 300,
    "ROOT", "JOINT", "End", "begin", "end", "root", "XYZ", "xyz", "None", "true", "../../../dev/zero", "/dev/zero",
)  # fmt: skip
"""Words that texts trip over."""
_DTYPES = ("<f8", "<f4", "<f2", ">f4", "<i8", "<i4", "<i2", "|u1", "<u8", ">i4", "<c16", "|b1", "<U3", "|S3", "<M8[s]")
_LARGE = 64 * 2**20
"""Entries of an array of nothing that deflates to a thousandth of its size, at 8 bytes each."""


def damaged(name: str, content: bytes, rng: random.Random) -> bytes:
    """The content of a file, changed in some places.

    Args:
        name: its name, of which the suffix says what is known of its format.
        content: of a sound file.
        rng: decides.
    """
    known = _FORMATS.get("." + name.rpartition(".")[2].lower(), ())
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        ways: list[Callable[[bytes, random.Random], bytes]] = [*known, *known, _bytes_changed]
        content = rng.choice(ways)(content, rng)
    return content


def _bytes_changed(content: bytes, rng: random.Random) -> bytes:
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        # Headers lie at the beginning, directories of archives at the end.
        place = rng.choice((rng.randrange(len(data) + 1), min(rng.randrange(200), len(data))))
        place = rng.choice((place, max(0, len(data) - rng.randrange(1, 200))))
        way = rng.randrange(7)
        if way == 0 and data:
            data[min(place, len(data) - 1)] ^= 1 << rng.randrange(8)
        elif way == 1 and data:
            data[min(place, len(data) - 1)] = rng.choice((0, 1, 0x20, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        elif way == 2:
            del data[place:]
        elif way == 3:
            del data[place : place + rng.choice((1, 4, 64))]
        elif way == 4:
            start = rng.randrange(len(data) + 1)
            data[place:place] = data[start : start + rng.choice((1, 8, 100))]
        elif way == 5:
            form = rng.choice(("<i", ">i", "<q", "<f", "<H"))
            value = rng.choice((0, 1, 255, 65535)) if form == "<H" else rng.choice((0, -1, 2**31 - 1, -(2**31), 1000))
            data[place : place + struct.calcsize(form)] = struct.pack(form, value)
        else:
            data[place : place + 16] = bytes(len(data[place : place + 16]))
    return bytes(data)


def _text_changed(content: bytes, rng: random.Random) -> bytes:
    lines = content.decode("latin-1").split("\n")
    for _ in range(rng.choice((1, 1, 2, 5))):
        place = rng.randrange(len(lines))
        way = rng.randrange(7)
        if way <= 2:
            words = re.split(r"([\s,=\[\]/]+)", lines[place])
            chosen = rng.randrange(0, len(words), 2)
            other = re.split(r"[\s,=\[\]/]+", rng.choice(lines))
            words[chosen] = rng.choice((rng.choice(WORDS), rng.choice(other), words[chosen] * 2))
            lines[place] = "".join(words)
        elif way == 3:
            del lines[place]
        elif way == 4:
            lines[place:place] = [rng.choice(lines)] * rng.choice((1, 1, 2, 2000))
        elif way == 5:
            other_place = rng.randrange(len(lines))
            lines[place], lines[other_place] = lines[other_place], lines[place]
        else:
            lines[place] = lines[place][: rng.randrange(len(lines[place]) + 1)]
        if not lines:
            lines = [""]
    return "\n".join(lines).encode("latin-1", "replace")


def _member_changed(content: bytes, rng: random.Random) -> bytes:
    """A member of a zip archive changed, dropped, named anew or packed, its checksum right."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist()}
    except Exception:  # what an earlier change left is no longer an archive
        return content
    if not members:
        return content
    name = rng.choice(list(members))
    way = rng.randrange(6)
    if way <= 2:
        members[name] = _bytes_changed(members[name], rng)
    elif way == 3:
        del members[name]
    elif way == 4:
        members[rng.choice((*members, "data.pkl", "x"))] = members.pop(name)
    else:
        members[name] = members[rng.choice(list(members))]
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
    written = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(written, "w", method) as archive:
        warnings.simplefilter("ignore")
        for each, inside in members.items():
            archive.writestr(each, inside)
    return written.getvalue()


@dataclass(frozen=True)
class _Forged:
    """An array whose header tells of another one.

    Args:
        content: bytes of its entries.
        dtype: that its header tells.
        shape: that its header tells.
    """

    content: bytes
    dtype: str
    shape: tuple[int, ...]


class _Tree(ABC):
    """A format that holds nested values: they are read, changed at random, and written again."""

    def __call__(self, content: bytes, rng: random.Random) -> bytes:
        try:
            tree = self.read(content)
        except Exception:  # what an earlier change left is no longer of the format
            return content
        for _ in range(20):
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    return self.write(_value_changed(tree, rng, self), content)
            except Exception:  # the format cannot hold that
                continue
        return content

    def scalars(self, rng: random.Random) -> Any:
        """A value that readers trip over."""
        odd: tuple[Any, ...] = (None, True, "", "text", [], {}, [[]], [1, "a"], _nested(rng), "a" * 2000, {"a": 1})
        return rng.choice((*NUMBERS, *odd))

    @abstractmethod
    def read(self, content: bytes) -> Any:
        """The values in a file of this content."""

    @abstractmethod
    def write(self, tree: Any, content: bytes) -> bytes:
        """A file of these values, in place of those of `content`."""


def _nested(rng: random.Random) -> Any:
    value: Any = rng.choice(([], {}, [1.0]))
    for _ in range(rng.choice((3, 100, 700))):
        value = rng.choice(([value], {"a": value}))
    return value


def _value_changed(tree: Any, rng: random.Random, form: _Tree) -> Any:
    """A copy of nested values with one of them changed."""
    if isinstance(tree, Mapping) and tree and rng.random() < 0.85:
        result = dict(tree)
        key = rng.choice(list(result))
        way = rng.random()
        if way < 0.06:
            del result[key]
        elif way < 0.12:
            result[rng.choice((*result, "x", "", 0, -1, "level1"))] = result[key]
        elif way < 0.18:
            result[key] = result[rng.choice(list(result))]
        else:
            result[key] = _value_changed(result[key], rng, form)
        return result
    if isinstance(tree, list | tuple) and tree and rng.random() < 0.8:
        items = list(tree)
        place = rng.randrange(len(items))
        way = rng.random()
        if way < 0.1:
            del items[place]
        elif way < 0.2:
            items *= rng.choice((2, 1000))
        else:
            items[place] = _value_changed(items[place], rng, form)
        return type(tree)(items)
    if isinstance(tree, np.ndarray):
        return _array_changed(tree, rng, form)
    if isinstance(tree, str) and tree[:1] in "{[" and rng.random() < 0.9:
        inner = json.loads(tree)
        return json.dumps(_value_changed(inner, rng, _JSON))
    return form.scalars(rng)


def _array_changed(array: np.ndarray, rng: random.Random, form: _Tree) -> Any:
    way = rng.randrange(9)
    if array.dtype.kind == "U" and not array.shape and way < 7:
        return np.array(_value_changed(str(array), rng, form))
    if way <= 2 and array.size:
        result = array.copy()
        flat = result.reshape(-1)
        for _ in range(rng.choice((1, 1, 3, 50))):
            try:
                flat[rng.randrange(len(flat))] = rng.choice(NUMBERS)
            except (OverflowError, ValueError, TypeError):
                flat[rng.randrange(len(flat))] = flat[0]
        return result
    if way == 3 and array.size:
        result = np.full_like(array, array.reshape(-1)[0])
        return result * rng.choice((0, 1, -1)) if array.dtype.kind in "fi" else result
    if way == 4:
        return array.astype(rng.choice(_DTYPES))
    if way == 5:
        axis = rng.randrange(array.ndim) if array.ndim else 0
        cut: list[Callable[[], np.ndarray]] = [
            lambda: array[None], lambda: array.reshape(-1), lambda: array.T, lambda: array[..., None],
            lambda: np.take(array, range(max(0, array.shape[axis] + rng.choice((-1, -2)))), axis),
            lambda: np.take(array, [], axis), lambda: np.concatenate([array, array], axis), lambda: array[..., :1],
            lambda: np.zeros(0), lambda: np.asfortranarray(array),
        ]  # fmt: skip
        try:
            return rng.choice(cut)()
        except (ValueError, IndexError):
            return array.reshape(-1)
    if way == 6:
        shape = rng.choice(((10**12,), (2**62, 4), (10**6, 10**6, 3), (-1, 3), (0, 3), array.shape[::-1], (2,) * 33))
        return _Forged(array.tobytes()[:1000], array.dtype.str, shape)
    if way == 7 and rng.random() < 0.1:
        return np.zeros(_LARGE)
    return form.scalars(rng)


class _Npz(_Tree):
    """Archives of arrays, stored or packed."""

    def read(self, content: bytes) -> Any:
        with np.load(io.BytesIO(content)) as archive:
            return {"members": dict(archive), "packed": False}

    def scalars(self, rng: random.Random) -> Any:
        value = super().scalars(rng)
        return value if isinstance(value, bool) else np.array(value, dtype=object if isinstance(value, dict) else None)

    def write(self, tree: Any, content: bytes) -> bytes:
        written = io.BytesIO()
        members = tree["members"]
        large = any(isinstance(value, np.ndarray) and value.size >= _LARGE for value in members.values())
        method = zipfile.ZIP_DEFLATED if tree.get("packed") or large else zipfile.ZIP_STORED
        with zipfile.ZipFile(written, "w", method, compresslevel=1) as archive:
            for name, value in members.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    if isinstance(value, _Forged):
                        header = {"descr": value.dtype, "fortran_order": False, "shape": value.shape}
                        np.lib.format.write_array_header_1_0(member, header)
                        member.write(value.content)
                    else:
                        np.lib.format.write_array(member, np.asarray(value), allow_pickle=True)
        return written.getvalue()


class _Pickle(_Tree):
    """Pickles of plain values and arrays."""

    def read(self, content: bytes) -> Any:
        return pickle.loads(content)

    def scalars(self, rng: random.Random) -> Any:
        import scipy.sparse

        endless: list[Any] = []
        endless.append(endless)
        doubling: Any = (1.0, 1.0)
        for _ in range(rng.choice((5, 20, 60))):
            doubling = rng.choice(((doubling, doubling), [doubling, doubling]))
        objects = np.empty(2, dtype=object)
        objects[:] = [doubling, {"a": 1}]
        odd = (
            endless,
            doubling,
            objects,
            {1, 2},
            b"bytes",
            1j,
            10**400,
            scipy.sparse.eye(3, format="csr"),
            np.float16(2),
        )
        return rng.choice((*odd, super().scalars(rng), super().scalars(rng)))

    def write(self, tree: Any, content: bytes) -> bytes:
        return pickle.dumps(_without_forgery(tree), protocol=2)


def _without_forgery(tree: Any) -> Any:
    if isinstance(tree, _Forged):
        return np.frombuffer(tree.content, dtype=np.uint8)
    return {key: _without_forgery(value) for key, value in tree.items()} if isinstance(tree, dict) else tree


class _Torch(_Tree):
    """Archives of torch."""

    def read(self, content: bytes) -> Any:
        import torch

        return _tensors(torch.load(io.BytesIO(content), weights_only=False), np.asarray)

    def write(self, tree: Any, content: bytes) -> bytes:
        import torch

        written = io.BytesIO()
        torch.save(_tensors(_without_forgery(tree), torch.from_numpy), written)
        return written.getvalue()


def _tensors(tree: Any, turned: Callable[[Any], Any]) -> Any:
    if isinstance(tree, Mapping):
        return {key: _tensors(value, turned) for key, value in tree.items()}
    return turned(tree) if hasattr(tree, "dtype") else tree


class _Json(_Tree):
    """JSON texts."""

    def read(self, content: bytes) -> Any:
        return json.loads(content)

    def write(self, tree: Any, content: bytes) -> bytes:
        return json.dumps(tree).encode()


class _Toml(_Tree):
    """TOML texts."""

    def read(self, content: bytes) -> Any:
        return tomllib.loads(content.decode())

    def write(self, tree: Any, content: bytes) -> bytes:
        return tomli_w.dumps(tree).encode()


class _Safetensors(_Tree):
    """Headers of safetensors files; the numbers after them stay."""

    def read(self, content: bytes) -> Any:
        return json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])

    def write(self, tree: Any, content: bytes) -> bytes:
        header = json.dumps(tree).encode()
        return struct.pack("<Q", len(header)) + header + content[8 + int.from_bytes(content[:8], "little") :]


class _Glb(_Tree):
    """Headers of GLB files; the numbers after them stay."""

    def read(self, content: bytes) -> Any:
        return json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])

    def write(self, tree: Any, content: bytes) -> bytes:
        header = json.dumps(tree).encode()
        header += b" " * (-len(header) % 4)
        rest = content[20 + int.from_bytes(content[12:16], "little") :]
        size = 20 + len(header) + len(rest)
        return struct.pack("<4sIIII", b"glTF", 2, size, len(header), 0x4E4F534A) + header + rest


_JSON = _Json()
_FORMATS: dict[str, tuple[Callable[[bytes, random.Random], bytes], ...]] = {
    ".npz": (_Npz(), _Npz(), _member_changed),
    ".pkl": (_Pickle(),),
    ".pth": (_Torch(), _member_changed),
    ".json": (_JSON, _text_changed),
    ".gltf": (_JSON, _text_changed),
    ".toml": (_Toml(), _text_changed),
    ".safetensors": (_Safetensors(),),
    ".glb": (_Glb(),),
    **dict.fromkeys((".obj", ".ply", ".off", ".stl", ".amc", ".asf", ".bvh", ".csv", ".txt"), (_text_changed,)),
}
