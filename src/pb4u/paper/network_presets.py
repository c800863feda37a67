"""The networks by name. An ablation is the paper's network with one part replaced by another."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.graph.features import ADVANCE, DESCENT, FeatureLayout, MaterialRange
from pb4u.network.graph.pins import PinsAtTarget, PinsAtTargetInEdges
from pb4u.network.graph.world_edges import NearestFaceRule, WorldEdgeRule
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation import PAPER_PROPAGATION, RELEASED_PROPAGATION
from pb4u.network.propagation_control import ConstantDistance, FixedSteps, TruncatedDistance
from pb4u.network.registry import CONFIGURATIONS, NETWORKS
from pb4u.network.update_scaling import MeanScaling, NoScaling, PerVertexScaling
from pb4u.paper.baselines.contourcraft import ContourCraftConfiguration
from pb4u.paper.baselines.directed_self_contact import DirectedSelfEdges
from pb4u.paper.baselines.eslr import EslrConfiguration
from pb4u.paper.baselines.hood import HoodConfiguration
from pb4u.paper.baselines.meshgraphnet import MeshGraphNetConfiguration

Configuration = TypeVar("Configuration", bound=NetworkConfiguration)


def with_start_shares(configuration: Configuration) -> Configuration:
    """Copy of `configuration` whose steps start at the least potential along the body's motion.

    Why: docs/design/time_step.md. Free flight and quarters of the skinned displacement are tried; the network gets the
        descent direction of the potential at the start, and the acceleration from free flight to it.

    Args:
        configuration: of a network that starts in free flight.
    """
    layout = replace(configuration.layout, extra=(DESCENT, ADVANCE))
    return replace(configuration, layout=layout, warm_start_shares=(0.25, 0.5, 0.75, 1.0))


pb4u_paper = Pb4uConfiguration(
    width=128,
    blocks=15,
    propagation=PAPER_PROPAGATION,
    control=ConstantDistance(0.225),
    scaling=PerVertexScaling(0.015),
)
pb4u_small = replace(pb4u_paper, width=64, blocks=4)
pb4u_small_carried = with_start_shares(pb4u_small)
pb4u_small_two_passes = replace(pb4u_small_carried, passes=2)
# Descents are shown three times as large as they are on the solver's own states: smaller or larger, weights that knew
# nothing of it left more of a step.
pb4u_small_conjugate = replace(pb4u_small_two_passes, conjugate=True, further_passes=8, descent_size=0.03)
_small_without_gradient = replace(
    pb4u_small_conjugate, layout=replace(pb4u_small_carried.layout, extra=(ADVANCE,)), descent_size=0.0
)

# What the paper names and nothing else; docs/design/paper_network.md has its release. On a training level of 1,200
# triangles edges are 45 mm in the mean, and D = 0.225 m gives 5 steps there.
literal = replace(
    pb4u_paper,
    scaling=PerVertexScaling(0.045),
    layout=FeatureLayout(
        node=("velocity", "vertex_mass", "normal", "material"),
        mesh_edge=("direction", "rest_direction", "length_ratio"),
        world_edge=("direction", "relative_distance"),
    ),
    # All body vertices within the threshold: two a garment vertex in the mean, fifty at most.
    world_edges=WorldEdgeRule(radius=0.03, neighbours=64),
)
literal_small = replace(literal, width=64, blocks=4)

mgn = MeshGraphNetConfiguration()
hood = HoodConfiguration()
eslr = EslrConfiguration()
contourcraft = ContourCraftConfiguration()
# The small ones take about as long as `pb4u_small` for a step of training at 2,500 triangles (docs/baselines.md), and
# start as `pb4u_small_carried` does: from free flight none holds a garment after what a processor affords.
_mgn_small = with_start_shares(replace(mgn, width=64, blocks=7))
_hood_small = with_start_shares(replace(hood, width=64, repeats=1))

# The released networks, as their code computes (docs/baselines.md): checkpoints of theirs are read into these.
_released_layout = FeatureLayout(
    node=("velocity", "normal", "time_step", "vertex_mass", "material"),
    mesh_edge=("direction", "rest_direction", "length_ratio", "time_step", "material"),
    world_edge=("relative_now", "distance_now", "relative_next", "distance_next", "time_step"),
    material_range=MaterialRange(margin=None),
)
_released_world_edges = WorldEdgeRule(radius=0.03, neighbours=1, whole_body=True)
release_pb4u = replace(
    pb4u_paper,
    propagation=RELEASED_PROPAGATION,
    control=TruncatedDistance(0.225),
    scaling=MeanScaling(0.01),
    layout=_released_layout,
    world_edges=_released_world_edges,
    pins=PinsAtTarget(),
)
_released_mesh_edge = (
    "relative_position", "length", "rest_relative_position", "rest_length", "time_step", "material",
)  # fmt: skip
release_mgn = replace(
    mgn,
    layout=replace(
        _released_layout,
        node=("velocity_ahead", "normal", "time_step", "vertex_mass", "material"),
        mesh_edge=_released_mesh_edge,
    ),
    world_edges=_released_world_edges,
    pins=PinsAtTarget(moving=True),
)
release_hood = HoodConfiguration(
    labelled=3,
    layout=replace(release_mgn.layout, node=_released_layout.node),
    world_edges=_released_world_edges,
    pins=PinsAtTarget(),
)
release_hood_cvpr = replace(release_hood, layout=release_mgn.layout, pins=PinsAtTarget(moving=True))
release_contourcraft = ContourCraftConfiguration(
    layout=FeatureLayout(
        node=("velocity_ahead", "normal", "mass", "material"),
        mesh_edge=("relative_position", "length", "rest_length", "material"),
        world_edge=(
            "relative_now", "distance_now", "relative_next", "distance_next", "relative_velocity", "relative_speed",
        ),
        found_edge=(
            "relative_position", "length", "previous_relative_position", "previous_length", "relative_velocity",
            "relative_speed", "future_pinned", "material",
        ),
        material_range=MaterialRange(margin=None),
    ),
    world_edges=NearestFaceRule(0.03),
    pins=PinsAtTargetInEdges(),
    self_edges=DirectedSelfEdges(),
)  # fmt: skip


def _ablations(prefix: str, configuration: Pb4uConfiguration, steps: int) -> dict[str, NetworkConfiguration]:
    """The network without propagation control, without update scaling, and without both."""
    fixed = replace(configuration, control=FixedSteps(steps))
    return {
        f"{prefix}without_propagation_control": fixed,
        f"{prefix}without_update_scaling": replace(configuration, scaling=NoScaling()),
        f"{prefix}without_both": replace(fixed, scaling=NoScaling()),
    }


NETWORKS.update(
    {
        "pb4u_paper": pb4u_paper,
        "release_pb4u": release_pb4u,
        "release_mgn": release_mgn,  # fine15
        "release_mgn_48": replace(release_mgn, blocks=48),  # fine48
        "release_hood": release_hood,  # postcvpr
        "release_hood_cvpr": release_hood_cvpr,  # that of HOOD's paper
        "release_contourcraft": release_contourcraft,
        "literal": literal,
        "literal_small": literal_small,
        **_ablations("literal_small_", literal_small, 5),
        "pb4u_small": pb4u_small,
        "pb4u_small_carried": pb4u_small_carried,
        "pb4u_small_two_passes": pb4u_small_two_passes,
        "pb4u_small_conjugate": pb4u_small_conjugate,
        "conjugate_without_gradient": _small_without_gradient,
        **_ablations("", pb4u_paper, 15),
        **_ablations("conjugate_", pb4u_small_conjugate, 5),
        "mgn": mgn,
        "hood": hood,
        "eslr": eslr,
        "contourcraft": contourcraft,
        "mgn_small": _mgn_small,
        "hood_small": _hood_small,
        "eslr_small": with_start_shares(replace(eslr, width=64, layers=3, landmarks=64)),
        # A level less: at the 30 mm of its finest training mesh, coarse edges of 0.24 m as ContourCraft's are at 15 mm.
        "contourcraft_small": with_start_shares(replace(contourcraft, width=64, blocks=4, level=2)),
    }
)
CONFIGURATIONS.update({type(network).__name__: type(network) for network in NETWORKS.values()})
