"""Checkpoints of the released research code (.pth of Pb4U-GNet, HOOD, ContourCraft) as networks of ours.

They are read without running anything. Every number is kept; only columns change places, and what the released networks
normalise and ours do not is folded into the weights that read it, in double precision, so that both give the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pb4u.compat.released_file import NETWORK, ReleasedFile, prefixed, reordered
from pb4u.compat.released_methods import METHODS, ReleasedMethod
from pb4u.errors import InputError, refuse_unknown
from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.encode_process_decode import LEVEL_WIDTH, TYPE_WIDTH, EncodeProcessDecode
from pb4u.network.graph.features import TABLES, FeatureLayout, MaterialRange, total_width
from pb4u.network.graph.graph import NodeType
from pb4u.network.registry import NETWORKS
from pb4u.simulation.checkpoint import READERS, Checkpoint, TrainingRecord, built_checkpoint, save_tensors

UNKNOWN_LICENCE = "unknown: ask the author"

_TYPE_ROWS = {NodeType.GARMENT: 0, NodeType.BODY: 1, NodeType.PINNED: 3}
"""Row of the released table of types by type of ours; row 2, body vertices left out of contact, never reaches cloth."""
_BENDING, _MU, _LAMBDA = "bending_coeff", "lame_mu", "lame_lambda"
_LABELS = {"future_pinned": ("edge_type", "model.edgetype_embedding.weight")}
"""Flags of ours that released networks embed as labels 0 and 1: their columns, and the table of the labels."""
_WIDTHS = {
    "is_init": 1,  # 0 at inference, so that its columns read nothing
    "edge_type": 4,
    "type": TYPE_WIDTH,
    "level": LEVEL_WIDTH,
    **{name: total_width((feature,)) for table in TABLES.values() for name, feature in table.items()},
}


@dataclass(frozen=True, eq=False)
class ReleasedWeights:
    """Weights of the released code as one of our networks.

    Args:
        name: stem of the file.
        preset: name of the released network.
        configuration: of our network with these weights.
        tensors: its state; float32 as in the file, float64 where something was folded.
        record: data of the file on its training.
        licence: as given by the user, else that it is unknown.
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
        """The model with these weights in precision `dtype`.

        Args:
            dtype: precision of the weights.
        """
        return built_checkpoint(self.name, self.configuration, self.tensors, self.record, self.licence, dtype)

    def save(self, path: Path | str) -> None:
        """Write a checkpoint of ours.

        Args:
            path: path of the .safetensors file.

        Raises:
            InputError: the folder cannot be written.
        """
        save_tensors(path, self.tensors, self.configuration, self.record, self.licence)


