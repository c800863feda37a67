"""Write the list of the kernels that a first run compiles: `python tools/list_kernels.py`, some minutes.

Runs the commands below with an empty folder of machine code and lists what is compiled, callees before their callers.
"""

from __future__ import annotations

import os
import sys
import tempfile
from typing import Any

from numba.core import config

from pb4u.cli.main import main
from pb4u.collision import compile_ahead
from pb4u.collision.kernel_cache import KernelCache
from pb4u.collision.kernel_list import LIST, line_of

COMMANDS = (
    "simulate --frames 3 --lead-in 1 --out walk.npz",
    "simulate --frames 3 --lead-in 1 --model quick-solver --out quick.npz",
    "simulate --frames 3 --lead-in 1 --garment tanktop --garment cardigan --out layers.npz",
    "simulate --frames 3 --lead-in 1 --garment dress --motion dance --triangles 8000 --out dress.npz",
)


def listed() -> list[str]:
    """Lines of what the commands compile."""
    lines: dict[str, None] = {}
    save = KernelCache.save_overload

    def save_and_list(cache: KernelCache, signature: Any, compiled: Any) -> None:
        save(cache, signature, compiled)
        if (line := line_of(cache._kernel, signature)) is not None:
            lines[line] = None

    KernelCache.save_overload = save_and_list  # type: ignore[method-assign]
    compile_ahead._program.start = lambda: None  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as folder:
        config.CACHE_DIR = folder
        os.chdir(folder)
        for command in COMMANDS:
            sys.argv = ["pb4u", *command.split()]
            try:
                main()
            except SystemExit as ended:
                if ended.code:
                    raise
    return list(lines)


if __name__ == "__main__":
    LIST.write_text("".join(f"{line}\n" for line in listed()), encoding="utf-8")
