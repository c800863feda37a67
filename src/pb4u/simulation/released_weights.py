"""Checkpoints of the released research code (.pth of Pb4U-GNet, HOOD, ContourCraft) as networks of ours.

They are read without running anything. Every number is kept; only columns change places, and what the released networks
normalise and ours do not is folded into the weights that read it, in double precision, so that both give the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load_file
from torch import Tensor

from pb4u.baselines.contourcraft import COARSE
from pb4u.baselines.hood import FAR, NEAR, SCHEDULE
from pb4u.baselines.self_contact import ATTRACTION, REPULSION
from pb4u.errors import InputError, unknown_name
from pb4u.graph.features import TABLES, FeatureLayout, MaterialRange, total_width
from pb4u.graph.graph import NodeType
from pb4u.nn.acceleration_model import NetworkConfiguration
from pb4u.nn.encode_process_decode import LEVEL_WIDTH, TYPE_WIDTH, EncodeProcessDecode
from pb4u.presets.networks import network_preset
from pb4u.reading_limits import require_small_header, told_error
from pb4u.restricted_pickle import load_torch_archive
from pb4u.simulation.checkpoint import Checkpoint, TrainingRecord, built_checkpoint, save_tensors

SUFFIXES = (".pth", ".pt")
UNKNOWN_LICENCE = "unknown: ask the author"

_NETWORK = "model._learned_model."
_TYPE_ROWS = {NodeType.GARMENT: 0, NodeType.BODY: 1, NodeType.PINNED: 3}
"""Row of the released table of types by type of ours; row 2, body vertices left out of contact, never reaches cloth."""
_SMALLEST_SPREAD = 1e-8
"""Floor of a spread in the released code."""
_LAYERS = {"0": "first", "2": "second", "4": "last"}
_BENDING, _MU, _LAMBDA = "bending_coeff", "lame_mu", "lame_lambda"


@dataclass(frozen=True)
class _Block:
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


class _File:
    """Tensors and settings of a released checkpoint; remembers what was read.

    Args:
        path: of the file, for messages.
        content: the dictionary in it.
    """

    def __init__(self, path: Path, content: Any) -> None:
        self.path = path
        if not isinstance(content, Mapping):
            raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary of a checkpoint.")
        weights = content.get("training_module", content)
        self.settings: Mapping[str, Any] = content.get("config") or {}
        self.optimiser = content.get("optimizer") or {}
        if not isinstance(weights, Mapping) or not any(str(key).startswith(_NETWORK) for key in weights):
            raise InputError(
                f"{path} is no checkpoint of Pb4U-GNet, HOOD or ContourCraft: it has no weights named {_NETWORK}*."
            )
        self.weights: dict[str, Tensor] = {}
        for key, value in weights.items():
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
                raise InputError(f"{path} holds something other than numbers in {key}.")
            if not np.isfinite(value).all():
                raise InputError(f"{path} holds numbers that are not finite in {key}; its training diverged.")
            self.weights[str(key)] = torch.from_numpy(value.astype(np.float32))
        self.used: set[str] = set()

    def tensor(self, key: str, columns: int | None = None) -> Tensor:
        if key not in self.weights:
            raise InputError(f"{self.path} lacks {key}; it is half a checkpoint, or of another project.")
        self.used.add(key)
        found = self.weights[key]
        if columns is not None and (found.ndim != 2 or found.shape[1] != columns):
            raise InputError(
                f"{self.path} has {key} of the shape {tuple(found.shape)}, where {columns} columns belong."
            )
        return found

    def mlp(self, prefix: str, layers: str = ".0.layers.") -> dict[str, Tensor]:
        """The MLP called `prefix` by our names; with a LayerNorm unless `layers` says that none ends it."""
        prefix = _NETWORK + prefix
        named = {
            f"{ours}.{part}": self.tensor(f"{prefix}{layers}{theirs}.{part}")
            for theirs, ours in _LAYERS.items()
            for part in ("weight", "bias")
        }
        if layers.startswith(".0"):
            named |= {f"norm.{part}": self.tensor(f"{prefix}.1.{part}") for part in ("weight", "bias")}
        return named

    def statistics(self, name: str) -> tuple[Tensor, Tensor]:
        """Mean and spread (columns,) float64 of a released normaliser."""
        counts, _, sums, squares = (
            self.tensor(f"model._{name}_normalizer._{part}").to(torch.float64).reshape(-1)
            for part in ("acc_count", "num_accumulations", "acc_sum", "acc_sum_squared")
        )
        if len(counts) != 1 or len(sums) != len(squares):
            raise InputError(f"{self.path} has statistics of {name} whose parts do not fit each other.")
        count = counts.clamp_min(1.0)
        mean = sums / count
        return mean, (squares / count - mean.square()).clamp_min(0.0).sqrt().clamp_min(_SMALLEST_SPREAD)

    def count(self, pattern: str) -> int:
        """Number of blocks whose keys match `pattern`, a number in its one group; they count from 0 without a gap."""
        found = {int(match[1]) for key in self.weights if (match := re.match(re.escape(_NETWORK) + pattern, key))}
        if found != set(range(len(found))):
            raise InputError(f"{self.path} lacks a block between its blocks {sorted(found)}.")
        return len(found)

    def setting(self, *names: str, default: Any) -> Any:
        """A number of the settings by its path, "*" for any name; `default` where the file says nothing."""
        found: Any = self.settings
        for name in names:
            if isinstance(found, Mapping) and name == "*" and len(found) == 1:
                found = next(iter(found.values()))
            elif isinstance(found, Mapping) and name in found:
                found = found[name]
            else:
                return default
        if isinstance(default, (int, float)) and (isinstance(found, bool) or not isinstance(found, (int, float))):
            return default  # an interpolation that was left as text
        return found


@dataclass(frozen=True)
class _Method:
    """A released network: its names, the columns that it reads and how it becomes a configuration of ours.

    Args:
        preset: name of its configuration here.
        models: names of it in the settings of a file.
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
    configure: Callable[[_File, Any], NetworkConfiguration]
    blocks: Callable[[_File], list[_Block]]
    further: Callable[[_File], dict[str, Tensor]] = lambda file: {}
    unread: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ReleasedWeights:
    """Weights of the released code as one of our networks.

    Args:
        name: stem of the file.
        preset: name of the released network.
        configuration: our network that they fit.
        tensors: its state; float32 as in the file, float64 where something was folded.
        record: what the file tells of its training.
        licence: what the user says of it, or that it is unknown.
        dropped: keys in the file that nothing reads.
    """

    name: str
    preset: str
    configuration: NetworkConfiguration
    tensors: Mapping[str, Tensor]
    record: TrainingRecord
    licence: str
    dropped: tuple[str, ...] = field(default=())

    def checkpoint(self, dtype: torch.dtype = torch.float32) -> Checkpoint:
        """The model with these weights in precision `dtype`."""
        return built_checkpoint(self.name, self.configuration, self.tensors, self.record, self.licence, dtype)

    def save(self, path: Path | str) -> None:
        """Write a checkpoint of ours. Raises InputError where the folder cannot be written."""
        save_tensors(path, self.tensors, self.configuration, self.record, self.licence)


