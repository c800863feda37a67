"""What OBJ and MTL files name: the MTL files of a mesh, and the images of their appearances."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterator
from pathlib import Path


def text_of(name: bytes) -> str:
    """Text of a line in UTF-8, or in another encoding, whose names stay distinct.

    Args:
        name: as in the file.
    """
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")


def joined_lines(obj: Path) -> bytes:
    """Content of an OBJ file in which continued lines are one, and all lines end in a line feed.

    Args:
        obj: the file.

    Raises:
        OSError: it cannot be read.
    """
    content = obj.read_bytes().removeprefix(codecs.BOM_UTF8)
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in content:
        # A comment may end in the path of a folder.
        content = re.sub(rb"(?m)^[ \t]*#.*\\$", b"#", content).replace(b"\\\n", b" ")
    return content


def named_libraries(obj: Path) -> list[tuple[str, Path | None]]:
    """The MTL files that an OBJ file names, each once: the name, and the file if it exists.

    Args:
        obj: the file.

    Raises:
        OSError: it cannot be read.
    """
    text = joined_lines(obj)
    # Much quicker than a look at every line; what stands before it on its line shows that it begins one.
    lines = [(text[text.rfind(b"\n", 0, m.start()) + 1 : m.start()], m[1]) for m in re.finditer(rb"mtllib(.*)", text)]
    libraries = list[tuple[str, Path | None]]()
    for rest in (text_of(name.strip()) for before, name in lines if name.strip() and not before.strip()):
        # A name may hold blanks, and a line several names.
        files = [(name, _beside(obj, name)) for name in ([rest] if _beside(obj, rest) else rest.split())]
        libraries += files if any(file for _, file in files) else [(rest, None)]
    return list(dict.fromkeys(libraries))


def libraries_of(obj: Path) -> list[Path]:
    """The existing MTL files that an OBJ file names, each once.

    Args:
        obj: the file.

    Raises:
        OSError: it cannot be read.
    """
    return list(dict.fromkeys(file for _, file in named_libraries(obj) if file is not None))


def statements(mtl: Path) -> Iterator[tuple[str, str]]:
    """The lines of an MTL file, each as its keyword and the rest.

    Args:
        mtl: the file.

    Raises:
        OSError: it cannot be read.
    """
    for line in map(text_of, mtl.read_bytes().removeprefix(codecs.BOM_UTF8).splitlines()):
        keyword, rest = (*line.split(None, 1), "", "")[:2]
        yield keyword, rest.strip()


def image_of(mtl: Path, rest: str) -> Path | None:
    """The image that a map_Kd names, after its options; None if it does not exist.

    Args:
        mtl: the file that contains the line.
        rest: of the line, after map_Kd.
    """
    # A name may hold blanks, so that options end at the first place after which a file is named.
    tails = (rest.split(None, k)[k].strip() for k in range(len(rest.split())))
    return next((file for tail in tails if (file := _beside(mtl, tail)) is not None), None)


def is_written_with(obj: Path, file: Path) -> bool:
    """Whether a file may be written together with an OBJ file: as its MTL file, or as an image of it.

    Args:
        obj: the OBJ file.
        file: another file.
    """
    names = re.escape(obj.stem) + r"\.(pb4u\.mtl|texture\d+\.(png|jpg))"
    return bool(re.fullmatch(names, file.name)) and obj.parent.resolve() == file.parent.resolve()


def _beside(file: Path, name: str) -> Path | None:
    """The file that `file` names, perhaps by another machine's path."""
    name = name.strip('"').replace("\\", "/")
    # Unlike `is_file` this takes a name of any length.
    return next((beside for n in (name, Path(name).name) if os.path.isfile(beside := file.parent / n)), None)
