"""A result's address: the same for the same work, another for any other; and what is measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.body.characters import write_doll

from pb4u.dataset.planning import footprints, together
from pb4u.jobs import job_folder
from pb4u.jobs.job import Failure, JobPack, jobs_of
from pb4u.measures import run_job
from pb4u.measures.job_planner import JobPlanner
from pb4u.measures.run_job import MOST_TOGETHER, RunJob, attempt, make
from pb4u.paper.protocol_plan import ALONE
from pb4u.physics.time_step import DivergedError
from pb4u.run import Run, WornGarment
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.stepwise_simulator import NetworkSimulator

RUN = Run((WornGarment("tshirt", triangles=400),), motion="walk", frames=3, model="solver", seed=2000, device="cpu")
JOB = RunJob(RUN)


@pytest.mark.parametrize(
    "other",
    [
        *(
            replace(JOB, run=RUN.with_entries(change))
            for change in (
                {"garment": "dress"}, {"body": "man"}, {"motion": "jump"}, {"seed": 2001}, {"triangles": 401},
                {"frames": 4}, {"lead_in": 0}, {"material": "silk"}, {"body_shape": {"height": 0.5}},
                {"propagation_steps": 3}, {"refine": 1}, {"contact": False}, {"self_contact": True}, {"device": "cuda"},
                {"model": "skinning"},
            )
        ),
        replace(JOB, excess=True),
        replace(JOB, weights="digest"),
        replace(JOB, keep="half"),
    ],
)  # fmt: skip
def test_other_work_has_another_address(other: RunJob) -> None:
    assert other.key != JOB.key


def test_the_name_in_tables_is_no_part_of_the_address() -> None:
    assert replace(JOB, label="ours").key == JOB.key


def test_versions_change_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    before = replace(JOB).key
    monkeypatch.setattr(run_job, "FOLDER_VERSION", job_folder.FOLDER_VERSION + 1)
    raised = replace(JOB).key
    monkeypatch.setattr(run_job, "__version__", "99.0")
    assert len({before, raised, replace(JOB).key}) == 3


def test_a_file_counts_by_its_content_and_not_by_its_place(tmp_path: Path) -> None:
    def on(folder: str, content: str) -> str:
        file = tmp_path / folder / "07_02.amc"
        file.parent.mkdir(exist_ok=True)
        file.write_text(content)
        return JobPlanner().job(replace(RUN, motion=str(file))).key

    assert on("here", "one") == on("there", "one")
    assert on("here", "one") != on("there", "two")


@pytest.mark.parametrize(
    ("entry", "file", "named"),
    [
        ("garment", "g.pkl", (":tshirt", ":dress", ":dress/level2", ":dress@73", ":dress@74")),
        ("motion", "wham.pkl", ("", ":0", ":1")),
    ],
)
def test_what_a_file_holds_counts_beside_its_content(
    entry: str, file: str, named: tuple[str, ...], tmp_path: Path
) -> None:
    """Garments, levels, centres and persons of one file are other work; the place of the file is not."""

    def on(folder: str, name: str) -> str:
        path = tmp_path / folder / file
        path.parent.mkdir(exist_ok=True)
        path.write_text("one")
        return JobPlanner().job(RUN.with_entries({entry: f"{path}{name}"})).key

    keys = [on("here", name) for name in named]
    assert len(set(keys)) == len(named)
    assert keys == [on("there", name) for name in named]


def test_a_job_names_itself_in_plain_words() -> None:
    job = RunJob(replace(RUN, propagation_steps=5), "best")
    assert str(job) == "tshirt in default on woman, walk, seed 2000, 400 triangles, by best, K 5"


def test_excess_is_measured_on_states_that_all_models_share() -> None:
    def metrics(model: str) -> dict:
        run = replace(RUN, **{**ALONE, "model": model, "frames": 4, "lead_in": 2})
        return make(RunJob(run, keep="stills", excess=True)).result["metrics"]

    start, descent = metrics("warm-start"), metrics("gradient-descent")
    assert start["excess_height"]["states"] == descent["excess_height"]["states"] == 1
    assert 0.0 < descent["excess_height"]["mean"] < start["excess_height"]["mean"]
    assert len(start["distance_to_reference"]["per_frame"]) == 4
    assert 0.0 < start["distance_to_reference"]["mean"] < 0.2


def test_a_rollout_lost_in_the_lead_in_has_an_excess_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(state: State) -> State:
        if state.frame == 1:
            raise DivergedError(state.frame, "it is told to")
        return state

    run = replace(RUN, **{**ALONE, "model": "gradient-descent", "frames": 4, "lead_in": 2})
    monkeypatch.setattr("pb4u.simulation.stepwise_simulator.require_finite", breaks)
    lost = make(RunJob(run, keep="stills", excess=True)).result
    assert (lost["frames"], lost["failed_at"] is None) == (0, False)
    assert lost["metrics"]["excess_height"]["states"] == 1


def test_jobs_of_a_pack_have_the_results_of_each_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Steps as on a card, on a processor; a job that cannot be built fails by itself."""
    monkeypatch.setattr(NetworkSimulator, "on_card", True)
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda device: (10**10, 10**11))
    packed, simulated = [], NetworkSimulator.together
    monkeypatch.setattr(NetworkSimulator, "together", lambda *given: packed.append(len(given[1])) or simulated(*given))
    bare = replace(RUN, **ALONE, model="pb4u-small", lead_in=2)
    jobs = [JobPlanner().job(run) for run in (bare, replace(bare, motion="jump", frames=4))]
    lost = replace(jobs[0], run=replace(jobs[0].run, garments=(WornGarment("tshirt", material="absent.toml"),)))
    *together, failure = attempt(JobPack((*jobs, lost)))  # type: ignore[misc]
    assert packed == [2]
    assert isinstance(failure, Failure)
    for job, one in zip(jobs, together, strict=True):
        alone = make(job)
        assert one.result["notes"] == alone.result["notes"]
        read = []
        for made in (one, alone):
            (tmp_path / "one.npz").write_bytes(made.trajectory or b"")
            read.append(Trajectory.open(tmp_path / "one.npz").positions)
        assert len(read[0]) == job.run.frames
        np.testing.assert_allclose(*read, rtol=0, atol=1e-5)


