"""Trained weights in one safetensors file that rebuilds its own model. Nothing is unpickled."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor
from torch.overrides import TorchFunctionMode

from pb4u.errors import InputError, on_disk, warn
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.io.atomic_file import replace_file
from pb4u.io.reading_limits import error_text, parse_json
from pb4u.network.acceleration_model import AccelerationModel, NetworkConfiguration, PreparedGarments
from pb4u.network.update_scaling import SwitchedScaling, scaling_name, with_scaling
from pb4u.registry import Registry
from pb4u.scene.packed import PackedGarments
from pb4u.simulation.network_configuration import configuration_from_json, configuration_to_json

FORMAT_VERSION = 1
SUFFIX = ".safetensors"
RESOLUTION_TOLERANCE, FABRIC_TOLERANCE = 0.05, 0.05
_CLOTH = {"density": "kg/m^2", "warp_stiffness": "N/m", "bending_stiffness": "N m"}
"""What is told of the cloth of a training, and its unit."""


@dataclass(frozen=True)
class TrainingRecord:
    """Record of the training of weights.

    Args:
        dt: time step that they were trained with [s].
        mean_edge_lengths: finest and coarsest mean rest edge length seen [m].
        propagation_steps: fewest and most propagation steps seen.
        optimiser_steps: number of optimiser steps taken.
        details: anything else, JSON data: preset, garments, motions, seed, versions.
    """

    dt: float
    mean_edge_lengths: tuple[float, float]
    propagation_steps: tuple[int, int]
    optimiser_steps: int = 0
    details: dict[str, Any] = field(default_factory=dict)

    def after(self, earlier: TrainingRecord) -> TrainingRecord:
        """Record of this training and the `earlier` one whose weights it began with; its details keep both apart.

        Args:
            earlier: record of the weights that it began with.
        """
        lengths = (*self.mean_edge_lengths, *earlier.mean_edge_lengths)
        steps = (*self.propagation_steps, *earlier.propagation_steps)
        return TrainingRecord(
            self.dt,
            (min(lengths), max(lengths)),
            (min(steps), max(steps)),
            self.optimiser_steps + earlier.optimiser_steps,
            {**self.details, "before": {"optimiser_steps": earlier.optimiser_steps, **earlier.details}},
        )


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained model and the record of its training.

    Args:
        name: the built-in name, or the file's stem.
        model: in evaluation mode, on the CPU, float32.
        configuration: network that the model was built from.
        record: resolutions, steps and time step of its training.
        licence: SPDX name of the weights' licence.
    """

    name: str
    model: AccelerationModel
    configuration: NetworkConfiguration
    record: TrainingRecord
    licence: str

    def prepare(self, garments: PackedGarments, propagation_steps: int | None = None) -> PreparedGarments:
        """Prepare the model for garments, warning about resolutions and propagation steps never seen in training.

        Args:
            garments: on the device to compute on.
            propagation_steps: override of the number that the resolution asks for.
        """
        prepared = self.model.prepare(garments, propagation_steps)
        for garment, steps in zip(garments.garments, prepared.steps, strict=True):
            self.warn_of(garment, steps)
        return prepared

    def scaling_in_use(self, name: str | None) -> SwitchedScaling | None:
        """Rule of a name in the place of that of the training; None where it is the same, or none is named.

        Args:
            name: per-vertex, mean, none or band-split.

        Raises:
            InputError: the network has no update scaling.
        """
        if name is None:
            return None
        trained = getattr(self.configuration, "scaling", None)
        if trained is None:
            raise InputError(
                f"The network {self.name} is not of Pb4U-GNet's family and has no update scaling; leave out --scaling."
            )
        if name == scaling_name(trained):
            return None
        seen = self.record.details.get("triangles") or [0]
        return SwitchedScaling(with_scaling(trained, name), trained, max(seen), self.record.mean_edge_lengths)

    def warn_of(self, garment: Garment, steps: int) -> None:
        """Warn where a garment's resolution or number of propagation steps was never seen in training.

        Args:
            garment: that is simulated.
            steps: its propagation steps; 0 for a method without them.
        """
        self.warn_of_resolution(garment)
        self.warn_of_fabric(garment)
        fewest, most = self.record.propagation_steps
        if steps != 0 and not fewest <= steps <= most:
            warn(
                f"{garment.name}: {steps} propagation steps, but the weights {self.name} were trained with {fewest} "
                f"to {most}; expect over-stretched or unsteady cloth.",
            )

    @property
    def fabrics(self) -> dict[str, tuple[float, float]]:
        """Least and most of what the cloth of its training had: weight by area, stiffness along threads, bending.

        Under the names of `Material`'s members [kg/m^2], [N/m], [N m]; the cloth was isotropic.
        """
        cloth = self.configuration.layout.material_range
        softest, stiffest = (
            Material.isotropic(*numbers)
            for numbers in zip(cloth.density, cloth.lame_mu, cloth.lame_lambda, cloth.bending, strict=True)
        )
        return {name: (getattr(softest, name), getattr(stiffest, name)) for name in _CLOTH}

    def warn_of_fabric(self, garment: Garment) -> None:
        """Warn where a garment is of other cloth than those in training, and say what to expect.

        Args:
            garment: the garment to simulate.
        """
        for material in garment.materials or (garment.material,):
            nearest = material.without_grain
            for name, (least, most) in self.fabrics.items():
                if least * (1 - FABRIC_TOLERANCE) <= (value := getattr(nearest, name)) <= most * (1 + FABRIC_TOLERANCE):
                    continue
                warn(
                    f"{garment.name}: its {name.replace('_', ' ')} of {value:.3g} {_CLOTH[name]} is outside the range "
                    f"{least:.3g} to {most:.3g} that {self.name} was trained on, so the cloth may stretch or tremble; "
                    "give --material default, or --refine 5 for solver iterations after each step.",
                )
                break

    def warn_of_resolution(self, garment: Garment) -> None:
        """Warn where a garment is finer or coarser than those in training, and say what to expect.

        Args:
            garment: the garment to simulate.
        """
        length, (finest, coarsest) = garment.mean_edge_length, self.record.mean_edge_lengths
        if finest * (1 - RESOLUTION_TOLERANCE) <= length <= coarsest * (1 + RESOLUTION_TOLERANCE):
            return
        side, bound, expect = "finer", finest, "more stretch and trembling"
        if length > coarsest:
            side, bound, expect = "coarser", coarsest, "stiffer cloth, fewer wrinkles and deeper contact"
        triangles = round(garment.triangle_count * (length / bound) ** 2, -2)
        warn(
            f"{garment.name}: its edges are {1e3 * length:.1f} mm long on average, {side} than the "
            f"{1e3 * finest:.1f} to {1e3 * coarsest:.1f} mm of the training of the weights {self.name}; expect "
            f"{expect}, or remesh it with `--triangles {triangles:.0f}`.",
        )


