"""Everything a simulation needs, loaded, checked and placed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pb4u.body.animated_body import AnimatedBody
from pb4u.environment import USUAL, Environment
from pb4u.errors import InputError
from pb4u.garment.dressing import Placement
from pb4u.garment.garment import Garment


@dataclass(frozen=True, eq=False)
class DressedGarment:
    """A garment and its placement on the body.

    Args:
        garment: rest shape, material and pins.
        placement: positions of the garment on the body at any frame.
    """

    garment: Garment
    placement: Placement


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """Garments on moving bodies.

    Frames run 0..lead_in + frames - 1: the first `lead_in` lead from the garment's rest pose into the motion and are
    simulated but not written, unless the lead-in is kept: then they are the first of `frames`.

    Args:
        garments: the garments worn, inner first.
        colliders: the moving bodies, each with all frames; empty if cloth hangs or falls without a body.
        frames: number of frames to write.
        lead_in: number of frames before the first written one.
        kept_lead_in: number of written frames that lead into the motion too.
        fps: frames per second [1/s]; one time step lasts 1 / fps.
        environment: gravity, air and ground.
        seed: seed of everything random in the simulation.
        labels: names for the metadata: garment, sources (name or file of each, None for a loaded object), body,
            body_shape, motion, rest_shape.
        notes: plain sentences on inputs that were found, changed or ignored while the scene was made.

    Raises:
        InputError: it has no garment.
    """

    garments: tuple[DressedGarment, ...]
    colliders: tuple[AnimatedBody, ...]
    frames: int
    lead_in: int = 0
    kept_lead_in: int = 0
    fps: float = 30.0
    environment: Environment = USUAL
    seed: int = 0
    labels: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.garments:
            raise InputError("A scene has no garment; give one or more.")

    def __repr__(self) -> str:
        pieces = [dressed.garment for dressed in self.garments]
        garments = ", ".join(f"{garment.name} ({garment.triangle_count:,} triangles)" for garment in pieces)
        bodies = ", ".join(f"{body.name} ({len(body.faces):,} triangles)" for body in self.colliders)
        ground = "none" if self.environment.ground is None else f"{self.environment.ground:g} m"
        return (
            f"Scene of {self.frames} frames at {self.fps:g} fps after {self.lead_in} of lead-in\n"
            f"  garments: {garments}\n"
            f"  bodies:   {bodies or 'none'}\n"
            f"  motion:   {self.labels.get('motion', 'own')}, seed {self.seed}\n"
            f"  gravity:  {list(self.environment.gravity)} m/s^2, ground {ground}, {len(self.notes)} notes"
        )

    @property
    def total_frames(self) -> int:
        """Number of frames simulated, lead-in included."""
        return self.lead_in + self.frames

    @property
    def led_frames(self) -> int:
        """Number of frames that lead into the motion, written or not."""
        return self.lead_in + self.kept_lead_in

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return 1.0 / self.fps
