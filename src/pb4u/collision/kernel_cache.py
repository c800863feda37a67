"""Machine code of kernels on disk, found by what it was compiled from: edited, a kernel and its callers compile again.

Numba looks at the file of a kernel alone, and at that file's place. Here a name holds a digest of the code of the
kernel, of every kernel that it calls, in whatever file, of the constants that they read, and of the names of the types
that they take, which are in the files too. So no code is stale, and copies of the package share one folder.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import stat
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any
from weakref import WeakSet

import numpy as np
from filelock import FileLock
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from pb4u.errors import warn
from pb4u.io.cache_folder import cache_folder

PACKAGE = Path(__file__).resolve().parents[1]
KEPT_DAYS = 30
"""After so many days, code of a kernel's earlier versions is deleted [days]."""
KERNELS: WeakSet[Dispatcher] = WeakSet()
"""All that have a cache."""


class KernelCache:
    """What a dispatcher of Numba asks of a cache, made when the kernel is first called: its callees exist by then.

    Args:
        kernel: whose machine code it keeps.
        is_coming: whether another process is about to compile a kernel for a signature; it is waited for.
    """

    def __init__(self, kernel: Dispatcher, is_coming: Callable[[Dispatcher, Any], bool]) -> None:
        self._kernel, self._is_coming = kernel, is_coming
        KERNELS.add(kernel)

    @functools.cached_property
    def _files(self) -> FunctionCache:
        return _KernelFiles(self._kernel)

    @property
    def cache_path(self) -> str:
        """Folder of the compiled kernels."""
        return str(self._files.cache_path)

    @property
    def is_kept(self) -> bool:
        """Whether machine code of the kernel is kept, for any types."""
        return Path(self.cache_path, f"{self._files._impl.filename_base}.nbi").exists()

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Machine code for a signature, None where none was kept.

        Args:
            signature: types of the arguments.
            target: what Numba compiles for.
        """
        if not is_trusted(Path(self.cache_path)):
            return None
        try:
            code = self._files.load_overload(signature, target)
            while code is None and self._is_coming(self._kernel, signature):
                time.sleep(0.02)
                code = self._files.load_overload(signature, target)
            return code
        except (AttributeError, EOFError, ImportError, pickle.UnpicklingError):
            # Damaged, or of a type that is no longer there: it is compiled again, and written over.
            with contextlib.suppress(OSError):
                self._files.flush()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep machine code; where that cannot be, say once where it could.

        Args:
            signature: types of the arguments.
            compiled: what Numba compiled.
        """
        folder = Path(self.cache_path)
        if not is_writable(folder):
            _say_where_kernels_could_be_kept(folder)
            return
        with contextlib.suppress(OSError), FileLock(folder / ".lock"):  # a full disk costs time alone
            self._files.save_overload(signature, compiled)
            _delete_earlier_versions(self._files)


def kernel_folder() -> Path:
    """Folder of machine code: NUMBA_CACHE_DIR, beside the package, or the user's cache; the first that can be used.

    A folder that cannot be written is used where somebody whom this process trusts has filled it.
    """
    places = [PACKAGE / "__pycache__", cache_folder()]
    if config.CACHE_DIR:
        places.insert(0, Path(config.CACHE_DIR))
    folders = [place / "kernels" for place in places]
    usable = (folder for folder in folders if is_writable(folder) or is_trusted(folder))
    return next(usable, folders[-1])


def is_writable(folder: Path) -> bool:
    """Whether this process may write into a trusted folder, which is made where there is none.

    Args:
        folder: of machine code.
    """
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    return is_trusted(folder) and os.access(folder, os.W_OK)


def is_trusted(folder: Path) -> bool:
    """Whether nobody else may put machine code there but root and the owner of this package.

    Args:
        folder: of machine code, absent or not.
    """
    try:
        status = folder.lstat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode):
        return False
    if not hasattr(os, "getuid"):  # Windows: folders of a user are its own
        return True
    owners = {0, os.getuid(), PACKAGE.stat().st_uid}
    return status.st_uid in owners and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def digest(kernel: Dispatcher) -> str:
    """Name of all that a kernel is compiled from: its code, that of its callees, their constants and types.

    Args:
        kernel: whose code it is.
    """
    content = hashlib.sha256()
    for part in _parts(kernel, set()):
        content.update(part.encode())
    return content.hexdigest()[:20]