def save_checkpoint(
    path: Path | str,
    model: AccelerationModel,
    configuration: NetworkConfiguration,
    record: TrainingRecord,
    licence: str = "Apache-2.0",
) -> None:
    """Write weights, normalisers and everything needed to rebuild them; the file appears whole or not at all.

    Args:
        path: path of the file.
        model: with the weights.
        configuration: network that the model was built from.
        record: record of its training.
        licence: SPDX name of the weights' licence.

    Raises:
        InputError: the folder cannot be written.
    """
    save_tensors(path, model.state_dict(), configuration, record, licence)


def save_tensors(
    path: Path | str,
    state: Mapping[str, Tensor],
    configuration: NetworkConfiguration,
    record: TrainingRecord,
    licence: str,
) -> None:
    """Write the state of a model as `save_checkpoint` does, each tensor in its own precision.

    Args:
        path: path of the file.
        state: tensors by their names in the model, each of the shape and unit that it has there.
        configuration: network that the state is of.
        record: record of its training.
        licence: SPDX name of the weights' licence.

    Raises:
        InputError: the folder cannot be written.
    """
    path = Path(path)
    metadata = {
        "pb4u_format_version": str(FORMAT_VERSION),
        "configuration": json.dumps(configuration_to_json(configuration)),
        "training_record": json.dumps(asdict(record)),
        "licence": licence,
    }
    tensors = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    content = save(tensors, metadata)
    with on_disk(f"Cannot write the checkpoint {path}"):
        replace_file(path, content)


_OF_A_TRAINING = ("best", "final", "last")
"""Stems of the weights in the folder of a training, alike in all of them."""


def weights_name(path: Path) -> str:
    """Name of the weights in a file: its stem, with its folder where a training named the file.

    Args:
        path: path of the file.
    """
    return f"{path.resolve().parent.name}-{path.stem}" if path.stem in _OF_A_TRAINING else path.stem


def load_checkpoint(path: Path | str, name: str | None = None, dtype: torch.dtype = torch.float32) -> Checkpoint:
    """Checkpoint in a file that `save_checkpoint` wrote.

    Args:
        path: path of the file.
        name: name of the checkpoint; `weights_name` by default.
        dtype: precision of the model.

    Raises:
        InputError: the file is absent, cut, foreign, of a newer format, or at odds with its own configuration.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}.")
    try:
        with safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(
            f"{path} is not a complete safetensors file ({error_text(error)}); download or train it again. Of "
            "checkpoints in pickle formats (.pt, .pth, .ckpt) only .pth files of the released research code are read."
        ) from error
    version = metadata.get("pb4u_format_version")
    if version is None or not version.isdecimal() or len(version) > 9:
        raise InputError(f"{path} has weights, but not those of a pb4u network: its header names no pb4u format.")
    if int(version) > FORMAT_VERSION:
        raise InputError(
            f"{path} is of checkpoint format {version} and this pb4u reads up to {FORMAT_VERSION}; upgrade pb4u."
        )
    try:
        configuration = configuration_from_json(parse_json(metadata["configuration"]))
        record = training_record_from_json(parse_json(metadata["training_record"]))
        # Each block has tensors of its own, and to describe thousands takes minutes.
        if getattr(configuration, "blocks", 0) > len(tensors):
            raise ValueError(f"it names more blocks than the file has tensors ({len(tensors)})")
        _described(configuration)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RuntimeError) as error:
        raise InputError(f"{path} has a header that this pb4u cannot read: {error_text(error)}") from error
    licence = metadata.get("licence", "unknown")
    return built_checkpoint(name or weights_name(path), configuration, tensors, record, licence, dtype, path)


class _NormalWeightsUndrawn(TorchFunctionMode):
    """Leaves out the drawing of normal weights: on the device "meta" torch imports for two seconds before it does."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if function is torch.nn.init.normal_:
            return kwargs["tensor"] if "tensor" in kwargs else args[0]
        return function(*args, **kwargs)


