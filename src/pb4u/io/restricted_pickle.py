"""Reads pickled arrays and tensors without running anything that a file names."""

from __future__ import annotations

import io
import math
import pickle
import re
import zipfile
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import refusing


class _Refused(Exception):
    """The file names something that is not plain data."""


def load_pickle(path: str | Path) -> Any:
    """Content of a pickle file made of numbers, strings, collections, numpy arrays and sparse matrices.

    Files of `joblib.dump` that are not compressed are read as well. Chumpy objects become plain arrays; pickles of
    Python 2 are read as latin-1. The classes and functions that the file names are never called: known ones are
    replaced by constructors of this module, all others are refused.

    Args:
        path: the file.

    Raises:
        InputError: the file cannot be read, or names anything else.
    """
    path = Path(path)
    with _plain(path, "pickle of plain arrays"), path.open("rb") as file:
        return _Unpickler(file).load()


def load_object_array(path: str | Path) -> Any:
    """Object in a file of `numpy.save`: numbers, text, collections, arrays and tensors of torch, as in `load_pickle`.

    Args:
        path: the file.

    Raises:
        InputError: it is no such .npy, or names anything else.
    """
    path = Path(path)
    with _plain(path, ".npy of plain data"), path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(file)
        if shape or not dtype.hasobject:
            raise InputError(f"{path} holds an array {shape} of {dtype}, not a dictionary.")
        return _Unpickler(file).load().item()


def load_tensors(path: str | Path) -> Any:
    """Tensors, numbers, text and collections of them in a file of `torch.save`, by `torch.load(weights_only=True)`.

    Args:
        path: the file. Tensors are memory-mapped: only those used are read.

    Raises:
        InputError: the file is not a complete archive of torch 1.6 or later, or names anything else.
    """
    import torch

    path = Path(path)
    with _plain(path, "file that torch 1.6 or later saved"):
        if not zipfile.is_zipfile(path):
            raise InputError(f"{path} is not a complete file of torch.save (torch 1.6 or later); download it again.")
        with zipfile.ZipFile(path) as archive:
            if any(member.compress_type != zipfile.ZIP_STORED for member in archive.infolist()):
                raise InputError(f"{path}: its members are compressed, which torch.save never does.")
        try:
            return torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        except pickle.UnpicklingError as error:
            # What torch says of it fills a page.
            callee = re.search(r"GLOBAL (\S+)", str(error))
            raise _Refused(f'it asks for "{callee[1]}"' if callee else "it is damaged") from None


@contextmanager
def _plain(path: Path, kind: str) -> Iterator[None]:
    try:
        with refusing(path, f"is not a complete {kind}"):
            yield
    except InputError as error:
        if not isinstance(error.__cause__, _Refused):
            raise
        raise InputError(
            f"{path}: {error.__cause__}; only plain data is read, and nothing in the file was run."
        ) from None


