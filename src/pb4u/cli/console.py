"""Shared by all verbs: messages, JSON output, and parsers of flag values."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias, get_args, get_origin

import typer

from pb4u.errors import InputError, noted
from pb4u.export.registry import is_same_file, would_overwrite, written_files
from pb4u.io.atomic_file import check_writable, json_text, replace_file
from pb4u.io.companions import with_companions
from pb4u.io.mtl_file import is_written_with
from pb4u.options import argument_texts
from pb4u.scene_file import named_file

if TYPE_CHECKING:
    from pb4u.jobs.worker_pool import WorkerPool

Switch: TypeAlias = Literal["on", "off"]
SHAPE_EXAMPLES = "such as height=0.7,weight=0.4, or beta0=1.5,beta1=-0.5 of an SMPL-family file"


_TOLD: ContextVar[Sequence[str]] = ContextVar("told", default=())
"""What the verb that runs has warned of."""


def verb(**groups: Mapping[str, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Makes a verb of a function: the text of an argument in its docstring is the help of its flag.

    Args:
        groups: by name of an argument that stands for several flags, the type of each as typer reads it. The argument
            gets the given values by the name of their flag, None for a flag that was not given.
    """

    def made(command: Callable[..., None]) -> Callable[..., None]:
        parameters, texts = [], argument_texts(command)
        for parameter in inspect.signature(command, eval_str=True).parameters.values():
            flags = groups.get(parameter.name) or {parameter.name: _with_help(parameter, texts.get(parameter.name))}
            default = None if parameter.name in groups else parameter.default
            parameters += [
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
                for name, kind in flags.items()
            ]

        def call(**values: Any) -> None:
            gathered = {argument: {name: values.pop(name) for name in flags} for argument, flags in groups.items()}
            with noted() as notes:
                token = _TOLD.set(notes)
                try:
                    command(**gathered, **values)
                finally:
                    _TOLD.reset(token)

        call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        call.__doc__, call.__name__ = command.__doc__, command.__name__
        return call

    return made


def _with_help(parameter: inspect.Parameter, text: str | None) -> Any:
    """Type of an argument as typer reads it, with its text as help where it has no other."""
    is_told = get_origin(parameter.annotation) is Annotated
    kind, offered = get_args(parameter.annotation)[:2] if is_told else (parameter.annotation, None)
    if offered is None:
        offered = typer.Argument() if parameter.default is inspect.Parameter.empty else typer.Option()
    elif offered.help is None:
        offered = copy(offered)
    offered.help = offered.help or text
    return Annotated[kind, offered]


def say(sentence: str) -> None:
    """Tell what a user may want to know besides the result, on standard error."""
    print(f"pb4u: {sentence}", file=sys.stderr)


def tell(payload: Mapping[str, Any], target: str | None, sentence: str) -> None:
    """Print the result of a verb as a sentence, and write it as JSON if `--json` is given.

    Args:
        payload: the result.
        target: of `--json`.
        sentence: sentence on the result of the verb.

    Raises:
        InputError: the file cannot be written.
    """
    write_json(with_notes(payload), target)
    if target != "-":
        print(sentence)


def with_notes(payload: Mapping[str, Any]) -> dict[str, Any]:
    """A result with all warnings of its verb as its `notes`, unless it has notes already.

    Args:
        payload: the result.
    """
    return {"notes": list(_TOLD.get()), **payload}


def write_json(payload: Mapping[str, Any], target: str | None) -> None:
    """Write JSON to a file, or to standard output; numbers that are not finite become null.

    Args:
        payload: data to write.
        target: of `--json`: path of the file, or "-" for standard output; None for neither.

    Raises:
        InputError: the file cannot be written.
    """
    if not target:
        return
    text = json_text(dict(payload), indent=2)
    if target == "-":
        print(text)
        return
    check_json_target(target)
    replace_file(Path(target), (text + "\n").encode())


def wrote(targets: Iterable[Path], frames: int) -> str:
    """Sentence on the files that an export wrote; of a long sequence only the first and last.

    Args:
        targets: paths that were exported to.
        frames: number of frames.
    """
    names: list[str] = []
    for target in targets:
        files = [str(file) for file in written_files(target, frames)]
        names += [f"{files[0]} to {files[-1]}"] if len(files) > 2 else files
    return f"Wrote {', '.join(dict.fromkeys(names))}"


def check_json_target(target: str | None) -> None:
    """Refuse a file of --json that cannot be written; called before any work is done.

    Args:
        target: path of the file; None or "-" needs none.

    Raises:
        InputError: its folder is absent or read-only, or its name is taken by a folder.
    """
    if target and target != "-":
        check_writable(Path(target), "--json")


