"""A dataset from jobs file to index: what is made, kept, packed, refused and gone on with."""

from __future__ import annotations

import io
import json
import os
import signal
import tarfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pb4u.dataset import dataset_run
from pb4u.dataset.dataset_run import make_dataset
from pb4u.dataset.planning import footprints, plan_clips
from pb4u.errors import InputError, MissingExtraError, Pb4uError
from pb4u.jobs import job_folder
from pb4u.jobs.job import Failure, Made
from pb4u.jobs.worker_pool import LocalPool, RayPool, WorkerPool
from pb4u.measures.run_job import RunJob, attempt
from pb4u.run import ENTRIES, Run
from pb4u.scene.trajectory import Trajectory

parquet = pytest.importorskip("pyarrow.parquet", reason='needs the "dataset" extra')

SMALL = {"garment": "tshirt", "triangles": 1000, "frames": 2, "lead_in": 0, "model": "skinning"}
NOTED = "PB4U_TEST_CLIPS_BEGUN"
"""Names the file that workers note clips in."""


def runs(count: int = 3, **entries: Any) -> list[Run]:
    return [Run().with_entries({**SMALL, "seed": seed, **entries}, Path()) for seed in range(count)]


class Here(WorkerPool):
    """Does every job at once, in this process."""

    size = 1

    def __init__(self, attempt: Callable[[RunJob], Made | Failure]) -> None:
        self._attempt = attempt
        self.did: list[int] = []
        self._waiting: list[RunJob] = []

    def submit(self, job: RunJob) -> None:
        self._waiting.append(job)

    def next_outcome(self) -> tuple[RunJob, Made | Failure | None]:
        job = self._waiting.pop()
        self.did.append(job.run.seed)
        return job, self._attempt(job)

    def close(self) -> None:
        self._waiting.clear()


def make(
    wanted: list[Run],
    out: Path,
    attempt: Callable = attempt,
    clips_per_shard: int | None = None,
    **options: Any,
) -> tuple[dict, list[int], list[str]]:
    said: list[str] = []
    pool = Here(attempt)
    made = make_dataset(wanted, out, lambda: pool, clips_per_shard, say=said.append, **options)
    return made, pool.did, said


def quick(job: RunJob) -> Made | Failure:
    """Clips without a simulation: a few bytes, and the record that the index reads; seed 2 is refused."""
    if job.run.seed == 2:
        return Failure("It is refused.", "")
    return unsimulated(job)


def unsimulated(job: RunJob) -> Made:
    record = {**job.labels, "metrics": {}, "metrics_paper": {}, "garments": [], "diverged": False, "seconds": 2.0}
    return Made({**record, "bytes": 5, "frames": 2}, f"clip{job.run.seed}".encode())


def rows(out: Path) -> list[dict]:
    return parquet.read_table(out / "index.parquet").to_pylist()


def test_every_label_and_metric_is_in_the_index_and_the_clips_open(tmp_path: Path) -> None:
    outfit = {"garment": ["tanktop", "skirt"], "material": ["silk", "wool"], "body_shape": {"height": 0.7}}
    made, _, said = make([*runs(1), *runs(1, **outfit)], tmp_path / "set")
    assert (made["clips"], made["done"], made["failures"]) == (2, 2, [])
    one, two = rows(tmp_path / "set")
    assert (two["garment"], two["material"], two["body"], two["motion"]) == (
        "tanktop+skirt",
        "silk+wool",
        "woman",
        "walk",
    )
    assert (dict(two["body_shape"]), two["seed"], two["status"], two["failure"]) == ({"height": 0.7}, 0, "done", None)
    assert [each["density"] for each in two["garments"]] == pytest.approx([0.06, 0.28])
    for row in (one, two):
        trajectory = Trajectory.open(tmp_path / "set" / row["file"])
        assert trajectory.positions.shape == (2, row["vertices"], 3)
        record = json.loads((tmp_path / "set" / "jobs" / f"{row['key']}.json").read_text())["result"]
        for name, measured in record["metrics"].items():
            assert row[f"{name}_mean"] == measured["mean"]
            assert row[f"{name}_per_frame"] == measured["per_frame"]
        assert row["paper_total_max"] == record["metrics_paper"]["total"]["max"]
        assert row["strain_p95_mean"] > 0.0
    assert sum(each["vertices"] for each in two["garments"]) == two["vertices"]
    # Told before anything was made, and true.
    assert "2 clips take about" in said[1]
    on_disk = sum(file.stat().st_size for file in (tmp_path / "set").rglob("*") if file.name != "index.parquet")
    planned = sum(footprints(plan_clips([*runs(1), *runs(1, **outfit)], False, print)))
    assert planned == pytest.approx(on_disk, rel=0.05)


