"""An outside reference: the cloth solver (vertex block descent) of the `newton` package on our scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.simulation.newton_cloth import NewtonCloth, NewtonOptions, warp_device
from pb4u.simulation.simulator import RunRecord, Simulator
from pb4u.simulation.timeline import Timeline


class NewtonSimulator(Simulator):
    """Newton's VBD solver: same scene in, same trajectory out, none of our energies, contacts or integrators.

    VBD minimises the backward-Euler potential of a sub-step vertex by vertex (Chen et al., "Vertex Block Descent",
    SIGGRAPH 2024). Frame 0 is the start pose, settled on the standing body for one frame's time. Velocities in the
    states are displacements over a frame, as everywhere in this package; Newton keeps its own, finer ones.

    Args:
        device: "auto", "cpu" or "cuda".
        options: sub-steps, iterations and contact of the solver; the defaults where None.

    Raises MissingExtraError when the `newton` package is absent, InputError when there is no such device.
    """

    name = "newton"

    def __init__(self, device: str = "auto", options: NewtonOptions | None = None) -> None:
        self.device = warp_device(device)
        self.options = options or NewtonOptions()

    def settings(self) -> dict[str, Any]:
        return {"solver": "newton VBD", "solver_options": asdict(self.options), "device": self.device}

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        timeline = Timeline.of(scene, torch.float32)
        pinned = timeline.garments.pinned.numpy()
        cloth = NewtonCloth(scene, timeline.body(0).numpy(), timeline.skinned(0).numpy(), self.device, self.options)
        cloth.settle(scene.dt, timeline.body(0).numpy())
        previous = cloth.positions
        for frame in range(scene.total_frames):
            if frame:
                cloth.advance(
                    scene.dt,
                    (timeline.body(frame - 1).numpy(), timeline.body(frame).numpy()),
                    (timeline.skinned(frame - 1).numpy()[pinned], timeline.skinned(frame).numpy()[pinned]),
                )
            positions = cloth.positions
            if not np.isfinite(positions).all():
                record.failed_at = frame - scene.lead_in
                return
            velocities = (positions - previous) / scene.dt
            previous = positions
            yield State(torch.from_numpy(positions), torch.from_numpy(velocities.astype(np.float32)), frame)
