"""Networks of the released research code: their names for weights, columns, blocks and settings, one entry each."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from torch import Tensor

from pb4u.compat.released_file import NETWORK, ReleasedFile, prefixed, reordered
from pb4u.errors import InputError
from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.paper.baselines.contourcraft import COARSE
from pb4u.paper.baselines.hood import FAR, NEAR, SCHEDULE
from pb4u.paper.baselines.self_contact_edges import ATTRACTION, REPULSION


@dataclass(frozen=True)
class ReleasedBlock:
    """Names of the parts of a released block.

    Args:
        prefix: of all its keys.
        mlps: key of the MLP of every kind of edges of ours.
        node_mlp: key of the MLP of nodes.
        order: parts of that MLP's input as the file has them, kinds of edges and "node".
    """

    prefix: str
    mlps: Mapping[str, str]
    node_mlp: str
    order: tuple[str, ...]


@dataclass(frozen=True)
class ReleasedMethod:
    """A released network: its names, the columns that it reads and how it becomes a configuration of ours.

    Args:
        preset: name of its configuration here.
        models: its names in the settings of a file.
        marker: part of a key that only its files have.
        columns: columns of each encoder as the file has them, by table; "-" before one whose sign is another here.
        kinds: encoder of every kind of edges of ours, its table and its statistics.
        configure: its configuration with the size and the rules of a file.
        blocks: the names of its blocks.
        further: weights beyond encoders, blocks and decoder, by name in our network.
        unread: patterns of keys that nothing reads.
    """

    preset: str
    models: tuple[str, ...]
    marker: str
    columns: Mapping[str, tuple[str, ...]]
    kinds: Mapping[str, tuple[str, str, str]]
    configure: Callable[[ReleasedFile, Any], NetworkConfiguration]
    blocks: Callable[[ReleasedFile], list[ReleasedBlock]]
    further: Callable[[ReleasedFile], dict[str, Tensor]] = lambda file: {}
    unread: tuple[str, ...] = ()


def _blocks_of_steps(
    file: ReleasedFile, mlps: Mapping[str, str], node_mlp: str, order: tuple[str, ...]
) -> list[ReleasedBlock]:
    count = file.count(r"processor_steps\.(\d+)\.")
    return [ReleasedBlock(f"processor_steps.{number}", mlps, node_mlp, order) for number in range(count)]


def _with_world_edges(file: ReleasedFile, preset: Any) -> Any:
    radius = float(file.setting("model", "*", "collision_radius", default=preset.world_edges.radius))
    neighbours = int(file.setting("model", "*", "k_world_edges", default=preset.world_edges.neighbours))
    return replace(preset, world_edges=replace(preset.world_edges, radius=radius, neighbours=neighbours))


def _require_steps(file: ReleasedFile, blocks: int) -> None:
    steps = file.setting("model", "*", "message_passing_steps", default=blocks)
    if steps != blocks or not blocks:
        raise InputError(
            f"{file.path} holds weights of {blocks} message-passing blocks, but its settings say {steps}; download it "
            "again."
        )


def _pb4u_configuration(file: ReleasedFile, preset: Any) -> NetworkConfiguration:
    blocks = file.count(r"processor_steps\.(\d+)\.")
    _require_steps(file, blocks)
    # The number of blocks is also that of propagation steps at the base length; a file without it keeps the distance.
    base_length = float(file.setting("model", "*", "l_base", default=preset.control.distance / blocks))
    preset = _with_world_edges(file, preset)
    return replace(preset, blocks=blocks, control=replace(preset.control, distance=blocks * base_length))


def _pb4u_blocks(file: ReleasedFile) -> list[ReleasedBlock]:
    mlps = {"mesh": "edge_processor_dict.mesh_edge", "world": "edge_processor_dict.world_edge"}
    return _blocks_of_steps(file, mlps, "node_processor_dict.node", ("node", "mesh", "world"))


def _propagation(file: ReleasedFile) -> dict[str, Tensor]:
    message = file.mlp("aggr_processor.message_mlp")
    message["first.weight"] = reordered(
        message["first.weight"], ("sender", "edge", "receiver"), ("receiver", "sender", "edge")
    )
    norm = {part: file.tensor(f"{NETWORK}aggr_processor.norm.{part}") for part in ("weight", "bias")}
    return {
        **prefixed("propagation.message", message),
        **prefixed("propagation.norm", norm),
        **prefixed("update", file.mlp("aggr_processor.fuse_mlp")),
    }


def _mgn_configuration(file: ReleasedFile, preset: Any) -> NetworkConfiguration:
    blocks = file.count(r"processor_steps\.(\d+)\.")
    _require_steps(file, blocks)
    return replace(_with_world_edges(file, preset), blocks=blocks)


def _mgn_blocks(file: ReleasedFile) -> list[ReleasedBlock]:
    mlps = {"mesh": "mesh_edge_processor", "world": "world_edge_processor"}
    return _blocks_of_steps(file, mlps, "node_processor", ("mesh", "world", "node"))


def _hood_stages(file: ReleasedFile, prefix: str, first: int) -> list[tuple[str, int]]:
    """Name of every stage and its number of blocks; the names are `prefix` and numbers from `first`."""
    names = [f"{prefix}{number}" for number in range(first, first + len(SCHEDULE))]
    return [(name, file.count(re.escape(name) + r"\.(\d+)\.")) for name in names]


def _hood_blocks(file: ReleasedFile, prefix: str, first: int) -> list[ReleasedBlock]:
    blocks = []
    for (name, count), kinds in zip(_hood_stages(file, prefix, first), SCHEDULE, strict=True):
        keys = {kind: f"edge_processor_dict.{_HOOD_KEYS[kind]}" for kind in (*kinds, "world")}
        # The sums stand in alphabetical order of their keys.
        order = ("node", *sorted(keys, key=keys.__getitem__))
        blocks += [
            ReleasedBlock(f"{name}.{number}", keys, "node_processor_dict.node", order) for number in range(count)
        ]
    return blocks


def _hood_configuration(file: ReleasedFile, preset: Any, prefix: str, first: int) -> NetworkConfiguration:
    repeats = tuple(count for _, count in _hood_stages(file, prefix, first))
    if not all(repeats):
        raise InputError(f"{file.path} lacks one of HOOD's {len(SCHEDULE)} stages.")
    ours, text = _architecture(repeats), file.setting("model", "*", "architecture", default=None)
    if text is not None and text != ours:
        raise InputError(f"{file.path} has the schedule {text} in its settings, where its blocks are those of {ours}.")
    return replace(_with_world_edges(file, preset), repeats=repeats)


def _architecture(repeats: Sequence[int]) -> str:
    """The schedule of HOOD's stages as its settings write it."""
    written = []
    for turn, kinds, count in zip(("", "d:", "d:", "u:", "u:"), SCHEDULE, repeats, strict=True):
        sets = ",".join(_HOOD_SETS[kind] for kind in kinds)
        written += [turn + sets, *[sets] * (count - 1)]
    return "|".join(written)


