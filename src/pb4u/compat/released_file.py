"""Checkpoint files of the released research code: what they hold, read without running it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from pb4u.errors import InputError
from pb4u.io.reading_limits import error_text
from pb4u.io.restricted_pickle import load_tensors

NETWORK = "model._learned_model."
"""What all keys of the network's weights begin with."""
_SMALLEST_SPREAD = 1e-8
"""Floor of a spread in the released code."""
_LAYERS = {"0": "first", "2": "second", "4": "last"}


class ReleasedFile:
    """Tensors and settings of a released checkpoint; remembers which entries were read.

    Args:
        path: of the file, for messages.
        content: the dictionary in it.

    Raises:
        InputError: it is not a checkpoint of a released network, or holds something other than finite numbers.
    """

    def __init__(self, path: Path, content: Any) -> None:
        self.path = path
        if not isinstance(content, Mapping):
            raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary of a checkpoint.")
        weights = content.get("training_module", content)
        self.settings: Mapping[str, Any] = content.get("config") or {}
        self.optimiser = content.get("optimizer") or {}
        if not isinstance(weights, Mapping) or not any(str(key).startswith(NETWORK) for key in weights):
            raise InputError(
                f"{path} is not a checkpoint of Pb4U-GNet, HOOD or ContourCraft: it has no weights named {NETWORK}*."
            )
        self.weights: dict[str, Tensor] = {}
        for key, value in weights.items():
            if not isinstance(value, Tensor) or value.is_complex() or value.dtype == torch.bool:
                raise InputError(f"{path} holds something other than numbers in {key}.")
            if not value.isfinite().all():
                raise InputError(f"{path} holds numbers that are not finite in {key}; its training diverged.")
            self.weights[str(key)] = value.detach().to(torch.float32)
        self.used: set[str] = set()

    @classmethod
    def read(cls, path: Path) -> ReleasedFile:
        """A .pth file, or .safetensors with the same keys.

        Args:
            path: the .pth or .safetensors file.

        Raises:
            InputError: it is damaged, of another project, or has unexpected content.
        """
        if path.suffix.lower() != ".safetensors":
            return cls(path, load_tensors(path))
        try:
            return cls(path, load_file(path))
        except (SafetensorError, OSError, ValueError) as error:
            raise InputError(
                f"{path} is not a complete safetensors file ({error_text(error)}); download it again."
            ) from None

    def tensor(self, key: str, columns: int | None = None) -> Tensor:
        """The weights called `key`, float32.

        Args:
            key: name of the weights in the file.
            columns: number of columns that they should have; None for any.

        Raises:
            InputError: they are missing or of other than `columns`.
        """
        if key not in self.weights:
            raise InputError(f"{self.path} lacks {key}; it is an incomplete checkpoint, or one of another project.")
        self.used.add(key)
        tensor = self.weights[key]
        if columns is not None and (tensor.ndim != 2 or tensor.shape[1] != columns):
            raise InputError(
                f"{self.path} has {key} of the shape {tuple(tensor.shape)}; it must have {columns} columns."
            )
        return tensor

    def mlp(self, prefix: str, layers: str = ".0.layers.") -> dict[str, Tensor]:
        """The MLP `prefix` under our names; with a LayerNorm at its end unless `layers` says otherwise.

        Args:
            prefix: start of its keys in the file.
            layers: text between the prefix and the number of a layer.
        """
        prefix = NETWORK + prefix
        layer_weights = {
            f"{ours}.{part}": self.tensor(f"{prefix}{layers}{theirs}.{part}")
            for theirs, ours in _LAYERS.items()
            for part in ("weight", "bias")
        }
        if layers.startswith(".0"):
            layer_weights |= {f"norm.{part}": self.tensor(f"{prefix}.1.{part}") for part in ("weight", "bias")}
        return layer_weights

    def statistics(self, name: str) -> tuple[Tensor, Tensor]:
        """Mean and spread (columns,) float64 of a released normaliser.

        Args:
            name: name of the normaliser in the file.

        Raises:
            InputError: its parts do not fit.
        """
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
        """Number of blocks whose keys match `pattern`, a number in its one group.

        Args:
            pattern: regular expression with one group.

        Raises:
            InputError: they do not count from 0 without a gap.
        """
        numbers = {int(match[1]) for key in self.weights if (match := re.match(re.escape(NETWORK) + pattern, key))}
        if numbers != set(range(len(numbers))):
            raise InputError(f"{self.path} lacks a block between its blocks {sorted(numbers)}.")
        return len(numbers)

    def setting(self, *names: str, default: Any) -> Any:
        """A number of the settings.

        Args:
            names: path to it; "*" is the only entry at its level.
            default: returned if the file has no such setting.
        """
        value: Any = self.settings
        for name in names:
            if isinstance(value, Mapping) and name == "*" and len(value) == 1:
                value = next(iter(value.values()))
            elif isinstance(value, Mapping) and name in value:
                value = value[name]
            else:
                return default
        if isinstance(default, (int, float)) and (isinstance(value, bool) or not isinstance(value, (int, float))):
            return default  # an interpolation that was left as text
        return value


def prefixed(prefix: str, mlp: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of an MLP with `prefix` and a dot before their names.

    Args:
        prefix: of the names.
        mlp: weights by name.
    """
    return {f"{prefix}.{name}": value for name, value in mlp.items()}


def reordered(weight: Tensor, names: Sequence[str], order: Sequence[str]) -> Tensor:
    """The first layer of an MLP whose input has parts of one width, with these parts in another order.

    Args:
        weight: (width, columns).
        names: names of the parts in the order of the columns.
        order: the same names in the order wanted.

    Raises:
        InputError: its columns are not those of as many parts.
    """
    if weight.shape[1] % len(names):
        raise InputError(
            f"A block has {weight.shape[1]} input columns, which cannot be divided into {len(names)} latents."
        )
    parts = dict(zip(names, weight.chunk(len(names), dim=1), strict=True))
    return torch.cat([parts[name] for name in order], dim=1)
