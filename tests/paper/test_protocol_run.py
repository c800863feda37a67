"""An evaluation from request to report, on a sheet above a ball."""

from __future__ import annotations

import json
import math
import re
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.paper.test_protocol_plan import weights
from tests.simulation.ball_scene import ball_scene

from pb4u.errors import InputError, Pb4uError
from pb4u.jobs.job import Failure, Made
from pb4u.jobs.worker_pool import Attempt, Outcome, WorkerPool
from pb4u.measures import run_job
from pb4u.measures.metrics import ENERGIES
from pb4u.measures.run_job import RunJob, attempt
from pb4u.paper import report
from pb4u.paper.evaluation import evaluate
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.protocol_plan import plan
from pb4u.paper.protocols import PROTOCOLS
from pb4u.paper.report import merge_similar
from pb4u.paper.summary import Row, share_text
from pb4u.paper.tables import terms_tables
from pb4u.run import Run
from pb4u.scene.scene import Scene

FRAMES = 3
REQUEST = EvaluationRequest(
    models=("skinning", "solver"), garments=("tshirt",), motions=("walk", "jump"), levels=("11K", "18K"),
    frames=FRAMES, lead_in=1, device="cpu",
)  # fmt: skip


class Here(WorkerPool):
    """Does every job at once, in this process."""

    size = 1

    def __init__(self, attempt: Attempt) -> None:
        self._attempt = attempt
        self.did: list[str] = []
        self._waiting: deque[RunJob] = deque()

    def submit(self, job: RunJob) -> None:
        self._waiting.append(job)

    def next_outcome(self) -> Outcome:
        job = self._waiting.popleft()
        self.did.append(str(job))
        return job, self._attempt(job)

    def close(self) -> None:
        self._waiting.clear()


def ball_of(asked: Run, **options: Any) -> Scene:
    return ball_scene(asked.frames, asked.lead_in, **options)


