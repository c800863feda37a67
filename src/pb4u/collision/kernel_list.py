"""The kernels that a simulation compiles, as text: one a line, in the order in which a first run needs them.

`tools/list_kernels.py` writes `kernel_list.txt`. A line has the kernel and the types that it takes, such as
`pb4u.collision.box_tree:sort_along_widest float64*2 int64*1 int64 int64`, `*2` a contiguous array of two axes.
"""

from __future__ import annotations

import functools
import importlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from numba import types
from numba.core.dispatcher import Dispatcher

LIST = Path(__file__).with_name("kernel_list.txt")


@functools.cache
def listed_kernels() -> tuple[str, ...]:
    """The lines of the list."""
    return tuple(LIST.read_text(encoding="utf-8").splitlines())


def line_of(kernel: Dispatcher, signature: Sequence[Any]) -> str | None:
    """Line of a kernel, None where one of its types cannot be written.

    Args:
        kernel: whose name it has.
        signature: types of its arguments.
    """
    try:
        return " ".join([kernel_name(kernel), *(_written(kind) for kind in signature)])
    except TypeError:
        return None


def kernel_name(kernel: Dispatcher) -> str:
    """Module and name of a kernel, and in brackets those of the kernels that it closes over.

    Args:
        kernel: whose name it is.
    """
    function = kernel.py_func
    values = [cell.cell_contents for cell in function.__closure__ or ()]
    inner = ",".join(kernel_name(value) for value in values if isinstance(value, Dispatcher))
    return _place(function) + (f"[{inner}]" if inner else "")


def signature_of(line: str) -> tuple[str, tuple[Any, ...]]:
    """Name of a kernel and types of its arguments; the modules that they are of are imported.

    Args:
        line: of the list.
    """
    name, _, arguments = line.partition(" ")
    for module in re.findall(r"([\w.]+):", line):
        importlib.import_module(module)
    return name, tuple(_read(iter(re.findall(r"[\w.:*]+|[()]", f"{arguments})"))))


def _place(definition: Any) -> str:
    return f"{definition.__module__}:{definition.__qualname__}"


def _written(kind: Any) -> str:
    if isinstance(kind, types.Array) and kind == types.Array(kind.dtype, kind.ndim, kind.layout):
        return f"{kind.dtype}*{kind.ndim}" + ("" if kind.layout == "C" else kind.layout)
    if isinstance(kind, types.BaseTuple):
        place = _place(kind.instance_class) if isinstance(kind, types.BaseNamedTuple) else ""
        return f"{place}({' '.join(_written(element) for element in kind)})"
    if type(kind) in (types.Integer, types.Float, types.Boolean):
        return str(kind)
    raise TypeError(kind)


def _read(words: Iterator[str]) -> list[Any]:
    """Types up to the bracket that closes them."""
    read, class_of_tuple = [], tuple
    for word in words:
        if word == ")":
            break
        if word == "(":
            read.append(types.BaseTuple.from_types(_read(words), class_of_tuple))
            class_of_tuple = tuple
        elif ":" in word:
            module, _, name = word.partition(":")
            class_of_tuple = getattr(importlib.import_module(module), name)
        elif "*" in word:
            dtype, _, axes = word.partition("*")
            read.append(types.Array(getattr(types, dtype), int(axes[0]), axes[1:] or "C"))
        else:
            read.append(getattr(types, word))
    return read
