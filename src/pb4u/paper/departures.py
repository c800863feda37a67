"""What a network is, and in what it departs from the paper: derived from its configuration and its training record."""

from __future__ import annotations

from typing import Any

from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.graph.world_edges import WorldEdgeRule
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation import PAPER_PROPAGATION
from pb4u.network.propagation_control import FixedSteps
from pb4u.network.update_scaling import PerVertexScaling, scaling_name
from pb4u.simulation.checkpoint import Checkpoint

NODE = {"velocity", "vertex_mass", "mass", "normal", "material"}
MESH_EDGE = {"direction", "rest_direction", "length_ratio"}
WORLD_EDGE = {"direction", "relative_distance"}
"""Features that the paper names; type of node is embedded by every network. The mass is log vertex mass."""
SIZE = (128, 15)
"""Width and number of blocks of the paper's network."""
MOST_NEIGHBOURS = 64
"""So many body vertices a garment vertex count as all within the threshold."""


def description(checkpoint: Checkpoint) -> dict[str, Any]:
    """Size, inputs, start, search and training of a network, and its departures from the paper, as JSON.

    Args:
        checkpoint: the network and its record.
    """
    configuration, record = checkpoint.configuration, checkpoint.record
    layout, details = configuration.layout, record.details
    stages = [details]
    while before := stages[-1].get("before"):
        stages.append(before)
    triangles = details.get("triangles") or []
    return {
        "width": configuration.width,
        "blocks": getattr(configuration, "blocks", getattr(configuration, "layers", None)),
        "passes": configuration.passes,
        "further_passes": configuration.further_passes,
        "inputs": {
            "node": [feature.name for feature in layout.columns("node")],
            "mesh_edge": list(layout.mesh_edge),
            "world_edge": list(layout.world_edge),
        },
        "scaling": scaling_name(configuration.scaling) if isinstance(configuration, Pb4uConfiguration) else "none",
        "start": "body-motion warm start" if configuration.warm_start_shares else "free flight",
        "search": "joined passes, by a line search on the energies" if configuration.conjugate else "none",
        "trained": {
            "optimiser_steps": record.optimiser_steps,
            "hours": round(sum(stage.get("hours") or 0.0 for stage in stages), 2),
            "garments": details.get("garments", []),
            "triangles": [min(triangles), max(triangles)] if triangles else [],
            "fabrics": {name: [float(f"{value:.3g}") for value in cloth] for name, cloth in checkpoint.fabrics.items()},
            "propagation_steps": [] if details.get("resolutions") == "unknown" else list(record.propagation_steps),
        },
        "departs_from_paper": departures(checkpoint),
    }


def departures(checkpoint: Checkpoint) -> list[str]:
    """Sentences on everything in which a network and its training are not the paper's; its energies apart.

    Args:
        checkpoint: the network and its record.
    """
    configuration = checkpoint.configuration
    if not isinstance(configuration, Pb4uConfiguration):
        method = type(configuration).__name__.removesuffix("Configuration")
        return [f"It is {method}, a method that the paper compares with.", *_additions(configuration)]
    lines = [
        *_size(configuration),
        *_additions(configuration),
        *_other("node", set(configuration.layout.node), NODE),
        *_other("mesh edge", set(configuration.layout.mesh_edge), MESH_EDGE),
        *_other("world edge", set(configuration.layout.world_edge), WORLD_EDGE),
    ]
    edges = configuration.world_edges
    if not isinstance(edges, WorldEdgeRule) or edges.neighbours < MOST_NEIGHBOURS:
        lines.append("World edges join a garment vertex to the nearest of the body, not to all within the threshold.")
    if configuration.propagation != PAPER_PROPAGATION:
        lines.append("Propagation has the form of the released code.")
    if isinstance(configuration.control, FixedSteps):
        lines.append("The number of propagation steps does not follow the resolution.")
    if type(configuration.scaling) is not PerVertexScaling:
        lines.append("Updates are not scaled by the edge length at each vertex.")
    return lines + _training(configuration, checkpoint)


def _size(configuration: Pb4uConfiguration) -> list[str]:
    if (configuration.width, configuration.blocks) == SIZE:
        return []
    return [
        f"It is {configuration.width} wide with {configuration.blocks} blocks; the paper's has {SIZE[0]} and {SIZE[1]}."
    ]


def _additions(configuration: NetworkConfiguration) -> list[str]:
    """Sentences on what surrounds a network here and not in the paper."""
    lines = [
        f"It reads the node feature {feature.name}: {feature.source.removesuffix('; ours')}."
        for feature in configuration.layout.extra
    ]
    if configuration.warm_start_shares:
        lines.append("A step starts from the body-motion warm start, not from free flight.")
    if configuration.passes > 1:
        lines.append(f"It is evaluated {configuration.passes} times in a step.")
    if configuration.conjugate:
        lines.append("A line search on the energies decides how far the step goes along each pass.")
    if configuration.further_passes:
        lines.append(f"Up to {configuration.further_passes} more passes follow while they lower the energy by much.")
    if configuration.descent_size:
        lines.append("The gradient feature is normalised, and the prediction from it is scaled back.")
    return lines


def _other(kind: str, names: set[str], paper: set[str]) -> list[str]:
    """Features beyond those that the paper names, as a sentence."""
    more = sorted(names - paper)
    return [f"Beyond the paper it reads the {kind} feature{'s' * (len(more) > 1)} {', '.join(more)}."] if more else []


def _training(configuration: Pb4uConfiguration, checkpoint: Checkpoint) -> list[str]:
    """Departures of the training."""
    record = checkpoint.record
    if record.details.get("resolutions") == "unknown":
        return []
    by_rule = sorted(configuration.control.steps(length) for length in record.mean_edge_lengths)
    least, most = record.propagation_steps
    if [least, most] == by_rule:
        return []
    earlier = " or one before it" if record.details.get("before") else ""
    return [
        f"In this training{earlier} the number of propagation steps was drawn from {least} to {most}, as in the "
        "release; the paper names the rule alone."
    ]
