"""Time of one network step of several methods, interleaved, as a ratio to the first.

    python benchmarks/methods.py [--triangles 48000] [--networks mgn pb4u_paper hood] [--repeats 3]

Weights are random: what a step costs does not depend on them. A sheet over a body within reach of all of it; the best
of several rounds counts, the graph left out.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.network import on_a_body
from tests.network_scenes import DT

from pb4u.network.acceleration_model import AccelerationModel
from pb4u.paper.network_presets import network_preset


def main() -> None:
    """Time all, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=48000)
    parser.add_argument("--networks", nargs="+", default=["mgn", "pb4u_paper", "hood"])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    at = on_a_body(options.triangles)
    steps = {}
    for name in options.networks:
        model = AccelerationModel(network_preset(name).network()).eval()
        prepared = model.prepare(at.garments)
        steps[name] = (model, prepared, prepared.graph(at.state, at.collider, DT))
    best = dict.fromkeys(steps, float("inf"))
    with torch.inference_mode():
        for _ in range(options.repeats):
            for name, (model, prepared, graph) in steps.items():
                began = time.process_time()
                model(graph, prepared)
                best[name] = min(best[name], 1e3 * (time.process_time() - began))
    print("| network | K | ms | of the first |\n|---|---|---|---|")
    for name, ms in best.items():
        propagation = steps[name][1].steps[0] or "-"
        print(f"| {name} | {propagation} | {ms:.0f} | {ms / best[options.networks[0]]:.2f} |")


if __name__ == "__main__":
    main()