def test_the_index_has_every_entry_that_a_jobs_file_may_vary(tmp_path: Path) -> None:
    varied = {"tacks": [[1, 2]], "tucked": True, "passes": 2, "keep_lead_in": True, "recorded_fps": 60.0}
    make([*runs(1), *runs(1, **varied)], tmp_path / "set", quick)
    plain, told = rows(tmp_path / "set")
    assert (told["tacks"], told["tucked"]) == ([[[1, 2]]], [True])
    for name in ("passes", "keep_lead_in", "recorded_fps"):
        assert told[name] == varied[name] != plain[name]
    named = {"garment": "garments", "triangles": "triangles_asked", "frames": "frames_asked"}
    assert {named.get(name, name) for name in ENTRIES} <= plain.keys()


def test_another_jobs_file_adds_its_clips_to_the_index(tmp_path: Path) -> None:
    make(runs(2), tmp_path / "set", quick, 2)
    make(runs(1, garment="skirt"), tmp_path / "set", quick, 2)
    kept = rows(tmp_path / "set")
    assert [(row["garment"], row["status"]) for row in kept] == [("skirt", "done"), *[("tshirt", "done")] * 2]
    assert all(row["file"].endswith(".tar") and row["member"] for row in kept[1:])
    make(runs(2), tmp_path / "set", quick, 2)
    assert [row["garment"] for row in rows(tmp_path / "set")] == ["tshirt", "tshirt", "skirt"]


def test_files_of_one_stem_and_what_is_in_them_are_told_apart_in_the_index(tmp_path: Path) -> None:
    def cloth(place: str, density: float) -> str:
        file = tmp_path / place
        file.parent.mkdir(parents=True, exist_ok=True)
        cloth = {"density": density, "lame_mu": 3e4, "lame_lambda": 4e4, "bending": 2e-5}
        file.write_text(json.dumps(cloth))
        return str(file)

    places = ("mill/3/felt.json", "mill/8/felt.json", "mill/8/jute.json")
    wanted = [run for at, each in enumerate(places) for run in runs(1, material=cloth(each, 0.1 + 0.1 * at))]
    make(wanted, tmp_path / "set", quick)
    assert [row["material"] for row in rows(tmp_path / "set")] == ["3/felt.json", "8/felt.json", "jute"]
    job = RunJob(replace(wanted[0], motion="wham.pkl:3"), contents=(("wham.pkl:3", "wham.pkl", "digest"),))
    assert job.labels["motion"] == "wham:3"


def test_half_precision_is_half_the_size_and_good_to_a_quarter_of_a_millimetre(tmp_path: Path) -> None:
    make(runs(1, motion="run", lead_in=10), tmp_path / "full")
    make(runs(1, motion="run", lead_in=10), tmp_path / "half", half=True)
    (full,), (half,) = rows(tmp_path / "full"), rows(tmp_path / "half")
    assert half["key"] != full["key"]
    one, other = (Trajectory.open(tmp_path / name / row["file"]) for name, row in (("full", full), ("half", half)))
    moving = sum(getattr(one, name).nbytes for name in ("positions", "velocities", "body_positions"))
    assert full["bytes"] - half["bytes"] == pytest.approx(moving / 2, rel=0.01)
    for name in ("positions", "body_positions"):
        assert np.abs(getattr(one, name) - getattr(other, name)).max() < 0.25e-3
    np.testing.assert_allclose(other.velocities, one.velocities, rtol=6e-4, atol=1e-6)
    planned = footprints(plan_clips(runs(1, motion="run", lead_in=10), True, print))[0]
    assert planned == pytest.approx(half["bytes"], rel=0.05)