class _Shell:
    """Stands for an object of a class that is not run; `made` gives the array that it holds."""

    def __init__(self, *args: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        # A state with slots comes as (dict, slots).
        first = state[0] if isinstance(state, tuple) and state else state
        self.state = {str(key): value for key, value in first.items()} if isinstance(first, Mapping) else {}

    def made(self, file: BinaryIO) -> Any:
        raise _Refused("it holds an object of an unknown class")


class _Chumpy(_Shell):
    """A chumpy leaf (`Ch`: its `x`) or a selection of one (`Select`: flat `idxs` of its `a`)."""

    def made(self, file: BinaryIO) -> Any:
        name, state = type(self).__name__, self.state
        if name == "Ch" and "x" in state:
            return np.asarray(state["x"])
        if name == "Select" and "a" in state and "idxs" in state:
            chosen = np.asarray(state["a"]).reshape(-1)[np.asarray(state["idxs"], dtype=np.int64)]
            shape = state.get("preferred_shape")
            return chosen if shape is None else chosen.reshape([int(n) for n in shape])
        raise _Refused(f'it holds the chumpy expression "{name}", which is not a plain array')


class _Sparse(_Shell):
    """A matrix of scipy as body models have it, whose indices are checked before compiled code follows them."""

    def made(self, file: BinaryIO) -> Any:
        import scipy.sparse

        state = self.state
        shape = tuple(int(n) for n in state["_shape" if "_shape" in state else "shape"])
        matrix = scipy.sparse.csc_matrix((state["data"], state["indices"], state["indptr"]), shape=shape)
        matrix.check_format(full_check=True)
        return matrix


class _JoblibArray(_Shell):
    """What describes an array in a file of joblib, whose bytes come next.

    Source of the layout: joblib 1.5, `numpy_pickle.py` (BSD).
    """

    def made(self, file: BinaryIO) -> np.ndarray:
        kind, shape, order = (self.state.get(name) for name in ("dtype", "shape", "order"))
        if not isinstance(kind, np.dtype) or not isinstance(shape, tuple) or kind.hasobject:
            raise _Refused("it holds an array of objects")
        if self.state.get("numpy_array_alignment_bytes") is not None:
            file.read(int.from_bytes(file.read(1), "little"))
        content = file.read(math.prod(shape) * kind.itemsize)
        return _from_buffer(content, kind, shape, order)


class _Unpickler(pickle._Unpickler):
    """An unpickler of plain data. The one written in Python: its handling of states can be restricted."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="latin1")
        self._file = file

    def find_class(self, module: str, name: str) -> Any:
        """What stands for what a file names."""
        stand_in = _KNOWN.get((module.replace("numpy._core", "numpy.core"), name))
        if stand_in is not None:
            return stand_in
        if module.split(".")[0] == "chumpy" and name.isidentifier():
            return type(name, (_Chumpy,), {})
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csc_array"):
            return type(name, (_Sparse,), {})
        raise _Refused(f'it asks for "{module}.{name}"')

    def load_build(self) -> None:
        """Set the state of an array, a data type or a shell; of nothing else, for a state can replace attributes."""
        stack: list[Any] = self.stack  # type: ignore[attr-defined]
        built = stack[-2]
        if isinstance(built, np.dtype):
            # Its state can make foreign memory of an array's bytes: all of it but the order of bytes is left alone.
            if stack.pop()[1] == ">":
                built.__setstate__((3, ">", None, None, None, -1, -1, 0))  # type: ignore[attr-defined]
            return
        if isinstance(built, np.ndarray):
            _, shape, kind, _, content = stack[-1]  # numpy trusts a shape that a file can forge
            if len(content) != math.prod(shape) * (1 if kind.hasobject else kind.itemsize) or min(shape, default=0) < 0:
                raise ValueError(f"an array of shape {shape} has another number of entries")
        elif not isinstance(built, _Shell):
            raise _Refused("it sets the state of an object of an unknown class")
        super().load_build()  # type: ignore[misc]
        if isinstance(built, _Shell):
            stack[-1] = value = built.made(self._file)
            memo: dict[int, Any] = self.memo  # type: ignore[attr-defined]
            memo.update({place: value for place, entry in memo.items() if entry is built})

    dispatch: ClassVar[dict[int, Any]] = {**pickle._Unpickler.dispatch, pickle.BUILD[0]: load_build}


def _dtype(code: object, *flags: object) -> np.dtype:
    kind = np.dtype(code, copy=True) if isinstance(code, str) else None
    if kind is None or kind.kind not in "biufcSUO":
        raise _Refused(f"it holds an array of data type {code!r}")
    return kind


def _empty_array(subtype: object, *rest: object) -> np.ndarray:
    if subtype != "numpy.ndarray":
        raise _Refused("it holds an array of an unknown class")
    return np.empty(0)


def _from_buffer(content: Any, kind: Any, shape: Any, order: Any, axis_order: Any = None) -> np.ndarray:
    """An array (shape) that can be written to; numpy refuses objects, and sizes that are not those of the content."""
    owned = bytearray(content, "latin1") if isinstance(content, str) else bytearray(content)
    array = np.frombuffer(owned, dtype=kind).reshape(shape, order="F" if order == "F" else "C")
    return array if axis_order is None else array.transpose(axis_order)


def _encode(text: str, encoding: object = "latin1") -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise _Refused(f'it calls "_codecs.encode" with {encoding!r}')
    return text.encode("latin1")


def _new_object(cls: object, *rest: object) -> Any:
    if not (isinstance(cls, type) and issubclass(cls, _Shell)):
        raise _Refused("it builds an object of an unknown class")
    return cls()


def _torch_storage(content: bytes) -> Any:
    """A storage of torch, which it pickles as a file of `torch.save`."""
    import torch

    return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)


def _torch_tensor(storage: Any, offset: int, size: Any, stride: Any, *flags: object) -> np.ndarray:
    import torch

    values = torch.tensor([], dtype=storage.dtype).set_(storage, offset, torch.Size(size), stride)
    return np.array(values.numpy())


# (module, name) -> what is called instead. A class that files name but need not call stands as its name.
_KNOWN: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): "numpy.ndarray",
    # A subclass that adds nothing to what is pickled.
    ("trimesh.caching", "TrackedArray"): "numpy.ndarray",
    ("numpy", "dtype"): _dtype,
    ("numpy.core.multiarray", "_reconstruct"): _empty_array,
    ("numpy.core.multiarray", "scalar"): lambda kind, content: _from_buffer(content, kind, (1,), "C")[0],
    ("numpy.core.numeric", "_frombuffer"): _from_buffer,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
    ("torch.storage", "_load_from_bytes"): _torch_storage,
    ("torch._utils", "_rebuild_tensor_v2"): _torch_tensor,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): lambda kind: {},
    **{(module, "_reconstructor"): _new_object for module in ("copyreg", "copy_reg")},
}
for _module in ("builtins", "__builtin__"):
    _KNOWN |= {(_module, kind.__name__): kind for kind in (set, frozenset, list, dict, tuple, complex)}
    # What the older protocols have for the content of an empty array, and for the base of a class.
    _KNOWN |= {(_module, "bytes"): lambda: b"", (_module, "object"): "object"}