def _contourcraft_configuration(file: ReleasedFile, preset: Any) -> NetworkConfiguration:
    blocks, text = file.count(r"levels\.0\.(\d+)\."), file.setting("model", "*", "architecture", default=None)
    if not blocks or text not in (None, "|".join(["f,c3"] * blocks)):
        raise InputError(f"{file.path} has the schedule {text} in its settings, which is not that of {blocks} blocks.")
    radius = float(file.setting("model", "*", "collision_radius", default=preset.radius))
    body_radius = float(file.setting("model", "*", "body_collision_radius", default=preset.world_edges.radius))
    return replace(preset, blocks=blocks, radius=radius, world_edges=replace(preset.world_edges, radius=body_radius))


def _contourcraft_blocks(file: ReleasedFile) -> list[ReleasedBlock]:
    parts = {"mesh": "mesh", COARSE: "coarse", REPULSION: "repulsion", ATTRACTION: "attraction", "world": "body"}
    keys = {kind: f"edge_processor_dict.{part}_edge" for kind, part in parts.items()}
    keys[COARSE] += "3"
    order = ("node", *sorted(keys, key=keys.__getitem__))
    count = file.count(r"levels\.0\.(\d+)\.")
    return [ReleasedBlock(f"levels.0.{number}", keys, "node_processor_dict.node", order) for number in range(count)]


