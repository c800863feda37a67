"""Reads pickled arrays without running anything that the file names."""

from __future__ import annotations

import io
import math
import mmap
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NamedTuple

import numpy as np

from pb4u.errors import InputError
from pb4u.io.array_archive import DamagedArchiveError, open_archive
from pb4u.io.pickle_limits import MOST_UNFOLDED, require_plain_pickle
from pb4u.io.reading_limits import Allowance, told_error

_SPARSE_FORMATS = ("csr", "csc", "coo")
_MOST_PLAIN = 2**20
"""Bytes of a file of joblib beside its arrays; each makes one object at most."""


class _Refused(Exception):
    """The file names something that is not plain data."""


class _Shell:
    """Stands for an object whose class is not run: keeps its state only."""

    kind = ""

    def __init__(self, *args: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        # A state with slots comes as (dict, slots).
        first = state[0] if isinstance(state, tuple) and state else state
        if isinstance(first, Mapping):
            self.state = {str(key): value for key, value in first.items()}


class _ArrayShell(_Shell):
    """Stands for a numpy array: numpy's own `__setstate__` trusts flags and sizes that a file can forge."""

    def __setstate__(self, state: Any) -> None:
        _, self.shape, self.dtype, self.fortran, self.content = state


class _DtypeShell(_Shell):
    """Stands for a numpy data type of numbers, text or objects."""

    def __init__(self, specification: object, *flags: object) -> None:
        if not isinstance(specification, str) or np.dtype(specification).kind not in "biufcmMSUO":
            raise _Refused(f"it holds an array of data type {specification!r}")
        self.dtype = np.dtype(specification)

    def __setstate__(self, state: Any) -> None:
        if state[1] in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(state[1])


def load_pickle(path: str | Path) -> Any:
    """Content of a pickle file made of numbers, strings, collections, numpy arrays and sparse matrices.

    Files of `joblib.dump` that are not compressed are read as well.

    Chumpy objects become plain arrays; pickles of Python 2 are read as latin-1. The classes and functions that the file
    names are never called: known ones are replaced by constructors of this module, all others are refused.

    Raises:
        InputError: the file cannot be read, names anything else, holds what contains itself, or would take more memory
            than it may.
    """
    path = Path(path)
    with _one_sentence(path, "arrays", "pickle of plain arrays"):
        allowance = Allowance(path)
        with path.open("rb") as file:
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                is_joblib = content.find(b"joblib.numpy_pickle", 0, _MOST_PLAIN) >= 0
                if not is_joblib:
                    require_plain_pickle(content, path)  # type: ignore[arg-type]
            unpickler = _JoblibUnpickler if is_joblib else _DataUnpickler
            return _Resolution(allowance).of(unpickler(file, allowance).load())


def load_torch_archive(path: str | Path) -> Any:
    """Content of a file that `torch.save` wrote, every tensor as a numpy array, read as `load_pickle` reads.

    Besides what `load_pickle` takes, tensors and parameters of 16, 32 and 64 bit floating point and whole numbers are
    known, on whichever device they lay; all other names are refused.

    Raises:
        InputError: the file is no whole archive of torch 1.6 or later, or names anything else.
    """
    path = Path(path)
    with _one_sentence(path, "tensors", "archive of plain tensors"):
        try:
            allowance = Allowance(path)
            with open_archive(path) as archive:
                members = _Archive(path, archive)
                require_plain_pickle(members.pickle(), path)
                return _Resolution(allowance).of(_ArchiveUnpickler(members, allowance).load())
        except DamagedArchiveError:
            raise InputError(
                f"{path} is not a torch file (or is damaged); give a .pth or .pt file that torch 1.6 or later saved."
            ) from None


def load_object_array(path: str | Path) -> Any:
    """What `numpy.save` wrote of one object: numbers, text, collections, arrays and tensors of torch, as `load_pickle`.

    Raises InputError when it is no such .npy, or names anything else.
    """
    path = Path(path)
    with _one_sentence(path, "arrays", ".npy of plain data"):
        allowance = Allowance(path)
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = header(file)
            if shape or not dtype.hasobject:
                raise InputError(f"{path} holds an array {shape} of {dtype}, and no dictionary.")
            content = io.BytesIO(file.read())
            require_plain_pickle(content, path)
            content.seek(0)
            unpickler = _DataUnpickler(content, allowance)
            unpickler._constructors["torch.storage", "_load_from_bytes"] = _stored_numbers
            unpickler._constructors["torch._utils", "_rebuild_tensor_v2"] = _tensor
            return _Resolution(allowance).of(unpickler.load()).item()


@contextmanager
def _one_sentence(path: Path, content: str, whole: str) -> Iterator[None]:
    """Whatever stops the reading of `path` as one InputError; `content` is what is read, `whole` what the file is not.

    A damaged pickle can raise nearly anything; what it raises says little to a user.
    """
    try:
        yield
    except InputError:
        raise
    except _Refused as refusal:
        raise InputError(f"{path}: {refusal}; only files of plain {content} are read, nothing in it was run.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except Exception as error:
        raise InputError(f"{path}: not a complete {whole} ({type(error).__name__}: {told_error(error)}).") from error


def _stored_numbers(content: Any) -> np.ndarray:
    """The numbers of a storage of torch, which it pickles as a file of `torch.save`."""
    import torch

    storage = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    return torch.tensor([], dtype=storage.dtype).set_(storage).numpy()


class _Names:
    """What an unpickler may call: nothing but `_constructors`, which are made for each file."""

    _constructors: dict[tuple[str, str], Any]

    def find_class(self, module: str, name: str) -> Any:
        constructor = self._constructors.get((module.replace("numpy._core", "numpy.core"), name))
        if constructor is not None:
            return constructor
        if module.split(".")[0] == "chumpy" and name.isidentifier():
            return type(name, (_Shell,), {"kind": "chumpy"})
        if module.startswith("scipy.sparse"):
            for sparse_format in _SPARSE_FORMATS:
                if name in (f"{sparse_format}_matrix", f"{sparse_format}_array"):
                    return type(name, (_Shell,), {"kind": sparse_format})
        raise _Refused(f'it asks for "{module}.{name}"')

    def persistent_load(self, pid: Any) -> Any:
        raise _Refused("it refers to data outside of itself")


class _DataUnpickler(_Names, pickle.Unpickler):
    """An unpickler of plain data."""

    def __init__(self, file: BinaryIO, allowance: Allowance) -> None:
        super().__init__(file, encoding="latin1")
        self._constructors = _constructors(allowance)


class _JoblibUnpickler(_Names, pickle._Unpickler):
    """An unpickler of `joblib.dump`, which writes the bytes of each array into the stream, after what describes it.

    Source of the layout: joblib 1.5, `numpy_pickle.py` (BSD). It needs the unpickler written in Python, as joblib does.

    Args:
        file: the stream.
        allowance: memory that it may take.
    """

    def __init__(self, file: BinaryIO, allowance: Allowance) -> None:
        self._file, self._allowance, self._plain = file, allowance, 0
        super().__init__(self, encoding="latin1")
        self._constructors = _constructors(allowance)
        self._constructors["joblib.numpy_pickle", "NumpyArrayWrapper"] = _InlineArray

    def read(self, size: int) -> bytes:
        """Bytes of the pickle itself, of which there are few beside the arrays."""
        self._plain += size
        if self._plain > _MOST_PLAIN:
            raise _Refused(f"it holds over {_MOST_PLAIN:,} bytes that are no arrays")
        return self._file.read(size)

    def readline(self) -> bytes:
        """A line of the pickle itself."""
        line = self._file.readline(_MOST_PLAIN)
        self._plain += len(line)
        return line

    def load_build(self) -> None:
        """Set the state of an object; the bytes of an array follow it."""
        super().load_build()  # type: ignore[misc]
        wrapper = self.stack[-1]  # type: ignore[attr-defined]
        if isinstance(wrapper, _InlineArray):
            self.stack[-1] = wrapper.read(self._file, self._allowance)  # type: ignore[attr-defined]

    dispatch: ClassVar[dict[int, Any]] = {**pickle._Unpickler.dispatch, pickle.BUILD[0]: load_build}


class _InlineArray(_Shell):
    """Stands for what describes an array in a file of joblib."""

    def read(self, file: BinaryIO, allowance: Allowance) -> np.ndarray:
        """The array whose bytes come next."""
        kind, shape, order = (self.state.get(name) for name in ("dtype", "shape", "order"))
        if not isinstance(kind, _DtypeShell) or not isinstance(shape, tuple) or kind.dtype.hasobject:
            raise _Refused("it holds an array of objects")
        if not all(type(n) is int and n >= 0 for n in shape):
            raise _Refused("it holds an array of an unknown shape")
        if self.state.get("numpy_array_alignment_bytes") is not None:
            file.read(int.from_bytes(file.read(1), "little"))
        size = math.prod(shape) * kind.dtype.itemsize
        if size > allowance.left:
            allowance.take(size, "an array")
        return _array(kind, shape, file.read(size), order == "F", allowance)


class _Storage(NamedTuple):
    """Stands for a storage class of torch: the data type of its numbers."""

    dtype: str


_STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "BoolStorage": "|b1",
}  # fmt: skip


class _Archive:
    """The members of a torch archive: a pickle that refers to storages, which are members of their own.

    Args:
        path: its file.
        archive: opened.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        members = archive.infolist()
        # Stored as they are, members are no larger than the file; packed ones could be of any size.
        packed = [member for member in members if member.compress_type != zipfile.ZIP_STORED]
        if packed or sum(member.file_size for member in members) > path.stat().st_size:
            raise _Refused("its members are packed, which torch.save never does")
        pickles = [member.filename for member in members if member.filename.endswith("data.pkl")]
        if len(pickles) != 1:
            raise _Refused("it is a zip file, but not one of torch.save")
        self._archive, self._folder = archive, pickles[0].removesuffix("data.pkl")
        if f"{self._folder}byteorder" in archive.namelist() and self._read("byteorder") != b"little":
            raise _Refused("its numbers are big-endian")

    def pickle(self) -> BinaryIO:
        return io.BytesIO(self._read("data.pkl"))

    def storage(self, kind: object, key: object) -> np.ndarray:
        if not isinstance(kind, _Storage) or not isinstance(key, str):
            raise _Refused("it holds a storage of an unknown kind")
        return np.frombuffer(self._read(f"data/{key}"), dtype=kind.dtype)

    def _read(self, member: str) -> bytes:
        return self._archive.read(self._folder + member)


class _ArchiveUnpickler(_DataUnpickler):
    """An unpickler that also knows the tensors of a torch archive."""

    def __init__(self, archive: _Archive, allowance: Allowance) -> None:
        super().__init__(archive.pickle(), allowance)
        self._archive = archive
        self._constructors |= {("torch", name): _Storage(dtype) for name, dtype in _STORAGES.items()}
        self._constructors["torch._utils", "_rebuild_tensor_v2"] = _tensor
        self._constructors["torch._utils", "_rebuild_parameter"] = _parameter

    def persistent_load(self, pid: Any) -> Any:
        if not isinstance(pid, tuple) or len(pid) != 5 or pid[0] != "storage":
            raise _Refused("it refers to data outside of itself")
        _, kind, key, _, _ = pid
        return self._archive.storage(kind, key)


def _tensor(storage: Any, offset: Any, size: Any, stride: Any, *flags: object) -> np.ndarray:
    """The view (size) of a storage as an array of its own; sizes and strides are what the file says."""
    numbers = (offset, *size, *stride)
    if not isinstance(storage, np.ndarray) or not all(type(n) is int and n >= 0 for n in numbers):
        raise _Refused("it holds a tensor of an unknown kind")
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    count = math.prod(size)
    if count > len(storage) or (count and last >= len(storage)):
        raise _Refused("it holds a tensor that is larger than its numbers")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:] if count else storage, size, steps).copy()


def _parameter(data: Any, *flags: object) -> Any:
    return data


def _constructors(allowance: Allowance) -> dict[tuple[str, str], Any]:
    """(module, name) -> what is called instead; closures, so that a file that alters them alters no other load."""

    class NdarrayName:
        """Stands for the class numpy.ndarray, which files name but need not call."""

        def __new__(cls, *args: object) -> Any:
            raise _Refused('it calls "numpy.ndarray"')

    def reconstruct(subtype: object, shape: object, kind: object) -> _ArrayShell:
        if subtype is not NdarrayName:
            raise _Refused("it holds an array of an unknown class")
        return _ArrayShell()

    def scalar(kind: object, content: object = None) -> Any:
        return _array(kind, (1,), content, False, allowance)[0]

    def from_buffer(buffer: Any, kind: object, shape: Any, order: object, axis_order: Any = None) -> np.ndarray:
        array = _array(kind, shape, buffer, order == "F", allowance)
        return array if axis_order is None else array.transpose(axis_order)

    def encode(text: object, encoding: object = "latin1") -> bytes:
        if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
            raise _Refused(f'it calls "_codecs.encode" with {encoding!r}')
        allowance.take(len(text), "a text turned into bytes")
        return text.encode("latin1")

    def no_bytes() -> bytes:
        # What the older protocols have for the content of an empty array.
        return b""

    def new_object(cls: object, base: object = None, state: object = None) -> Any:
        if not (isinstance(cls, type) and issubclass(cls, _Shell)):
            raise _Refused("it builds an object of an unknown class")
        return cls()

    def counted(kind: Callable[..., Any]) -> Callable[..., Any]:
        def build(*entries: Any) -> Any:
            if any(isinstance(given, str | bytes | bytearray) for given in entries):
                raise _Refused("it takes a text apart")
            allowance.take(64 + sum(128 * len(given) for given in entries if hasattr(given, "__len__")), "a collection")
            return kind(*entries)

        return build

    named: dict[tuple[str, str], Callable[..., Any]] = {
        ("numpy", "ndarray"): NdarrayName,
        # A subclass that adds nothing to what is pickled.
        ("trimesh.caching", "TrackedArray"): NdarrayName,
        ("numpy", "dtype"): _DtypeShell,
        ("numpy.core.multiarray", "_reconstruct"): reconstruct,
        ("numpy.core.multiarray", "scalar"): scalar,
        ("numpy.core.numeric", "_frombuffer"): from_buffer,
        ("_codecs", "encode"): encode,
        ("collections", "OrderedDict"): counted(OrderedDict),
        ("collections", "defaultdict"): lambda kind: {},
    }
    for builtins in ("builtins", "__builtin__"):
        named |= {(builtins, kind.__name__): counted(kind) for kind in (set, frozenset, list, dict, tuple)}
        named[builtins, "complex"] = complex
        named[builtins, "bytes"] = no_bytes
        named[builtins, "object"] = _Shell
    for registry in ("copyreg", "copy_reg"):
        named[registry, "_reconstructor"] = new_object
    return named


class _Resolution:
    """What a file holds, with every shell turned into an array or a sparse matrix.

    What is shared stays shared. Its entries are counted each time it is used, as whoever makes an array of it would.

    Args:
        allowance: memory that the file may take.
    """

    def __init__(self, allowance: Allowance) -> None:
        self._allowance = allowance
        self._done: dict[int, tuple[Any, int]] = {}
        self._open: set[int] = set()

    def of(self, value: Any) -> Any:
        """`value`, resolved."""
        return self._entries(value)[0]

    def _entries(self, value: Any) -> tuple[Any, int]:
        """`value`, resolved, and its number of entries."""
        if not isinstance(value, dict | list | tuple | _Shell):
            return value, 1
        if (done := self._done.get(id(value))) is not None:
            return done
        if id(value) in self._open:
            raise _Refused("it holds something that contains itself")
        self._open.add(id(value))
        if isinstance(value, dict):
            pairs = {key: self._entries(item) for key, item in value.items()}
            result: Any = type(value)((key, item) for key, (item, _) in pairs.items())
            count = sum(count for _, count in pairs.values())
        elif isinstance(value, list | tuple):
            items = [self._entries(item) for item in value]
            result, count = type(value)(item for item, _ in items), sum(count for _, count in items)
        elif isinstance(value, _ArrayShell):
            content, value.content = value.content, None
            content, count = self._entries(content) if isinstance(content, list) else (content, 1)
            result = _array(value.dtype, value.shape, content, bool(value.fortran), self._allowance)
        else:
            result, count = self._resolve_shell(value), 1
        if count > MOST_UNFOLDED:
            raise _Refused(f"its collections are nested in each other to over {MOST_UNFOLDED:,} entries")
        self._open.discard(id(value))
        self._done[id(value)] = result, count + 1
        return result, count + 1

    def _resolve_shell(self, shell: _Shell) -> Any:
        name = type(shell).__name__
        # Marked before its parts are visited: chumpy objects may point back at those that use them.
        self._done[id(shell)] = None, 1
        state = {key: self._entries(item)[0] for key, item in shell.state.items()}
        if shell.kind == "chumpy":
            return self._chumpy_value(name, state)
        if shell.kind in _SPARSE_FORMATS:
            return _sparse_matrix(shell.kind, state, self._allowance)
        raise _Refused(f'it holds an object of class "{name}"')

    def _chumpy_value(self, name: str, state: Mapping[str, Any]) -> np.ndarray:
        """The value of a chumpy leaf (`Ch`: its `x`) or of a selection of one (`Select`: flat `idxs` of its `a`)."""
        if name == "Ch" and "x" in state:
            return np.asarray(state["x"])
        if name == "Select" and "a" in state and "idxs" in state:
            places = np.asarray(state["idxs"], dtype=np.int64)
            self._allowance.take(8 * places.size, "a selection of an array")
            chosen = np.asarray(state["a"]).reshape(-1)[places]
            shape = state.get("preferred_shape")
            return chosen if shape is None else chosen.reshape([int(n) for n in shape])
        raise _Refused(f'it holds the chumpy expression "{name}", which is not a plain array')


def _array(kind: Any, shape: Any, content: Any, fortran: bool, allowance: Allowance) -> np.ndarray:
    """The array (shape) of data type `kind`, a `_DtypeShell`, with `content` as raw bytes or a list of objects."""
    if not isinstance(kind, _DtypeShell):
        raise _Refused("it holds an array of an unknown data type")
    order: Any = "F" if fortran else "C"
    allowance.take(8 * len(content) if isinstance(content, list) else len(content), "an array")
    if kind.dtype.hasobject:
        if not isinstance(content, list):
            raise _Refused("it holds objects as raw memory")
        objects = np.empty(len(content), dtype=object)
        objects[:] = content
        return objects.reshape(shape, order=order)
    # A copy of either, so that it can be written to.
    owned = bytearray(content, "latin1") if isinstance(content, str) else bytearray(content)
    return np.frombuffer(owned, dtype=kind.dtype).reshape(shape, order=order)


def _sparse_matrix(sparse_format: str, state: Mapping[str, Any], allowance: Allowance) -> Any:
    import scipy.sparse

    shape = tuple(int(n) for n in state["_shape" if "_shape" in state else "shape"])
    # Another format of it has a pointer for each row or column.
    allowance.take(8 * sum(shape), f"a sparse matrix of the shape {shape}")
    if sparse_format == "coo":
        row, column = state["coords"] if "coords" in state else (state["row"], state["col"])
        return scipy.sparse.coo_matrix((state["data"], (row, column)), shape=shape)
    kind = scipy.sparse.csr_matrix if sparse_format == "csr" else scipy.sparse.csc_matrix
    matrix = kind((state["data"], state["indices"], state["indptr"]), shape=shape)
    matrix.check_format(full_check=True)
    return matrix
