"""`pb4u convert-weights`: a checkpoint of the released research code as one of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pb4u.cli.console import JsonFlag, check_json_target, keep_inputs, tell, verb
from pb4u.errors import InputError
from pb4u.io.atomic_file import check_writable


@verb()
def convert_weights(
    checkpoint: Annotated[Path, typer.Argument(metavar="IN.pth")],
    out: Annotated[Path, typer.Argument(metavar="OUT.safetensors")],
    method: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    licence: Annotated[str | None, typer.Option(metavar="SPDX")] = None,
    json: JsonFlag = None,
) -> None:
    """Convert a .pth of the released Pb4U-GNet, MeshGraphNet, HOOD or ContourCraft, number by number.\f

    Args:
        checkpoint: Checkpoint of Pb4U-GNet, HOOD or ContourCraft; no code in it is run.
        out: File to write, for --model.
        method: Network preset of the checkpoint, such as release_hood. Default: found from its settings and keys.
        licence: Licence of the weights, kept with them. Default: "unknown: ask the author".
        json: file for the result.

    Raises:
        InputError: the file is not a checkpoint of these, damaged, or has unexpected content; nothing is written then.
    """
    if out.suffix != ".safetensors":
        raise InputError(f"Weights are written as .safetensors; {out} has another suffix.")
    keep_inputs([checkpoint], [("OUT", out), ("--json", json)])
    check_writable(out, "the weights")
    check_json_target(json)
    from pb4u.compat.released_weights import read_released

    released = read_released(checkpoint, method, licence)
    parameters = sum(parameter.numel() for parameter in released.checkpoint().model.network.parameters())
    released.save(out)
    summary = {
        "out": str(out),
        "network": released.preset,
        "parameters": parameters,
        "licence": released.licence,
        "optimiser_steps": released.record.optimiser_steps,
        "time_step": released.record.dt,
        "dropped": list(released.dropped),
    }
    text = f"Wrote {out}: {released.preset}, {parameters:,} parameters, licence {released.licence}."
    if released.dropped:
        parts = sorted({_part(key) for key in released.dropped})
        text += f"\nLeft out, since nothing reads them: {len(released.dropped)} tensors of {', '.join(parts)}."
    tell(summary, json, text)


def _part(key: str) -> str:
    """The part of a network that a released key belongs to."""
    return ".".join(key.removeprefix("model.").removeprefix("_learned_model.").split(".")[:2])
