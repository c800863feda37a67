"""Node features that need the physics of a step: what a layout names as `extra`, made from the situation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.graph.features import DESCENT
from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.physics.descent import JacobiDescent
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.scene.packed import PackedGarments
from pb4u.simulation.step import BallisticPredictor, Situation

_LINEAR_UP_TO = 0.05


class SituationFeature(Protocol):
    """One node feature."""

    def of(self, situation: Situation, incident_length: Tensor) -> Tensor:
        """(vertices, width), given the mean rest length of the edges at each vertex (vertices,) [m]."""


class DescentFeature:
    """Jacobi descent of the incremental potential at free flight, in edge lengths: a strain, the same at any resolution.

    Steps beyond 5% of an edge grow as their logarithm: one vertex deep inside the body must not drown the others.
    """

    def __init__(self) -> None:
        self._made_for: tuple[PackedGarments, float] | None = None

    def of(self, situation: Situation, incident_length: Tensor) -> Tensor:
        x = BallisticPredictor().predict(situation).positions
        potential = IncrementalPotential().prepare(
            situation.garments, situation.state, situation.collider, situation.dt, situation.gravity
        )
        step = self._descent(situation).at(potential, x) / incident_length.to(x)[:, None]
        size = step.norm(dim=1, keepdim=True) / _LINEAR_UP_TO
        return step * torch.where(size > 1e-6, torch.log1p(size) / size.clamp_min(1e-6), 1.0)

    def _descent(self, situation: Situation) -> JacobiDescent:
        key = situation.garments, situation.dt
        if self._made_for is None or self._made_for[0] is not key[0] or self._made_for[1] != key[1]:
            self._made_for, self._made = key, JacobiDescent(*key)
        return self._made


class SituationFeatures:
    """The extra features that prepared garments' layout names.

    Args:
        prepared: of the network that reads them. Raises InputError where the layout names one that nobody makes.
    """

    def __init__(self, prepared: PreparedGarments) -> None:
        self._incident_length = prepared.builder.static.incident_length
        self._features: dict[str, SituationFeature] = {}
        for feature in prepared.builder.layout.extra:
            if feature != DESCENT:
                raise InputError(f"The network reads the node feature {feature.name!r}, which this version cannot make.")
            self._features[feature.name] = DescentFeature()

    @torch.no_grad()
    def of(self, situation: Situation) -> Mapping[str, Tensor]:
        """Every feature (vertices, width) by name."""
        return {name: feature.of(situation, self._incident_length) for name, feature in self._features.items()}
