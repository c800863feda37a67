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
        self._wanted: dict[str, Tensor] = {}

    def size(self, name: str, wanted: Tensor) -> int:
        """Room for what is called `name`, measured when first asked for.

        Args:
            name: of the search.
            wanted: () int64 rows that it found.
        """
        if name not in self.sizes:
            self.sizes[name] = _spacious(int(wanted))
        self.note(name, wanted)
        return self.sizes[name]

    def repeats(self, name: str, most: int) -> int:
        """How often what is called `name` is done: once more than it last had to be, at most `most` times.

        Args:
            name: of what is done.
            most: upper limit.
        """
        self._limits[name] = most
        return self.sizes.setdefault(name, most)

    def note(self, name: str, wanted: Tensor) -> None:
        """Note that () int64 `wanted` would have been needed of `name`.

        Args:
            name: of the search.
            wanted: () int64 room that the search needed.
        """
        before = self._wanted.get(name)
        self._wanted[name] = wanted if before is None else torch.maximum(before, wanted)

    def too_little(self) -> Tensor:
        """Whether () bool a search has found more than its room since `taken` was last called."""
        return torch.stack(
            [wanted > self.sizes[name] for name, wanted in self._wanted.items() if name not in self._limits]
        ).any()

    def taken(self) -> tuple[tuple[str, ...], Tensor]:
        """Names of the searches since this was last called, and the most rows (searches,) int64 that each wanted."""
        wanted, self._wanted = self._wanted, {}
        return tuple(wanted), torch.stack(list(wanted.values())) if wanted else torch.zeros(0, dtype=torch.int64)

    def grow(self, names: tuple[str, ...], wanted: Tensor) -> bool:
        """Make room for what was wanted; whether there was too little.

        Args:
            names: of the searches.
            wanted: (searches,) int64, on the processor.
        """
        most = dict(zip(names, wanted.tolist(), strict=True))
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
        found = torch.nonzero(mask.reshape(-1))[:, 0]
        return found, torch.ones_like(found, dtype=torch.bool)
    room = capacities.size(name, mask.sum())
    found = torch.nonzero_static(mask.reshape(-1), size=room, fill_value=-1)[:, 0]
    return found.clamp_min(0), found >= 0


def _spacious(wanted: int) -> int:
    return int(_SPARE * wanted) + 64