def keep_inputs(
    inputs: Iterable[object],
    outputs: Sequence[tuple[str, Path | str | None]],
    exports: Sequence[Path] = (),
    called: str = "--out",
) -> None:
    """Refuse an output that would replace what is read, or another output; called before any work is done.

    Args:
        inputs: names and paths of inputs; those that are not a file or folder are ignored.
        outputs: the flag that names each, for the message, and its path; None and "-" write no file.
        exports: paths of exported trajectories; some formats also write files of other names.
        called: the flag or the argument that names the outputs, for the message.

    Raises:
        InputError: two of them are one file.
    """
    paths = [named_file(name) for name in inputs if isinstance(name, str | Path)]
    read = [file for path in paths if path.exists() for file in with_companions(path)]
    written: list[tuple[Path, Path]] = []
    single = [(flag, Path(path)) for flag, path in outputs if path is not None and str(path) != "-"]
    for flag, path, is_export in [*((f, p, False) for f, p in single), *((called, p, True) for p in exports)]:
        for file in read:
            alone = is_same_file(path, file) or (path.suffix.lower() == ".obj" and is_written_with(path, file))
            if would_overwrite(path, file) if is_export else alone:
                raise InputError(f"{flag} {path} would overwrite {file}, which is read; give another name.")
        for other, file in written:
            if would_overwrite(path, file) if is_export else is_same_file(path, file):
                raise InputError(f"{path} and {other} would both be written to {file}; give each a name of its own.")
        written += [(path, file) for file in (written_files(path, 1) if is_export else (path,))]


def pool_of(workers: int, ray: str | None) -> Callable[[], WorkerPool]:
    """Function that makes the workers of a run; called once there is work.

    Args:
        workers: processes on this machine.
        ray: address of a Ray cluster to use instead; None for none.

    Raises:
        InputError: `workers` is not a positive number.
    """
    if workers < 1:
        raise InputError(f"The number of workers must be 1 or more, not {workers}.")

    def pool() -> WorkerPool:
        from pb4u.jobs.worker_pool import LocalPool, RayPool
        from pb4u.measures.run_job import attempt

        return LocalPool(workers, attempt) if ray is None else RayPool(ray, attempt, workers)

    return pool


class BodyShape(dict[str, float]):
    """Shape parameters of a body by name."""

    @classmethod
    def parse(cls, text: str) -> BodyShape:
        """Shape parameters from `height=0.7,weight=0.4`.

        Raises:
            BadParameter: the text is anything else.
        """
        shape = cls()
        for entry in filter(str.strip, text.split(",")):
            key, equals, value = entry.partition("=")
            try:
                shape.add(key.strip(), float(value))
            except ValueError:
                equals = ""
            if not equals:
                raise typer.BadParameter(f"it takes KEY=VALUE pairs such as height=0.7,weight=0.4; {entry!r} is none.")
        return shape

    @classmethod
    def of(cls, flags: Iterable[BodyShape] | None) -> BodyShape:
        """Shape parameters of a flag that was given several times.

        Raises:
            BadParameter: two of them set the same parameter.
        """
        shape = cls()
        for flag in flags or ():
            for key, value in flag.items():
                shape.add(key, value)
        return shape

    def add(self, key: str, value: float) -> None:
        """Set a parameter.

        Args:
            key: its name.
            value: its value, within the body's range.

        Raises:
            BadParameter: it is set already.
        """
        if key in self:
            raise typer.BadParameter(f"--body-shape gives {key} twice; give it once.")
        self[key] = value


class FrameRange(NamedTuple):
    """A range of frames, first..stop-1.

    Args:
        first: first frame, counted from 0.
        stop: frame after the last.
    """

    first: int
    stop: int

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """Range from `A:B`, B exclusive.

        Raises:
            BadParameter: the text is anything else.
        """
        first, colon, stop = text.partition(":")
        if colon and first.strip().isdecimal() and stop.strip().isdecimal() and int(first) < int(stop):
            return cls(int(first), int(stop))
        raise typer.BadParameter(f"a range is A:B, frame A to frame B-1 with 0 <= A < B, such as 30:120; not {text!r}.")


ShapeFlag: TypeAlias = Annotated[
    list[BodyShape] | None,
    typer.Option(
        "--body-shape",
        parser=BodyShape.parse,
        metavar="KEY=VALUE,..",
        help=f"Shape of the body, {SHAPE_EXAMPLES}. Repeatable.",
    ),
]
CropFlag: TypeAlias = Annotated[
    FrameRange | None,
    typer.Option(parser=FrameRange.parse, metavar="A:B", help="Frames A to B-1 of a recording, at its own rate."),
]
JsonFlag: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="FILE|-", help="Write the result as JSON to a file; '-' is standard output."),
]
WorkersFlag: TypeAlias = Annotated[int, typer.Option(metavar="N", help="Processes on this machine, one thread each.")]
RayFlag: TypeAlias = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on a Ray cluster: its address, auto, or local.")
]
