"""Time of one network step as it simulates, as it trains, and by its readable twin.

    python benchmarks/network.py [--triangles 2500 11000 ..] [--networks pb4u_paper pb4u_small]
        [--precisions float32 bfloat16] [--json FILE]

Everything is interleaved and the best of several rounds counts, so that a busy machine slows all alike. "torch" is the
network as it trains, in float32. The twin computes in float32; "off" is how far the network is from it, as a share of
the twin's mean size. On one thread: torch's own threads wait busily beside those of compiled layers.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.network_scenes import DT, Moment, moment, sheet, sheet_of
from tests.readable_network import readable_accelerations

from pb4u.network.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.network.registry import NETWORKS
from pb4u.scene.colliders import ColliderFrame, pack_colliders

Shapes = Counter[tuple[int, int, int]]


class MatrixProducts(TorchDispatchMode):
    """Counts the matrix products issued inside, by (rows, inner, columns)."""

    def __init__(self) -> None:
        super().__init__()
        self.shapes: Shapes = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        if name == "linear":
            rows, columns = args[0], args[1].shape[0]
            self.shapes[(rows.shape[0], rows.shape[1], columns)] += 1
        elif name in ("mm", "addmm", "addmm_"):
            a, b = args[-2:]
            self.shapes[(a.shape[0], a.shape[1], b.shape[1])] += 1
        return func(*args, **(kwargs or {}))


def operations(shapes: Shapes) -> int:
    """Floating point operations, a multiplication and an addition counting as two."""
    return sum(2 * m * k * n * count for (m, k, n), count in shapes.items())


def on_a_body(triangles: int) -> Moment:
    """A garment all of whose vertices lie within reach of a body of 1 cm edges, as close-fitting clothes do."""
    garment = sheet_of(triangles)
    side = int(garment.vertices[:, 0].max() / 0.01) + 2
    under = sheet(side, side, edge=0.01, seed=1)
    now = torch.as_tensor(under.vertices, dtype=torch.float32) - torch.tensor([0.0, 0.012, 0.0])
    bodies = pack_colliders([torch.as_tensor(under.faces)], [torch.ones(len(now), dtype=torch.bool)], [0])
    collider = ColliderFrame(bodies.pose(now - 0.002), bodies.pose(now), bodies.pose(now + 0.002))
    bare = moment([garment], body=False, dtype=torch.float32)
    return Moment(bare.garments, bare.state, collider)


def seconds(work: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    work()
    return clock() - start


def measure(network: str, precision: str, repeats: int, at: Moment, clock: Callable[[], float]) -> dict[str, Any]:
    torch.manual_seed(0)
    exact = AccelerationModel(NETWORKS.named(network).network()).eval()
    dtype = getattr(torch, precision)
    model = exact.for_inference(dtype)
    prepared: PreparedGarments = model.prepare(at.garments)
    with torch.inference_mode():
        graph = prepared.graph(at.state, at.collider, DT)
        with MatrixProducts() as products:
            readable = readable_accelerations(exact, graph, prepared)
        off = float((model(graph, prepared) - readable).norm() / readable.norm())
        assert off < (1e-5 if precision == "float32" else 5e-2), off
        times: dict[str, list[float]] = {"network": [], "torch": [], "twin": [], "graph": []}
        for _ in range(repeats):
            times["network"].append(seconds(lambda: model(graph, prepared), clock))
            times["torch"].append(seconds(lambda: exact(graph, prepared), clock))
            times["twin"].append(seconds(lambda: readable_accelerations(exact, graph, prepared), clock))
            times["graph"].append(seconds(lambda: prepared.graph(at.state, at.collider, DT), clock))
    ms = {name: 1e3 * min(values) for name, values in times.items()}
    return {
        "network": network,
        "precision": precision,
        "off": off,
        "triangles": at.garments.faces.shape[0],
        "vertices": at.garments.vertex_count,
        "mesh_edges": graph.edges["mesh"].edge_count,
        "world_edges": 2 * graph.edges["body_to_garment"].edge_count,
        "propagation_steps": prepared.steps[0],
        "graph_ms": ms["graph"],
        "network_ms": ms["network"],
        "torch_ms": ms["torch"],
        "twin_ms": ms["twin"],
        "speed_over_twin": ms["twin"] / ms["network"],
        "twin_gflop": operations(products.shapes) / 1e9,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--triangles", type=int, nargs="+", default=[2500, 11000, 18000, 25000, 38000])
    parser.add_argument("--networks", nargs="+", default=["pb4u_paper", "pb4u_small"])
    parser.add_argument("--precisions", nargs="+", default=["float32", "bfloat16"])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--clock", choices=("wall", "cpu"), default="wall", help="cpu, with one thread, on a machine that others use"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    os.environ["OMP_NUM_THREADS"] = str(options.threads)
    clock = time.process_time if options.clock == "cpu" else time.perf_counter
    rows = []
    print("network     precision  triangles  K  graph  network    torch     twin [ms]  twin/net  Gflop, twin     off")
    for triangles in options.triangles:
        at = on_a_body(triangles)
        for network, precision in product(options.networks, options.precisions):
            row = measure(network, precision, options.repeats, at, clock)
            rows.append(row)
            print(
                f"{network:11} {precision:9} {row['triangles']:10} {row['propagation_steps']:2} {row['graph_ms']:6.1f} "
                f"{row['network_ms']:8.1f} {row['torch_ms']:8.1f} {row['twin_ms']:8.1f}       "
                f"{row['speed_over_twin']:7.2f} {row['twin_gflop']:12.1f} {row['off']:.1e}",
                flush=True,
            )
    if options.json:
        options.json.write_text(
            json.dumps(
                {"threads": options.threads, "clock": options.clock, "torch": torch.__version__, "rows": rows}, indent=1
            )
        )


if __name__ == "__main__":
    main()
