"""Bodies by name or file."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path

from pb4u.body.anny_body import AnnyBody
from pb4u.body.baked_body import BUILT_IN, BakedBody
from pb4u.body.body_model import BodyModel, ShapedBody
from pb4u.body.point_cache import CACHE_SUFFIXES
from pb4u.body.smpl import SmplBody
from pb4u.body.surface_file import SURFACE_SUFFIXES
from pb4u.body.vertex_sequence import VertexSequence, load_vertex_sequence
from pb4u.errors import InputError

_ANNY = "anny"
_SUFFIXES = (".npz", ".pkl", *SURFACE_SUFFIXES, *CACHE_SUFFIXES)


def body_names() -> tuple[str, ...]:
    """Names of the built-in bodies; "anny" as well is any body of the full model, where its extra is installed."""
    return BUILT_IN


def load_body(name_or_path: str | Path, shape: Mapping[str, float] | None = None) -> ShapedBody | VertexSequence:
    """A body by name, or from a file or folder.

    Args:
        name_or_path: "woman", "man", "anny" (the full model), an SMPL-family .npz or .pkl, a baked body .npz, or a
            moving surface as `load_vertex_sequence` reads it.
        shape: shape parameters by name; a moving surface has none.

    Raises InputError on an unknown name, a file that cannot be used, or a shape parameter that does not fit.
    """
    given = dict(shape or {})
    if str(name_or_path) in BUILT_IN:
        return _built_in(str(name_or_path), tuple(sorted(given.items())))
    model = _model(str(name_or_path))
    if model is not None:
        return model.shaped(**given)
    if given:
        raise InputError(f"{name_or_path} is a moving surface without shape parameters; leave out {', '.join(given)}.")
    return load_vertex_sequence(name_or_path)


@lru_cache(maxsize=8)
def _built_in(name: str, shape: tuple[tuple[str, float], ...]) -> ShapedBody:
    """Kept, because garments keep what they worked out about a body for as long as it lives."""
    return BakedBody.built_in(name).shaped(**dict(shape))


def _model(name: str) -> BodyModel | None:
    """The model of a name or file; None where the file is a moving surface."""
    if name == _ANNY:
        return AnnyBody()
    path = Path(name)
    if not path.exists():
        raise InputError(_unknown(name))
    suffix = path.suffix.lower()
    if suffix == ".pkl":
        return SmplBody(path)
    if suffix != ".npz" or path.is_dir():
        return None
    try:
        members = {Path(member).stem for member in zipfile.ZipFile(path).namelist()}
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable .npz ({error}).") from error
    if "term_basis" in members:
        return BakedBody(path)
    return SmplBody(path) if members & {"v_template", "shapedirs", "kintree_table"} else None


def _unknown(name: str) -> str:
    names = (*BUILT_IN, _ANNY)
    if Path(name).suffix.lower() in _SUFFIXES or "/" in name:
        return f'There is no body file "{name}"; check the path, or use one of the names {", ".join(names)}.'
    near = get_close_matches(name.lower(), names, n=2, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"the built-in ones are {', '.join(names)}."
    return f'There is no body called "{name}"; {hint}'
