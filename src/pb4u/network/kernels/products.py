"""Products of a few hundred rows inside compiled kernels, where calls of a library would take longer than they do.

float32 on processors with AVX-512, for whose registers its blocks are cut; bfloat16, as bits in uint16, by the matrix
units (AMX) of those that have them. Sums are in float32 for both. Written in LLVM's terms, since Numba's own loops keep
no block of sums in registers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic, overload
from torch import Tensor

from pb4u.collision.jit import compiled

COLUMNS = 64
"""Outputs of a product come in blocks of so many columns: four vectors of 16, or four matrix tiles."""

_LANES, _VECTORS = 16, 4
_ROWS = 6
"""With four vectors each they take 24 of the 32 vector registers, which leaves room for the factors."""
_TILE_ROWS, _TILE_BYTES = 16, 64
_FLOAT, _WORD, _BYTE = ir.FloatType(), ir.IntType(64), ir.IntType(8)
_ADDRESS = _BYTE.as_pointer()
_VECTOR = ir.VectorType(_FLOAT, _LANES)

# Palette 1; eight tiles of 16 rows of 64 bytes: four of sums, one of rows and three of weights.
_TILES = np.zeros(64, np.uint8)
_TILES[0], _TILES[48:56] = 1, _TILE_ROWS
_TILES[16:32:2] = _TILE_BYTES


def multiplies_in(precision: torch.dtype) -> bool:
    """Whether kernels can multiply in `precision` here, faster than torch."""
    features = cpu_target.target_context.codegen().magic_tuple()[2]
    if precision != torch.bfloat16:
        return precision == torch.float32 and "+avx512f" in features
    # Linux lets a process use the registers of the units only once it has asked, which torch does.
    return "+amx-bf16" in features and hasattr(torch.cpu, "_init_amx") and torch.cpu._init_amx()


def packed(weight: Tensor, precision: torch.dtype) -> np.ndarray:
    """Weights of a layer as `multiply` reads them.

    Args:
        weight: (outputs, inputs); outputs are filled up to a multiple of `COLUMNS` with zeros.
        precision: float32 or bfloat16; in bfloat16 inputs are a multiple of 32.
    """
    outputs, inputs = weight.shape
    factor = torch.zeros(inputs, -(-outputs // COLUMNS) * COLUMNS)
    factor[:, :outputs] = weight.detach().t()
    if precision == torch.float32:
        blocks = factor.view(inputs, -1, COLUMNS).transpose(0, 1)
        return blocks.contiguous().numpy()
    # A tile holds two inputs of 16 outputs in each of its rows: (block, inputs / 32, tile of it, row, 32).
    pairs = factor.to(precision).view(inputs // 32, 16, 2, -1, 4, 16).permute(3, 0, 4, 1, 5, 2)
    return pairs.reshape(-1, inputs, COLUMNS).contiguous().view(torch.uint16).numpy()


def _constant(value: int) -> ir.Constant:
    return ir.Constant(_WORD, value)


def _counted(builder: Any, count: Any, sums: list[Any]) -> tuple[Any, Any, list[Any]]:
    """Begin a loop over `count`, one or more, that carries `sums`: its block, its index and what it carries."""
    entry, body = builder.block, builder.append_basic_block("products")
    builder.branch(body)
    builder.position_at_end(body)
    index = builder.phi(_WORD)
    index.add_incoming(_constant(0), entry)
    carried = []
    for value in sums:
        carried.append(builder.phi(value.type))
        carried[-1].add_incoming(value, entry)
    return body, index, carried


def _end(builder: Any, body: Any, index: Any, count: Any, carried: list[Any], sums: list[Any]) -> None:
    """End it, carrying `sums` on."""
    following, after = builder.add(index, _constant(1)), builder.append_basic_block("summed")
    index.add_incoming(following, body)
    for phi, value in zip(carried, sums, strict=True):
        phi.add_incoming(value, body)
    builder.cbranch(builder.icmp_signed("<", following, count), body, after)
    builder.position_at_end(after)


def _of_rows(rows: int) -> Any:
    """Product of `rows` rows and a block of columns in float32, kept in registers."""

    def declared(context: Any, a: Any, a_step: Any, weight: Any, out: Any, out_step: Any, inputs: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            a, a_step, weight, out, out_step, inputs = arguments
            a, weight, out = (builder.inttoptr(of, _FLOAT.as_pointer()) for of in (a, weight, out))

            def vector_at(base: Any, offset: Any) -> Any:
                return builder.bitcast(builder.gep(base, [offset]), _VECTOR.as_pointer())

            fused = builder.module.declare_intrinsic(
                "llvm.fma.v16f32", fnty=ir.FunctionType(_VECTOR, (_VECTOR, _VECTOR, _VECTOR))
            )
            zeros = [ir.Constant(_VECTOR, [0.0] * _LANES)] * (rows * _VECTORS)
            body, k, carried = _counted(builder, inputs, zeros)
            start = builder.mul(k, _constant(COLUMNS))
            factors = [
                builder.load(vector_at(weight, builder.add(start, _constant(_LANES * v))), align=4)
                for v in range(_VECTORS)
            ]
            sums = []
            for row in range(rows):
                value = builder.load(builder.gep(a, [builder.add(builder.mul(a_step, _constant(row)), k)]))
                nothing, first = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.IntType(32), 0)
                lanes = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
                spread = builder.shuffle_vector(builder.insert_element(nothing, value, first), nothing, lanes)
                for v in range(_VECTORS):
                    sums.append(builder.call(fused, [spread, factors[v], carried[row * _VECTORS + v]]))
            _end(builder, body, k, inputs, carried, sums)
            for row in range(rows):
                for v in range(_VECTORS):
                    place = builder.add(builder.mul(out_step, _constant(row)), _constant(_LANES * v))
                    builder.store(sums[row * _VECTORS + v], vector_at(out, place), align=4)
            return context.get_dummy_value()

        return types.void(*[types.int64] * 6), generate

    return intrinsic(declared)


_of_six_rows, _of_one_row = _of_rows(_ROWS), _of_rows(1)


def _unit(builder: Any, name: str, *arguments: Any) -> None:
    """Call an instruction of the matrix units."""
    name = f"llvm.x86.{name}"
    function = builder.module.globals.get(name)
    if function is None:
        kinds = [argument.type for argument in arguments]
        function = ir.Function(builder.module, ir.FunctionType(ir.VoidType(), kinds), name)
    builder.call(function, arguments)


@intrinsic
def _begin_tiles(context: Any, tiles: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _unit(builder, "ldtilecfg", builder.inttoptr(arguments[0], _ADDRESS))
        return context.get_dummy_value()

    return types.void(types.int64), generate


@intrinsic
def _end_tiles(context: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _unit(builder, "tilerelease")
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def _of_tile(context: Any, a: Any, a_step: Any, weight: Any, out: Any, out_step: Any, parts: Any) -> Any:
    """Product of 16 rows and a block of columns in bfloat16; steps in bytes, 32 inputs a part."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, a_step, weight, out, out_step, parts = arguments

        def tile(number: int) -> ir.Constant:
            return ir.Constant(_BYTE, number)

        def at(base: Any, offset: Any) -> Any:
            return builder.inttoptr(builder.add(base, offset), _ADDRESS)

        for column in range(4):
            _unit(builder, "tilezero", tile(column))
        body, part, _ = _counted(builder, parts, [])
        _unit(builder, "tileloadd64", tile(4), at(a, builder.mul(part, _constant(_TILE_BYTES))), a_step)
        start = builder.mul(part, _constant(4 * _TILE_ROWS * _TILE_BYTES))
        for column in range(4):
            weights = at(weight, builder.add(start, _constant(column * _TILE_ROWS * _TILE_BYTES)))
            _unit(builder, "tileloadd64", tile(5 + column % 3), weights, _constant(_TILE_BYTES))
            _unit(builder, "tdpbf16ps", tile(column), tile(4), tile(5 + column % 3))
        _end(builder, body, part, parts, [], [])
        for column in range(4):
            _unit(builder, "tilestored64", tile(column), at(out, _constant(column * _TILE_BYTES)), out_step)
        return context.get_dummy_value()

    return types.void(*[types.int64] * 6), generate


