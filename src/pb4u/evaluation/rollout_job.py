"""One rollout of an evaluation: what is simulated, by what and how, and the address of its result."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pb4u import __version__

PROTOCOL_VERSION = 2
"""Raised when a rollout or its measuring comes to mean something else, so that no older result is taken for it."""

FPS = 30.0
"""Frames per second of every protocol."""


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    hasher = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            hasher.update(block)
    return hasher.hexdigest()


@dataclass(frozen=True)
class SceneRecord:
    """A scene to be made.

    Args:
        garment, body, motion: built-in names, or files.
        seed: of a built-in motion; None for a recording.
        triangles: resolution asked for.
        frames: frames to write.
        lead_in: frames simulated before them.
        digests: (field, SHA-256) of every field that is a file; a result belongs to a file's content, not to its place.
    """

    garment: str
    body: str
    motion: str
    seed: int | None
    triangles: int
    frames: int
    lead_in: int = 30
    digests: tuple[tuple[str, str], ...] = ()

    def identity(self) -> dict[str, Any]:
        """What distinguishes this scene from every other."""
        fields = asdict(self)
        for field, content in fields.pop("digests"):
            fields[field] = f"{Path(fields[field]).name} {content}"
        return fields

    def label(self, field: str) -> str:
        """Short name of the garment, body or motion."""
        name = Path(getattr(self, field)).stem if field in dict(self.digests) else getattr(self, field)
        return str(name)


@dataclass(frozen=True)
class ModelRecord:
    """A simulator of the run.

    Args:
        name: what `load_simulator` takes.
        label: what tables call it.
        weights: SHA-256 of a network's weights; None for what has none.
        adapts: it has a number of propagation steps that can be set.
    """

    name: str
    label: str
    weights: str | None = None
    adapts: bool = False


@dataclass(frozen=True)
class Settings:
    """How a model is run; for what has no such setting, the value here.

    Args:
        propagation_steps: override of K; None follows the model's own rule.
        refine: solver iterations after each step.
        contact: the garment is pushed out of the body after each step.
        device: "cpu" or "cuda".
    """

    propagation_steps: int | None = None
    refine: int = 0
    contact: bool = False
    device: str = "cpu"


@dataclass(frozen=True)
class RolloutJob:
    """A scene, a model and its settings."""

    scene: SceneRecord
    model: ModelRecord
    settings: Settings

    @property
    def key(self) -> str:
        """Address of the result: the same for the same work, another for any other."""
        identity = {
            "protocol_version": PROTOCOL_VERSION,
            "pb4u": __version__,
            "scene": self.scene.identity(),
            "model": self.model.weights or self.model.name,
            "settings": asdict(self.settings),
        }
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:24]

    def __str__(self) -> str:
        scene = self.scene
        steps = "" if self.settings.propagation_steps is None else f", K {self.settings.propagation_steps}"
        worn = " ".join(scene.label(field) for field in ("garment", "body", "motion"))
        return f"{self.model.label} on {worn} at {scene.triangles:,} triangles{steps}"