def read_released(path: Path | str, method: str | None = None, licence: str | None = None) -> ReleasedWeights:
    """Weights in a checkpoint of the released code; nothing in it is run.

    Args:
        path: the .pth file, or its weights alone as .safetensors with the same keys.
        method: name of its preset; None finds it by the file's settings and keys.
        licence: licence of the weights; None where the user does not know it.

    Raises:
        InputError: the file is none of a known method, damaged, or holds something unexpected.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}.")
    file = _File(path, _content(path))
    chosen = _method(file, method)
    preset = network_preset(chosen.preset)
    width = len(file.tensor(f"{_NETWORK}node_encoder.0.layers.0.bias"))
    layout = replace(preset.layout, material_range=_material_range(file))
    configuration = chosen.configure(file, replace(preset, width=width, layout=layout))
    network = configuration.network()
    assert isinstance(network, EncodeProcessDecode)
    tensors = _folded(file, chosen, network)
    dropped = _dropped(file, chosen)
    return ReleasedWeights(
        path.stem, chosen.preset, configuration, tensors, _record(file, chosen), licence or UNKNOWN_LICENCE, dropped
    )


def _content(path: Path) -> Any:
    if path.suffix.lower() != ".safetensors":
        return load_torch_archive(path)
    try:
        require_small_header(path)
        return load_file(path)
    except InputError:
        raise
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(f"{path} is no whole safetensors file ({told_error(error)}); fetch it again.") from None


def _method(file: _File, name: str | None) -> _Method:
    if name is not None:
        if name not in METHODS:
            raise unknown_name("released network", name, METHODS)
        return METHODS[name]
    model = file.settings.get("model") if isinstance(file.settings, Mapping) else None
    named = next(iter(model)) if isinstance(model, Mapping) and len(model) == 1 else None
    fitting = [
        method
        for method in METHODS.values()
        if (named is None or named in method.models) and any(method.marker in key for key in file.weights)
    ]
    if not fitting:
        told = f"its settings say {named}, and its" if named else "its"
        raise InputError(f"{file.path} is of no known method: {told} keys are those of none; name one with --method.")
    return fitting[0]


def _material_range(file: _File) -> MaterialRange:
    published = {
        "density": (0.0434, 0.7),
        _MU: (15909.0, 63636.0),
        _LAMBDA: (3535.414406069427, 93333.73508005822),
        _BENDING: (6.370782056371576e-08, 0.0013139737991266374),
    }
    found = {
        name: tuple(
            float(file.setting("runner", "*", "material", f"{name}_{end}", default=value))
            for end, value in zip(("min", "max"), limits, strict=True)
        )
        for name, limits in published.items()
    }
    for name, (low, high) in found.items():
        if not 0.0 < low <= high < float("inf"):
            raise InputError(f"{file.path} was trained with {name} from {low:g} to {high:g}, which is no range.")
    return MaterialRange(found["density"], found[_MU], found[_LAMBDA], found[_BENDING], margin=None)  # type: ignore[arg-type]


def _record(file: _File, method: _Method) -> TrainingRecord:
    state = file.optimiser.get("state") if isinstance(file.optimiser, Mapping) else None
    steps = [float(each["step"]) for each in state.values() if "step" in each] if isinstance(state, Mapping) else []
    dt = float(file.setting("runner", "*", "regular_ts", default=1.0 / 30.0))
    if not 0.0 < dt < float("inf"):
        raise InputError(f"{file.path} was trained with a time step of {dt:g} s.")
    # The files do not tell the resolutions, so nothing is warned of.
    unknown = {"network": method.preset, "resolutions": "not told by the file"}
    return TrainingRecord(dt, (1e-5, 10.0), (0, 10_000), int(max(steps, default=0)), unknown)


def _folded(file: _File, method: _Method, network: EncodeProcessDecode) -> dict[str, Tensor]:
    """Our network's state."""
    layout = network.layout
    node = _Columns(file, method.columns["node"], "node")
    marks = ("type", *(("level",) if network.level is not None else ()))
    state = _named("network.node_encoder", node.fold(file.mlp("node_encoder"), _names(layout, "node") + marks))
    types = file.tensor("model.nodetype_embedding.weight")
    state["network.node_type.weight"] = node.embedding("type", types)[list(_TYPE_ROWS.values())]
    if network.level is not None:
        levels = file.tensor("model.vertexlevel_embedding.weight", LEVEL_WIDTH)
        state["network.level.weight"] = node.embedding("level", levels)
    state |= node.normaliser("node", layout)
    shared: dict[str, _Columns] = {}
    for kind, (encoder, table, statistics) in method.kinds.items():
        columns = _Columns(file, method.columns[table], statistics)
        # Kinds of one table share our normaliser, which has the statistics of the first of them.
        first = shared.setdefault(table, columns)
        mlp = columns.fold(file.mlp(f"edgeset_encoders.{encoder}"), _names(layout, table), first)
        state |= _named(f"network.edge_encoders.{kind}", mlp)
        state |= first.normaliser(table, layout)
    for number, (block, kinds) in enumerate(zip(method.blocks(file), _kinds(network), strict=True)):
        name = f"network.blocks.{number}"
        for kind, key in block.mlps.items():
            state |= _named(f"{name}.edge_mlps.{kind}", file.mlp(f"{block.prefix}.{key}"))
        node_mlp = file.mlp(f"{block.prefix}.{block.node_mlp}")
        node_mlp["first.weight"] = _reordered(node_mlp["first.weight"], block.order, ("node", *kinds))
        state |= _named(f"{name}.node_mlp", node_mlp)
    state |= _named("network.decoder", file.mlp("decoder", ".layers."))
    state |= {f"network.{name}": value for name, value in method.further(file).items()}
    mean, spread = file.statistics("output")
    state |= _normaliser_state("acceleration", mean, spread)
    # Encoders of one file may serve two kinds here; each gets numbers of its own.
    return {name: value.clone() for name, value in state.items()}