def read_released(path: Path | str, method: str | None = None, licence: str | None = None) -> ReleasedWeights:
    """Weights in a checkpoint of the released code; no code in it is run.

    Args:
        path: the .pth file, or its weights alone as .safetensors with the same keys.
        method: name of its preset; None finds it by the file's settings and keys.
        licence: licence of the weights; None where the user does not know it.

    Raises:
        InputError: the file is of no known method, damaged, or has unexpected content.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}.")
    file = ReleasedFile.read(path)
    chosen = _method(file, method)
    preset = NETWORKS[chosen.preset]
    width = len(file.tensor(f"{NETWORK}node_encoder.0.layers.0.bias"))
    layout = replace(preset.layout, material_range=_material_range(file))
    configuration = chosen.configure(file, replace(preset, width=width, layout=layout))
    network = configuration.network()
    assert isinstance(network, EncodeProcessDecode)
    tensors = _folded(file, chosen, network)
    dropped = _dropped(file, chosen)
    return ReleasedWeights(
        path.stem, chosen.preset, configuration, tensors, _record(file, chosen), licence or UNKNOWN_LICENCE, dropped
    )


READERS.update(dict.fromkeys((".pth", ".pt"), lambda path: read_released(path).checkpoint()))


def _method(file: ReleasedFile, name: str | None) -> ReleasedMethod:
    if name is not None:
        refuse_unknown("released network", [name], METHODS)
        return METHODS[name]
    model = file.settings.get("model") if isinstance(file.settings, Mapping) else None
    title = next(iter(model)) if isinstance(model, Mapping) and len(model) == 1 else None
    fitting = [
        method
        for method in METHODS.values()
        if (title is None or title in method.models) and any(method.marker in key for key in file.weights)
    ]
    if not fitting:
        hint = f"its settings say {title}, and its" if title else "its"
        raise InputError(f"{file.path} is of no known method: {hint} keys match none; name one with --method.")
    return fitting[0]


def _material_range(file: ReleasedFile) -> MaterialRange:
    published = {
        "density": (0.0434, 0.7),
        _MU: (15909.0, 63636.0),
        _LAMBDA: (3535.414406069427, 93333.73508005822),
        _BENDING: (6.370782056371576e-08, 0.0013139737991266374),
    }
    ranges = {
        name: tuple(
            float(file.setting("runner", "*", "material", f"{name}_{end}", default=value))
            for end, value in zip(("min", "max"), limits, strict=True)
        )
        for name, limits in published.items()
    }
    for name, (low, high) in ranges.items():
        if not 0.0 < low <= high < float("inf"):
            raise InputError(
                f"{file.path} was trained with {name} from {low:g} to {high:g}; a range must be "
                "positive, finite and rising."
            )
    return MaterialRange(ranges["density"], ranges[_MU], ranges[_LAMBDA], ranges[_BENDING], margin=None)  # type: ignore[arg-type]


def _record(file: ReleasedFile, method: ReleasedMethod) -> TrainingRecord:
    state = file.optimiser.get("state") if isinstance(file.optimiser, Mapping) else None
    steps = [float(entry["step"]) for entry in state.values() if "step" in entry] if isinstance(state, Mapping) else []
    dt = float(file.setting("runner", "*", "regular_ts", default=1.0 / 30.0))
    if not 0.0 < dt < float("inf"):
        raise InputError(f"{file.path} was trained with a time step of {dt:g} s.")
    # The files do not tell the resolutions, so nothing is warned of.
    unknown = {"network": method.preset, "resolutions": "unknown"}
    return TrainingRecord(dt, (1e-5, 10.0), (0, 10_000), int(max(steps, default=0)), unknown)


def _folded(file: ReleasedFile, method: ReleasedMethod, network: EncodeProcessDecode) -> dict[str, Tensor]:
    layout = network.configuration.layout
    node = _Columns(file, method.columns["node"], "node")
    marks = ("type", *(("level",) if network.level is not None else ()))
    state = prefixed("network.node_encoder", node.fold(file.mlp("node_encoder"), _names(layout, "node") + marks))
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
        state |= prefixed(f"network.edge_encoders.{kind}", mlp)
        state |= first.normaliser(table, layout)
    for number, (block, kinds) in enumerate(zip(method.blocks(file), _kinds(network), strict=True)):
        name = f"network.blocks.{number}"
        for kind, key in block.mlps.items():
            state |= prefixed(f"{name}.edge_mlps.{kind}", file.mlp(f"{block.prefix}.{key}"))
        node_mlp = file.mlp(f"{block.prefix}.{block.node_mlp}")
        node_mlp["first.weight"] = reordered(node_mlp["first.weight"], block.order, ("node", *kinds))
        state |= prefixed(f"{name}.node_mlp", node_mlp)
    state |= prefixed("network.decoder", file.mlp("decoder", ".layers."))
    state |= {f"network.{name}": value for name, value in method.further(file).items()}
    mean, spread = file.statistics("output")
    state |= _normaliser_state("acceleration", mean, spread)
    # Encoders of one file may serve two kinds here; each gets numbers of its own.
    return {name: value.clone() for name, value in state.items()}


class _Columns:
    """Columns that an encoder of a file reads, and their statistics.

    Args:
        file: with both.
        names: of the columns in order, as in a `ReleasedMethod`.
        statistics: name of the released normaliser; its columns are the first ones.
    """

    def __init__(self, file: ReleasedFile, names: Sequence[str], statistics: str) -> None:
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
        self, mlp: dict[str, Tensor], names: Iterable[str], normalised_by: _Columns | None = None
    ) -> dict[str, Tensor]:
        """The encoder with the columns that are wanted, in their order and sign.

        Args:
            mlp: as the file has it.
            names: names of our columns.
            normalised_by: whose statistics our normaliser has; these by default.
        """
        weight, bias = mlp["first.weight"], mlp["first.bias"]
        if weight.shape[1] != self.width:
            raise InputError(
                f"{self.file.path} has an encoder of {weight.shape[1]} columns, where its method reads {self.width}."
            )
        parts = []
        other = normalised_by or self
        for name in map(_theirs, names):
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
            is_normalised = feature.normalised and place.stop <= len(self.mean)
            mean.append(sign * self.mean[place] if is_normalised else torch.zeros(feature.width, dtype=torch.float64))
            spread.append(self.spread[place] if is_normalised else torch.ones(feature.width, dtype=torch.float64))
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


def _kinds(network: torch.nn.Module) -> list[tuple[str, ...]]:
    blocks: Any = network.blocks
    return [block.kinds for block in blocks]


def _dropped(file: ReleasedFile, method: ReleasedMethod) -> tuple[str, ...]:
    unread = sorted(file.weights.keys() - file.used)
    foreign = [key for key in unread if not any(re.match(pattern, key) for pattern in method.unread)]
    if foreign:
        raise InputError(f"{file.path} holds {foreign[0]}, which the network {method.preset} does not have.")
    return tuple(unread)
