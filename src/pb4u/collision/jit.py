"""The compiler of kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
import torch
from numba.core.dispatcher import Dispatcher
from torch import Tensor

from pb4u.collision.compile_ahead import is_coming
from pb4u.collision.kernel_cache import KernelCache

Compiled = TypeVar("Compiled", bound=Callable)


def compiled(function: Compiled) -> Compiled:
    """`function` compiled when first called; the machine code is kept on disk and does not hold up other threads.

    Args:
        function: what is compiled.
    """
    return _compiled(function, set())


def compiled_with_fused_products(function: Compiled) -> Compiled:
    """As `compiled`, a product and the sum that it enters rounded once: faster, for what compares nothing exactly.

    Args:
        function: what is compiled.
    """
    return _compiled(function, {"contract"})


def compiled_into_callers(function: Compiled) -> Compiled:
    """As `compiled_with_fused_products`, for what a loop calls once an element: its code becomes part of the loop's.

    Args:
        function: what is compiled.
    """
    return cast(
        Compiled, numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)(function)
    )


def compiled_with_free_sums(function: Compiled) -> Compiled:
    """As `compiled_with_fused_products`, and sums over columns taken in any order, many columns at once.

    Args:
        function: what is compiled.
    """
    return _compiled(function, {"contract", "reassoc"})


def _compiled(function: Compiled, freedom: set[str]) -> Compiled:
    kernel = numba.njit(nogil=True, error_model="numpy", fastmath=freedom)(function)
    if isinstance(kernel, Dispatcher):  # NUMBA_DISABLE_JIT leaves the function as it is
        kernel._cache = KernelCache(kernel, is_coming)  # type: ignore[attr-defined]
    return cast(Compiled, kernel)


def as_float64(values: Tensor) -> np.ndarray:
    """`values` as a contiguous float64 array, in their unit; its memory is that of the tensor where it can be.

    Args:
        values: (...) of any type.
    """
    if values.dtype is not torch.float64:
        values = values.to("cpu", torch.float64)
    return np.asarray(values.numpy(force=True), order="C")