def _described(configuration: NetworkConfiguration) -> Mapping[str, Tensor]:
    """State of the network without memory: a header may tell of one that is far larger than the weights beside it."""
    with torch.device("meta"), _NormalWeightsUndrawn():
        return AccelerationModel(configuration.network()).state_dict()


def built_checkpoint(
    name: str,
    configuration: NetworkConfiguration,
    state: Mapping[str, Tensor],
    record: TrainingRecord,
    licence: str,
    dtype: torch.dtype = torch.float32,
    origin: Path | str | None = None,
) -> Checkpoint:
    """Checkpoint of a model whose state is at hand.

    Args:
        name: name of the checkpoint.
        configuration: network that the state is of.
        state: tensors by their names in the model, each of the shape and unit that it has there.
        record: record of its training.
        licence: SPDX name of the weights' licence.
        dtype: precision of the model.
        origin: the file it comes from, for messages; the name by default.

    Raises:
        InputError: the state does not fit the configuration, or is not finite.
    """
    _check_fit(origin or name, _described(configuration), state)
    model = AccelerationModel(configuration.network())
    if dtype != torch.float32:
        model = model.to(dtype)
    model.load_state_dict(state)
    return Checkpoint(name, model.eval(), configuration, record, licence)


def built_in_models() -> tuple[str, ...]:
    """Names of the weights that come with the package."""
    folder = resources.files("pb4u.simulation") / "weights"
    if not folder.is_dir():
        return ()
    return tuple(sorted(entry.name[: -len(SUFFIX)] for entry in folder.iterdir() if entry.name.endswith(SUFFIX)))


def from_pretrained(name_or_path: str | Path) -> Checkpoint:
    """Checkpoint of a built-in name, or of a path.

    Args:
        name_or_path: built-in name, or path.

    Raises:
        InputError: there is neither, listing the names, and whatever `load_checkpoint` refuses.
    """
    name = str(name_or_path)
    with weights_file(name) as path:
        return load_checkpoint(path, name if name in built_in_models() else None)


READERS: Registry[Callable[[str], Checkpoint]] = Registry("kind of weights", {SUFFIX: from_pretrained})
"""Suffix -> function of a path that gives its checkpoint."""


@contextmanager
def weights_file(name_or_path: str) -> Iterator[Path]:
    """File of a built-in name, or of a path.

    Args:
        name_or_path: built-in name, or path.

    Raises:
        InputError: there is neither, listing the names.
    """
    if name_or_path in built_in_models():
        with resources.as_file(resources.files("pb4u.simulation") / "weights" / (name_or_path + SUFFIX)) as path:
            yield path
    elif Path(name_or_path).is_file():
        yield Path(name_or_path)
    else:
        names = ", ".join(built_in_models()) or "none"
        raise InputError(
            f"There is no model file {name_or_path} and no built-in model of that name; built in: {names}."
        )


def training_record_from_json(data: dict[str, Any]) -> TrainingRecord:
    """Record of a training from the fields of one as JSON gives them.

    Args:
        data: fields by name.

    Raises:
        InputError: they are out of range.
    """
    record = TrainingRecord(**data)
    finest, coarsest = (float(length) for length in record.mean_edge_lengths)
    fewest, most = (int(count) for count in record.propagation_steps)
    if not (record.dt > 0 and 0 < finest <= coarsest and 0 <= fewest <= most):
        raise InputError("the training record holds a time step, resolution or step count out of range.")
    return TrainingRecord(
        float(record.dt), (finest, coarsest), (fewest, most), int(record.optimiser_steps), dict(record.details)
    )


def _check_fit(path: Path | str, expected: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    missing, foreign = sorted(expected.keys() - tensors.keys()), sorted(tensors.keys() - expected.keys())
    if missing or foreign:
        fault = f"{missing[0]} is missing" if missing else f"{foreign[0]} is not part of it"
        raise InputError(f"{path} does not hold the network that its header describes: {fault}.")
    for key, tensor in tensors.items():
        if tensor.shape != expected[key].shape:
            raise InputError(
                f"{path} has another feature layout or size than its header says: {key} is {tuple(tensor.shape)} and "
                f"should be {tuple(expected[key].shape)}."
            )
        if not bool(torch.isfinite(tensor).all()):
            raise InputError(f"{path} holds numbers that are not finite in {key}; its training diverged.")
