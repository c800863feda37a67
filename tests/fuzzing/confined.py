"""Reads files in processes of their own, with limits of memory and time, and tells how each ended."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import multiprocessing
import os
import re
import resource
import signal
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

SECONDS = 20.0
"""Processor time that a file of a few kilobytes may take to be read: a hundred times what the slowest takes."""
_SILENCE = 600.0
"""Wall time after which a process that says nothing is given up; a busy machine may stop it for minutes."""
_GUARD = 4 * 2**30
"""Address space above the reader's own at which it is cut off, for the machine's sake."""
SLACK = 48 * 2**20
"""What interpreter, parsers and compiled kernels take beside the file, at their first use."""
_LONGEST_SENTENCE = 1600
"""Characters of a refusal on the command line."""


@dataclass(frozen=True)
class Ending:
    """How the reading of a case ended.

    Args:
        kind: "read", "refused", or what is wrong: "traceback", "memory", "hang", "crash", "not finite", "sentence".
        told: the sentence of a refusal, or the place and the trace of an error.
        grown: bytes of memory that were taken at most.
    """

    kind: str
    told: str = ""
    grown: int = 0

    @property
    def is_sound(self) -> bool:
        """Whether the file was read, or refused in a sentence."""
        return self.kind in ("read", "refused")

    @property
    def place(self) -> str:
        """Where it went wrong, for telling one finding from another."""
        return f"{self.kind}: {self.told.splitlines()[0] if self.told else ''}"


class Confinement:
    """A process that reads one case after another; where it dies, another takes its place.

    Args:
        only: part of the names of the kinds of files that are read.
    """

    def __init__(self, only: str = "") -> None:
        self._only = only
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._only), daemon=True)
        self._process.start()
        theirs.close()
        if not self._pipe.poll(_SILENCE) or self._pipe.recv() != "ready":
            raise RuntimeError("the reading process did not start")

    def ending(self, seed: str) -> Ending:
        """How the case of a seed ends."""
        self._pipe.send(seed)
        try:
            if self._pipe.poll(_SILENCE):
                ended = self._pipe.recv()
                assert isinstance(ended, Ending)
                return ended
            told = Ending("hang", f"nothing was heard for {_SILENCE:g} s")
        except EOFError:
            self._process.join()
            code = self._process.exitcode or 0
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            told = Ending("hang" if name == "SIGPROF" else "crash", name)
        self.restart()
        return told

    def restart(self) -> None:
        """Begin a new process."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _work(pipe: Connection, only: str) -> None:
    from tests.fuzzing.samples import case, samples

    warnings.simplefilter("ignore")
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="fuzz-cache-")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        # What is loaded and compiled once is not held against the first file.
        for number, sample in enumerate(each for each in samples() if only in each.name):
            for read in (*sample.readers, *sample.slow):
                place = Path(folder) / f"sound{number}"
                with contextlib.suppress(ValueError):
                    read(sample.written(place))
        gc.collect()
        # What is there by now is there for good, and need not be looked through each time.
        gc.freeze()
        resource.setrlimit(resource.RLIMIT_AS, (_memory("VmSize") + _GUARD,) * 2)
        pipe.send("ready")
        count = 0
        while True:
            try:
                seed = pipe.recv()
            except EOFError:
                return
            chosen = case(seed, only)
            place = Path(folder) / str(count)
            count += 1
            path = chosen.sample.written(place)
            size = sum(len(content) for content in chosen.sample.files.values())
            ended = ending(chosen.read, path, size)
            with contextlib.suppress(OSError):
                for file in sorted(place.rglob("*"), reverse=True):
                    file.rmdir() if file.is_dir() else file.unlink()
                place.rmdir()
            pipe.send(ended)


def ending(read: Callable[[Path], object], path: Path, size: int) -> Ending:
    """How the reading of a file ends; needs Linux, which tells the memory taken.

    Args:
        read: the reader.
        path: the file.
        size: bytes that it and those beside it have.
    """
    from pb4u.errors import Pb4uError
    from pb4u.io.reading_limits import HEADROOM

    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    before = _memory("VmRSS")
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        read(path)
        kind, told = "read", ""
    except Pb4uError as error:
        kind, told = "refused", str(error)
        if told.startswith("pb4u: ") and len(told) > _LONGEST_SENTENCE:
            kind, told = "sentence", f"of {len(told)} characters: {told[:200]}"
        elif not told.strip() or "MemoryError" in told or "Unable to allocate" in told:
            kind, told = "memory", f"{told}\n{traceback.format_exc()}"
    except AssertionError as error:
        kind, told = "not finite", f"{error}\n{traceback.format_exc()}"
    except Exception as error:
        kind, told = "traceback", f"{type(error).__name__} at {_place(error)}\n{traceback.format_exc()}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    grown = _memory("VmHWM") - before
    if grown > size + HEADROOM + SLACK:
        kind, told = "memory", f"{path.suffix}\n{grown / 2**20:.0f} MB for a file of {size} bytes, {kind}: {told}"
    return Ending(kind, told, grown)


def _place(error: BaseException) -> str:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/pb4u/" in frame.filename]
    last = frames[-1] if frames else traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename.rpartition('/pb4u/')[2]}:{last.lineno} {last.name}"


def _memory(field: str) -> int:
    found = re.search(rf"{field}:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024 * int(found[1])