@pytest.fixture(autouse=True)
def balls(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Scenes are balls: the motion sets their speed, the level how fine the sheet is; on "turn" there is none."""

    def made(asked: Run, fps: float) -> Scene:
        if asked.motion == "turn":
            raise InputError("The ball cannot turn.")
        speed = 0.3 if asked.motion == "walk" else 0.6
        return ball_of(asked, cells=5 if asked.garments[0].triangles == 11_000 else 6, speed=speed)

    monkeypatch.setattr(run_job, "_scene", made)
    if "plots" not in request.node.name:
        monkeypatch.setitem(PROTOCOLS, "resolution", replace(PROTOCOLS["resolution"], pictured=False))
        monkeypatch.setitem(report.VIEWS, "resolution", (terms_tables,))


def run(
    request: EvaluationRequest, out: Path, attempt: Attempt = attempt, retry: bool = False
) -> tuple[dict, list[str], list[str]]:
    said: list[str] = []
    pool = Here(attempt)
    results = evaluate(request, out, lambda: pool, retry, said.append)
    return results, pool.did, said


def cell(results: dict, **wanted: object) -> dict:
    (found,) = (each for each in results["cells"] if all(each[key] == value for key, value in wanted.items()))
    return found


def test_a_run_is_summed_up_by_scene(tmp_path: Path) -> None:
    results, did, said = run(REQUEST, tmp_path / "run")
    assert len(did) == 8
    assert said == ["8 rollouts, 8 to do."]
    assert json.loads((tmp_path / "run" / "results.json").read_text()) == results
    rows = [row for row in results["rollouts"] if row["level"] == "11K"]
    by = {(row["model"], row["motion"]): row for row in rows}
    above_ground = set(ENERGIES) - {"gravity", "total"}
    for motion in ("walk", "jump"):
        skinning, solver = by["skinning", motion], by["solver", motion]
        above = [sum(row["result"]["metrics"][term]["mean"] for term in above_ground) for row in (skinning, solver)]
        assert skinning["ratio_to_floor"] == pytest.approx(above[0] / above[1])
        assert solver["ratio_to_floor"] == 1.0
        assert skinning["floor"] == "solver run"
    totals = [row["result"]["metrics_paper"]["total"]["mean"] for row in rows if row["model"] == "skinning"]
    found = cell(results, model="skinning", level="11K")
    assert found["quantities"]["total"]["mean"] == pytest.approx(sum(totals) / 2)
    assert found["quantities"]["total"]["deviation"] == pytest.approx(abs(totals[0] - totals[1]) / 2)
    assert (found["scenes"], found["done"], found["diverged"], found["failed"]) == (2, 2, 0, 0)
    assert results["paper"]["11K"]["Pb4U-GNet"]["total"] == -1.66e-2


def test_the_page_holds_tables_and_plots_and_marks_what_is_the_papers(tmp_path: Path) -> None:
    results, _, _ = run(REQUEST, tmp_path / "run")
    plots = sorted(path.name for path in (tmp_path / "run" / "plots").iterdir())
    assert plots == ["across_levels.png", "picture_grid.png", "stretch_over_time.png"]
    tables = (tmp_path / "run" / "tables.md").read_text()
    assert re.findall(r"\(plots/(\w+\.png)\)", tables) == [
        "across_levels.png",
        "stretch_over_time.png",
        "picture_grid.png",
    ]
    assert "| -1.66e-02 |" in tables
    values = (tmp_path / "run" / "tables.csv").read_text().splitlines()
    assert 'Level 11K,total loss [J],"Pb4U-GNet (paper, other data)",-1.66e-02' in values
    mean = cell(results, model="solver", level="18K")["quantities"]["total"]["mean"]
    assert f"{mean:.2e} ±" in tables
    assert "| HOOD (paper, other data) |" in tables
    assert f"diverged | {share_text(0, 2)} | {share_text(0, 2)}" in tables


def test_a_second_run_does_only_what_is_missing(tmp_path: Path) -> None:
    out = tmp_path / "run"
    first, _, _ = run(replace(REQUEST, levels=("11K",)), out)
    done = {path.name: path.read_bytes() for path in (out / "jobs").iterdir()}
    next(out.glob("jobs/*.json")).write_text('{"half')
    again, did, said = run(replace(REQUEST, levels=("11K",)), out)
    assert len(did) == 1
    assert said == ["4 rollouts, 3 done before, 1 to do."]
    assert [row["key"] for row in again["rollouts"]] == [row["key"] for row in first["rollouts"]]
    _, did, said = run(REQUEST, out)
    assert len(did) == 4
    assert said == ["8 rollouts, 4 done before, 4 to do."]
    assert set(done) < {path.name for path in (out / "jobs").iterdir()}
    _, did, _ = run(replace(REQUEST, motions=("walk",)), out)
    assert did == []


def test_failures_are_told_kept_and_tried_again_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    request, out = replace(REQUEST, motions=("walk", "turn"), levels=("11K",)), tmp_path / "run"
    results, did, _ = run(request, out)
    assert [failure["sentence"] for failure in results["failures"]] == ["The ball cannot turn."] * 2
    assert cell(results, model="skinning")["failed"] == 1
    told = "tshirt in default on woman, turn, seed 2000, 11,000 triangles, by skinning: The ball cannot turn."
    assert told in (out / "tables.md").read_text()
    assert "1, 1 missing" in (out / "tables.md").read_text()
    results, did, said = run(request, out)
    assert (did, len(results["failures"])) == ([], 2)
    assert "2 failed before and are skipped (--retry tries them again)" in said[0]
    results, did, _ = run(request, out, retry=True)
    assert (len(did), len(results["failures"])) == (2, 2)
    monkeypatch.setattr(run_job, "_scene", lambda asked, fps: ball_of(asked, cells=5))
    results, did, _ = run(request, out, retry=True)
    assert (len(did), results["failures"]) == (2, [])


def test_an_interrupt_keeps_what_is_done(tmp_path: Path) -> None:
    def interrupted(job: RunJob) -> Made | Failure:
        if job.run.motion == "jump":
            raise KeyboardInterrupt
        return attempt(job)

    with pytest.raises(Pb4uError, match="2 of 4 rollouts"):
        run(replace(REQUEST, levels=("11K",)), tmp_path / "run", interrupted)


def test_networks_are_run_at_every_depth_and_against_the_floor(tmp_path: Path) -> None:
    file = weights(tmp_path / "net.safetensors")
    request = replace(
        REQUEST,
        protocol="depth",
        models=(str(file), "solver"),
        propagation_steps=(1, 3),
        levels=("11K",),
        motions=("walk",),
    )
    results, did, _ = run(request, tmp_path / "run")
    assert len(did) == 3
    rows = {row["steps"]: row["result"] for row in results["rollouts"] if row["model"] == "net"}
    assert {steps: result["propagation_steps"] for steps, result in rows.items()} == {1: 1, 3: 3}
    assert len({result["own_steps"] for result in rows.values()}) == 1
    assert (tmp_path / "run" / "plots" / "against_steps.png").stat().st_size > 5000
    assert any("the weights net" in note for result in rows.values() for note in result["notes"])


def test_a_run_that_broke_off_is_counted_and_has_no_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pb4u.physics.time_step import DivergedError
    from pb4u.simulation import stepwise_simulator

    def breaks(state: object) -> object:
        if state.frame == 3:  # type: ignore[attr-defined]
            raise DivergedError(state.frame, "it is told to")  # type: ignore[attr-defined]
        return state

    file = weights(tmp_path / "net.safetensors")
    run(replace(REQUEST, models=("solver",), levels=("11K",), motions=("walk",)), tmp_path / "run")
    monkeypatch.setattr(stepwise_simulator, "require_finite", breaks)
    request = replace(REQUEST, models=(str(file),), levels=("11K",), motions=("walk",))
    results, _, _ = run(request, tmp_path / "run")
    (row,) = results["rollouts"]
    assert (row["result"]["frames"], row["result"]["failed_at"]) == (2, 2)
    assert (row["floor"], row["ratio_to_floor"]) == ("solver run", None)
    assert math.isfinite(row["result"]["metrics_paper"]["total"]["mean"])
    assert cell(results, model="net")["diverged"] == 1


def test_weights_that_changed_after_planning_are_not_taken_for_the_old_ones(tmp_path: Path) -> None:
    file = weights(tmp_path / "net.safetensors")

    def changed(job: RunJob) -> Made | Failure:
        weights(tmp_path / "net.safetensors", seed=1)
        return attempt(job)

    request = replace(REQUEST, models=(str(file),), levels=("11K",), motions=("walk",), floors="stored")
    results, _, _ = run(request, tmp_path / "run", changed)
    (failure,) = results["failures"]
    assert "changed after the run was planned" in failure["sentence"]


def test_unexpected_errors_come_back_as_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(asked: Run, fps: float) -> Scene:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(run_job, "_scene", broken)
    results, _, _ = run(replace(REQUEST, levels=("11K",), motions=("walk",)), tmp_path / "run")
    assert {failure["sentence"] for failure in results["failures"]} == {
        "It ended with an unexpected error: ZeroDivisionError: division by zero"
    }


def test_notes_that_differ_in_numbers_alone_are_told_once() -> None:
    notes = ["dress: edges of 18.5 mm", "dress: edges of 27.4 mm", "tshirt: edges of 13.1 mm", "dress: edges of 9 mm"]
    first, second = merge_similar(notes)
    assert first == "dress: edges of 18.5 mm (2 more with other numbers, in results.json.)"
    assert second == "tshirt: edges of 13.1 mm"


def test_networks_at_given_steps_have_columns_of_their_own(tmp_path: Path) -> None:
    file = weights(tmp_path / "net.safetensors")
    request = replace(REQUEST, models=(str(file), "skinning"), propagation_steps=(1, 3), motions=("walk",))
    run(request, tmp_path / "run")
    page = (tmp_path / "run" / "tables.md").read_text()
    head = next(line for line in page.splitlines() if "net, K 1" in line)
    assert [cell.strip() for cell in head.split("|")[2:5]] == ["net, K 1", "net, K 3", "skinning"]
    assert "0 of 0" not in page


def test_a_recording_that_ends_sooner_than_asked_is_whole() -> None:
    case = plan(replace(REQUEST, models=("skinning",), frames=120)).cases[0]
    whole = {"diverged": False, "diverged_at": None, "failed_at": None, "frames": 82, "scene_frames": 82}
    assert Row(case, whole, None, None, "absent").survived_percent == 100.0
    lost = Row(case, {**whole, "diverged": True, "diverged_at": 41}, None, None, "absent")
    assert lost.survived_percent == 50.0
