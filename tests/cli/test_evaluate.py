"""`pb4u evaluate`: a run that can stop at any instant, and how it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

TINY = (
    "--models", "skinning", "--garments", "tshirt", "--levels", 400, "--frames", 2, "--lead-in", 0,
    "--floors", "stored",
)  # fmt: skip


def results_in(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("jobs/*.json")}


@pytest.mark.slow
def test_killed_in_mid_run_it_goes_on_where_it_was(pb4u: Callable, tmp_path: Path) -> None:
    out = tmp_path / "run"
    call = ("evaluate", *TINY, "--motions", "walk,jump,turn,dance", "--out", out)
    command = [sys.executable, "-c", "from pb4u.cli.main import main; main()", *map(str, call)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
    until = time.monotonic() + 120
    while not results_in(out):
        assert time.monotonic() < until
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    before = results_in(out)
    assert 1 <= len(before) < 4
    assert not (out / "tables.md").exists()

    ended = pb4u(*call, "--plots", tmp_path / "plots", "--json", tmp_path / "r.json")
    assert ended.code == 0, ended.err
    assert f"4 rollouts, {len(before)} done before, {4 - len(before)} to do." in ended.err
    assert ended.out == f"Report: {out / 'tables.md'}\n"
    assert before.items() <= results_in(out).items()
    results = json.loads((tmp_path / "r.json").read_text())
    assert results == {**json.loads((out / "results.json").read_text()), "notes": results["notes"]}
    assert [row["motion"] for row in results["rollouts"]] == ["walk", "jump", "turn", "dance"]
    assert all(row["result"]["frames"] == 2 for row in results["rollouts"])
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"picture_grid.png", "stretch_over_time.png"}

    other = pb4u("evaluate", *TINY, "--protocol", "ablation", "--out", out)
    assert other.code == 1
    assert "holds an evaluation with protocol resolution, not ablation" in other.err


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--protocol", "resolutions"), "did you mean resolution"),
        (("--models", "absent.safetensors"), "no model file absent.safetensors"),
        (("--models", "pb4u-smal"), "There is no model 'pb4u-smal'"),
        (("--motions", "wlak"), "did you mean walk"),
        (("--motions", "07_02"), "--recordings"),
        (("--levels", "12Q"), "no level '12Q'"),
        (("--propagation-steps", "5,many"), "not 'many'"),
        (("--workers", 0), "1 or more, not 0"),
        (("--refine", -1), "0 or more, not -1"),
        (("--json", "absent/r.json"), "does not exist"),
    ],
)
def test_bad_values_are_refused_in_one_sentence(
    pb4u: Callable, tmp_path: Path, flags: tuple[object, ...], says: str
) -> None:
    ended = pb4u("evaluate", *TINY, *flags, "--out", tmp_path / "run")
    assert ended.code == 1
    (line,) = ended.err.strip().splitlines()
    assert line.startswith("pb4u: ")
    assert says in line
    assert list(tmp_path.iterdir()) == []


def test_failed_rollouts_end_with_1_and_their_sentence(pb4u: Callable, tmp_path: Path) -> None:
    broken = tmp_path / "broken.obj"
    broken.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    ended = pb4u("evaluate", *TINY, "--motions", "walk", "--garments", broken, "--out", tmp_path / "run")
    assert ended.code == 1
    assert (
        "1 of 1 rollouts failed; the first: broken in default on woman, walk, seed 2000, 400 triangles, by skinning:"
        in ended.err
    )
    assert "Traceback" not in ended.err
    assert (tmp_path / "run" / "tables.md").exists()


def test_plots_may_stay_where_they_are_and_a_file_is_no_folder(pb4u: Callable, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    ended = pb4u("evaluate", *TINY, "--motions", "walk", "--out", tmp_path / "run", "--plots", tmp_path / "taken")
    assert (ended.code, "--plots writes a folder" in ended.err, (tmp_path / "run").exists()) == (1, True, False)
    plots = tmp_path / "run" / "plots"
    ended = pb4u("evaluate", *TINY, "--motions", "walk", "--out", tmp_path / "run", "--plots", plots)
    assert ended.code == 0, ended.err
    assert any(plots.iterdir())
