"""Steps of a network alone on an accelerator, each begun before the one before it has ended."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.collision.batched_surface import GROUP
from pb4u.collision.capacities import Capacities
from pb4u.errors import InputError
from pb4u.network.acceleration_model import GraphNetwork
from pb4u.network.interaction_block import InteractionBlock
from pb4u.scene.state import State
from pb4u.simulation.step import StepMethod, Taken
from pb4u.simulation.step_graph import StepGraph
from pb4u.simulation.timeline import Timeline


@dataclass(frozen=True, eq=False)
class _Pending:
    """A step that may still be computed, with what it began from.

    Args:
        begun: what it left.
        copies: positions and velocities of the state that it led to, and the room that it wanted, on the processor.
        names: of the searches that wanted room.
        event: recorded behind the copies; None where nothing has to be waited for.
    """

    begun: Taken
    copies: tuple[Tensor, ...]
    names: tuple[str, ...]
    event: torch.cuda.Event | None

    @staticmethod
    def of(begun: Taken, state: State, names: tuple[str, ...], sizes: Tensor) -> _Pending:
        parts = (state.positions, state.velocities, sizes)
        copies = tuple(part.to("cpu", non_blocking=True) for part in parts)
        on_card = state.positions.device.type == "cuda"
        event = torch.cuda.Event() if on_card else None  # type: ignore[no-untyped-call]
        if event is not None:
            event.record()
        return _Pending(begun, copies, names, event)

    def had_room(self, capacities: Capacities) -> bool:
        """Whether the step had room for all that it found; makes more where it had not."""
        if self.event is not None:
            self.event.synchronize()
        return not capacities.grow(self.names, self.copies[2])

    @property
    def state(self) -> State:
        return State(self.copies[0], self.copies[1], self.begun.state.frame + 1)


def bytes_a_vertex(network: GraphNetwork, body_faces: int, recorded: int | None = None) -> int:
    """Bytes that a step takes on a card for each vertex of the garments, roughly.

    Args:
        network: that is evaluated.
        body_faces: number of faces of the bodies.
        recorded: propagation steps K where gradients are recorded, so that all layers are kept; None without gradients.
    """
    width = max(weights.shape[0] for weights in network.parameters())
    # Of six directed edges a vertex five arrays live at a time; kept are some 40 arrays a vertex in a block and 15 in a
    # propagation step, half as many again for edges to bodies.
    blocks = sum(isinstance(module, InteractionBlock) for module in network.modules())
    arrays = 30 if recorded is None else 30 + 60 * blocks + 22 * recorded
    return 4 * width * arrays + 4 * 8 * -(-body_faces // GROUP)


def require_memory(what: str, vertices: int, size: int, device: torch.device) -> None:
    """Refuse what a card has no room for, before its first step.

    Args:
        what: takes the memory, as the subject of a sentence.
        vertices: number of the garments' vertices.
        size: bytes a vertex.
        device: the card.

    Raises:
        InputError: it is too large; a number of triangles that would fit is named.
    """
    free, _ = torch.cuda.mem_get_info(device)
    if size * vertices > free:
        raise InputError(
            f"The card has {free / 1e9:.1f} GB free, but {what} takes about {size * vertices / 1e9:.1f} GB; garments "
            f"of {2 * free // size:,} triangles in total would fit."
        )


def states_after(
    timeline: Timeline, method: StepMethod, taken: Taken, frames: int, replays: bool | None = None
) -> Iterator[State]:
    """States after that of `taken`, on the processor; nothing waits for a step but the copy of it.

    What a step decides by what it finds is known with its copy, when the next has begun already: both are taken again
    where it had too little room.

    Args:
        timeline: garments and bodies on the accelerator.
        method: whose start, network and search take the steps.
        taken: the last frame that was made in a way of its own, on the accelerator.
        frames: total number, of which that is one.
        replays: whether steps are replayed as CUDA graphs where their shapes stay; on a card by default.
    """
    capacities, waiting = timeline.colliders.capacities, None
    assert capacities is not None
    steps = StepGraph(timeline, method, timeline.garments.device.type == "cuda" if replays is None else replays)
    while True:
        pending = None
        if taken.state.frame < frames - 1:
            begun = taken
            taken, names, sizes = steps.take(begun)
            pending = _Pending.of(begun, taken.state, names, sizes)
        if waiting is not None and not waiting.had_room(capacities):
            taken, waiting = waiting.begun, None
            continue
        if waiting is not None:
            yield waiting.state
        if pending is None:
            return
        waiting = pending
