"""Errors and warnings of the package."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches
from pathlib import Path

_LISTED, _FEW = 20, 8
"""Names that a refusal lists at most, a line or two, and beside near ones: the catalogue of scenes has thousands."""


_ALIASES = {
    "female": "woman", "male": "man", "pants": "trousers", "leggings": "trousers",
    "jacket": "cardigan", "coat": "cardigan", "hoodie": "longsleeve", "sweater": "longsleeve",
}  # fmt: skip
"""What users call things -> what they are called here."""

_ELSEWHERE = {
    ("fbx",): "FBX is not read; import it in Blender and export glTF of a body, OBJ of a garment, BVH of a motion.",
    ("blend", "ma", "mb", "max", "c4d", "hip", "dae", "3mf", "usd", "usda", "usdc", "usdz", "abc"): "Export glTF of a "
    "body (OBJ with MDD where it has no bones), OBJ of a garment or BVH of a motion from the program it comes from.",
    ("zprj", "zpac", "zcmt"): "Projects of CLO are not read; export OBJ there, thin and in metres.",
    ("dxf", "val", "vit", "sm2d"): "Patterns of this kind are not read; draw or export them as an SVG, beside a .toml.",
    ("c3d", "trc", "mvnx", "mvn", "csv"): "Places of markers and sensors are not read; solve them to a skeleton, and "
    "export BVH.",
    ("mp4", "mov", "avi", "mkv", "webm", "png", "jpg", "jpeg"): "Pictures and videos are not read; give the poses that "
    "GVHMR, WHAM or TRAM find in a video, or the body that SAM 3D Body finds in pictures.",
}
"""Suffixes of files that programs before pb4u read -> what to do with them."""


class Pb4uError(Exception):
    """The request failed or was refused; the message is one plain sentence that says what is wrong, where, and the
    remedy."""


class Interrupted(KeyboardInterrupt):
    """The user or the system interrupted the request; the message says what is kept.

    Args:
        sentence: one plain sentence on what is kept; empty for nothing.
        signal: number of the signal that ended it.
    """

    def __init__(self, sentence: str = "", signal: int = 2) -> None:
        super().__init__(sentence)
        self.signal = signal


def interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interrupt that caused an error, or the error itself if it is one; None without an interrupt.

    Args:
        error: compiled code raises a SystemError of its own when it is interrupted.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


class InputError(Pb4uError, ValueError):
    """An input (file, name or number) cannot be used."""


class MissingExtraError(Pb4uError, ImportError):
    """An optional part of the package is not installed.

    Args:
        extra: name of the missing extra.
        purpose: feature that needs it, as the beginning of the sentence.
    """

    def __init__(self, extra: str, purpose: str) -> None:
        super().__init__(f'{purpose} needs the "{extra}" extra: pip install "pb4u[{extra}]".')
        self.extra = extra


@contextmanager
def extra(name: str, purpose: str) -> Iterator[None]:
    """Refuse a feature if the imports of its optional part of the package fail.

    Args:
        name: of the extra.
        purpose: feature that needs it, as the beginning of the sentence.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(name, purpose) from error


@contextmanager
def on_disk(what: str, kind: type[Pb4uError] = InputError) -> Iterator[None]:
    """Turn errors of the disk into one sentence.

    Args:
        what: could not be done, as the beginning of the sentence.
        kind: of the error.

    Raises:
        Pb4uError: of that kind, in the place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror or error}.") from error


def sentence_on(error: BaseException) -> str | None:
    """Sentence on an error of this package, of the memory or of the disk; None for any other, which is a fault of pb4u.

    Args:
        error: the error.
    """
    if isinstance(error, Pb4uError):
        return " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "There is not enough memory for this; ask for fewer triangles or frames."
    if isinstance(error, OSError):
        return f"{error.strerror or error}{f' ({error.filename})' if error.filename else ''}."
    return None


class InputWarning(UserWarning):
    """An input is unusual but usable; the message is one plain sentence."""


class InputNote(InputWarning):
    """Note on a change of an input that needs no action."""


_NOTED: ContextVar[tuple[list[str], ...]] = ContextVar("noted", default=())


@contextmanager
def noted() -> Iterator[list[str]]:
    """List of the warnings given inside the `with` block, each once and in order; other handlers still get them."""
    notes: list[str] = []
    token = _NOTED.set((*_NOTED.get(), notes))
    try:
        yield notes
    finally:
        _NOTED.reset(token)


def warn(sentence: str, kind: type[InputWarning] = InputWarning) -> None:
    """Warn of an input, as an `InputWarning` at the line outside of this package that gave it; `noted` has it too.

    Args:
        sentence: one plain sentence.
        kind: of the warning.
    """
    for notes in _NOTED.get():
        if sentence not in notes:
            notes.append(sentence)
    depth, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("pb4u."):
        depth, frame = depth + 1, frame.f_back
    warnings.warn(sentence, kind, depth)


def unknown_name(kind: str, name: str, choices: Iterable[str], where: str = "") -> InputError:
    """Error for a name that is none of the `choices`, with the names nearest to it.

    Args:
        kind: kind of thing that was named, such as "garment".
        name: name that was given.
        choices: every name there is.
        where: section that holds things of the kind, such as "[scene]".
    """
    names = list(choices)
    alias = _ALIASES.get(name.lower())
    near = [alias] if alias in names else get_close_matches(name.lower(), names, n=3, cutoff=0.6)
    rest = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    hint = f"there are {', '.join(names[:_LISTED]) or 'none'}{rest}."
    if near:
        hint = f"did you mean {' or '.join(near)}?" + (f" T{hint[1:]}" if len(names) <= _FEW else "")
    return InputError(f"{f'{where} has' if where else 'There is'} no {kind} {name!r}; {hint}")


def unread_kind(path: Path, kind: str, suffixes: Iterable[str]) -> InputError:
    """Error for a file of an unknown format, with advice for formats of other programs.

    Args:
        path: the file.
        kind: its purpose, such as "motion".
        suffixes: of the kinds that are read.
    """
    suffix = path.suffix.lower().removeprefix(".")
    hint = next((f" {sentence}" for suffixes, sentence in _ELSEWHERE.items() if suffix in suffixes), "")
    return InputError(f"{path} is not a kind of {kind} file that pb4u reads; it reads {', '.join(suffixes)}.{hint}")


def refuse_unknown(kind: str, names: Iterable[str], choices: Collection[str], where: str = "") -> None:
    """Refuse names that are none of the `choices`; arguments as in `unknown_name`.

    Args:
        kind: kind of thing that was named.
        names: names that were given.
        choices: every name there is.
        where: section that holds things of the kind.

    Raises:
        InputError: one of them is unknown; the sentence names the first.
    """
    for name in names:
        if name not in choices:
            raise unknown_name(kind, name, choices, where)
