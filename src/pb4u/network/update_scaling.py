"""Factors on predicted accelerations (paper, "Resolution-Aware Update Scaling")."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.network.graph.garment_graph import GarmentGraph


@dataclass(frozen=True)
class PerVertexScaling:
    """The paper's rule: s_i / L_ref, s_i the mean rest length of the edges at vertex i [m].

    Args:
        reference_length: L_ref [m], the mean edge length of the base resolution; makes the factor dimensionless.
    """

    reference_length: float = 0.015

    def factors(self, garments: GarmentGraph) -> Tensor | None:
        """Factors (vertices, 1), dimensionless, on the accelerations, or None for 1.

        Args:
            garments: static graph of the pack.
        """
        return (garments.incident_length / self.reference_length)[:, None]


@dataclass(frozen=True)
class MeanScaling:
    """The released form: one factor a garment, its mean rest edge length / L_ref (reference 7: L_ref = 1 cm).

    Args:
        reference_length: L_ref [m].
    """

    reference_length: float = 0.01

    def factors(self, garments: GarmentGraph) -> Tensor | None:
        lengths = torch.tensor(garments.mean_edge_lengths, dtype=garments.incident_length.dtype)
        return (lengths.to(garments.node_owner.device) / self.reference_length)[garments.node_owner][:, None]


@dataclass(frozen=True)
class NoScaling:
    """Accelerations as predicted: no update scaling."""

    def factors(self, garments: GarmentGraph) -> Tensor | None:
        return None