def _parts(kernel: Dispatcher, seen: set[Dispatcher]) -> Iterator[str]:
    if kernel in seen:
        return
    seen.add(kernel)
    function = kernel.py_func
    freedom = sorted(kernel.targetoptions.get("fastmath") or ())
    names = list(_code(function.__code__))
    yield f"{function.__qualname__}{function.__defaults__}{function.__annotations__}{freedom}{names}"
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    reached = {name: cell.cell_contents for name, cell in cells} | function.__globals__
    for name in sorted({name for _, _, reads, _ in names for name in reads} & reached.keys()):
        yield from _value(name, reached[name], names, seen)


def _code(code: CodeType) -> Iterator[tuple[str, str, tuple[str, ...], tuple[str, ...]]]:
    """Instructions, constants, and names of a function and of the functions within it."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    constants = tuple(constant for constant in code.co_consts if not isinstance(constant, CodeType))
    yield code.co_code.hex(), repr(constants), code.co_names + code.co_freevars, code.co_varnames
    for function in inner:
        yield from _code(function)


def _value(name: str, value: Any, code: list[Any], seen: set[Dispatcher]) -> Iterator[str]:
    """What a name stands for: the code of a kernel, a constant, or the name of something of a library."""
    if isinstance(value, Dispatcher):
        yield name
        yield from _parts(value, seen)
    elif isinstance(value, _Intrinsic):
        # What else its module defines, such as operators of the types that it makes, is reached by no name.
        module = Path(value._defn.__code__.co_filename)
        yield f"{name}:{hashlib.sha256(module.read_bytes()).hexdigest()}"
    elif isinstance(value, ModuleType) and value.__name__.partition(".")[0] not in ("numpy", "math", "numba"):
        attributes = {attribute for _, _, reads, _ in code for attribute in reads}
        for attribute in sorted(attributes & vars(value).keys()):
            yield from _value(f"{name}.{attribute}", vars(value)[attribute], code, seen)
    elif isinstance(value, np.ndarray):
        yield f"{name}:{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    elif isinstance(value, (bool, int, float, complex, str, bytes, tuple, np.generic, np.dtype)):
        yield f"{name}:{value!r}"
    else:
        yield f"{name}:{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)}"


class _Place:
    """Where the machine code of one kernel lies, in Numba's terms."""

    def __init__(self, kernel: Dispatcher) -> None:
        self._py_file = kernel.py_func.__code__.co_filename  # for Numba's warnings
        self._digest = digest(kernel)
        self._folder = kernel_folder()

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return self._digest

    def ensure_cache_path(self) -> None: ...


class _KernelCode(CompileResultCacheImpl):  # type: ignore[misc]
    def __init__(self, kernel: Dispatcher) -> None:
        self._locator = _Place(kernel)
        self._lineno = kernel.py_func.__code__.co_firstlineno
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        self._filename_base = self.get_filename_base(name, getattr(sys, "abiflags", ""))


class _KernelFiles(FunctionCache):  # type: ignore[misc]
    _impl_class = _KernelCode

    def _index_key(self, signature: Any, codegen: Any) -> tuple:
        return signature, codegen.magic_tuple()  # the rest of the key is in the files' names


def _delete_earlier_versions(files: FunctionCache) -> None:
    current = files._impl.filename_base
    kernel = current.partition("-")[0]
    for path in Path(files.cache_path).glob(f"{kernel}-*"):
        with contextlib.suppress(OSError):
            if not path.name.startswith(current) and time.time() - path.stat().st_atime > KEPT_DAYS * 86400:
                path.unlink()


@functools.cache
def _say_where_kernels_could_be_kept(folder: Path) -> None:
    warn(
        f"Compiled kernels cannot be stored in {folder}, so every run compiles them again: set NUMBA_CACHE_DIR to a "
        "folder to which only you can write."
    )