class _Columns:
    """Columns that an encoder of a file reads, and their statistics.

    Args:
        file: with both.
        names: of the columns in order, as in a `_Method`.
        statistics: name of the released normaliser; its columns are the first ones.
    """

    def __init__(self, file: _File, names: Sequence[str], statistics: str) -> None:
        self.file, self.statistics, self.places, self.signs = file, statistics, {}, {}
        self.mean, self.spread = file.statistics(statistics)
        stop = 0
        for name in names:
            start, stop = stop, stop + _WIDTHS[name.removeprefix("-")]
            self.places[name.removeprefix("-")] = slice(start, stop)
            self.signs[name.removeprefix("-")] = -1.0 if name.startswith("-") else 1.0
        self.width = stop
        if len(self.mean) > stop:
            raise InputError(
                f"{file.path} has statistics of {len(self.mean)} {statistics} columns, more than it reads."
            )

    def fold(
        self, mlp: dict[str, Tensor], wanted: Iterable[str], normalised_by: _Columns | None = None
    ) -> dict[str, Tensor]:
        """The encoder with the columns that are wanted, in their order and sign.

        Args:
            mlp: as the file has it.
            wanted: names of our columns.
            normalised_by: whose statistics our normaliser has; these by default.
        """
        weight, bias = mlp["first.weight"], mlp["first.bias"]
        if weight.shape[1] != self.width:
            raise InputError(
                f"{self.file.path} has an encoder of {weight.shape[1]} columns, where its method reads {self.width}."
            )
        parts = []
        other = normalised_by or self
        for name in map(_theirs, wanted):
            if name in _LABELS:
                label, key = _LABELS[name]
                rows = self.embedding(label, self.file.tensor(key))
                read = weight[:, self.places[label]].to(torch.float64)
                parts.append((read @ (rows[1] - rows[0]))[:, None])
                bias = bias + read @ rows[0]
                continue
            place, read = self.places[name], weight[:, self.places[name]] * self.signs[name]
            if other.statistics != self.statistics and place.stop <= len(self.mean):
                read = read.to(torch.float64) / self.spread[place]
                bias = bias + read @ (other.mean[place] - self.mean[place])
                read = read * other.spread[place]
            parts.append(read)
        return {**mlp, "first.weight": torch.cat(parts, dim=1), "first.bias": bias}

    def embedding(self, name: str, rows: Tensor) -> Tensor:
        """Rows (labels, width) float64 of an embedding as the normalised columns have them."""
        place = self.places[name]
        return (rows.to(torch.float64) - self.mean[place]) / self.spread[place]

    def normaliser(self, table: str, layout: FeatureLayout) -> dict[str, Tensor]:
        """State of our normaliser of a table."""
        mean, spread = [], []
        for feature in layout.columns(table):
            if feature.name in _LABELS:
                mean.append(torch.zeros(feature.width, dtype=torch.float64))
                spread.append(torch.ones(feature.width, dtype=torch.float64))
                continue
            place, sign = self.places[_theirs(feature.name)], self.signs[_theirs(feature.name)]
            known = feature.normalised and place.stop <= len(self.mean)
            mean.append(sign * self.mean[place] if known else torch.zeros(feature.width, dtype=torch.float64))
            spread.append(self.spread[place] if known else torch.ones(feature.width, dtype=torch.float64))
        return _normaliser_state(table, torch.cat(mean), torch.cat(spread))


