"""Trains every network of the comparison alike, one after the other: `pb4u train --preset comparison` with each.

python tools/comparison.py --out FOLDER [--only pb4u,mgn] [--seed 0] [--steps 8000] [--ship]
python tools/comparison.py --out FOLDER --only wide,wide-half-width --steps 4000    # `pb4u-wide` and its departures
python tools/comparison.py --out FOLDER --only literal,literal-by-rule --steps 2500 --weights \
    weights/literal_small/best.safetensors    # the paper's network, trained on with K drawn or by another law

The weights of the end are compared, so that all have had the same budget. Those of the departures are also written
beside their folders, with the further passes that the shipped network takes. Killed at any instant, the same command
goes on where it was; several may share the folder, each with its own --only.
--ship copies the finished weights to where the package looks for them, under the names that `pb4u evaluate` compares.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

from pb4u.paper.network_presets import pb4u_small_conjugate
from pb4u.simulation.checkpoint import load_checkpoint, save_checkpoint

LAW_OF_K = ("most_propagation_steps=0",)
"""K in training is the network's own: by the rule, or five without control; else drawn, for the table of depths."""

AS_SHIPPED = (
    *LAW_OF_K, "network.further_passes=0", "loss_weight=progress", "inside_weight=1e5", "gradient_norm=20.",
    "curriculum.collision_weight=((0.0, 5e3),)",
)  # fmt: skip
"""The shipped network's losses. Its further passes are not learnt from: they are taken in use alone."""
WIDE = ("network=pb4u_small_conjugate", *AS_SHIPPED)

TRAINED_ON = (
    "curriculum.learning_rate=2e-5", "curriculum.halvings=2", "curriculum.window_steps=((0.0, 5),)",
    "curriculum.collision_weight=((0.0, 5e3),)",
)  # fmt: skip

LITERAL = {
    "literal": ("network=literal_small", *TRAINED_ON),
    "literal-by-rule": ("network=literal_small", *LAW_OF_K, *TRAINED_ON),
    "literal-without-control": ("network=literal_small_without_propagation_control", *LAW_OF_K, *TRAINED_ON),
    "literal-without-scaling": ("network=literal_small_without_update_scaling", *TRAINED_ON),
    "literal-without-both": ("network=literal_small_without_both", *LAW_OF_K, *TRAINED_ON),
}
"""The paper's network and its ablations, which go on from weights that --weights gives; K is drawn, by the preset."""

COMPARED = {
    "pb4u": ("network=pb4u_small_carried",),
    "mgn": ("network=mgn_small",),
    "hood": ("network=hood_small",),
    "eslr": ("network=eslr_small",),
    "contourcraft": ("network=contourcraft_small",),
    "wide": WIDE,
    "wide-without-gradient": ("network=conjugate_without_gradient", *AS_SHIPPED),
    "wide-without-warm-start": (*WIDE, "network.warm_start_shares=()"),
    # Progress is what the search frees.
    "wide-without-search": (*WIDE, "network.conjugate=False", "loss_weight=joule"),
    "wide-without-feature-size": (*WIDE, "network.descent_size=0."),
    "wide-without-inside-term": (*WIDE, "inside_weight=0."),
    "wide-without-control": ("network=conjugate_without_propagation_control", *AS_SHIPPED),
    "wide-without-scaling": ("network=conjugate_without_update_scaling", *AS_SHIPPED),
    "wide-without-both": ("network=conjugate_without_both", *AS_SHIPPED),
    "wide-half-width": (*WIDE, "network.width=32"),
    "wide-half-depth": (*WIDE, "network.blocks=2"),
}
"""The comparison, and the shipped network less each of its departures, by the name each gets."""

WEIGHTS = Path(__file__).parents[1] / "src" / "pb4u" / "simulation" / "weights"


def train(name: str, folder: Path, options: argparse.Namespace) -> None:
    """Train one network, or go on with it."""
    if (folder / "ended.json").exists():
        return
    preset, chosen = ("literal_small", LITERAL[name]) if name in LITERAL else ("comparison", COMPARED[name])
    pack = options.out / f"{preset}.npz"
    if not pack.exists():
        subprocess.run(["pb4u", "assets", "pack", str(pack), "--preset", preset], check=True)
    if (folder / "last.safetensors").exists():
        wanted = ["--resume", str(folder)]
    else:
        shutil.rmtree(folder, ignore_errors=True)
        settings = [part for setting in (*chosen, f"seed={options.seed}") for part in ("--set", setting)]
        wanted = ["--preset", preset, "--steps", str(options.steps), "--out", str(folder), *settings]
        wanted += ["--pack", str(pack)] + (["--weights", options.weights] if options.weights else [])
    print(f"{name}: pb4u train {' '.join(wanted)}", flush=True)
    subprocess.run(["pb4u", "train", *wanted, "--json", str(folder.with_suffix(".json"))], check=True)
    ended = json.loads(folder.with_suffix(".json").read_text())
    if ended["ending"] == "finished":
        os.replace(folder.with_suffix(".json"), folder / "ended.json")


def write_as_used(folder: Path) -> None:
    """Write FOLDER.safetensors: the weights with further passes, where a search tells whether one pays."""
    final = load_checkpoint(folder / "final.safetensors")
    further = pb4u_small_conjugate.further_passes if final.configuration.conjugate else 0
    configuration = replace(final.configuration, further_passes=further)
    save_checkpoint(f"{folder}.safetensors", final.model, configuration, final.record, final.licence)


def main() -> None:
    """Train what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default=",".join(COMPARED))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--weights", help="weights that every training begins with; default: drawn")
    parser.add_argument("--ship", action="store_true")
    options = parser.parse_args()
    names = options.only.split(",")
    if unknown := [name for name in names if name not in COMPARED and name not in LITERAL]:
        parser.error(f"there is no {unknown[0]}; there are {', '.join((*COMPARED, *LITERAL))}")
    if options.weights is None and (begun := [name for name in names if name in LITERAL]):
        parser.error(f"{begun[0]} goes on from weights: add --weights weights/literal_small/best.safetensors")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        folder = options.out / (name if options.seed == 0 else f"{name}-seed{options.seed}")
        train(name, folder, options)
        if name.startswith("wide") and (folder / "ended.json").exists():
            write_as_used(folder)
        if options.ship and (folder / "ended.json").exists():
            shutil.copy(folder / "final.safetensors", WEIGHTS / f"comparison-{folder.name}.safetensors")


if __name__ == "__main__":
    main()
