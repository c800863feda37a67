"""Four numbers that a kernel works on at once: the compiler finds no such groups by itself in loops over 3x3 blocks.

A vector of a vertex fills three of the lanes. What stands in the fourth never enters the others, so it may be anything.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, overload, register_model

from pb4u.collision.jit import compiled_into_callers

COUNT = 4


class Lanes(types.Type):
    """Four numbers of one type, with sums and products of each with each.

    Args:
        dtype: type of the numbers.
    """

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(f"Lanes({dtype})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, ir.VectorType(manager.lookup(lanes.dtype).get_value_type(), COUNT))


def _in_kernels(make: Callable[..., Any]) -> Callable[..., Any]:
    """What a kernel may call, by what `make` gives: its types, and the maker of its code."""
    return cast(Callable[..., Any], intrinsic(make))


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> tuple[Any, int]:
    """Address of the lanes that begin at one number of a contiguous array, and the alignment of a number."""
    kind = signature.args[0]
    offset = context.cast(builder, arguments[1], signature.args[1], types.intp)
    data = context.make_array(kind)(context, builder, arguments[0]).data
    place = builder.bitcast(builder.gep(data, [offset]), ir.PointerType(context.get_value_type(Lanes(kind.dtype))))
    return place, context.get_abi_sizeof(context.get_data_type(kind.dtype))


@_in_kernels
def lanes_at(_: Any, array: Any, offset: Any) -> Any:
    """The four numbers of a contiguous `array` from an `offset` on, counted in numbers."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, alignment = _place(context, builder, signature, arguments)
        return builder.load(place, align=alignment)

    return Lanes(array.dtype)(array, offset), make


@_in_kernels
def put_lanes(_: Any, array: Any, offset: Any, lanes: Any) -> Any:
    """Write `lanes` over the four numbers of a contiguous `array` from an `offset` on, counted in numbers."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, alignment = _place(context, builder, signature, arguments)
        builder.store(arguments[2], place, align=alignment)
        return context.get_dummy_value()

    return types.none(array, offset, lanes), make


@_in_kernels
def spread(_: Any, number: Any) -> Any:
    """The `number` in every lane."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.Constant(context.get_value_type(signature.return_type), ir.Undefined)
        for lane in range(COUNT):
            lanes = builder.insert_element(lanes, arguments[0], ir.Constant(ir.IntType(32), lane))
        return lanes

    return Lanes(number)(number), make


@_in_kernels
def lane(_: Any, lanes: Any, number: Any) -> Any:
    """One of the `lanes`, counted from 0."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(
            arguments[0], context.cast(builder, arguments[1], signature.args[1], types.int32)
        )

    return lanes.dtype(lanes, number), make


@_in_kernels
def as_doubles(_: Any, lanes: Any) -> Any:
    """The `lanes` in double precision."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wanted = context.get_value_type(signature.return_type)
        return arguments[0] if arguments[0].type == wanted else builder.fpext(arguments[0], wanted)

    return Lanes(types.float64)(lanes), make


@_in_kernels
def turned(_: Any, lanes: Any) -> Any:
    """The `lanes` one to the left, the first one last."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _picked(builder, arguments[0], arguments[0], (1, 2, 3, 0))

    return lanes(lanes), make


@_in_kernels
def sums_of_three(_: Any, first: Any, second: Any, third: Any) -> Any:
    """Sums of the first three lanes of each, in this order; the fourth is that of nothing."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, third = arguments
        near, far = _picked(builder, first, second, (0, 4, 1, 5)), _picked(builder, first, second, (2, 6, 2, 6))
        x, y = _picked(builder, near, third, (0, 1, 4, 4)), _picked(builder, near, third, (2, 3, 5, 5))
        return builder.fadd(builder.fadd(x, y), _picked(builder, far, third, (0, 1, 6, 6)))

    return first(first, second, third), make


def _picked(builder: Any, first: Any, second: Any, which: tuple[int, ...]) -> Any:
    return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(ir.IntType(32), COUNT), list(which)))


@_in_kernels
def _sum(_: Any, first: Any, second: Any) -> Any:
    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fadd(*arguments, flags=("contract",))

    return first(first, second), make


@_in_kernels
def _product(_: Any, first: Any, second: Any) -> Any:
    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fmul(*arguments, flags=("contract",))

    return first(first, second), make


def _sums(first: Any, second: Any) -> Any:
    return (lambda first, second: _sum(first, second)) if {type(first), type(second)} == {Lanes} else None


def _products(first: Any, second: Any) -> Any:
    return (lambda first, second: _product(first, second)) if {type(first), type(second)} == {Lanes} else None


overload(operator.add, strict=False)(_sums)
overload(operator.mul, strict=False)(_products)


@compiled_into_callers
def sum_of_three(lanes: Any) -> float:
    """Sum of the first three `lanes`."""
    return lane(lanes, 0) + lane(lanes, 1) + lane(lanes, 2)


@compiled_into_callers
def block_at(blocks: np.ndarray, block: int) -> Any:
    """The three rows of a block (3, 3) of contiguous `blocks`, as lanes."""
    place = 9 * block
    # The last one is read from before it, for behind it the array may end.
    return lanes_at(blocks, place), lanes_at(blocks, place + 3), turned(lanes_at(blocks, place + 5))


@compiled_into_callers
def padded(vectors: np.ndarray, dtype: Any) -> np.ndarray:
    """Vectors (rows, 3) as (rows, 4) of another type, 0 in the fourth lane."""
    result = np.zeros((len(vectors), 4), dtype)
    for row in range(len(vectors)):
        for axis in range(3):
            result[row, axis] = vectors[row, axis]
    return result
