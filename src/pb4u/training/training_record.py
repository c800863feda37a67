"""The record that trained weights carry: what they were trained on, for how long, and how good they were."""

from __future__ import annotations

import math
from typing import Any

import torch

from pb4u import __version__
from pb4u.network.acceleration_model import GraphNetwork
from pb4u.simulation.checkpoint import TrainingRecord
from pb4u.training.budget import Counters
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.packed_data import TrainingData


def training_record(
    configuration: TrainingConfiguration,
    data: TrainingData,
    network: GraphNetwork,
    counters: Counters,
    score: dict[str, Any],
    device: torch.device,
) -> TrainingRecord:
    """Record of a training up to now.

    Args:
        configuration: everything that decides it.
        data: what the network is trained on.
        network: the network.
        counters: steps and seconds so far.
        score: of the last validation, as JSON data.
        device: of the training.
    """
    ruled = [network.propagation_steps(outfit.garment.mean_edge_length) for outfit in data.outfits]
    most = configuration.most_propagation_steps
    details = {
        "garments": sorted({outfit.garment.name for outfit in data.outfits}),
        "triangles": sorted({outfit.garment.triangle_count for outfit in data.outfits}),
        "bodies": sorted({body.name for body in data.bodies}),
        "clips": len(data.clips),
        "motions": sorted({clip.name for clip in data.clips}),
        "batch": configuration.batch,
        "seed": configuration.seed,
        "hours": round(counters.seconds / 3600.0, 3),
        "device": str(device),
        "validation": {name: value if math.isfinite(value) else None for name, value in score.items()},
        "versions": {"pb4u": __version__, "torch": torch.__version__},
    }
    steps = (1, most) if most else (min(ruled), max(ruled))
    return TrainingRecord(1.0 / data.clips[0].poses.fps, data.edge_lengths, steps, counters.step, details)
