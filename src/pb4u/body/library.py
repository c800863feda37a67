"""Bodies by name or file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import NamedTuple

from pb4u.body.baked_body import BakedBody
from pb4u.body.body_model import BodyModel, ShapedBody
from pb4u.body.built_in import BUILT_IN
from pb4u.body.character_file import read_character
from pb4u.body.sam3d_body import VERTICES, is_sam3d_folder
from pb4u.body.sequence_files import SUFFIXES, load_vertex_sequence
from pb4u.body.smpl import SmplBody
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.errors import InputError, unknown_name, unread_kind
from pb4u.io.array_archive import member_names
from pb4u.io.gltf_file import SUFFIXES as GLTF_SUFFIXES
from pb4u.io.restricted_pickle import load_pickle


class _Format(NamedTuple):
    """A kind of body file: a function of its path gives a `BodyModel` or a `VertexSequence`."""

    reader: str
    suffixes: tuple[str, ...]
    # An .npz is of this kind where it has one of these; none for a kind that its suffix alone tells.
    members: tuple[str, ...] = ()
    # Whether the unit of its lengths may be given.
    any_unit: bool = False


_FOLDER = "/"
_CHARACTER = "pb4u.body.character_file:read_character"
# The first that fits; another format is one more line here.
_FORMATS = (
    _Format("pb4u.body.baked_body:BakedBody", (".npz",), ("term_basis",)),
    _Format("pb4u.body.smpl:SmplBody", (".npz",), ("v_template", "shapedirs", "kintree_table")),
    _Format("pb4u.body.library:read_pickled_body", (".pkl",), any_unit=True),
    _Format(_CHARACTER, GLTF_SUFFIXES),
    _Format("pb4u.body.sam3d_body:read_sam3d_body", (".npz", _FOLDER), (VERTICES,)),
    _Format("pb4u.body.sequence_files:load_vertex_sequence", (".npz", *SUFFIXES, _FOLDER), any_unit=True),
)
_MODELS = {"anny": "pb4u.body.anny_body:AnnyBody"}


def body_names() -> tuple[str, ...]:
    """Names of the built-in bodies; "anny" is any body of the full model, if its extra is installed."""
    return BUILT_IN


def file_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that `load_body` reads."""
    return tuple(dict.fromkeys(suffix for form in _FORMATS for suffix in form.suffixes if suffix != _FOLDER))


def load_body(
    name_or_path: str | Path,
    shape: Mapping[str, float] | None = None,
    *,
    clip: str | None = None,
    parts: Collection[str] | None = None,
    units: str | None = None,
) -> ShapedBody | VertexSequence:
    """A body by name, or from a file or folder.

    Args:
        name_or_path: "woman", "man", "anny" (the full model), an SMPL-family .npz or .pkl, a baked body .npz, a rigged
            character (.glb, .gltf, .vrm), or a moving surface as `load_vertex_sequence` reads it.
        shape: shape parameters by name; a character and a moving surface have none.
        clip: name of the clip that a character performs; by default its first.
        parts: names of the meshes or materials that form a character's body; by default recognised by their names.
        units: unit of length of a character's or a moving surface's file, such as "inches"; by default recognised by
            the size of a person.

    Raises:
        InputError: the name is unknown, the file cannot be used, or a shape parameter does not fit.
    """
    values = dict(shape or {})
    name = str(name_or_path)
    if Path(name).suffix.lower() in GLTF_SUFFIXES and Path(name).is_file():
        if values:
            raise InputError(f"{name} is a character without shape parameters; leave out {', '.join(values)}.")
        return read_character(Path(name), clip, parts, units)
    if clip is not None or parts is not None:
        option = "clip" if clip is not None else "body-parts"
        raise InputError(f"{name} is not a rigged character ({', '.join(GLTF_SUFFIXES)}); leave out --{option}.")
    if units is not None and (name in BUILT_IN or name in _MODELS):
        raise InputError(f"{name} is in metres; leave out --body-units.")
    if name in BUILT_IN:
        return _built_in(name, tuple(sorted(values.items())))
    body: BodyModel | VertexSequence = (
        resolve_name(_MODELS[name])() if name in _MODELS else _read(Path(name_or_path), units)
    )
    if isinstance(body, BodyModel):
        return body.shaped(**values)
    if values:
        raise InputError(f"{name} is a moving surface without shape parameters; leave out {', '.join(values)}.")
    return body


def load_boned_body(name_or_path: str | Path, shape: Mapping[str, float] | None = None) -> ShapedBody:
    """A body with bones; arguments as for `load_body`.

    Args:
        name_or_path: name, or path of a file.
        shape: shape parameters by name.

    Raises:
        InputError: it has no bones, or for the reasons of `load_body`.
    """
    body = load_body(name_or_path, shape)
    if not isinstance(body, ShapedBody):
        raise InputError(f"{name_or_path} is a sequence of vertices; this needs a body with bones.")
    return body


def read_pickled_body(path: Path, units: str | None = None) -> BodyModel | VertexSequence:
    """A body in a pickle, read without running its code: a sequence of vertices if it has any, else an SMPL model.

    Args:
        path: the file.
        units: name of its unit of length, where it is a sequence.

    Raises:
        InputError: it is neither, its parts do not fit each other, or a unit is given for a model.
    """
    content = load_pickle(path)
    is_sequence = isinstance(content, Mapping) and "verts" in content
    if units is not None and not is_sequence:
        raise _in_metres(path)
    return load_vertex_sequence(path, units) if is_sequence else SmplBody(path)


def _in_metres(path: Path) -> InputError:
    return InputError(f"{path} is of a format that is always in metres; leave out --body-units.")


@lru_cache(maxsize=4)
def _built_in(name: str, shape: tuple[tuple[str, float], ...]) -> ShapedBody:
    """A few are kept, with what garments and motions worked out about them: some 25 MB each."""
    return BakedBody.built_in(name).shaped(**dict(shape))


def _read(path: Path, units: str | None) -> BodyModel | VertexSequence:
    suffix, names = path.suffix.lower(), (*BUILT_IN, *(model for model in _MODELS if find_spec(model) is not None))
    if suffix and suffix not in file_suffixes() and not path.is_dir():
        raise unread_kind(path, "body", file_suffixes())
    if not path.exists():
        if suffix or path.name != str(path):
            raise InputError(
                f'There is no body file "{path}"; check the path, or use one of the names {", ".join(names)}.'
            )
        if path.name.lower().startswith("smpl"):
            raise InputError(f'There is no body "{path}"; give the file of the model, which its authors distribute.')
        raise unknown_name("body", str(path), names)
    suffix = _FOLDER if path.is_dir() else suffix
    members: set[str] = set()
    if suffix == ".npz":
        members = set(member_names(path))
    elif suffix == _FOLDER and is_sam3d_folder(path):
        members = {VERTICES}
    fitting = (f for f in _FORMATS if suffix in f.suffixes and (not f.members or members & set(f.members)))
    # What is of no known kind is refused by the reader of the last one, which lists the kinds.
    form = next(fitting, _FORMATS[-1])
    if units is not None and not form.any_unit:
        raise _in_metres(path)
    return resolve_name(form.reader)(path, units) if form.any_unit else resolve_name(form.reader)(path)
