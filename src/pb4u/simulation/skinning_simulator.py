"""Bare skinning: the garment carried by the body without any physics."""

from __future__ import annotations

from collections.abc import Iterator

from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.simulation.simulator import RunRecord, Simulator

_CHUNK = 32


class SkinningSimulator(Simulator):
    """Puts every vertex where the body alone would carry it."""

    name = "skinning"

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        placement = scene.garments[0].placement
        previous = None
        for start in range(0, scene.total_frames, _CHUNK):
            block = placement.positions(start, min(start + _CHUNK, scene.total_frames))
            for offset, positions in enumerate(block):
                velocities = (positions - (positions if previous is None else previous)) / scene.dt
                previous = positions
                yield State(positions, velocities, start + offset)
