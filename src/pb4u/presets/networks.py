"""The networks by name. An ablation is the paper's network with one part replaced by its null object."""

from __future__ import annotations

from dataclasses import replace

from pb4u.errors import InputError
from pb4u.graph.features import DESCENT, FeatureLayout
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.model.pb4u_gnet import Pb4uConfiguration
from pb4u.model.propagation import PAPER_PROPAGATION, RELEASED_PROPAGATION
from pb4u.model.propagation_control import ConstantDistance, FixedSteps
from pb4u.model.update_scaling import MeanScaling, NoScaling, PerVertexScaling

pb4u_paper = Pb4uConfiguration(
    width=128,
    blocks=15,
    propagation=PAPER_PROPAGATION,
    control=ConstantDistance(0.225),
    scaling=PerVertexScaling(0.015),
)

pb4u_release = replace(
    pb4u_paper,
    propagation=RELEASED_PROPAGATION,
    scaling=MeanScaling(0.01),
    layout=FeatureLayout(node=("velocity", "normal", "dt", "vertex_mass", "material")),
)

pb4u_bare_edges = replace(pb4u_paper, layout=FeatureLayout(mesh_edge=("direction", "rest_direction", "length_ratio")))

pb4u_all_pairs = replace(pb4u_paper, world_edges=WorldEdgeRule(radius=0.03, neighbours=16))

pb4u_small = replace(pb4u_paper, width=64, blocks=4)

pb4u_small_descent = replace(pb4u_small, layout=FeatureLayout(extra=(DESCENT,)))

without_propagation_control = replace(pb4u_paper, control=FixedSteps(15))

without_update_scaling = replace(pb4u_paper, scaling=NoScaling())

without_both = replace(pb4u_paper, control=FixedSteps(15), scaling=NoScaling())

NETWORKS: dict[str, Pb4uConfiguration] = {
    "pb4u_paper": pb4u_paper,
    "pb4u_release": pb4u_release,
    "pb4u_bare_edges": pb4u_bare_edges,
    "pb4u_all_pairs": pb4u_all_pairs,
    "pb4u_small": pb4u_small,
    "pb4u_small_descent": pb4u_small_descent,
    "without_propagation_control": without_propagation_control,
    "without_update_scaling": without_update_scaling,
    "without_both": without_both,
}


def network_preset(name: str) -> Pb4uConfiguration:
    """The configuration called `name`. Raises InputError listing the names."""
    if name not in NETWORKS:
        raise InputError(f"There is no network preset {name!r}; there are: {', '.join(NETWORKS)}.")
    return NETWORKS[name]
