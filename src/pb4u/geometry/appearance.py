"""Colours and images of a mesh as its author gave them: what glTF and MTL call materials."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pb4u.errors import InputError, warn
from pb4u.geometry.topology import offsets
from pb4u.io.atomic_file import replace_file
from pb4u.io.mtl_file import image_of, statements
from pb4u.io.reading_limits import parse_json, refusing

if TYPE_CHECKING:
    from PIL import Image


@dataclass(frozen=True)
class Appearance:
    """How some faces look.

    Args:
        name: as given by its author.
        colour: red, green and blue, sRGB [0 to 1]; multiplies the image.
        image: content of a PNG or JPEG file mapped by the UVs, v upward; or None.
    """

    name: str
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    image: bytes | None = None


@dataclass(frozen=True, eq=False)
class Appearances:
    """How the faces of a mesh look.

    Args:
        listed: each appearance once.
        of_face: (faces,) int64 index of the appearance of each face, or polygon; -1 for none.
    """

    listed: tuple[Appearance, ...]
    of_face: np.ndarray

    def at(self, faces: np.ndarray) -> Appearances:
        """Appearances of a selection of the faces.

        Args:
            faces: (faces,) int64 the face from which each takes its appearance.
        """
        return replace(self, of_face=self.of_face[faces])

    def named_apart(self) -> Appearances:
        """The same with unique names, for files that refer to appearances by name."""
        taken, renamed = set[str](), list[Appearance]()
        for look in self.listed:
            names = chain((look.name,), (f"{look.name}.{number}" for number in count(1)))
            name = next(name for name in names if name not in taken)
            taken.add(name)
            renamed.append(replace(look, name=name))
        return replace(self, listed=tuple(renamed))

    @staticmethod
    def joined(parts: Sequence[Appearances | None], faces: Sequence[int]) -> Appearances | None:
        """Appearances of several meshes joined into one; None where no mesh has any.

        Args:
            parts: appearances of each mesh, or None.
            faces: number of faces of each.
        """
        looks = [part or Appearances((), np.full(count, -1)) for part, count in zip(parts, faces, strict=True)]
        all_looks = tuple(look for part in looks for look in part.listed)
        if not all_looks:
            return None
        starts = offsets([part.listed for part in looks])
        of_face = [np.where(part.of_face < 0, -1, part.of_face + k) for part, k in zip(looks, starts, strict=False)]
        return Appearances(all_looks, np.concatenate(of_face))

    def members(self, prefix: str = "") -> dict[str, np.ndarray]:
        """Arrays of a trajectory file by name: (bytes,) uint8 of a JSON text and of all images, and (faces,) int64.

        Args:
            prefix: put before each name.
        """
        described = [
            {"name": look.name, "colour": look.colour, "bytes": len(look.image or b"")} for look in self.listed
        ]
        images = b"".join(look.image or b"" for look in self.listed)
        return {
            f"{prefix}appearances": np.frombuffer(json.dumps(described).encode(), dtype=np.uint8),
            f"{prefix}appearance_images": np.frombuffer(images, dtype=np.uint8),
            f"{prefix}appearance_of_face": self.of_face.astype(np.int64),
        }

    @classmethod
    def from_members(cls, members: dict[str, np.ndarray], prefix: str = "") -> Appearances | None:
        """Appearances of a trajectory file; None where it has none.

        Args:
            members: arrays (...) of the file by name, as `members` wrote them.
            prefix: before the name of each.

        Raises:
            ValueError, LookupError, TypeError: they are damaged.
        """
        text = members.get(f"{prefix}appearances")
        if text is None:
            return None
        images = io.BytesIO(members[f"{prefix}appearance_images"].tobytes())
        looks = []
        for entry in parse_json(text.tobytes()):
            red, green, blue = (min(max(float(channel), 0.0), 1.0) for channel in entry["colour"])
            looks.append(Appearance(str(entry["name"]), (red, green, blue), images.read(int(entry["bytes"])) or None))
        of_face = np.asarray(members[f"{prefix}appearance_of_face"])
        if of_face.min(initial=-1) < -1 or of_face.max(initial=-1) >= len(looks):
            raise ValueError("a face has an appearance out of range")
        return cls(tuple(looks), of_face)


def read_image(path: Path) -> bytes:
    """Content of a PNG or JPEG file; other kinds of images are turned into PNG.

    Args:
        path: the file.

    Raises:
        InputError: it is missing, or no image that can be read.
    """
    if not path.is_file():
        raise InputError(f"There is no image {path}.")
    with refusing(path, "cannot be read as an image"):
        return sound_image(path.read_bytes(), str(path))


def sound_image(content: bytes, name: str) -> bytes:
    """Content of a PNG or JPEG file; other kinds of images are turned into PNG.

    Args:
        content: of a file.
        name: name of the image for error messages.

    Raises:
        InputError: it is not an image that can be read.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(content)) as image:
            image.load()
            return content if image.format in ("PNG", "JPEG") else _as_png(image)
    except UnidentifiedImageError:
        raise InputError(f"{name} is not an image, or a damaged one; save it as PNG or JPEG.") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{name} cannot be read as an image ({error}); save it as PNG or JPEG.") from None


