"""A first run's kernels are compiled by other processes, from a list of what runs need."""

import json
import os
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from pb4u.collision import compile_ahead
from pb4u.collision.kernel_cache import KERNELS
from pb4u.collision.kernel_list import kernel_name, line_of, listed_kernels, signature_of

FIRST_KERNEL = """
import json
from pb4u.collision.compile_ahead import _program, compile_ahead
from pb4u.collision.kernel_cache import KERNELS
from pb4u.collision.kernel_list import kernel_name, listed_kernels, signature_of
name, signature = signature_of(listed_kernels()[0])
compile_ahead()
kernel, = [kernel for kernel in KERNELS if kernel_name(kernel) == name]
kernel.compile(signature)
compile_ahead()
print(json.dumps([kernel.stats.cache_hits[signature], _program._process.pid]))
"""
UNLISTED = """
import json, sys
from pb4u.cli.main import main
from pb4u.collision.kernel_cache import KERNELS
from pb4u.collision.kernel_list import line_of, listed_kernels
sys.argv = ["pb4u", "simulate", "--triangles", "400", "--frames", "2", "--lead-in", "1", "--out", sys.argv[1]]
try:
    main()
except SystemExit as ended:
    assert not ended.code
used = {line_of(kernel, signature) for kernel in KERNELS for signature in kernel.signatures}
print(json.dumps([len(used), sorted(used - {None, *listed_kernels()})]))
"""


def _printed(script, *arguments, **surroundings):
    command = [sys.executable, "-c", script, *arguments]
    ended = subprocess.run(command, env={**os.environ, **surroundings}, capture_output=True, text=True, check=True)
    return json.loads(ended.stdout.splitlines()[-1])


def test_each_line_is_of_one_kernel_and_says_what_it_takes() -> None:
    for line in listed_kernels():
        name, signature = signature_of(line)
        named = [kernel for kernel in KERNELS if kernel_name(kernel) == name]
        assert [line_of(kernel, signature) for kernel in named] == [line]


def test_the_list_has_what_a_run_calls(tmp_path) -> None:
    used, unlisted = _printed(UNLISTED, str(tmp_path / "clip.npz"))
    assert used > 30
    assert unlisted == [], "python tools/list_kernels.py writes the list again"


def test_nothing_is_started_where_most_kernels_are_kept(monkeypatch) -> None:
    kernels = [SimpleNamespace(_cache=SimpleNamespace(is_kept=number > 0)) for number in range(3)]
    monkeypatch.setattr(compile_ahead, "KERNELS", kernels)
    program = compile_ahead._Program()
    program.start()
    assert not program.is_running


@pytest.mark.skipif(sys.platform == "win32", reason="a process of Windows cannot be asked whether it runs")
def test_a_first_run_waits_for_what_others_compile_and_they_end_with_it(tmp_path) -> None:
    hits, process = _printed(FIRST_KERNEL, NUMBA_CACHE_DIR=str(tmp_path))
    assert hits == 1
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("It compiles on although the run has ended.")
    assert len(list((tmp_path / "kernels").glob("*.nbi"))) < len(listed_kernels())
