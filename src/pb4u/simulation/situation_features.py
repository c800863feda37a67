"""Node features that need the physics of a step: what a layout names as `extra`, made from the situation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.graph.features import ADVANCE, DESCENT, Feature
from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.physics.descent import JacobiDescent
from pb4u.physics.integrator import integrate
from pb4u.scene.packed import PackedGarments
from pb4u.simulation.step import Situation

_LINEAR_UP_TO = 0.05


class SituationFeature(Protocol):
    """One node feature."""

    def of(self, situation: Situation, found: Tensor, incident_length: Tensor) -> Tensor:
        """(vertices, width).

        Args:
            found: (vertices, 3) accelerations from free flight to where the pass starts [m per step^2].
            incident_length: (vertices,) mean rest length of the edges at each vertex [m].
        """


class DescentFeature:
    """Jacobi descent of the incremental potential where the step would end so far.

    In edge lengths it is a strain, and looks the same at any resolution. Steps beyond 5% of an edge grow as their
    logarithm: one vertex deep inside the body must not drown the others.
    """

    def __init__(self) -> None:
        self._made_for: tuple[PackedGarments, float] | None = None

    def of(self, situation: Situation, found: Tensor, incident_length: Tensor) -> Tensor:
        garments = situation.garments
        x = integrate(situation.state, found, situation.dt, garments.pinned, situation.pin_positions).positions
        step = self._descent(situation).at(situation.potential, x) / incident_length.to(x)[:, None]
        size = step.norm(dim=1, keepdim=True) / _LINEAR_UP_TO
        return step * torch.where(size > 1e-6, torch.log1p(size) / size.clamp_min(1e-6), 1.0)

    def _descent(self, situation: Situation) -> JacobiDescent:
        key = situation.garments, situation.dt
        if self._made_for is None or self._made_for[0] is not key[0] or self._made_for[1] != key[1]:
            self._made_for, self._made = key, JacobiDescent(*key)
        return self._made


class AdvanceFeature:
    """The accelerations from free flight to where the pass starts."""

    def of(self, situation: Situation, found: Tensor, incident_length: Tensor) -> Tensor:
        return 100.0 * found


_MAKERS: dict[Feature, Callable[[], SituationFeature]] = {DESCENT: DescentFeature, ADVANCE: AdvanceFeature}


class SituationFeatures:
    """The extra features that prepared garments' layout names.

    Args:
        prepared: of the network that reads them. Raises InputError where the layout names one that nobody makes.
    """

    def __init__(self, prepared: PreparedGarments) -> None:
        self._incident_length = prepared.builder.static.incident_length
        self._features: dict[str, SituationFeature] = {}
        for feature in prepared.builder.layout.extra:
            if feature not in _MAKERS:
                raise InputError(
                    f"The network reads the node feature {feature.name!r}, which this version cannot make."
                )
            self._features[feature.name] = _MAKERS[feature]()

    @torch.no_grad()
    def of(self, situation: Situation, found: Tensor) -> Mapping[str, Tensor]:
        """Every feature (vertices, width) by name; `found` (vertices, 3) as in `SituationFeature.of`."""
        return {name: feature.of(situation, found, self._incident_length) for name, feature in self._features.items()}
