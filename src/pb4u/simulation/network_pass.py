"""The network in a time step: its graph, the node features that need the step's physics, and its passes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.acceleration_model import PreparedGarments
from pb4u.network.graph.features import ADVANCE, DESCENT
from pb4u.network.graph.graph import Graph
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.descent import JacobiDescent
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.colliders import ColliderFrame, PackedColliders
from pb4u.scene.packed import PackedGarments

_ORIGIN_GRID = 1.0 / 16.0
"""Grid of the origins of a step [m], coarse in binary, so that float32 differences of positions stay exact."""

_LINEAR_UP_TO = 0.05
"""Share of an edge up to which the gradient feature is left as it is."""

_SMALLEST_DESCENT = 1e-6
"""Root mean square of a descent, in edge lengths, that is no longer shown larger: cloth at rest in single precision."""


class NetworkPass:
    """The network's correction of the accelerations reached so far.

    Args:
        network: called with a graph and the prepared garments; the model itself, or what distributes it.
        prepared: what it derived once from the garments, with the propagation steps of this step.
        features: makes the node features that need the step's physics.
        passes: how often it is evaluated in a step.
        mode: entered while the network computes; no gradient by default, `nullcontext` in training.
        further: how often it is evaluated again at most, while a pass lowers the energy much.
    """

    def __init__(
        self,
        network: nn.Module,
        prepared: PreparedGarments,
        features: StepFeatures,
        passes: int = 1,
        mode: Callable[[], AbstractContextManager] = torch.inference_mode,
        further: int = 0,
    ) -> None:
        self.network, self.prepared, self.features, self.mode = network, prepared, features, mode
        self.passes, self.further = passes, further
        self.device = next(network.parameters()).device
        self._colliders: tuple[PackedColliders, PackedColliders] | None = None

    def correction(self, step: TimeStep, accelerations: Tensor) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] to add to those reached so far.

        Args:
            step: that is taken.
            accelerations: (vertices, 3) reached so far, from free flight [m per step^2].
        """
        extra, scale = self.features.scaled(step, accelerations)
        with self.mode():
            return scale * self.network(self._graph(step, extra), self.prepared).to(accelerations)

    def graph(self, step: TimeStep, accelerations: Tensor) -> Graph:
        """Graph that the network reads after `accelerations` (vertices, 3) [m per step^2].

        Args:
            step: the time step.
            accelerations: (vertices, 3) [m per step^2] from free flight.
        """
        return self._graph(step, self.features.scaled(step, accelerations)[0])

    def _graph(self, step: TimeStep, features: Mapping[str, Tensor]) -> Graph:
        extra = {name: value.to(self.device) for name, value in features.items()}
        state = replace(
            step.state,
            positions=step.state.positions.to(self.device),
            velocities=step.state.velocities.to(self.device),
        )
        origins = local_origins(step.collider, step.garments.world_count).to(self.device)
        pins = None if step.pin_positions is None else step.pin_positions.to(self.device)
        return self.prepared.graph(state, self._on_device(step.collider), step.dt, origins, extra, pins)

    def _on_device(self, collider: ColliderFrame) -> ColliderFrame:
        """The bodies where the network computes; what never changes is moved once."""
        if collider.now.positions.device == self.device:
            return collider
        if self._colliders is None or self._colliders[0] is not collider.colliders:
            self._colliders = collider.colliders, collider.colliders.to(self.device)
        colliders = self._colliders[1]
        poses = (collider.previous, collider.now, collider.following)
        return ColliderFrame(*(colliders.pose(pose.positions.to(self.device)) for pose in poses))


def local_origins(collider: ColliderFrame, worlds: int) -> Tensor:
    """Middle (worlds, 3) [m] of the bodies of each world, rounded so that float32 differences of positions stay exact.

    Args:
        collider: the bodies around a step.
        worlds: number of worlds.
    """
    return (collider.now.middles(worlds, torch.float64) / _ORIGIN_GRID).round() * _ORIGIN_GRID