def test_a_run_goes_on_with_what_is_missing_and_grows_with_its_file(tmp_path: Path) -> None:
    out = tmp_path / "set"
    made, did, said = make(runs(4), out, quick)
    assert (did, made["done"], [each["sentence"] for each in made["failures"]]) == ([0, 1, 2, 3], 3, ["It is refused."])
    assert [row["status"] for row in rows(out)] == ["done", "done", "failed", "done"]
    assert rows(out)[2]["failure"] == "It is refused."
    (out / rows(out)[1]["file"]).unlink()
    half = out / "jobs" / f"{rows(out)[3]['key']}.json"
    half.write_bytes(half.read_bytes()[:-9])
    _, did, said = make(runs(5), out, quick)
    assert did == [1, 3, 4]
    assert said[0] == "5 clips, 1 done before, 3 to do, 1 failed before and are skipped (--retry tries them again)."
    planned, did, _ = make(runs(5), out, quick, retry=True, plan_only=True)
    assert (did, len(planned["failures"])) == ([], 1)
    made, did, _ = make(runs(5), out, lambda job: quick(plan_clips(runs(1), False, print)[0]), retry=True)
    assert (did, made["failures"], made["done"]) == ([2], [], 5)


def test_one_clip_described_twice_is_made_once(tmp_path: Path) -> None:
    made, did, said = make([*runs(2), *runs(2)], tmp_path / "set", quick)
    assert (did, made["clips"]) == ([0, 1], 2)
    assert said[0] == "2 of 4 clips are described twice; each is made once."


def test_shards_hold_every_clip_once_with_its_record(tmp_path: Path) -> None:
    out = tmp_path / "set"
    make(runs(6), out, quick, 2)
    assert list((out / "clips").iterdir()) == []
    shards = sorted((out / "shards").iterdir())
    assert [shard.name for shard in shards] == ["shard-00000.tar", "shard-00001.tar", "shard-00002.tar"]
    found = {}
    for shard in shards:
        with tarfile.open(shard) as archive:
            names = archive.getnames()
            # Files of one clip stand beside each other, as WebDataset wants them.
            assert [name.partition(".")[0] for name in names[::2]] == [name.partition(".")[0] for name in names[1::2]]
            for name in names:
                assert name not in found
                found[name] = archive.extractfile(name).read()  # type: ignore[union-attr]
    done = [row for row in rows(out) if row["status"] == "done"]
    assert len(found) == 2 * len(done) == 10
    for row in done:
        assert found[row["member"]] == f"clip{row['seed']}".encode()
        assert json.loads(found[row["key"] + ".json"])["seed"] == row["seed"]
        with tarfile.open(out / row["file"]) as archive:
            assert row["member"] in archive.getnames()
    kept = {shard.name: shard.read_bytes() for shard in shards}
    _, did, _ = make(runs(7), out, quick, 2)
    assert did == [6]
    assert {shard.name: shard.read_bytes() for shard in shards} == kept
    assert [row["file"] for row in rows(out)][-1] == "shards/shard-00003.tar"


def test_a_kill_while_shards_are_written_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "set"

    def killed(written: Path, path: Path) -> None:
        if path.name == "shard-00001.tar":
            raise KeyboardInterrupt
        os.replace(written, path)

    monkeypatch.setattr("pb4u.dataset.dataset_folder.move_into_place", killed)
    with pytest.raises(Pb4uError, match="5 of 6 clips"):
        make(runs(6), out, quick, 2)
    monkeypatch.undo()
    assert len(list((out / "clips").iterdir())) == 3
    # As a kill between a shard and the removal of what it holds leaves it.
    with tarfile.open(out / "shards" / "shard-00000.tar") as archive:
        name = archive.getnames()[0]
        (out / "clips" / name).write_bytes(archive.extractfile(name).read())  # type: ignore[union-attr]
    made, did, _ = make(runs(6), out, quick, 2)
    assert (did, made["done"]) == ([], 5)
    members = Counter()
    for shard in (out / "shards").iterdir():
        with tarfile.open(shard) as archive:
            members.update(archive.getnames())
    assert set(members.values()) == {1}
    assert len(members) == 10
    assert list((out / "clips").iterdir()) == []


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_nothing_is_made_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NOTED, str(tmp_path / "begun"))

    out = tmp_path / "set"
    made = make_dataset(runs(3, triangles=400, frames=1), out, lambda: LocalPool(2, dies_once))
    assert (made["done"], made["failures"]) == (3, [])
    begun = Counter((tmp_path / "begun").read_text().split())
    assert begun == {"0": 1, "1": 2, "2": 1}
    assert len(list((out / "clips").iterdir())) == 3
    simulated, *others = [out / row["file"] for row in rows(out)]
    assert Trajectory.open(simulated).metadata["seed"] == 0
    assert [path.read_bytes() for path in others] == [b"clip1", b"clip2"]


