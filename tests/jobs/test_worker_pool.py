"""Who does the rollouts: a worker that dies costs nothing but time, and nothing is done twice."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.paper.quick_rollouts import attempt, job, note, noted

from pb4u.errors import InputError, MissingExtraError
from pb4u.jobs.job import JobPack
from pb4u.jobs.job_folder import MOST_TRIES, JobFolder
from pb4u.jobs.worker_pool import LocalPool, RayPool, WorkerPool
from pb4u.measures.run_job import RunJob


def local() -> WorkerPool:
    return LocalPool(2, attempt)


def ray() -> WorkerPool:
    pytest.importorskip("ray", reason='needs the "ray" extra')
    return RayPool("local", attempt, 2)


@pytest.fixture(params=[local, pytest.param(ray, marks=pytest.mark.slow)], ids=["processes", "ray"])
def pool(request: pytest.FixtureRequest) -> Iterator[WorkerPool]:
    made = request.param()
    yield made
    made.close()


def test_dying_workers_lose_nothing_and_nothing_is_done_twice(pool: WorkerPool, tmp_path: Path) -> None:
    log = tmp_path / "log"
    good = [job(name, log) for name in ("a", "dies-once", "b", "c", "meets-1", "meets-2")]
    refused, poison = job("refused", log), job("dies", log)
    seen: list[tuple[int, int]] = []
    with JobFolder(tmp_path / "run", "an evaluation", {}) as folder:
        folder.work_through([*good, refused, poison], pool, lambda done, total: seen.append((done, total)))
        results = {str(each.run.motion): folder.result(each) for each in good}
        refusal, given_up = folder.failure(refused), folder.failure(poison)

    assert {motion: result["motion"] for motion, result in results.items() if result} == {n: n for n in results}
    assert refusal is not None
    assert refusal.sentence == "It is refused."
    assert given_up is not None
    assert f"died {MOST_TRIES} times" in given_up.sentence
    lines = noted(log)
    assert {motion: lines[f"end {motion}"] for motion in results} == dict.fromkeys(results, 1)
    begun = {name: lines[f"begin {name}"] for name in (*results, "refused", "dies")}
    assert begun == {**dict.fromkeys(results, 1), "dies-once": 2, "refused": 1, "dies": MOST_TRIES}
    assert seen == [(done, 8) for done in range(9)]
    workers = {motion: result["worker"] for motion, result in results.items() if result}
    assert os.getpid() not in workers.values()
    assert workers["meets-1"] != workers["meets-2"]


def attempt_pack(work: RunJob | JobPack) -> object:
    return [attempt(each) for each in work.jobs] if isinstance(work, JobPack) else attempt(work)


def test_the_jobs_of_a_pack_are_kept_singly_and_done_alone_where_one_ends_the_worker(tmp_path: Path) -> None:
    log = tmp_path / "log"
    jobs = {name: job(name, log) for name in ("a", "b", "refused", "c", "dies")}
    packs = [JobPack(tuple(jobs[name] for name in names)) for names in (("a", "b", "refused"), ("c", "dies"))]
    seen: list[tuple[int, int]] = []
    pool = LocalPool(1, attempt_pack)
    try:
        with JobFolder(tmp_path / "run", "a dataset", {}) as folder:
            folder.work_through(packs, pool, lambda done, total: seen.append((done, total)))
            done = {name for name, each in jobs.items() if folder.result(each) is not None}
            failures = {name: folder.failure(each) for name, each in jobs.items() if folder.failure(each)}
    finally:
        pool.close()
    assert done == {"a", "b", "c"}
    assert {name: failure.sentence for name, failure in failures.items() if failure} == {
        "refused": "It is refused.",
        "dies": f"Its worker died {MOST_TRIES} times, for want of memory perhaps; try fewer --workers.",
    }
    assert noted(log)["begin c"] == 2
    assert seen == [(0, 5), (3, 5), (4, 5), (5, 5)]


def test_an_idle_worker_that_died_is_replaced(tmp_path: Path) -> None:
    pool = LocalPool(1, attempt)
    try:
        pool.submit(job("a", tmp_path / "log"))
        assert pool.next_outcome()[0].run.motion == "a"
        (worker,) = pool._idle
        worker.process.kill()
        worker.process.join()
        with JobFolder(tmp_path / "run", "an evaluation", {}) as folder:
            folder.work_through([job("b", tmp_path / "log")], pool, lambda done, total: None)
            assert folder.result(job("b", tmp_path / "log")) is not None
    finally:
        pool.close()


def never_ends(asked: RunJob) -> None:
    note(Path(str(asked.run.body)), str(os.getpid()))
    time.sleep(600)


def wait_until(met: Callable[[], bool]) -> None:
    until = time.monotonic() + 30
    while not met():
        assert time.monotonic() < until, "it did not happen within 30 s"
        time.sleep(0.02)


def test_dismissed_workers_are_gone(tmp_path: Path) -> None:
    log = tmp_path / "log"
    pool = LocalPool(1, never_ends)  # type: ignore[arg-type]
    pool.submit(job("a", log))
    wait_until(log.exists)
    pool.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int(next(iter(noted(log)))), 0)


def test_impossible_pools_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="1 or more, not 0"):
        LocalPool(0, attempt)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r'"ray" extra'):
        RayPool("auto", attempt)


@pytest.mark.slow
def test_an_address_without_a_cluster_is_refused() -> None:
    pytest.importorskip("ray", reason='needs the "ray" extra')
    for address in ("auto", "127.0.0.1:1", "ray://127.0.0.1:1", "127.0.0.1:many"):
        with pytest.raises(InputError, match=f"No Ray cluster can be reached at {address}"):
            RayPool(address, attempt)