def _normaliser_state(table: str, mean: Tensor, spread: Tensor) -> dict[str, Tensor]:
    name = f"{table}_normaliser"
    sums = torch.cat([torch.ones(1, dtype=torch.float64), mean, mean.square() + spread.square()])
    return {
        f"{name}.sums": sums,
        f"{name}.mean": mean,
        f"{name}.spread": spread,
        f"{name}.frozen": torch.tensor(True),
    }


def _names(layout: FeatureLayout, table: str) -> tuple[str, ...]:
    return tuple(feature.name for feature in layout.columns(table))


def _theirs(name: str) -> str:
    return {"velocity_ahead": "velocity"}.get(name, name)


def _named(prefix: str, mlp: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}.{name}": value for name, value in mlp.items()}


def _reordered(weight: Tensor, given: Sequence[str], wanted: Sequence[str]) -> Tensor:
    """The first layer of an MLP of parts of one width, its parts in another order."""
    if weight.shape[1] % len(given):
        raise InputError(f"A block reads {weight.shape[1]} columns, which are not {len(given)} latents.")
    parts = dict(zip(given, weight.chunk(len(given), dim=1), strict=True))
    return torch.cat([parts[name] for name in wanted], dim=1)


def _kinds(network: torch.nn.Module) -> list[tuple[str, ...]]:
    blocks: Any = network.blocks
    return [block.kinds for block in blocks]