@pytest.mark.slow
def test_a_request_to_end_is_answered_as_before_while_ray_works_and_after() -> None:
    pytest.importorskip("ray", reason='needs the "ray" extra')
    asked: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    try:
        pool = RayPool("local", attempt)
        os.kill(os.getpid(), signal.SIGTERM)
        pool.close()
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert asked == [signal.SIGTERM] * 2


def dies_once(job: RunJob) -> Made | Failure:
    """A worker that is killed over seed 1, the first time; only seed 0 is simulated, which is slow in a new worker."""
    begun = Path(os.environ[NOTED])
    seed = str(job.run.seed)
    first = seed not in (begun.read_text().split() if begun.exists() else ())
    with begun.open("a") as stream:
        stream.write(seed + "\n")
    if seed == "1" and first:
        os.kill(os.getpid(), signal.SIGKILL)
    return attempt(job) if seed == "0" else unsimulated(job)


def test_an_interrupt_keeps_what_is_done(tmp_path: Path) -> None:
    def interrupted(job: RunJob) -> Made | Failure:
        if job.run.seed == 1:
            raise KeyboardInterrupt
        return quick(job)

    with pytest.raises(Pb4uError, match="1 of 3 clips"):
        make(runs(3), tmp_path / "set", interrupted)
    assert make(runs(3), tmp_path / "set", quick)[1] == [1, 2]


def test_two_runs_on_one_folder_are_told_apart(tmp_path: Path) -> None:
    def second(job: RunJob) -> Made | Failure:
        with pytest.raises(InputError, match="Another process is at work in"):
            make(runs(1), tmp_path / "set", quick)
        return quick(job)

    assert make(runs(1), tmp_path / "set", second)[0]["done"] == 1


def test_a_disk_that_is_too_small_is_refused_before_and_a_full_one_on_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset_run.shutil, "disk_usage", lambda path: SimpleNamespace(free=65 * 2**20))
    with pytest.raises(InputError, match=r"[\d.]+ MB.* 68\.2 MB free"):
        make(runs(3, frames=60), tmp_path / "set", quick)
    assert not list(tmp_path.glob("set/clips/*"))
    monkeypatch.undo()

    def full(path: Path, content: bytes) -> None:
        if path.suffix == ".npz":
            raise OSError(28, "No space left on device")
        job_folder_write(path, content)

    job_folder_write = job_folder.replace_file
    monkeypatch.setattr(job_folder, "replace_file", full)
    with pytest.raises(Pb4uError, match="No space left"):
        make(runs(3), tmp_path / "set", quick)


def test_only_planned_nothing_is_made(tmp_path: Path) -> None:
    made, did, said = make(runs(3), tmp_path / "set", quick, plan_only=True)
    assert (did, made["done"]) == ([], 0)
    assert "3 clips take about" in said[1]
    assert make(runs(3), tmp_path / "set", quick)[1] == [0, 1, 2]