def test_what_a_card_takes_whole_is_packed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr(NetworkSimulator, "__init__", lambda self, *given, **more: None)
    monkeypatch.setattr(NetworkSimulator, "on_card", True)
    on_card = replace(RUN, **ALONE, model="pb4u-small", device="cuda")
    jobs = [RunJob(replace(on_card, seed=seed), weights="digest") for seed in range(MOST_TOGETHER + 2)]
    others = [RunJob(replace(on_card, device="cpu")), RunJob(replace(on_card, model="pb4u-wide"))]
    packs = together([*jobs, *others])
    assert [len(jobs_of(pack)) for pack in packs] == [MOST_TOGETHER, 2, 1, 1]
    assert sorted(each.key for pack in packs for each in jobs_of(pack)) == sorted(job.key for job in [*jobs, *others])


def test_a_drawing_counts_for_the_pattern_that_names_it(tmp_path: Path) -> None:
    pattern, drawing = tmp_path / "skirt.toml", tmp_path / "skirt.svg"
    pattern.write_text('svg = "skirt.svg"\n')
    run, keys = replace(RUN, garments=(WornGarment(str(pattern)),)), set()
    for content in ("one", "two"):
        drawing.write_text(content)
        keys.add(JobPlanner().job(run).key)
    assert len(keys) == 2


def test_a_character_plays_its_own_clip_unless_it_is_given_a_motion(tmp_path: Path) -> None:
    run = replace(RUN, motion=None, body=str(write_doll(tmp_path / "doll.glb")))
    alone, chosen = JobPlanner().job(run), JobPlanner().job(replace(run, clip="slide"))
    assert (alone.run.motion, alone.labels["motion"]) == (None, "own")
    assert (chosen.run.motion, chosen.labels["motion"]) == (None, "slide")
    parts = [JobPlanner().job(replace(run, body_parts=name)).run.body_parts for name in ("Skin", "Body0")]
    assert parts == ["Skin", "Body0"]
    assert JobPlanner().job(replace(run, motion="dance")).labels["motion"] == "dance"
    of_clip, of_walk = footprints(
        [replace(alone, run=replace(alone.run, frames=None)), replace(alone, run=replace(alone.run, frames=60))]
    )
    assert of_clip < of_walk