def _dropped(file: _File, method: _Method) -> tuple[str, ...]:
    left = sorted(file.weights.keys() - file.used)
    foreign = [key for key in left if not any(re.match(pattern, key) for pattern in method.unread)]
    if foreign:
        raise InputError(f"{file.path} holds {foreign[0]}, which {method.preset} has no place for.")
    return tuple(left)


def _blocks_of_steps(file: _File, mlps: Mapping[str, str], node_mlp: str, order: tuple[str, ...]) -> list[_Block]:
    count = file.count(r"processor_steps\.(\d+)\.")
    return [_Block(f"processor_steps.{number}", mlps, node_mlp, order) for number in range(count)]


def _with_world_edges(file: _File, preset: Any) -> Any:
    radius = float(file.setting("model", "*", "collision_radius", default=preset.world_edges.radius))
    neighbours = int(file.setting("model", "*", "k_world_edges", default=preset.world_edges.neighbours))
    return replace(preset, world_edges=replace(preset.world_edges, radius=radius, neighbours=neighbours))


def _require_steps(file: _File, blocks: int) -> None:
    told = file.setting("model", "*", "message_passing_steps", default=blocks)
    if told != blocks or not blocks:
        raise InputError(f"{file.path} holds {blocks} blocks, where its settings speak of {told}.")


def _pb4u_configuration(file: _File, preset: Any) -> NetworkConfiguration:
    blocks = file.count(r"processor_steps\.(\d+)\.")
    _require_steps(file, blocks)
    # The number of blocks is also that of propagation steps at the base length; a file without it keeps the distance.
    base_length = float(file.setting("model", "*", "l_base", default=preset.control.distance / blocks))
    preset = _with_world_edges(file, preset)
    return replace(preset, blocks=blocks, control=replace(preset.control, distance=blocks * base_length))


def _pb4u_blocks(file: _File) -> list[_Block]:
    mlps = {"mesh": "edge_processor_dict.mesh_edge", "world": "edge_processor_dict.world_edge"}
    return _blocks_of_steps(file, mlps, "node_processor_dict.node", ("node", "mesh", "world"))


def _propagation(file: _File) -> dict[str, Tensor]:
    message = file.mlp("aggr_processor.message_mlp")
    message["first.weight"] = _reordered(
        message["first.weight"], ("sender", "edge", "receiver"), ("receiver", "sender", "edge")
    )
    norm = {part: file.tensor(f"{_NETWORK}aggr_processor.norm.{part}") for part in ("weight", "bias")}
    return {
        **_named("propagation.message", message),
        **_named("propagation.norm", norm),
        **_named("update", file.mlp("aggr_processor.fuse_mlp")),
    }


def _mgn_configuration(file: _File, preset: Any) -> NetworkConfiguration:
    blocks = file.count(r"processor_steps\.(\d+)\.")
    _require_steps(file, blocks)
    return replace(_with_world_edges(file, preset), blocks=blocks)


def _mgn_blocks(file: _File) -> list[_Block]:
    mlps = {"mesh": "mesh_edge_processor", "world": "world_edge_processor"}
    return _blocks_of_steps(file, mlps, "node_processor", ("mesh", "world", "node"))


def _hood_stages(file: _File, prefix: str, first: int) -> list[tuple[str, int]]:
    """Name of every stage and its number of blocks; the names are `prefix` and numbers from `first`."""
    names = [f"{prefix}{number}" for number in range(first, first + len(SCHEDULE))]
    return [(name, file.count(re.escape(name) + r"\.(\d+)\.")) for name in names]


def _hood_blocks(file: _File, prefix: str, first: int) -> list[_Block]:
    blocks = []
    for (name, count), kinds in zip(_hood_stages(file, prefix, first), SCHEDULE, strict=True):
        keys = {kind: f"edge_processor_dict.{_HOOD_KEYS[kind]}" for kind in (*kinds, "world")}
        # The sums stand in alphabetical order of their keys.
        order = ("node", *sorted(keys, key=keys.__getitem__))
        blocks += [_Block(f"{name}.{number}", keys, "node_processor_dict.node", order) for number in range(count)]
    return blocks


