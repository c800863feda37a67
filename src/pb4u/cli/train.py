"""`pb4u train`: a network from the physics alone, in a folder that it can always go on from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pb4u.cli.console import JsonFlag, check_json_target, keep_inputs, tell


def train(
    preset: Annotated[
        str | None,
        typer.Option(
            help="Which training: small (two cores, the default), wide (goes on with small by --weights), literal (the "
            "paper's network and schedule; days of an accelerator), literal_small (the same, 64 wide with 4 blocks), "
            "paper (the paper's size and schedule with inputs of ours), comparison (half an hour), smoke (seconds)."
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1, help="Optimiser steps in all, those before --resume included. Default: the preset's own number."
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help="Minutes of training in all, beyond the making of its data; instead of steps, or besides."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="New folder to keep the training in; this or --resume is needed.")
    ] = None,
    resume: Annotated[Path | None, typer.Option(help="Folder of a training to go on with, instead of --out.")] = None,
    pack: Annotated[
        Path | None, typer.Option(help="Training data that `pb4u assets pack` wrote; default: made from the preset.")
    ] = None,
    recordings: Annotated[
        Path | None,
        typer.Option(
            help="Folder of recordings to train on as well: CMU's as SUBJECT/TRIAL.amc beside SUBJECT.asf, VTO's .pkl, "
            "AMASS's .npz, .bvh."
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME", help="Begin with these weights and their network, as in --preset wide; default: drawn."
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a field of the preset, as in network.width=64."),
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    json: JsonFlag = None,
) -> None:
    """Train a network. After a kill, --resume goes on from the last checkpoint; an interrupt saves and ends."""
    from pb4u.training.session import Request, train as run

    check_json_target(json)
    keep_inputs([pack, weights], [("--json", json)])
    result = run(Request(preset, steps, minutes, out, resume, pack, recordings, tuple(set_ or ()), device, weights))
    tell(result, json, result["sentence"] + (f" Weights: {result['weights']}" if result["weights"] else ""))
