"""Memory that one operation frees is kept for the next one."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from pb4u.memory import keep_freed_memory
keep_freed_memory()
def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.empty(64 << 20, np.uint8)[:] = 1
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
first = pages()
print(pages() < 0.1 * first)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is set up")
@pytest.mark.parametrize(("own", "kept"), [({}, "True"), ({"MALLOC_TRIM_THRESHOLD_": "131072"}, "False")])
def test_the_memory_of_a_large_array_is_used_again_but_where_the_user_sets_malloc_up(own: dict, kept: str) -> None:
    rest = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    said = subprocess.run([sys.executable, "-c", FAULTS], env=rest | own, capture_output=True, text=True, check=True)
    assert said.stdout.strip() == kept