def _hood_configuration(file: _File, preset: Any, prefix: str, first: int) -> NetworkConfiguration:
    repeats = tuple(count for _, count in _hood_stages(file, prefix, first))
    if not all(repeats):
        raise InputError(f"{file.path} lacks one of HOOD's {len(SCHEDULE)} stages.")
    made, told = _architecture(repeats), file.setting("model", "*", "architecture", default=None)
    if told is not None and told != made:
        raise InputError(f"{file.path} has the schedule {told} in its settings, where its blocks are those of {made}.")
    return replace(_with_world_edges(file, preset), repeats=repeats)


def _architecture(repeats: Sequence[int]) -> str:
    """The schedule of HOOD's stages as its settings write it."""
    written = []
    for turn, kinds, count in zip(("", "d:", "d:", "u:", "u:"), SCHEDULE, repeats, strict=True):
        sets = ",".join(_HOOD_SETS[kind] for kind in kinds)
        written += [turn + sets, *[sets] * (count - 1)]
    return "|".join(written)


def _contourcraft_configuration(file: _File, preset: Any) -> NetworkConfiguration:
    blocks, made = file.count(r"levels\.0\.(\d+)\."), file.setting("model", "*", "architecture", default=None)
    if not blocks or made not in (None, "|".join(["f,c3"] * blocks)):
        raise InputError(f"{file.path} has the schedule {made} in its settings, which is not that of {blocks} blocks.")
    radius = float(file.setting("model", "*", "collision_radius", default=preset.radius))
    body_radius = float(file.setting("model", "*", "body_collision_radius", default=preset.world_edges.radius))
    return replace(preset, blocks=blocks, radius=radius, world_edges=replace(preset.world_edges, radius=body_radius))


def _contourcraft_blocks(file: _File) -> list[_Block]:
    parts = {"mesh": "mesh", COARSE: "coarse", REPULSION: "repulsion", ATTRACTION: "attraction", "world": "body"}
    keys = {kind: f"edge_processor_dict.{part}_edge" for kind, part in parts.items()}
    keys[COARSE] += "3"
    order = ("node", *sorted(keys, key=keys.__getitem__))
    count = file.count(r"levels\.0\.(\d+)\.")
    return [_Block(f"levels.0.{number}", keys, "node_processor_dict.node", order) for number in range(count)]


_HOOD_KEYS = {"mesh": "mesh_edge", NEAR: "coarse_edge0", FAR: "coarse_edge1", "world": "world_edge"}
_HOOD_SETS = {"mesh": "f", NEAR: "c0", FAR: "c1"}
_LABELS = {"future_pinned": ("edge_type", "model.edgetype_embedding.weight")}
"""Flags of ours that released networks embed as labels 0 and 1: their columns, and the table of the labels."""
_WIDTHS = {
    "is_init": 1,  # 0 at inference, so that its columns read nothing
    "edge_type": 4,
    "type": TYPE_WIDTH,
    "level": LEVEL_WIDTH,
    **{name: total_width((feature,)) for table in TABLES.values() for name, feature in table.items()},
}
_NODE = ("velocity", "type", "normal", "time_step", "vertex_mass", "material")
_LABELLED_NODE = ("velocity", "type", "level", "normal", "time_step", "vertex_mass", "material")
_MESH = ("relative_position", "length", "rest_relative_position", "rest_length", "time_step", "material")
_WORLD = ("-relative_now", "distance_now", "-relative_next", "distance_next", "time_step")
_RELATIVE_MESH = ("direction", "rest_direction", "length_ratio", "time_step", "material")
_TWO_KINDS = {"mesh": ("mesh", "mesh_edge", "mesh_edge"), "world": ("world", "world_edge", "world_edge")}

METHODS: Mapping[str, _Method] = {
    method.preset: method
    for method in (
        _Method(
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
        _Method(
            "release_mgn",
            ("baselines",),
            "mesh_edge_processor",
            {"node": _NODE, "mesh_edge": _MESH, "world_edge": _WORLD},
            _TWO_KINDS,
            _mgn_configuration,
            _mgn_blocks,
        ),
        _Method(
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
        _Method(
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
        _Method(
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