class DescentFeature:
    """Jacobi descent of the incremental potential where the step would end so far.

    In edge lengths it is a strain, and looks the same at any resolution. Steps beyond 5% of an edge grow as their
    logarithm: one vertex deep inside the body must not drown the others.

    Args:
        potential: the energies; those of cloth against cloth do not count, as passes may cross.
    """

    def __init__(self, potential: IncrementalPotential) -> None:
        self._potential = potential.without_self_contact()
        self._made: tuple[PackedGarments, float | Tensor, JacobiDescent] | None = None

    def of(self, step: TimeStep, accelerations: Tensor, incident_length: Tensor) -> Tensor:
        """Descent (vertices, 3) [edge lengths].

        Args:
            step: that is taken.
            accelerations: (vertices, 3) from free flight to where the pass starts [m per step^2].
            incident_length: (vertices,) mean rest length of the edges at each vertex [m].
        """
        x = integrate(step, accelerations).positions
        strain = self._descent(step).at(self._potential.of(step), x) / incident_length.to(x)[:, None]
        size = strain.norm(dim=1, keepdim=True) / _LINEAR_UP_TO
        return strain * torch.where(size > 1e-6, torch.log1p(size) / size.clamp_min(1e-6), 1.0)

    def _descent(self, step: TimeStep) -> JacobiDescent:
        dt, memory = step.inertial_dt, self._made
        # One for each vertex is of its step alone.
        same = memory is not None and (memory[1] is dt or (isinstance(dt, float) and memory[1] == dt))
        if memory is None or memory[0] is not step.garments or not same:
            memory = self._made = step.garments, dt, JacobiDescent(step.garments, dt)
        return memory[2]


class StepFeatures:
    """The extra features that prepared garments' layout names.

    Args:
        prepared: of the network that reads them.
        potential: the energies that the gradient feature descends.

    Raises:
        InputError: the layout names one that nobody makes.
    """

    def __init__(self, prepared: PreparedGarments, potential: IncrementalPotential) -> None:
        self._incident_length = prepared.builder.static.incident_length
        self._descent_size = prepared.descent_size
        self._descent = DescentFeature(potential)
        self._names = [feature.name for feature in prepared.builder.layout.extra]
        for feature in prepared.builder.layout.extra:
            if feature not in (DESCENT, ADVANCE):
                raise InputError(
                    f"The network needs the node feature {feature.name!r}, which this version cannot compute."
                )

    @torch.no_grad()
    def of(self, step: TimeStep, accelerations: Tensor) -> Mapping[str, Tensor]:
        """Every feature (vertices, width) by name; arguments as in `scaled`.

        Args:
            step: the time step.
            accelerations: (vertices, 3) [m per step^2] from free flight.
        """
        return {
            name: self._descent.of(step, accelerations, self._incident_length)
            if name == DESCENT.name
            else 100.0 * accelerations
            for name in self._names
        }

    @torch.no_grad()
    def scaled(self, step: TimeStep, accelerations: Tensor) -> tuple[Mapping[str, Tensor], Tensor]:
        """Features as the network sees them, and the factors (vertices, 1) on what it predicts from them.

        Where the network has a `descent_size`, each garment's gradient feature is normalised to that RMS, and the
        prediction scaled as it was: near the minimum then looks like far from it, as it does to Newton's method.

        Args:
            step: that is taken.
            accelerations: (vertices, 3) from free flight to where the pass starts [m per step^2].
        """
        features = dict(self.of(step, accelerations))
        if not self._descent_size:
            return features, accelerations.new_ones(len(accelerations), 1)
        descent, garments = features[DESCENT.name], step.garments
        owner = garments.vertex_garment
        squares = descent.new_zeros(garments.garment_count).index_add_(0, owner, descent.square().sum(1))
        size = (squares / garments.garment_vertices).sqrt().clamp_min(_SMALLEST_DESCENT)
        factor = (size / self._descent_size)[owner, None]
        features[DESCENT.name] = descent / factor
        return features, factor.to(accelerations)
