"""`pb4u batch`: what it says and how it ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.dataset.test_dataset_run import Here

pytest.importorskip("pyarrow", reason='needs the "dataset" extra')

SMALL = '[fixed]\nmodel = "skinning"\ntriangles = 1000\nframes = 2\nlead_in = 0\n'


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Writes a jobs file; workers are this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pb4u.jobs.worker_pool.LocalPool", lambda workers, attempt: Here(attempt))

    def write(text: str) -> Path:
        (tmp_path / "jobs.toml").write_text(text)
        return Path("jobs.toml")

    return write


def test_a_dataset_is_planned_made_and_told(pb4u: Callable, jobs: Callable[[str], Path]) -> None:
    file = jobs(SMALL + "[product]\nseed = { first = 0, count = 2 }\n")
    planned = pb4u("batch", file, "--out", "set", "--plan")
    assert planned.code == 0, planned.err
    assert "2 clips take about" in planned.err
    assert planned.out == ""
    made = pb4u("batch", file, "--out", "set", "--json", "-")
    assert made.code == 0, made.err
    told = json.loads(made.out)
    assert (told["clips"], told["done"], told["failures"]) == (2, 2, [])
    assert told["bytes"] == sum(clip.stat().st_size for clip in Path("set/clips").iterdir())
    again = pb4u("batch", file, "--out", "set")
    assert "2 done before, 0 to do" in again.err
    assert again.out.startswith("2 of 2 clips, ")


def test_failed_clips_are_listed_and_end_with_1(pb4u: Callable, jobs: Callable[[str], Path]) -> None:
    ended = pb4u("batch", jobs(SMALL.replace("1000", "10") + "[[clips]]\n"), "--out", "set")
    assert ended.code == 1
    assert (
        "failed: tshirt in default on woman, walk, seed 0, 10 triangles, by skinning: A built-in garment has"
        in ended.err
    )
    assert ended.err.splitlines()[-1].startswith("pb4u: 1 of 1 clips failed; the index lists them")


@pytest.mark.parametrize(
    ("text", "flags", "says"),
    [
        ("[fixed]\ngarmet = 'dress'\n[[clips]]\n", (), "[fixed] has no entry 'garmet'; did you mean garment"),
        (
            "[product]\nseed = { first = 0, count = 1000000 }\n",
            (),
            "describes 1,000,000 clips; a data set has at most 100,000",
        ),
        ("[product]\nseed = [0, 1, 2]\n", ("--most-clips", 2), "describes 3 clips; a data set has at most 2"),
        ("[[clips]]\n", ("--workers", 0), "workers must be 1 or more"),
        ("[[clips]]\n", ("--format", "webdataset", "--clips-per-shard", 0), "A shard must have 1 clip or more"),
        ("[[clips]]\n", ("--json", "jobs.toml"), "--json jobs.toml would overwrite jobs.toml"),
    ],
)
def test_bad_input_is_one_sentence(
    pb4u: Callable, jobs: Callable[[str], Path], text: str, flags: tuple, says: str
) -> None:
    ended = pb4u("batch", jobs(text), "--out", "set", *flags)
    assert ended.code == 1
    (sentence,) = ended.err.splitlines()
    assert says in sentence
    assert not Path("set").exists()


def test_help_keeps_brackets(pb4u: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    told = pb4u("batch", "--help").out
    assert all(section in told for section in ("[fixed]", "[product]", "[[clips]]"))


def test_a_broken_jobs_file_is_named_once(pb4u: Callable, jobs: Callable[[str], Path]) -> None:
    ended = pb4u("batch", jobs("[fixed"), "--out", "set")
    assert ended.err.count("jobs.toml") == 1
    assert "cannot be read as TOML" in ended.err


def test_diverged_clips_are_told_at_the_end(pb4u: Callable, jobs: Callable[[str], Path], monkeypatch) -> None:
    from pb4u.measures import run_report

    measured = run_report.measure
    monkeypatch.setattr(run_report, "measure", lambda *given: {**measured(*given), "diverged": True})
    ended = pb4u("batch", jobs(SMALL + "[[clips]]\n"), "--out", "set")
    assert "warning: 1 of 1 clips diverged" in ended.err
