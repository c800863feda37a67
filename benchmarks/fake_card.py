"""A step of a network alone on a card that is not there: torch's fake tensors on "cuda:0", and what the step does there.

Reading a value back, a shape that waits for data, tensors of two devices in one operation are errors of such a step.
Copies from the processor are counted: each makes a real card wait. In a process of its own, as torch's guard of devices
is changed for good.
"""

from __future__ import annotations

import copy
import ctypes
import dataclasses
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

CARD = torch.device("cuda:0")
_CUDA, _META = 1, 14
_NO_KERNEL = {
    "view", "_unsafe_view", "expand", "select", "slice", "unsqueeze", "squeeze", "t", "transpose", "permute", "detach",
    "alias", "as_strided", "unbind", "split", "split_with_sizes", "diagonal", "unfold", "empty", "empty_strided",
    "new_empty", "empty_like", "lift_fresh", "_reshape_alias", "reshape", "unsafe_split", "narrow", "chunk",
    "new_empty_strided", "set_", "is_same_size", "_local_scalar_dense",
}  # fmt: skip
_SEVERAL = {"sort": 8, "argsort": 8, "topk": 4, "cumsum": 2, "nonzero_static": 4, "_embedding_bag": 2, "index_put": 3}
"""Kernels that the library launches for one operation, from its sources and roughly; the others launch one."""


class Counted(TorchDispatchMode):
    """Counts what runs under it.

    Attributes:
        launches: kernels by name of the operation.
        read_and_written: bytes.
        operations: floating point, of products of matrices, and of the rest one for each number written, by data type.
        transfers: copies between the processor and the card, by the line that asked for them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.launches: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.transfers: Counter[str] = Counter()
        self.read_and_written = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        out = func(*args, **kwargs)
        name = func._schema.name.split("::")[1].removesuffix("_") or func._schema.name
        inputs, outputs = list(_tensors((args, kwargs))), list(_tensors(out))
        places = {t.device.type for t in inputs if t.dim() or t.device.type == "cuda"}
        if outputs and {t.device.type for t in outputs} - places and places:
            self.transfers[_place()] += 1
        elif any(t.device.type == "cuda" for t in outputs) and name not in _NO_KERNEL and out is not (args or [None])[0]:
            self.launches[name] += _SEVERAL.get(name, 1)
            self.read_and_written += sum(_bytes(t) for t in (*inputs, *outputs))
            kind = str(outputs[0].dtype).removeprefix("torch.")
            formula = flop_registry.get(func._overloadpacket)
            done = formula(*args, **kwargs, out_val=out) if formula else sum(t.numel() for t in outputs)
            self.operations[kind if outputs[0].is_floating_point() else "integers"] += int(done)
        return out


def _place() -> str:
    """The innermost line of the package that is being executed."""
    frames = [frame for frame in traceback.extract_stack() if "/pb4u/" in frame.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "outside"


def _tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from _tensors(part)
    elif isinstance(value, dict):
        yield from _tensors(list(value.values()))


def _bytes(values: Tensor) -> int:
    """Memory that `values` span: an expanded axis is read from cache."""
    spanned = 1
    for size, stride in zip(values.shape, values.stride(), strict=True):
        spanned *= size if stride else 1
    return spanned * values.element_size()


@contextmanager
def fake_card() -> Iterator[None]:
    """Tensors made within are fake; operations on `CARD` need no CUDA."""
    library = ctypes.CDLL(str(next((Path(torch.__file__).parent / "lib").glob("libc10.*"))))
    guards = (ctypes.c_void_p * 24).in_dll(library, "_ZN3c104impl26device_guard_impl_registryE")
    if not torch.cuda.is_available():
        # The guard of meta tensors switches to no device, which is all that fake ones need.
        guards[_CUDA] = guards[_META]
        torch.cuda._lazy_init = lambda: None  # type: ignore[assignment]
    with FakeTensorMode(allow_non_fake_inputs=True):
        yield


def faked(value: Any, known: dict[int, Any] | None = None) -> Any:
    """A copy of records, modules and other objects in which every tensor is a fake one on `CARD`."""
    known = {} if known is None else known
    if id(value) in known:
        return known[id(value)]
    made: Any = value
    if isinstance(value, nn.Parameter):
        made = nn.Parameter(_on_card(value), requires_grad=value.requires_grad)
    elif isinstance(value, Tensor):
        made = _on_card(value)
    elif isinstance(value, torch.device):
        made = CARD
    elif isinstance(value, (tuple, list)) and not hasattr(value, "_fields"):
        made = type(value)(faked(part, known) for part in value)
    elif isinstance(value, dict):
        made = {faked(key, known): faked(part, known) for key, part in value.items()}
    elif dataclasses.is_dataclass(value) or type(value).__module__.startswith(("pb4u", "torch.nn")):
        if isinstance(value, type):
            return value
        made = copy.copy(value)
        known[id(value)] = made
        vars(made).update({name: faked(part, known) for name, part in vars(value).items()})
    known[id(value)] = made
    # What an address stands for must live as long as it is known.
    known.setdefault(-id(value), value)
    return made


def _on_card(values: Tensor) -> Tensor:
    return torch.empty_strided(values.shape, values.stride(), dtype=values.dtype, device=CARD)
