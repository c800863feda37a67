"""A tiny network with written-down results, forward and backward: what it computes may not drift unnoticed.

Nothing here is random: weights and state are sines of their indices. After an intended change run this file as a
program; it rewrites golden_network.json.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.world_edges import WorldEdgeRule
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation import RELEASED_PROPAGATION
from pb4u.network.update_scaling import MeanScaling
from pb4u.paper.network_presets import pb4u_paper
from pb4u.scene.colliders import ColliderFrame, pack_colliders
from pb4u.scene.packed import pack
from pb4u.scene.state import State

GOLDEN = Path(__file__).with_name("golden_network.json")
FORMS: dict[str, Pb4uConfiguration] = {
    "pb4u_paper": pb4u_paper,
    "pb4u_release": replace(
        pb4u_paper,
        propagation=RELEASED_PROPAGATION,
        scaling=MeanScaling(0.01),
        layout=FeatureLayout(node=("velocity", "normal", "dt", "vertex_mass", "material")),
    ),
    "pb4u_all_pairs": replace(pb4u_paper, world_edges=WorldEdgeRule(radius=0.03, neighbours=16)),
}


def wave(*shape: int, pitch: float = 1.0) -> Tensor:
    count = int(np.prod(shape))
    return torch.sin(pitch * (1.0 + torch.arange(count, dtype=torch.float64)) ** 1.1).reshape(shape)


def grid(rows: int, columns: int, edge: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    vertices = np.stack([i * edge, np.full(i.shape, height), (j + 0.3 * i) * edge], axis=-1).reshape(-1, 3)
    a = (i * columns + j)[:-1, :-1].reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + columns], 1), np.stack([a + 1, a + columns + 1, a + columns], 1)])
    return vertices, faces


def results(configuration: Pb4uConfiguration) -> dict[str, Any]:
    material = Material.isotropic(density=0.2, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5)
    fine, coarse = (Garment("sheet", *grid(*size, height=1.0), material) for size in ((5, 4, 0.04), (4, 3, 0.06)))
    coarse = coarse.with_pins(np.arange(12) < 3)
    packed = pack([fine, coarse])
    state = State(packed.rest_positions + 1e-3 * wave(32, 3), 0.1 * wave(32, 3, pitch=0.7), 0)
    under, faces = grid(4, 4, 0.03, height=0.985)
    now = torch.as_tensor(np.concatenate([under, under]))
    contact = torch.arange(32) % 7 != 0
    bodies = pack_colliders([torch.as_tensor(faces)] * 2, [contact[:16], contact[16:]], [0, 1])
    before, after = now - 1e-3 * wave(32, 3, pitch=0.3), now + 2e-3 * wave(32, 3, pitch=0.2)
    body = ColliderFrame(bodies.pose(before), bodies.pose(now), bodies.pose(after))
    model = AccelerationModel(configuration.network()).double()
    for index, parameter in enumerate(model.parameters()):
        spread = parameter.shape[-1] ** -0.5 if parameter.dim() > 1 else 0.3
        parameter.data = spread * wave(*parameter.shape, pitch=0.1 + 0.37 * index % 1.0)
    prepared = model.prepare(packed, dtype=torch.float64)
    out = model(prepared.graph(state, body, 1 / 30), prepared)
    (out * 1e3).square().sum().backward()
    gradients = {name: p.grad.abs().sum().item() for name, p in model.named_parameters()}
    return {"steps": list(prepared.steps), "accelerations": out.tolist(), "gradients": gradients}


def all_results() -> dict[str, Any]:
    return {name: results(replace(FORMS[name], width=6, blocks=2)) for name in FORMS}


@pytest.mark.parametrize("name", FORMS)
def test_the_network_computes_what_was_written_down(name):
    expected = json.loads(GOLDEN.read_text())[name]
    found = results(replace(FORMS[name], width=6, blocks=2))
    assert found["steps"] == expected["steps"]
    largest = np.abs(expected["accelerations"]).max()
    np.testing.assert_allclose(found["accelerations"], expected["accelerations"], rtol=0, atol=1e-9 * largest)
    assert found["gradients"].keys() == expected["gradients"].keys()
    for parameter, value in expected["gradients"].items():
        assert found["gradients"][parameter] == pytest.approx(value, rel=1e-7, abs=1e-12), parameter


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(all_results(), indent=1) + "\n")