def _as_png(image: Image.Image) -> bytes:
    """The content of a PNG file of an image."""
    written = io.BytesIO()
    image.convert("RGBA" if "A" in image.getbands() else "RGB").save(written, "PNG")
    return written.getvalue()


def read_mtl(path: Path) -> dict[str, Appearance]:
    """The appearances of an MTL file by name: map_Kd if present, else Kd; warns of entries that cannot be read.

    Args:
        path: the file.
    """
    looks: dict[str, Appearance] = {}
    current = Appearance("")
    for kind, rest in statements(path):
        if kind == "newmtl":
            current = Appearance(rest, (0.8, 0.8, 0.8))
        elif kind == "Kd" and current.image is None:
            current = _with_colour(current, path, rest)
        elif kind == "map_Kd":
            current = _with_image(current, path, rest)
        if current.name:
            looks[current.name] = current
    return looks


def write_mtl(path: Path, looks: Sequence[Appearance]) -> None:
    """Write an MTL file, and the images beside it as NAME.texture0.png.

    Args:
        path: the file.
        looks: appearances that it describes.

    Raises:
        OSError: they cannot be written.
    """
    lines = []
    for number, look in enumerate(looks):
        lines.append("newmtl {}\nKd {:.6g} {:.6g} {:.6g}\n".format(look.name, *look.colour))
        if look.image is not None:
            image = path.with_name(f"{path.stem.removesuffix('.pb4u')}.texture{number}{image_suffix(look.image)}")
            replace_file(image, look.image)
            lines.append(f"map_Kd {image.name}\n")
    replace_file(path, "".join(lines).encode())


def image_suffix(image: bytes) -> str:
    """Suffix of an image's file by its content: ".png" or ".jpg".

    Args:
        image: content of the file.
    """
    return ".png" if image.startswith(b"\x89PNG") else ".jpg"


def _with_colour(appearance: Appearance, mtl: Path, rest: str) -> Appearance:
    """With the colour of a Kd, of which one number is a grey, or as it was, with a warning."""
    try:
        channels = np.array(rest.split()[:3], dtype=np.float64)
        red, green, blue = np.clip(np.broadcast_to(channels, 3), 0.0, 1.0).tolist()
    except ValueError:
        red = green = blue = np.nan
    if not np.isfinite([red, green, blue]).all():
        warn(f"{mtl.name}: the colour Kd {rest[:60]} is not three numbers; it is ignored.")
        return appearance
    return replace(appearance, colour=(red, green, blue))


def _with_image(appearance: Appearance, mtl: Path, rest: str) -> Appearance:
    """With the image that a map_Kd names, or as it was, with a warning."""
    file = image_of(mtl, rest)
    if file is None:
        warn(f"{mtl.name}: the image {(rest.split() or [''])[-1]} is missing; put it beside the file to see it.")
        return appearance
    try:
        return Appearance(appearance.name, image=read_image(file))
    except InputError as error:
        warn(f"{mtl.name}: {error}")
        return appearance