_HOOD_KEYS = {"mesh": "mesh_edge", NEAR: "coarse_edge0", FAR: "coarse_edge1", "world": "world_edge"}
_HOOD_SETS = {"mesh": "f", NEAR: "c0", FAR: "c1"}

_NODE = ("velocity", "type", "normal", "time_step", "vertex_mass", "material")
_LABELLED_NODE = ("velocity", "type", "level", "normal", "time_step", "vertex_mass", "material")
_MESH = ("relative_position", "length", "rest_relative_position", "rest_length", "time_step", "material")
_WORLD = ("-relative_now", "distance_now", "-relative_next", "distance_next", "time_step")
_RELATIVE_MESH = ("direction", "rest_direction", "length_ratio", "time_step", "material")
_TWO_KINDS = {"mesh": ("mesh", "mesh_edge", "mesh_edge"), "world": ("world", "world_edge", "world_edge")}

METHODS: Mapping[str, ReleasedMethod] = {
    method.preset: method
    for method in (
        ReleasedMethod(
            "release_pb4u",
            ("pb4u",),
            "aggr_processor",
            {"node": _NODE, "mesh_edge": _RELATIVE_MESH, "world_edge": _WORLD},
            _TWO_KINDS,
            _pb4u_configuration,
            _pb4u_blocks,
            _propagation,
            (r".*aggr_processor\.(edge|node)_processor_dict\.", r"model\.vertexlevel_embedding"),
        ),
        ReleasedMethod(
            "release_mgn",
            ("baselines",),
            "mesh_edge_processor",
            {"node": _NODE, "mesh_edge": _MESH, "world_edge": _WORLD},
            _TWO_KINDS,
            _mgn_configuration,
            _mgn_blocks,
        ),
        ReleasedMethod(
            "release_hood",
            ("postcvpr", "hood"),
            "edgeset_encoders.coarse0",
            {"node": _LABELLED_NODE, "mesh_edge": _MESH, "world_edge": _WORLD},
            {
                **_TWO_KINDS,
                NEAR: ("coarse0", "mesh_edge", "mesh_edge"),
                FAR: ("coarse1", "mesh_edge", "mesh_edge"),
            },
            partial(_hood_configuration, prefix="levels.", first=0),
            partial(_hood_blocks, prefix="levels.", first=0),
            unread=(r".*edgeset_encoders\.coarse[2-9]\.",),
        ),
        ReleasedMethod(
            "release_hood_cvpr",
            ("cvpr",),
            "edgeset_encoders.coarse.",
            {"node": _LABELLED_NODE, "mesh_edge": _MESH, "world_edge": _WORLD},
            {
                **_TWO_KINDS,
                NEAR: ("coarse", "mesh_edge", "mesh_edge"),
                FAR: ("coarse", "mesh_edge", "mesh_edge"),
            },
            partial(_hood_configuration, prefix="processor_steps", first=1),
            partial(_hood_blocks, prefix="processor_steps", first=1),
        ),
        ReleasedMethod(
            "release_contourcraft",
            ("ccraft",),
            "edgeset_encoders.repulsion",
            {
                "node": ("velocity", "type", "level", "normal", "mass", "is_init", "material"),
                "mesh_edge": ("relative_position", "length", "rest_length", "is_init", "material"),
                "world_edge": (*_WORLD[:4], "-relative_velocity", "relative_speed", "is_init"),
                "found_edge": (
                    "relative_position",
                    "length",
                    "previous_relative_position",
                    "previous_length",
                    "relative_velocity",
                    "relative_speed",
                    "edge_type",
                    "is_init",
                    "material",
                ),
            },
            {
                "mesh": ("mesh", "mesh_edge", "mesh_edge"),
                COARSE: ("coarse3", "mesh_edge", "coarse_edge"),
                REPULSION: ("repulsion", "found_edge", "world_edge"),
                ATTRACTION: ("attraction", "found_edge", "world_edge"),
                "world": ("body", "world_edge", "body_edge"),
            },
            _contourcraft_configuration,
            _contourcraft_blocks,
            unread=(r".*edgeset_encoders\.coarse[0-2]\.",),
        ),
    )
}
"""The released networks by the name of their preset."""
