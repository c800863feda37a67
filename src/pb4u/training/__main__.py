"""Trains from a pack on a machine that has torch, numpy and safetensors only: `python -m pb4u.training --help`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pb4u.errors import Pb4uError
from pb4u.training.session import Request, train


def main() -> int:
    """Run a training with the options of `pb4u train` that need no asset but the pack; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m pb4u.training", description="Train a network from a pack.")
    parser.add_argument("--pack", type=Path, help="file that `pb4u assets pack` wrote")
    parser.add_argument("--preset", help="name of a training, as `pb4u train --preset` takes it")
    parser.add_argument("--steps", type=int, help="optimiser steps")
    parser.add_argument("--minutes", type=float, help="wall time [min]")
    parser.add_argument("--out", type=Path, help="new folder of the training")
    parser.add_argument("--resume", type=Path, help="folder of a training to go on with")
    parser.add_argument("--weights", help="built-in name or file of weights to begin with")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="replace a field of the preset")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    given = parser.parse_args()
    request = Request(
        preset=given.preset,
        steps=given.steps,
        minutes=given.minutes,
        out=given.out,
        resume=given.resume,
        pack=given.pack,
        settings=tuple(given.set),
        device=given.device,
        weights=given.weights,
    )
    try:
        if given.pack is None and given.resume is None:
            parser.error("--pack FILE is needed for a new training")
        result = train(request)
    except Pb4uError as error:
        print(f"pb4u: {error}", file=sys.stderr)
        return 1
    print(result["sentence"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
