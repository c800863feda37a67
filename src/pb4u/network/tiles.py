"""Work on rows of a network's tensors a tile at a time, on several threads, while no gradients are recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import torch

from pb4u.threads import parallel_map

Tile = TypeVar("Tile")
Result = TypeVar("Result")


def of_tiles(function: Callable[[Tile], Result], tiles: Sequence[Tile]) -> list[Result]:
    """`function` of each of the `tiles`, in their order.

    A tile stays in the cache of one processor through all its layers; threads of torch's own would share out every
    product of it and meet after each.

    Args:
        function: reads and writes rows of its own tile, without gradients.
        tiles: parts of the rows.
    """

    inference = torch.is_inference_mode_enabled()

    def alone(tile: Tile) -> Result:
        # Whether gradients are recorded is each thread's own setting.
        with torch.inference_mode() if inference else torch.no_grad():
            return function(tile)

    return parallel_map(alone, tiles)
