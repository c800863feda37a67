"""A first run's kernels, compiled by processes of their own while it goes on: one process takes over a minute.

Run as a program, this module has the listed kernels compiled. It ends with the run that started it.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from typing import Any

from filelock import FileLock
from numba.core.dispatcher import Dispatcher

from pb4u.collision.kernel_cache import KERNELS, is_writable, kernel_folder
from pb4u.collision.kernel_list import kernel_name, line_of, listed_kernels, signature_of
from pb4u.jobs.worker_pool import LocalPool
from pb4u.threads import thread_count

MOST_PROCESSES = 8
"""At most so many: each loads the package, and takes 0.7 GB."""
LACKING = 0.5
"""Share of the imported kernels that is not kept above which a run counts as a first one."""
_COLLECTED = 100_000
"""Objects made from one search for cycles to the next: every 700, as by default, takes a twelfth of the time."""


class _Program:
    """The program, where this process has started it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None

    @property
    def is_running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        folder, processes = kernel_folder(), min(thread_count(), MOST_PROCESSES)
        lacking = [kernel for kernel in KERNELS if not kernel._cache.is_kept]  # type: ignore[attr-defined]
        if len(lacking) <= LACKING * len(KERNELS) or not is_writable(folder):
            return
        if sys.stderr.isatty():
            print(f"Compiling kernels in {processes} processes, once on this machine.", file=sys.stderr)
        with contextlib.suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(processes)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "NUMBA_CACHE_DIR": str(folder.parent)},
            )


_program = _Program()


@functools.cache
def compile_ahead() -> None:
    """Have the listed kernels compiled by other processes, where most of those imported so far are not kept; once."""
    _program.start()


def is_coming(kernel: Dispatcher, signature: Any) -> bool:
    """Whether a process that `compile_ahead` has started will compile a kernel.

    Args:
        kernel: that is wanted.
        signature: types of its arguments.
    """
    return _program.is_running and line_of(kernel, signature) in listed_kernels()


@dataclass(frozen=True)
class ListedKernel:
    """A kernel to compile, as a job.

    Args:
        line: of the list.
    """

    line: str
    device = "cpu"

    @property
    def key(self) -> str:
        """The line."""
        return self.line


def compile_listed(job: ListedKernel) -> None:
    """Compile a kernel, unless it is kept.

    Args:
        job: the kernel.
    """
    gc.set_threshold(_COLLECTED)
    name, signature = signature_of(job.line)
    for kernel in [kernel for kernel in KERNELS if kernel_name(kernel) == name]:
        kernel.compile(signature)


def main() -> None:
    """Compile the list, in as many processes as the argument says."""
    threading.Thread(target=_end_with_run, daemon=True).start()
    with FileLock(kernel_folder() / ".ahead.lock"):
        pool, running = LocalPool(int(sys.argv[1]), compile_listed), 0
        for line in listed_kernels():
            if running == pool.size:
                pool.next_outcome()
                running -= 1
            pool.submit(ListedKernel(line))
            running += 1
        for _ in range(running):
            pool.next_outcome()
        pool.close()


def _end_with_run() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    # By its name, so that the compiling processes import it by that too.
    from pb4u.collision import compile_ahead as program

    program.main()
