"""`pb4u info`: versions, device, threads, optional parts; what a network is, and what is in a trajectory."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from pb4u import __version__
from pb4u.cli.console import JsonFlag, check_json_target, verb, write_json

_EXTRAS = {
    "anny": "anny",
    "render": "cv2",
    "usd": "pxr",
    "abc": "alembic3d",
    "svg": "svgelements",
    "ffmpeg": "imageio_ffmpeg",
    "view": "viser",
    "ray": "ray",
    "dataset": "pyarrow",
}
_OF_EXTRAS = {"ffmpeg": ' (H.264 videos; its program is under the GPL, so "all" leaves it out)'}


@verb()
def info(
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="FILE.npz")] = None,
    json: JsonFlag = None,
) -> None:
    """Show versions, the device, threads and which optional parts are installed.\f

    Args:
        model: Also describe a network: what it is, its size, training and licence.
        trajectory: Also list the garments of a trajectory, with their fabrics and those of their parts.
        json: file for the result.
    """
    check_json_target(json)
    facts = gather()
    if model is not None:
        facts["model"], described = describe_model(model)
        facts |= described
    if trajectory is not None:
        facts["garments"] = describe_trajectory(trajectory)
    write_json(facts, json)
    if json == "-":
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    for key, value in facts.items():
        if key == "garments":
            value = [_told(garment) for garment in value]
        if isinstance(value, list):
            value = "\n".join(value) or "in nothing"
        if isinstance(value, dict):
            value = ", ".join(
                f"{name}{_OF_EXTRAS.get(name, '')} "
                f"{'yes' if present is True else 'no' if present is False else present}"
                for name, present in value.items()
            )
        table.add_row(key.replace("_", " "), str(value))
    Console().print(table)


def gather() -> dict[str, Any]:
    """Versions, device, threads and installed extras, by the name that `pb4u info` shows."""
    import torch

    from pb4u.collision.kernel_cache import kernel_folder

    return {
        "pb4u": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: _version(name) for name in ("torch", "numpy", "scipy", "trimesh", "pyvista", "safetensors")},
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
        "threads": torch.get_num_threads(),
        "compiled kernels": str(kernel_folder()),
        "extras": {extra: find_spec(module) is not None for extra, module in _EXTRAS.items()},
    }


def describe_model(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Network, parameters and licence of a model by name or file, and what the network is.

    Args:
        name: a shipped network, a checkpoint file or a .pth of the released code.

    Raises:
        InputError: there is no such model, or its file cannot be used.
    """
    from pb4u.paper.departures import description
    from pb4u.simulation.models import load_checkpoint_of

    checkpoint = load_checkpoint_of(name)
    return {
        "name": checkpoint.name,
        "network": type(checkpoint.model.network).__name__,
        "parameters": sum(parameter.numel() for parameter in checkpoint.model.network.parameters()),
        "licence": checkpoint.licence,
        "optimiser steps": checkpoint.record.optimiser_steps,
        "time step [s]": checkpoint.record.dt,
    }, description(checkpoint)


def describe_trajectory(path: Path) -> list[dict[str, Any]]:
    """Each garment of a trajectory: name, triangles, shares of its area by fabric, parts, panels and number of buttons.

    Args:
        path: of the .npz.

    Raises:
        InputError: it is not a trajectory.
    """
    from pb4u.garment.material import FABRICS, MATERIALS, Material
    from pb4u.measures.metrics import garments_of
    from pb4u.scene.trajectory import Trajectory

    opened = Trajectory.open(path)
    names = {material: name for name, material in [*FABRICS.items(), *MATERIALS.items()]}

    def named(material: Material) -> str:
        return names.get(material, f"another of {material.density:g} kg/m2")

    buttons = opened.header.buttons
    of_garment = [] if buttons is None else opened.header.vertex_garment[buttons].tolist()
    garments = []
    for number, (garment, entry) in enumerate(zip(garments_of(opened), opened.header.garments, strict=True)):
        layers = garment.layers / garment.layers.sum(axis=1, keepdims=True)
        fabrics: dict[str, float] = {}
        for material, share in zip(garment.materials or (garment.material,), layers.T, strict=True):
            name = named(material)
            area = float(garment.face_areas @ share / garment.face_areas.sum())
            if area > 0.0:
                fabrics[name] = round(fabrics.get(name, 0.0) + area, 4)
        parts: dict[str, dict[str, Any]] = {}
        for part in garment.sewn:
            values = {name: value for name, value in vars(part).items() if value is not None and name != "name"}
            parts[part.name] = values if part.material is None else values | {"material": named(part.material)}
        garments.append(
            {
                "name": garment.name, "triangles": len(garment.faces), "fabrics": fabrics, "parts": parts,
                "panels": entry.get("panels", []), "buttons": of_garment.count(number),
            }
        )  # fmt: skip
    return garments


def _told(garment: dict[str, Any]) -> str:
    fabrics = sorted(garment["fabrics"].items(), key=lambda share: -share[1])
    text = f"{garment['name']}: {garment['triangles']} triangles of " + ", ".join(f"{n} {s:.0%}" for n, s in fabrics)
    parts = [_told_part(name, values) for name, values in garment["parts"].items()]
    text += f"; {', '.join(parts)}" if parts else ""
    text += f"; panels {', '.join(garment['panels'])}" if garment["panels"] else ""
    return text + (f"; {garment['buttons']} buttons" if garment["buttons"] else "")


def _told_part(name: str, values: dict[str, Any]) -> str:
    """A part and what it is made of, as `hem (2 layers)`."""
    words = {
        "material": "{}", "layers": "{} layers", "interfacing": "interfacing of {} N m",
        "elastic": "elastic of {} times the length", "width": "{} m wide",
    }  # fmt: skip
    return f"{name} ({', '.join(words[key].format(value) for key, value in values.items())})"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
