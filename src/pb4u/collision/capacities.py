"""Room for the rows that searches find: fixed, so that on an accelerator no shape waits for data."""

from __future__ import annotations

import torch
from torch import Tensor

_SPARE = 1.3
"""Room for the next steps over what was found: garments near a body by and by."""


class Capacities:
    """Number of rows that each search may find, and the most that it wanted since that was last looked at.

    A search that found more than its room gave a wrong result: its step is taken again after `grow`.
    """

    def __init__(self) -> None:
        self.sizes: dict[str, int] = {}
        self._limits: dict[str, int] = {}
        self._largest: dict[str, Tensor] = {}

    def size(self, name: str, count: Tensor) -> int:
        """Room for what is called `name`, measured when first asked for.

        Args:
            name: of the search.
            count: () int64 rows that it found.
        """
        if name not in self.sizes:
            self.sizes[name] = _spacious(int(count))
        self.note(name, count)
        return self.sizes[name]

    def repeats(self, name: str, most: int) -> int:
        """How often what is called `name` is done: once more than it last had to be, at most `most` times.

        Args:
            name: of what is done.
            most: upper limit.
        """
        self._limits[name] = most
        return self.sizes.setdefault(name, most)

    def note(self, name: str, count: Tensor) -> None:
        """Note that () int64 `count` would have been needed of `name`.

        Args:
            name: of the search.
            count: () int64 room that the search needed.
        """
        before = self._largest.get(name)
        self._largest[name] = count if before is None else torch.maximum(before, count)

    def too_little(self) -> Tensor:
        """Whether () bool a search has found more than its room since `taken` was last called."""
        return torch.stack(
            [count > self.sizes[name] for name, count in self._largest.items() if name not in self._limits]
        ).any()

    def taken(self) -> tuple[tuple[str, ...], Tensor]:
        """Names of the searches since this was last called, and the most rows (searches,) int64 that each wanted."""
        largest, self._largest = self._largest, {}
        return tuple(largest), torch.stack(list(largest.values())) if largest else torch.zeros(0, dtype=torch.int64)

    def grow(self, names: tuple[str, ...], counts: Tensor) -> bool:
        """Make room for what was wanted; whether there was too little.

        Args:
            names: of the searches.
            counts: (searches,) int64, on the processor.
        """
        most = dict(zip(names, counts.tolist(), strict=True))
        short = {name: _spacious(count) for name, count in most.items() if count > self.sizes[name]}
        repeats = {name: min(most[name] + 1, limit) for name, limit in self._limits.items() if name in most}
        self.sizes |= short | repeats
        return bool(short)


def found_rows(mask: Tensor, name: str, capacities: Capacities | None) -> tuple[Tensor, Tensor]:
    """Places (rows,) int64 at which a flattened `mask` holds, ascending, and which of these rows are filled.

    Args:
        mask: bool of any shape.
        name: of the search.
        capacities: gives a fixed number of rows, those left over at place 0; None gives as many as there are.
    """
    if capacities is None:
        places = torch.nonzero(mask.reshape(-1))[:, 0]
        return places, torch.ones_like(places, dtype=torch.bool)
    room = capacities.size(name, mask.sum())
    places = torch.nonzero_static(mask.reshape(-1), size=room, fill_value=-1)[:, 0]
    return places.clamp_min(0), places >= 0


def _spacious(count: int) -> int:
    return int(_SPARE * count) + 64
