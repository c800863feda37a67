"""How much a network takes out in one step, of bulk and of wrinkles, by level; docs/science/update_scaling.md shows it.

    python benchmarks/scaling_gains.py ROWS.jsonl [--levels 1200,2400,4800,9600,19200] [--garment tshirt]
    python benchmarks/scaling_gains.py ROWS.jsonl --draw FIGURE.svg

States are those of the quick solver, at three frames of a walk. A wave of the mesh's own wavelength and 5 % of an edge
is laid on the positions: the gain is the share of it that the network takes out. At 1 nothing of it is left, above 2 it
grows from step to step. For bulk it is the share of the step's true motion from free flight that the network predicts,
both behind a low-pass of 90 mm. The rules of scaling are applied to the same predictions.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.network.surface_low_pass import SurfaceLowPass
from pb4u.network.update_scaling import UpdateScale
from pb4u.physics.time_step import TimeStep
from pb4u.scene.assembly import make_scene
from pb4u.simulation.models import load_simulator
from pb4u.simulation.network_pass import NetworkPass
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import take
from pb4u.simulation.stepwise_simulator import NetworkSimulator, StepwiseSimulator
from pb4u.simulation.timeline import Timeline

FRAMES = (12, 15, 18)
RULES = ("per-vertex", "none", "band-split")
SHARE = 0.05
"""Size of a wave at the mesh's own wavelength, in edge lengths."""
BULK, SHORT = 0.09, 0.045
"""Lengths of the low-passes [m] that what is long, and what is not short, is taken with."""


def gains(triangles: int, garment: str, model: str) -> list[dict[str, Any]]:
    """Gains of every rule, one row a frame."""
    scene = make_scene(garment, "woman", "walk", triangles=triangles, frames=FRAMES[-1] + 2, lead_in=0, seed=2000)
    quick = load_simulator("quick-solver", refine=10, contact=False, self_contact=False)
    networks = {
        rule: load_simulator(model, refine=0, contact=False, self_contact=False, device="cpu", scaling=rule)
        for rule in RULES
    }
    assert isinstance(quick, StepwiseSimulator)
    timeline = Timeline.of(scene)
    going = quick.method(timeline, RunRecord())
    states = [next(iter(quick.first_frame.states(timeline, going))).state]
    while len(states) < FRAMES[-1] + 2:
        states.append(take(timeline.step_from(states[-1]), going).state)
    scales: dict[str, UpdateScale | None] = {}
    plain: NetworkPass | None = None
    for rule, simulator in networks.items():
        assert isinstance(simulator, NetworkSimulator)
        network = simulator.method(timeline, RunRecord()).network
        assert network is not None
        scales[rule] = network.prepared.scale
        plain = NetworkPass(network.network, replace(network.prepared, scale=None), network.features)
    assert plain is not None
    garments = timeline.garments
    bulk, short = SurfaceLowPass(garments, BULK), SurfaceLowPass(garments, SHORT)
    areas, edge = garments.vertex_areas[:, None], garments.mean_edge_lengths[0]

    def share(part: Tensor, of: Tensor) -> float:
        return float((areas * part * of).sum() / (areas * of * of).sum())

    def predicted(step: TimeStep) -> Tensor:
        return plain.correction(step, torch.zeros_like(step.state.positions))

    rows = []
    for frame in FRAMES:
        state = states[frame]
        step = timeline.step_from(state)
        there = predicted(step)
        true = bulk(states[frame + 1].positions - state.positions - step.dt * state.velocities)
        wave = torch.from_numpy(np.random.default_rng(0).standard_normal(state.positions.shape))
        wave = wave - short(wave)
        wave *= SHARE * edge / wave.square().sum(1).mean().sqrt()
        moved = predicted(timeline.step_from(replace(state, positions=state.positions + wave)))
        row: dict[str, Any] = {"triangles": triangles, "edge_length": edge, "frame": frame}
        for rule, scale in scales.items():
            one, other = (values if scale is None else scale(values) for values in (there, moved))
            row[rule] = {"bulk": share(bulk(one), true), "mesh": share(one - other, wave)}
        rows.append(row)
    return rows


def draw(rows: list[dict[str, Any]], out: Path) -> None:
    """Two panels over the edge length: the gain of the mesh's own waves, and that of bulk."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"svg.hashsalt": "gains", "svg.fonttype": "none"})
    figure, panels = pyplot.subplots(1, 2, figsize=(8.0, 3.2), layout="constrained")
    lengths = sorted({row["edge_length"] for row in rows}, reverse=True)
    for panel, part, title in ((panels[0], "mesh", "waves of the mesh"), (panels[1], "bulk", "bulk motion")):
        for rule, colour in zip(RULES, ("tab:red", "tab:gray", "tab:blue"), strict=True):
            for row in rows:
                panel.plot(1e3 * row["edge_length"], row[rule][part], ".", color=colour, alpha=0.4)
            means = [np.median([row[rule][part] for row in rows if row["edge_length"] == each]) for each in lengths]
            panel.plot(1e3 * np.array(lengths), means, "-", color=colour, label=rule)
        panel.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
        panel.set(xscale="log", xlabel="mean edge length [mm]", title=f"Gain on {title}")
        panel.set_xticks([1e3 * each for each in lengths], [f"{1e3 * each:.0f}" for each in lengths])
        panel.minorticks_off()
        panel.invert_xaxis()
    panels[0].axhline(2.0, color="black", linewidth=0.8, linestyle="--")
    panels[0].legend(title="scaling", frameon=False)
    figure.savefig(out, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--levels", default="1200,2400,4800,9600,19200")
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--model", default="literal_small")
    parser.add_argument("--draw", type=Path)
    options = parser.parse_args()
    if options.draw is not None:
        draw([json.loads(line) for line in options.rows.read_text().splitlines()], options.draw)
        return
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    for triangles in options.levels.split(","):
        with options.rows.open("a") as out:
            for row in gains(int(triangles), options.garment, options.model):
                out.write(json.dumps(row) + "\n")
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