def test_other_folders_layouts_and_precisions_are_refused(tmp_path: Path) -> None:
    make(runs(1), tmp_path / "set", quick)
    with pytest.raises(InputError, match="format folder, not webdataset"):
        make(runs(1), tmp_path / "set", quick, 2)
    with pytest.raises(InputError, match="precision full, not half"):
        make(runs(1), tmp_path / "set", quick, half=True)
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("...")
    with pytest.raises(InputError, match="is not a folder of a dataset"):
        make(runs(1), tmp_path / "thesis", quick)


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"garment": "tshrt"}, "no garment 'tshrt'; did you mean tshirt"),
        ({"garment": "absent.obj"}, "no garment file absent.obj"),
        ({"motion": "wlak"}, "no motion 'wlak'; did you mean walk"),
        ({"motion": "absent.amc"}, "no motion file absent.amc"),
        ({"body": "wman"}, "did you mean woman"),
        ({"material": "sillk"}, "did you mean silk"),
        ({"model": "pb4u-smal"}, "no model 'pb4u-smal'"),
    ],
)
def test_names_that_are_not_there_are_refused_before_any_work(tmp_path: Path, entries: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make(runs(2, **entries), tmp_path / "set", quick)


def test_a_clip_that_cannot_be_made_is_a_sentence(tmp_path: Path) -> None:
    made, _, _ = make(runs(1, triangles=10), tmp_path / "set")
    (failure,) = made["failures"]
    assert "A built-in garment has between 200 and 200000 triangles, not 10" in failure["sentence"]
    assert rows(tmp_path / "set")[0]["failure"] == failure["sentence"]


def test_clips_belong_to_the_content_of_their_files(tmp_path: Path) -> None:
    def planned(folder: str, density: float) -> RunJob:
        file = tmp_path / folder / "felt.json"
        file.parent.mkdir(exist_ok=True)
        cloth = {"density": density, "lame_mu": 3e4, "lame_lambda": 4e4, "bending": 2e-5}
        file.write_text(json.dumps(cloth))
        return plan_clips([Run().with_entries({**SMALL, "material": str(file)}, Path())], False, print)[0]

    here, there = planned("here", 0.2), planned("there", 0.2)
    assert here.key == there.key
    assert planned("there", 0.3).key != here.key
    changed = attempt(there)
    assert isinstance(changed, Failure)
    assert "changed after the run was planned" in changed.sentence


@pytest.mark.parametrize(
    "other",
    [{"seed": 1}, {"frames": 3}, {"triangles": 300}, {"garment": "skirt"}, {"model": "solver"}, {"pins": "hem"}],
)
def test_other_work_has_another_address(other: dict) -> None:
    def key(**entries: Any) -> str:
        return plan_clips([Run().with_entries({**SMALL, **entries}, Path())], False, print)[0].key

    assert key() == key()
    assert key(**other) != key()


def test_the_index_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingExtraError, match=r'"dataset" extra'):
        make(runs(1), tmp_path / "set", quick)


def test_pandas_and_duckdb_read_the_index(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    duckdb = pytest.importorskip("duckdb")
    make(runs(4), tmp_path / "set", quick)
    index = tmp_path / "set" / "index.parquet"
    frame = pandas.read_parquet(index)
    assert frame.status.value_counts().to_dict() == {"done": 3, "failed": 1}
    query = f"select garment, count(*), sum(bytes) from '{index}' where status = 'done' group by garment"
    assert duckdb.sql(query).fetchall() == [("tshirt", 3, 15)]
    assert io.BytesIO(index.read_bytes()).read(4) == b"PAR1"


def test_a_clip_without_a_motion_is_labelled_with_what_the_body_performs(tmp_path: Path) -> None:
    made, _, said = make([*runs(1), *runs(1, motion="walk")], tmp_path / "set", quick)
    assert (made["clips"], [row["motion"] for row in rows(tmp_path / "set")]) == (1, ["walk"])
    assert any("described twice" in sentence for sentence in said)


def test_diverged_clips_and_notes_are_summed(tmp_path: Path) -> None:
    def noted(job: RunJob) -> Made:
        made = quick(job)
        assert isinstance(made, Made)
        seed = job.run.seed
        notes = [f"{seed} of 4 vertices were moved."] + ["It rained."] * (seed == 1)
        return Made({**made.result, "diverged": seed == 1, "notes": notes}, made.trajectory)

    made, _, _ = make(runs(2), tmp_path / "set", noted)
    assert made["diverged"] == 1
    assert [each["clips"] for each in made["notes"]] == [2, 1]
    assert made["notes"][1]["sentence"] == "It rained."


def test_a_refusal_names_file_and_clip(tmp_path: Path) -> None:
    told = r"^jobs\.toml: clip 2 \(tshirt in linnen, model = skinning\): There is no material .linnen."
    with pytest.raises(InputError, match=told):
        make([*runs(1), *runs(1, material="linnen")], tmp_path / "set", quick, jobs_file="jobs.toml")