@compiled
def _multiply_float32(values: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    rows, inputs = values.shape
    a_step, out_step = values.strides[0] // 4, out.strides[0] // 4
    for block in range(weight.shape[0]):
        a, b = values.ctypes.data, weight.ctypes.data + 4 * block * inputs * COLUMNS
        o = out.ctypes.data + 4 * block * COLUMNS
        whole = rows - rows % _ROWS
        for row in range(0, whole, _ROWS):
            _of_six_rows(a + 4 * row * a_step, a_step, b, o + 4 * row * out_step, out_step, inputs)
        for row in range(whole, rows):
            _of_one_row(a + 4 * row * a_step, a_step, b, o + 4 * row * out_step, out_step, inputs)


@compiled
def _multiply_bfloat16(values: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    rows, inputs = values.shape
    if rows < _TILE_ROWS:
        padded, filled = np.zeros((_TILE_ROWS, inputs), np.uint16), np.empty((_TILE_ROWS, out.shape[1]), np.float32)
        padded[:rows] = values
        _multiply_tiles(padded, weight, filled)
        out[:rows] = filled[:rows]
    else:
        _multiply_tiles(values, weight, out)


@compiled
def _multiply_tiles(values: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    rows, inputs = values.shape
    _begin_tiles(_TILES.ctypes.data)  # type: ignore[call-arg]  # what compiles it is given the first
    for block in range(weight.shape[0]):
        b, o = weight.ctypes.data + 2 * block * inputs * COLUMNS, out.ctypes.data + 4 * block * COLUMNS
        for first in range(0, rows, _TILE_ROWS):
            # The last tile begins early enough to be full.
            row = min(first, rows - _TILE_ROWS)
            a = values.ctypes.data + row * values.strides[0]
            _of_tile(a, values.strides[0], b, o + row * out.strides[0], out.strides[0], inputs // 32)
    _end_tiles()


def multiply(values: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (rows, outputs) float32 with the product of `values` (rows, inputs) and weights; compiled code only.

    Args:
        values: float32, or bfloat16 as uint16; columns one after another in memory.
        weight: from `packed`, in the same precision.
        out: overwritten; columns one after another in memory.
    """
    raise NotImplementedError


@overload(multiply, strict=False)
def _multiply_of(values: Any, weight: Any, out: Any) -> Any:
    if isinstance(values.dtype, types.Float):
        return lambda values, weight, out: _multiply_float32(values, weight, out)
    return lambda values, weight, out: _multiply_bfloat16(values, weight, out)
