"""Steps of a network alone on an accelerator, each begun before the one before it has ended."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.collision.batched_surface import GROUP
from pb4u.collision.rooms import Rooms
from pb4u.errors import InputError
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.step import StepMethod
from pb4u.simulation.step_graph import StepGraph
from pb4u.simulation.timeline import Timeline


@dataclass(frozen=True, eq=False)
class _Taken:
    """A step that may still be computed, with what it began from.

    Args:
        begun: state that it left.
        last: move of the pass before it.
        copies: positions and velocities of the state that it led to, and the room that it wanted, on the processor.
        names: of the searches that wanted room.
        done: recorded behind the copies; None where nothing has to be waited for.
    """

    begun: State
    last: Tensor | None
    copies: tuple[Tensor, ...]
    names: tuple[str, ...]
    done: torch.cuda.Event | None

    @staticmethod
    def of(begun: State, last: Tensor | None, state: State, names: tuple[str, ...], wanted: Tensor) -> _Taken:
        parts = (state.positions, state.velocities, wanted)
        copies = tuple(part.to("cpu", non_blocking=True) for part in parts)
        on_card = state.positions.device.type == "cuda"
        done = torch.cuda.Event() if on_card else None  # type: ignore[no-untyped-call]
        if done is not None:
            done.record()
        return _Taken(begun, last, copies, names, done)

    def had_room(self, rooms: Rooms) -> bool:
        """Whether the step had room for all that it found; makes more where it had not."""
        if self.done is not None:
            self.done.synchronize()
        return not rooms.grow(self.names, self.copies[2])

    @property
    def state(self) -> State:
        return State(self.copies[0], self.copies[1], self.begun.frame + 1)


def require_memory(garments: PackedGarments, body_faces: int, width: int, free: int) -> None:
    """Refuse a scene that a card has no room for, before its first step.

    Args:
        garments: of the scene.
        body_faces: number of faces of its bodies.
        width: columns of the network's latents.
        free: bytes that the card has left.

    Raises:
        InputError: it is too large; a number of triangles that would fit is named.
    """
    # Six directed edges a vertex, some five arrays of latents each; and a few numbers for each group of the bodies.
    each = 6 * 5 * 4 * width + 4 * 8 * -(-body_faces // GROUP)
    needed = each * garments.vertex_count
    if needed > free:
        raise InputError(
            f"The card has {free / 1e9:.1f} GB left, and the scene takes about {needed / 1e9:.1f} GB; garments of "
            f"{2 * free // each:,} triangles in all would fit."
        )


def states_after(
    timeline: Timeline, method: StepMethod, state: State, frames: int, replays: bool | None = None
) -> Iterator[State]:
    """States after `state`, on the processor; nothing waits for a step but the copy of it.

    What a step decides by what it finds is known with its copy, when the next has begun already: both are taken again
    where it had too little room.

    Args:
        timeline: garments and bodies on the accelerator.
        method: whose start, network and search take the steps; the search changes.
        state: on the accelerator.
        frames: total number, of which `state` is one.
        replays: whether steps are replayed as CUDA graphs where their shapes stay; on a card by default.
    """
    rooms, waiting = timeline.colliders.rooms, None
    assert rooms is not None
    steps = StepGraph(timeline, method, timeline.garments.device.type == "cuda" if replays is None else replays)
    while True:
        taken = None
        if state.frame < frames - 1:
            begun, last = state, method.search.last
            state, names, wanted = steps.take(begun)
            taken = _Taken.of(begun, last, state, names, wanted)
        if waiting is not None and not waiting.had_room(rooms):
            state, method.search.last, waiting = waiting.begun, waiting.last, None
            continue
        if waiting is not None:
            yield waiting.state
        if taken is None:
            return
        waiting = taken
