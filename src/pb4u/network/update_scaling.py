"""Factors on predicted accelerations (paper, "Resolution-Aware Update Scaling"), and their split by wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.network.graph.garment_graph import GarmentGraph
from pb4u.network.surface_low_pass import SurfaceLowPass
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True, eq=False)
class UpdateScale:
    """Factors that multiply the accelerations predicted for packed garments.

    Args:
        wrinkles: (vertices, 1) dimensionless factors; with a low-pass, only for short wavelengths.
        bulk: (vertices, 1) dimensionless factors for long wavelengths; None without a low-pass.
        low_pass: filter that gives the long wavelengths, or None.
    """

    wrinkles: Tensor
    bulk: Tensor | None = None
    low_pass: SurfaceLowPass | None = None

    def __call__(self, accelerations: Tensor) -> Tensor:
        """Scaled accelerations (vertices, 3), in the unit of those given.

        Args:
            accelerations: (vertices, 3) of any unit.
        """
        if self.low_pass is None or self.bulk is None:
            return self.wrinkles * accelerations
        smooth = self.low_pass(accelerations)
        return self.bulk * smooth + self.wrinkles * (accelerations - smooth)


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
        return self.lengths(garments) / self.reference_length

    def lengths(self, garments: GarmentGraph) -> Tensor:
        """Lengths (vertices, 1) [m] that the factors follow.

        Args:
            garments: static graph of the pack.
        """
        return garments.incident_length[:, None]

    def on_bulk(self, lengths: Tensor) -> Tensor:
        """Factors (vertices, 1), dimensionless, on the bulk (long wavelengths), where edges have the given lengths.

        Args:
            lengths: (vertices, 1) [m].
        """
        return lengths / self.reference_length

    def low_pass(self, garments: PackedGarments) -> SurfaceLowPass | None:
        """Low-pass filter that separates bulk from wrinkles; None if both have the same factor.

        Args:
            garments: the pack.
        """
        return None


@dataclass(frozen=True)
class MeanScaling(PerVertexScaling):
    """The released form: one factor a garment, its mean rest edge length / L_ref (reference 7: L_ref = 1 cm).

    Args:
        reference_length: L_ref [m].
    """

    reference_length: float = 0.01

    def lengths(self, garments: GarmentGraph) -> Tensor:
        lengths = torch.tensor(garments.mean_edge_lengths, dtype=garments.incident_length.dtype)
        return lengths.to(garments.node_owner.device)[garments.node_owner][:, None]


@dataclass(frozen=True)
class NoScaling:
    """Accelerations as predicted: no update scaling."""

    def factors(self, garments: GarmentGraph) -> Tensor | None:
        return None

    def lengths(self, garments: GarmentGraph) -> Tensor | None:
        return None

    def on_bulk(self, lengths: Tensor) -> Tensor:
        return torch.ones_like(lengths)

    def low_pass(self, garments: PackedGarments) -> SurfaceLowPass | None:
        return None


@dataclass(frozen=True)
class BandSplitScaling(PerVertexScaling):
    """Bulk as predicted, wrinkles by the paper's rule up to 1: low(A) + min(1, s_i / L_ref) (A - low(A)).

    docs/science/update_scaling.md derives it.

    Args:
        reference_length: L_ref [m].
        low_pass_length: l of the low-pass [m]; waves of 2 pi l are halved.

    Raises:
        InputError: a low-pass length of 0, or of a metre or more, which leaves no bulk.
    """

    low_pass_length: float = 0.09

    def __post_init__(self) -> None:
        if not 0.0 < self.low_pass_length < 1.0:
            raise InputError(
                f"network.scaling.low_pass_length must be above 0 and below 1 m, a garment's size, not "
                f"{self.low_pass_length:g}."
            )

    def factors(self, garments: GarmentGraph) -> Tensor | None:
        factors = super().factors(garments)
        return None if factors is None else factors.clamp_max(1.0)

    def on_bulk(self, lengths: Tensor) -> Tensor:
        return torch.ones_like(lengths)

    def low_pass(self, garments: PackedGarments) -> SurfaceLowPass | None:
        for garment, length in zip(garments.garments, garments.mean_edge_lengths, strict=True):
            if length >= self.low_pass_length:
                raise InputError(
                    f"{garment.name}: its edges are {1e3 * length:.0f} mm long on average, too long for a low-pass of "
                    f"{1e3 * self.low_pass_length:.0f} mm to separate wrinkles from the overall motion; ask for more "
                    "triangles, or use a scaling other than band-split."
                )
        return SurfaceLowPass(garments, self.low_pass_length)


Scaling = PerVertexScaling | MeanScaling | NoScaling | BandSplitScaling

SCALINGS: Mapping[str, type[PerVertexScaling] | type[NoScaling]] = {
    "per-vertex": PerVertexScaling,
    "mean": MeanScaling,
    "none": NoScaling,
    "band-split": BandSplitScaling,
}
"""Rules by the names that `--scaling` takes."""


def scaling_name(scaling: Scaling) -> str:
    """Name of a rule for `--scaling`.

    Args:
        scaling: the rule.
    """
    return next(name for name, kind in SCALINGS.items() if kind is type(scaling))


def scaling_of(scaling: Scaling, garments: PackedGarments, graph: GarmentGraph) -> UpdateScale | None:
    """Factors of a rule on a pack; None for 1.

    Args:
        scaling: the rule.
        garments: the pack.
        graph: its static graph.

    Raises:
        InputError: the edges of a garment are too long for the rule's low-pass.
    """
    factors = scaling.factors(graph)
    if factors is None:
        return None
    low_pass = scaling.low_pass(garments)
    return UpdateScale(factors, None if low_pass is None else torch.ones_like(factors), low_pass)


@dataclass(frozen=True)
class SwitchedScaling:
    """Another rule than that of the training, for the same weights; the two agree at the training's own resolution.

    There a garment's edges have the length L_t, and the weights were trained together with their own rule's factor for
    L_t. The other rule's factor, relative to that for L_t and at most 1, multiplies this one.

    Args:
        used: the rule.
        trained: that of the training.
        triangles: most triangles that a garment had in the training; 0 where that is not known.
        edge_lengths: finest and coarsest mean rest edge length in the training [m].
    """

    used: Scaling
    trained: Scaling
    triangles: int
    edge_lengths: tuple[float, float]

    def of(self, garments: PackedGarments, graph: GarmentGraph) -> UpdateScale:
        """Factors on a pack.

        Args:
            garments: the pack.
            graph: its static graph.

        Raises:
            InputError: the edges of a garment are too long for the rule's low-pass.
        """
        trained = torch.tensor([self._trained_length(garments, k) for k in range(garments.garment_count)])
        lengths = trained.to(graph.incident_length)[graph.node_owner][:, None]
        learnt, present = self.trained.on_bulk(lengths), self.used.lengths(graph)
        factors = learnt if present is None else learnt * (present / lengths).clamp_max(1.0)
        low_pass = self.used.low_pass(garments)
        return UpdateScale(factors, None if low_pass is None else learnt, low_pass)

    def _trained_length(self, garments: PackedGarments, number: int) -> float:
        """Mean edge length [m] of a garment at the number of triangles of the training."""
        finest, coarsest = self.edge_lengths
        length, triangles = garments.mean_edge_lengths[number], garments.garments[number].triangle_count
        if self.triangles:
            length *= (triangles / self.triangles) ** 0.5
        return min(max(length, finest), coarsest)


def with_scaling(scaling: Scaling, name: str) -> Scaling:
    """The named rule, with the reference length of another rule if both have one.

    Args:
        scaling: the other rule.
        name: per-vertex, mean, none or band-split.
    """
    other = SCALINGS[name]()
    if isinstance(other, PerVertexScaling) and isinstance(scaling, PerVertexScaling):
        return scaling if type(scaling) is type(other) else replace(other, reference_length=scaling.reference_length)
    return other
