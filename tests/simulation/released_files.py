"""Checkpoints as the released research code saves them, of random weights."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import torch


def _mlp(prefix: str, inputs: int, outputs: int = 8, norm: bool = True) -> dict[str, torch.Tensor]:
    width, layers = 8, ".0.layers." if norm else ".layers."
    shapes = {"0": (width, inputs), "2": (width, width), "4": (outputs, width)}
    made = {}
    for name, shape in shapes.items():
        made[f"{prefix}{layers}{name}.weight"] = torch.randn(shape)
        made[f"{prefix}{layers}{name}.bias"] = torch.randn(shape[0])
    if norm:
        made |= {f"{prefix}.1.weight": torch.ones(outputs), f"{prefix}.1.bias": torch.zeros(outputs)}
    return made


def _normaliser(name: str, width: int) -> dict[str, torch.Tensor]:
    values = {"acc_count": torch.tensor([50.0]), "num_accumulations": torch.tensor([3.0])}
    values |= {"acc_sum": torch.randn(1, width), "acc_sum_squared": 60.0 + torch.rand(1, width)}
    return {f"model._{name}_normalizer._{part}": value for part, value in values.items()}


def made_checkpoint(blocks: int = 2) -> dict[str, Any]:
    """A MeshGraphNet of random weights as the released code saves one."""
    torch.manual_seed(0)
    root = "model._learned_model."
    weights = _mlp(f"{root}node_encoder", 20) | _mlp(f"{root}decoder", 8, 3, norm=False)
    weights |= _mlp(f"{root}edgeset_encoders.mesh", 12) | _mlp(f"{root}edgeset_encoders.world", 9)
    for number in range(blocks):
        for part in ("node_processor", "mesh_edge_processor", "world_edge_processor"):
            weights |= _mlp(f"{root}processor_steps.{number}.{part}", 24)
    for name, width in (("output", 3), ("node", 17), ("mesh_edge", 9), ("world_edge", 9)):
        weights |= _normaliser(name, width)
    weights["model.nodetype_embedding.weight"] = torch.randn(9, 9)
    config = {
        "model": {"baselines": {"latent_size": 8, "message_passing_steps": blocks, "collision_radius": 0.02}},
        "runner": {"baselines": {"material": {"lame_mu_min": 100.0, "lame_mu_max": 200.0}, "regular_ts": 0.02}},
    }
    return {"training_module": OrderedDict(weights), "config": config}
