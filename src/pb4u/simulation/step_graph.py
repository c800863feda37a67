"""Steps of a network alone, replayed as one CUDA graph where their shapes stay: thousands of launches become one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame
from pb4u.scene.state import State
from pb4u.simulation.step import StepMethod, Taken, predictions
from pb4u.simulation.timeline import Timeline

Outputs = tuple[Tensor, ...]
"""Positions (vertices, 3) [m], velocities (vertices, 3) [m/s], the room wanted, and the last move if there is one."""

_SAME = 1e-6
"""Difference [m, m/s] of a replay from the plain way up to which it counts as the same: sums change their order."""


def captured(compute: Callable[..., Outputs], inputs: list[Tensor], pool: Any) -> Callable[[], Outputs]:
    """Function that computes again what `compute` did, from what `inputs` then contain.

    Args:
        compute: launches the same kernels for any `inputs`.
        inputs: tensors that the graph reads, of any unit.
        pool: memory of the graphs, from `torch.cuda.graph_pool_handle`.
    """
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=pool):
        outputs = compute(*inputs)

    def replay() -> Outputs:
        graph.replay()
        return outputs

    return replay


@dataclass
class _Graph:
    """Steps of one set of shapes: how many were seen, what the graph reads, and what replays it."""

    seen: int = 0
    inputs: list[Tensor] | None = None
    replay: Callable[[], Outputs] | None = None


class StepGraph:
    """Takes steps: the first with some shapes in the plain way, from the fourth on as a graph.

    The second is captured as well, and the third compared: where its replay differs, all steps stay plain.

    States have no history here.

    Args:
        timeline: garments and bodies on the accelerator.
        method: whose start, network and search take the steps.
        replays: whether steps may be replayed at all.
    """

    def __init__(self, timeline: Timeline, method: StepMethod, replays: bool) -> None:
        self.timeline, self.method, self.replays = timeline, method, replays
        self._graphs: dict[tuple[Any, ...], _Graph] = {}
        self._pool = torch.cuda.graph_pool_handle() if replays and torch.cuda.is_available() else None

    def take(self, begun: Taken) -> tuple[Taken, tuple[str, ...], Tensor]:
        """What comes after `begun`, and the searches and the room that each wanted, as `Capacities.taken` gives them.

        Args:
            begun: at the start of the step.
        """
        capacities, last = self.timeline.colliders.capacities, begun.last_move
        assert capacities is not None
        self._step = self.timeline.step_from(begun.state)
        graph = self._graphs.setdefault((last is None, *sorted(capacities.sizes.items())), _Graph())
        graph.seen += 1
        replayed = self._replayed(graph, last) if self.replays and graph.seen > 1 else None
        if replayed is None or graph.seen == 3:
            plain = self._outputs(self._step, last)
            if replayed is not None and not all(
                torch.allclose(one, other, rtol=0.0, atol=_SAME)
                for one, other in zip(replayed[:2], plain, strict=False)
            ):
                self.replays = False
            replayed = plain
        positions, velocities, sizes, *moves = replayed
        return Taken(State(positions, velocities, begun.state.frame + 1), *moves), self._names, sizes

    def _replayed(self, graph: _Graph, last: Tensor | None) -> Outputs | None:
        """Outputs of a replay; None where the graph is captured only now, or cannot be."""
        step = self._step
        assert step.pin_positions is not None
        assert step.skinned_motion is not None
        poses = (step.collider.previous, step.collider.now, step.collider.following)
        inputs = [step.state.positions, step.state.velocities, step.pin_positions, step.skinned_motion]
        inputs += [*(pose.positions for pose in poses), *([] if last is None else [last])]
        if graph.inputs is None:
            graph.inputs = [values.clone() for values in inputs]
            try:
                graph.replay = captured(self._computed, graph.inputs, self._pool)
            except RuntimeError:
                # An operation that cannot be captured.
                self.replays = False
            return None
        for mine, values in zip(graph.inputs, inputs, strict=True):
            mine.copy_(values)
        assert graph.replay is not None
        return tuple(values.clone() for values in graph.replay())

    def _computed(self, x: Tensor, v: Tensor, pins: Tensor, motion: Tensor, *more: Tensor) -> Outputs:
        """Outputs as a function of tensors alone."""
        bodies = ColliderFrame(*(self.timeline.colliders.pose(positions) for positions in more[:3]))
        state = State(x, v, self._step.state.frame)
        step = replace(self._step, state=state, collider=bodies, pin_positions=pins, skinned_motion=motion)
        return self._outputs(step, *more[3:])

    def _outputs(self, step: TimeStep, last_move: Tensor | None = None) -> Outputs:
        capacities = self.timeline.colliders.capacities
        assert capacities is not None
        with torch.no_grad():
            *_, prediction = predictions(step, self.method, last_move, capacities)
        self._names, sizes = capacities.taken()
        after, move = prediction.state, prediction.last_move
        return (after.positions, after.velocities, sizes, *([] if move is None else [move]))
