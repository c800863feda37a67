"""The arguments of `pb4u evaluate`: its flags are made of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pb4u.options import Flag, require_fitting


@dataclass(frozen=True)
class EvaluationRequest:
    """Options of an evaluation; None keeps the protocol's own choice.

    Args:
        protocol: resolution, unseen (garments), depth (propagation steps), efficiency (time and loss), ablation,
            controls (the network's contribution), or robustness (random scenes).
        models: solver, quick-solver, skinning, networks by name or .safetensors files. Default: the protocol's.
        garments: Built-in garments or mesh files. Default: the protocol's.
        motions: Built-in motions (walk, walk-7 with a seed), CMU trials (07_02) or files. Default: the protocol's.
        bodies: Bodies, by name or file. Default: woman.
        levels: Resolutions: base, 11K, .. 38K, or numbers of triangles. Default: the protocol's.
        propagation_steps: Numbers of propagation steps to set. Default: the protocol's.
        frames: Frames of each rollout, at 30 a second. Default: 30, of controls and robustness 60.
        lead_in: Frames from the rest pose into the motion, simulated but not measured.
        recordings: Folder of CMU recordings, SUBJECT/TRIAL.amc beside SUBJECT/SUBJECT.asf; they replace built-in
            motions.
        refine: Solver iterations after each step of a network.
        contact: Push the garment out of the body after each step.
        device: Where networks compute: auto, cpu or cuda.
        floors: Reference energies: run the solver on scenes that lack a stored one, or use stored ones.
        measure: Also measure excess, the energy of single steps above their minimum, and the distance from the solver's
            rollout: two solves a frame for each scene. `controls` always does.
        scenes: Scenes that robustness draws. Default: 64.
        seed: Seed of the scenes that robustness draws.
        layout: Tables of the project, or as the paper lays them out, with its figures beside them.

    Raises:
        InputError: a number out of range.
    """

    protocol: Annotated[str, Flag(metavar="NAME")] = "resolution"
    models: Annotated[tuple[str, ...] | None, Flag(metavar="A,B")] = None
    garments: Annotated[tuple[str, ...] | None, Flag(metavar="A,B")] = None
    motions: Annotated[tuple[str, ...] | None, Flag(metavar="A,B")] = None
    bodies: Annotated[tuple[str, ...] | None, Flag(metavar="A,B")] = None
    levels: Annotated[tuple[str, ...] | None, Flag(metavar="A,B")] = None
    propagation_steps: Annotated[tuple[int, ...] | None, Flag(metavar="K,K")] = None
    frames: Annotated[int | None, Flag(metavar="N", least=1)] = None
    lead_in: Annotated[int, Flag(metavar="N", least=0)] = 30
    recordings: Annotated[Path | None, Flag(metavar="DIR")] = None
    refine: Annotated[int, Flag(metavar="N", least=0)] = 0
    contact: Annotated[bool, Flag()] = False
    device: Annotated[str, Flag()] = "auto"
    floors: Annotated[Literal["run", "stored"], Flag()] = "run"
    measure: Annotated[Literal["excess"] | None, Flag()] = None
    scenes: Annotated[int | None, Flag(metavar="N", least=1)] = None
    seed: Annotated[int, Flag(metavar="N", least=0)] = 0
    layout: Annotated[Literal["project", "paper"], Flag()] = "project"

    def __post_init__(self) -> None:
        require_fitting(self)

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON."""
        return asdict(self) | {"recordings": None if self.recordings is None else str(self.recordings)}
