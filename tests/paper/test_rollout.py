"""A result's address: the same for the same work, another for any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pb4u.jobs.job import digest
from pb4u.paper import rollout
from pb4u.paper.rollout import ModelRecord, RolloutJob, SceneRecord, Settings

SCENE = SceneRecord("tshirt", "woman", "walk", 2000, 400, 3)
JOB = RolloutJob(SCENE, ModelRecord("solver", "solver"), Settings())


@pytest.mark.parametrize(
    "other",
    [
        *(
            replace(JOB, scene=replace(SCENE, **change))
            for change in (
                {"garment": "dress"}, {"body": "man"}, {"motion": "jump"}, {"seed": 2001}, {"triangles": 401},
                {"frames": 4}, {"lead_in": 0}, {"material": "silk"}, {"shape": (("height", 0.5),)},
            )
        ),
        *(
            replace(JOB, settings=Settings(**change))
            for change in (
                {"propagation_steps": 3}, {"refine": 1}, {"contact": True}, {"self_contact": True}, {"device": "cuda"},
            )
        ),
        replace(JOB, excess=True),
        replace(JOB, model=ModelRecord("skinning", "skinning")),
        replace(JOB, model=ModelRecord("solver", "solver", "digest")),
    ],
)  # fmt: skip
def test_other_work_has_another_address(other: RolloutJob) -> None:
    assert other.key != JOB.key


def test_versions_change_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    before = JOB.key
    monkeypatch.setattr(rollout, "PROTOCOL_VERSION", 99)
    raised = JOB.key
    monkeypatch.setattr(rollout, "__version__", "99.0")
    assert len({before, raised, JOB.key}) == 3


def test_a_file_counts_by_its_content_and_not_by_its_place(tmp_path: Path) -> None:
    def on(folder: str, content: str) -> str:
        file = tmp_path / folder / "07_02.amc"
        file.parent.mkdir(exist_ok=True)
        file.write_text(content)
        scene = replace(SCENE, motion=str(file), seed=None, digests=(("motion", digest(file)),))
        weights = ModelRecord(str(tmp_path / folder / "best.safetensors"), folder, "the same weights")
        return RolloutJob(scene, weights, Settings()).key

    assert on("here", "one") == on("there", "one")
    assert on("here", "one") != on("there", "two")


def test_a_job_names_itself_in_plain_words() -> None:
    job = RolloutJob(SCENE, ModelRecord("/a/best.safetensors", "best", "0"), Settings(propagation_steps=5))
    assert str(job) == "best on tshirt woman walk at 400 triangles, K 5"


def test_excess_is_measured_on_states_that_all_models_share() -> None:
    def metrics(model: str) -> dict:
        job = RolloutJob(replace(SCENE, frames=4, lead_in=2), ModelRecord(model, model), Settings(), excess=True)
        return rollout.run(job).result["metrics"]

    start, descent = metrics("warm-start"), metrics("gradient-descent")
    assert start["excess_height"]["states"] == descent["excess_height"]["states"] == 1
    assert 0.0 < descent["excess_height"]["mean"] < start["excess_height"]["mean"]
    assert len(start["distance_to_reference"]["per_frame"]) == 4
    assert 0.0 < start["distance_to_reference"]["mean"] < 0.2
