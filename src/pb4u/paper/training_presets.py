"""Complete trainings by name."""

from __future__ import annotations

from dataclasses import replace

from pb4u.network.registry import NETWORKS
from pb4u.paper import network_presets
from pb4u.simulation.models import TRAINABLE
from pb4u.training.configuration import (
    TRAININGS,
    DataSelection,
    MaterialSampling,
    TrainingConfiguration,
    TrainingPreset,
)
from pb4u.training.curriculum import Curriculum

paper = TrainingConfiguration(
    network=network_presets.pb4u_paper, data=DataSelection(triangles=(11000,)), checkpoint_every=2000
)
"""The paper's own protocol: one low level, windows of up to 5 steps, 450,000 optimiser steps."""

literal = TrainingConfiguration(
    network=network_presets.literal,
    data=DataSelection(triangles=(1200,)),
    # As in the release; the paper does not say. On one level the rule gives 3 to 7, and what it gives on finer meshes
    # would never be learnt: trained by it, both seeds lost a T-shirt of four times the triangles, which these hold.
    most_propagation_steps=30,
    checkpoint_every=2000,
    validate_every=5000,
)
"""The paper's network and protocol on one level that a processor affords; 1,200 triangles times 32 are its finest."""

literal_small = replace(literal, network=network_presets.literal_small)

small = TrainingConfiguration(
    network=network_presets.pb4u_small_two_passes,
    data=DataSelection(triangles=(1300, 2500), shapes=4, clip_frames=200),
    curriculum=Curriculum(
        # What cloth drifts into over a clip is only seen in long windows.
        window_steps=((0.0, 1), (0.02, 3), (0.05, 5), (0.2, 10), (0.35, 20), (0.55, 40), (0.75, 80)),
        # Before windows grow: in long ones cloth would learn that sinking is cheap.
        collision_weight=((0.0, 5e3), (0.05, 2e4), (0.2, 1e5)),
        learning_rate=1e-3,
        halvings=6,
    ),
    interleaved=8,
    most_propagation_steps=24,
    after_settling="slowed",
    checkpoint_every=500,
    validate_every=3000,
    validation_clips=6,
    validation_frames=80,
    patience=12,
)
"""For two processor cores: a narrow network on two levels at once, so that it sees what resolution changes."""

wide = replace(
    small,
    network=network_presets.pb4u_small_conjugate,
    data=DataSelection(
        garments=("tshirt", "tanktop", "longsleeve", "dress", "fitted_dress", "cardigan", "trousers", "skirt", "cape"),
        triangles=(1100, 2400, 4800),
        shapes=8,
        clips=24,
        clip_frames=200,
        drawn_shapes=(0.0, 1.0),
        varied=0.5,
        uneven=0.25,
    ),
    # Half again as wide as the family's: what features are normalised by bears twice its width.
    material=MaterialSampling((0.03, 0.95), (11000.0, 90000.0), (2000.0, 135000.0), (4e-8, 2e-3)),
    curriculum=Curriculum(
        # For weights that know short windows already; 80 steps would draw too few garments in an hour.
        window_steps=((0.0, 24), (0.5, 40)),
        # That of a simulation: learning with more, cloth hovers, and friction does not hold it.
        collision_weight=((0.0, 5e3),),
        # A third of what they began with: moments start from nothing, and what is known is not to be unlearnt.
        learning_rate=3e-4,
        halvings=5,
        # Adam's first steps go by signs alone.
        warm_up=0.01,
    ),
    # What is left of a step differs a thousandfold, by cloth and by how far it is from the minimum.
    loss_weight="progress",
    # Without it a sleeve that an arm swung out of stays inside the arm.
    inside_weight=1e5,
    # One to three times the mean of a hundred steps; steps of which hardly anything is left have many times it.
    gradient_norm=20.0,
    # By the rule: random K left 4 % more of a step after 5,000 steps; finer meshes were not compared.
    most_propagation_steps=0,
    checkpoint_every=200,
    # A validation costs as much as four hundred steps.
    validate_every=6000,
    validation_clips=9,
    validation_frames=60,
)
"""To go on with `small` by `--weights`: every garment and a cape, other cuts, shapes, materials and uneven meshes."""

comparison = replace(
    small,
    network=network_presets.pb4u_small_carried,
    data=DataSelection(garments=("tshirt", "dress"), triangles=(700, 1200), shapes=2, clips=96),
    curriculum=Curriculum(
        window_steps=((0.0, 1), (0.03, 2), (0.06, 3), (0.1, 5), (0.4, 10), (0.7, 20)),
        collision_weight=((0.0, 5e3), (0.05, 2e4), (0.2, 1e5)),
        learning_rate=1e-3,
        halvings=6,
    ),
    interleaved=1,
    most_propagation_steps=16,
    validate_every=2000,
    validation_frames=40,
    patience=0,
)
"""Twenty to thirty minutes on one processor core: the training that networks and ablations are compared by."""

smoke = replace(
    small,
    network=replace(network_presets.pb4u_small, width=16, blocks=1),
    data=DataSelection(
        garments=("tshirt",),
        triangles=(400,),
        bodies=("woman",),
        shapes=1,
        motions=("walk",),
        clips=1,
        clip_frames=30,
    ),
    most_propagation_steps=3,
    statistics_windows=4,
    log_every=5,
    checkpoint_every=20,
    validate_every=1000,
    validation_clips=1,
    validation_frames=6,
    patience=0,
)
"""Seconds: a test that a training runs at all."""

TRAININGS["paper"] = TrainingPreset(paper, 450_000)
TRAININGS["literal"] = TrainingPreset(literal, 450_000)
TRAININGS["literal_small"] = TrainingPreset(literal_small, 450_000)
TRAININGS["small"] = TrainingPreset(small, 60_000)
TRAININGS["wide"] = TrainingPreset(wide, 30_000)
TRAININGS["comparison"] = TrainingPreset(comparison, 8_000)
TRAININGS["smoke"] = TrainingPreset(smoke, 40)


def _advice(name: str) -> str:
    """How a network is trained that has a name but no weights, and which preset is the paper's."""
    if name in TRAININGS:
        how = f"`pb4u train --preset {name}` trains it"
    elif name in NETWORKS:
        how = f"`pb4u train --set network={name}` trains it"
    else:
        how = "it is the name of the method"
    if name == "literal":
        return f"{how}, the paper's network to the letter"
    if name == "literal_small":
        return f"{how}, the paper's network to the letter, 64 wide with 4 blocks"
    return f"{how}; the paper's network to the letter is `literal`"


TRAINABLE.update({name: _advice(name) for name in (*TRAININGS, *NETWORKS, "pb4u", "pb4u_gnet")})
