"""Progress reports of work that takes long."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from statistics import median

Progress = Callable[[int, int], None]
"""Called with (parts done, parts in all)."""

_LONG = 60.0
"""Seconds of work from which it is worth knowing beforehand how long it takes."""

_LEAST_PARTS, _LEAST_SECONDS = 3, 2.0
"""Measured before the rest is estimated: parts after the first, which also loads and compiles, and their time [s]."""


_LEAST_SECONDS_OF_MANY = 20.0
"""The same time [s] where parts differ: garments and rollouts of all kinds come in turn."""

_SLOWER = 2.0
"""Times the time of a part that was said, or that was too short to say, from which it is said again."""


def no_progress(done: int, total: int) -> None:
    """Ignore a progress report.

    Args:
        done: parts done.
        total: parts in all.
    """


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """A bar with the remaining time, on standard error; silent if that is not a terminal.

    Args:
        label: what is being done.
    """
    if not sys.stderr.isatty():
        yield no_progress
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def progress_or_bar(progress: Progress | None, label: str) -> AbstractContextManager[Progress]:
    """The progress callback of the caller, or a bar by default.

    Args:
        progress: callback; `no_progress` for none.
        label: what is being done.
    """
    return progress_bar(label) if progress is None else nullcontext(progress)


class Estimate:
    """Estimates the time of work from its first parts; prints it if it is over a minute, and again if the work gets
    slower.

    Args:
        say: called with the sentence.
        part: name of a part, such as "step".
        alike: whether parts take about equally long: the quickest then counts, otherwise the mean of several.
        clock: the time [s].
    """

    def __init__(
        self,
        say: Callable[[str], None],
        part: str,
        alike: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say, self._part, self._alike, self._clock = say, part, alike, clock
        self._began, self._said = clock(), 0.0
        self._first: tuple[float, int] | None = None
        self._last, self._paces = (0.0, 0), list[float]()
        self._each: float | None = None

    def __call__(self, done: int, total: int) -> None:
        """Take a progress report.

        Args:
            done: parts done.
            total: parts in all.
        """
        now = self._clock()
        if self._first is None:
            self._first = self._last = now, done
            return
        # What is compiled only when it is first needed falls into single parts, and comes once.
        if done > self._last[1]:
            self._paces.append((now - self._last[0]) / (done - self._last[1]))
            self._last = now, done
        seconds, parts = now - self._first[0], done - self._first[1]
        again = self._each is not None
        if parts < _LEAST_PARTS or seconds < (_LEAST_SECONDS if self._alike and not again else _LEAST_SECONDS_OF_MANY):
            return
        pace = median(self._paces) if again else min(self._paces) if self._alike else seconds / parts
        self._first, self._paces = (now, done), []
        # Cloth gets harder on the way, and what was said of its first steps is then too little.
        if self._each is not None and pace <= _SLOWER * self._each:
            return
        self._each = pace
        remaining = pace * (total - done)
        # What was said may have been too much before, and still hold.
        duration = now - self._began + remaining
        if remaining > _LONG and (not again or duration > self._said):
            self._said = duration
            self._say(
                f"{'Slower than at first: ' if again else ''}{total - done} more {self._part}s take about "
                f"{format_duration(remaining)}, {pace:.2g} s each."
            )


def format_duration(seconds: float) -> str:
    """A stretch of time in words, to a minute, a tenth of an hour or a day.

    Args:
        seconds: its length [s].
    """
    minutes = max(round(seconds / 60.0), 1)
    if minutes < 90:
        return f"{minutes} minute{'s' if minutes > 1 else ''}"
    return f"{seconds / 3600.0:.1f} hours" if seconds < 48 * 3600.0 else f"{seconds / 86400.0:.0f} days"


@contextmanager
def announced(
    label: str,
    part: str,
    say: Callable[[str], None],
    alike: bool = True,
) -> Iterator[Progress]:
    """A bar with the remaining time, and for work of over a minute a sentence with its estimated time.

    Args:
        label: what is being done.
        part: name of a part, such as "step".
        say: called with the sentence.
        alike: whether parts take about equally long.
    """
    estimate = Estimate(say, part, alike)
    with progress_bar(label) as bar:

        def told(done: int, total: int) -> None:
            bar(done, total)
            estimate(done, total)

        yield told
