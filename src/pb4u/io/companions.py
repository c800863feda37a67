"""The files that are read with a file: no output may replace them, and their content is a clip's too."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote

from pb4u.errors import InputError
from pb4u.io.mtl_file import image_of, libraries_of, statements
from pb4u.io.reading_limits import parse_json
from pb4u.io.toml_file import read_tables

_BESIDE = {".amc": (".asf",), ".pc2": (".obj",), ".obj": (".pc2", ".mdd"), ".mdd": (".obj",)}
"""What may lie beside a file and be read with it, by its ending: a skeleton of any name, others of the same."""


def with_companions(path: Path) -> list[Path]:
    """A file and its companions that are read with it: a skeleton, a point cache and its mesh, a pattern's drawing,
    buffers.

    Args:
        path: the file.
    """
    kind = path.suffix.lower()
    if kind in (".toml", ".gltf"):
        return [path, *_named_within(path)]
    looks = _looks_of(path) if kind == ".obj" else []
    if kind == ".npy":  # of TRAM
        return [path, *{camera for up in path.absolute().parents[:2] if (camera := up / "camera.npy").is_file()}]
    near = (file for file in path.absolute().parent.glob("*") if file.suffix.lower() in _BESIDE.get(kind, ()))
    return [path, *(file for file in near if file.suffix.lower() == ".asf" or file.stem == path.stem), *looks]


def _looks_of(path: Path) -> list[Path]:
    """The MTL files of an OBJ, and the images that they name."""
    files: list[Path] = []
    with suppress(OSError):
        for library in libraries_of(path):
            files.append(library)
            images = [image_of(library, rest) for kind, rest in statements(library) if kind == "map_Kd"]
            files += [image for image in images if image is not None]
    return list(dict.fromkeys(files))


def _named_within(path: Path) -> list[Path]:
    """Files that a pattern or a glTF names; none of one that cannot be read, which is refused where it is."""
    with suppress(InputError, OSError, ValueError, AttributeError, TypeError):
        if path.suffix.lower() == ".toml":
            names = [read_tables(path, "a sewing pattern").get("svg")]
        else:
            document = parse_json(path.read_bytes())
            names = [unquote(part.get("uri", "")) for kind in ("buffers", "images") for part in document.get(kind, ())]
        return [path.parent / name for name in names if name and (path.parent / name).is_file()]
    return []
