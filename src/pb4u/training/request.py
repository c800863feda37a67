"""The arguments of `pb4u train`: its flags are made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pb4u.options import Flag, require_fitting


@dataclass(frozen=True)
class TrainingRequest:
    """Options of a training.

    Args:
        preset: Which training: small (two cores, the default), wide (continues small by --weights), literal (the
            paper's network and schedule), literal_small (the same, 64 wide with 4 blocks),
            paper (the paper's size and schedule with our inputs), comparison (half an hour), smoke (seconds).
        steps: Total number of optimiser steps, including those before --resume. Default: the preset's own number.
        minutes: Minutes of training in all, beyond the making of its data; instead of steps, or besides.
        out: New folder for the training; this or --resume is required.
        resume: Folder of a training to continue, instead of --out.
        pack: Training data that `pb4u assets pack` wrote; default: made from the preset.
        recordings: Folder of recordings to train on as well: CMU's as SUBJECT/TRIAL.amc beside SUBJECT.asf, VTO's .pkl,
            AMASS's .npz, .bvh.
        weights: Start from these weights and their network, as in --preset wide; --set network=NAME may differ from it
            in control and scaling. Default: drawn.
        set: Replace a field of the preset, as in network.width=64. Repeatable.
        device: auto, cpu or cuda.

    Raises:
        InputError: a number out of range.
    """

    preset: Annotated[str | None, Flag()] = None
    steps: Annotated[int | None, Flag(least=1)] = None
    minutes: Annotated[float | None, Flag()] = None
    out: Annotated[Path | None, Flag()] = None
    resume: Annotated[Path | None, Flag()] = None
    pack: Annotated[Path | None, Flag()] = None
    recordings: Annotated[Path | None, Flag()] = None
    weights: Annotated[str | None, Flag(metavar="FILE|NAME")] = None
    set: Annotated[Sequence[str], Flag(metavar="KEY=VALUE")] = ()
    device: Annotated[str, Flag()] = "auto"

    def __post_init__(self) -> None:
        require_fitting(self)
