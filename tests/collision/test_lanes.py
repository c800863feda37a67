"""Groups of four numbers in kernels, against NumPy."""

import numpy as np
import pytest

from pb4u.collision.jit import compiled
from pb4u.collision.lanes import (
    as_doubles,
    block_at,
    lane,
    lanes_at,
    padded,
    put_lanes,
    spread,
    sum_of_three,
    sums_of_three,
)


@compiled
def _products(blocks: np.ndarray, vectors: np.ndarray, product: np.ndarray, transposed: np.ndarray) -> float:
    total = spread(0.0)
    for row in range(len(vectors)):
        here = lanes_at(vectors, 4 * row)
        first, second, third = block_at(blocks, row)
        put_lanes(product, 4 * row, sums_of_three(first * here, second * here, third * here))
        x, y, z = spread(lane(here, 0)), spread(lane(here, 1)), spread(lane(here, 2))
        put_lanes(transposed, 4 * row, first * x + (second * y + third * z))
        total = total + as_doubles(here * here)
    return sum_of_three(total)


@compiled
def _padded(vectors: np.ndarray, like: np.ndarray) -> np.ndarray:
    return padded(vectors, like.dtype.type)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blocks_are_multiplied_from_both_sides_and_nothing_is_written_beyond(dtype: type[np.floating]) -> None:
    rng = np.random.default_rng(0)
    blocks, vectors = rng.normal(size=(5, 3, 3)).astype(dtype), rng.normal(size=(5, 3))
    four = _padded(vectors, blocks)
    assert four.dtype == dtype
    np.testing.assert_array_equal(four, np.column_stack([vectors.astype(dtype), np.zeros(5)]))
    four[:, 3] = np.nan
    product, transposed = np.full((6, 4), 7.0, dtype), np.full((6, 4), 7.0, dtype)
    squared = _products(blocks, four, product, transposed)
    near = {"rtol": 0, "atol": 20 * np.finfo(dtype).eps}
    np.testing.assert_allclose(product[:5, :3], np.einsum("rij,rj->ri", blocks, vectors), **near)
    np.testing.assert_allclose(transposed[:5, :3], np.einsum("rij,ri->rj", blocks, vectors), **near)
    np.testing.assert_allclose(squared, (vectors**2).sum(), rtol=1e-6)
    assert (product[5] == 7.0).all()
    assert (transposed[5] == 7.0).all()
