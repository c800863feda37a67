"""Drawn scenes: the same by their number, run in both ways, judged, and each failure named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.paper.test_protocol_run import Here, ball_of
from tests.simulation.ball_scene import ball_scene

from pb4u.errors import InputError
from pb4u.measures import run_job
from pb4u.measures.divergence import SLID, SLID_FRAMES, hold_shifts, slid_from
from pb4u.measures.run_job import RunJob, attempt, make
from pb4u.paper.evaluation import evaluate
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.page import Table
from pb4u.paper.protocol_plan import ALONE, BY_DEFAULT, plan
from pb4u.paper.robustness import failure_pictures, failure_table, parts_tables, robustness_table
from pb4u.paper.summary import Row, Summary
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator

REQUEST = EvaluationRequest("robustness", models=("pb4u-small", "solver"), scenes=16, device="cpu")


def test_scenes_follow_from_seed_and_number_and_have_every_garment_and_motion() -> None:
    few, more, other = (plan(replace(REQUEST, **change)) for change in ({"scenes": 3}, {}, {"seed": 1}))
    assert [case.job for case in few.cases] == [case.job for case in more.cases[: len(few.cases)]]
    scenes = {case.number: case.job.run for case in more.cases}
    assert len({run.motion for run in scenes.values()}) == 8
    assert len({run.garments[0].name for run in scenes.values()}) == 8
    assert all(run.seed >= 2000 for run in scenes.values())
    shapes = np.array([list(run.body_shape.values()) for run in scenes.values()])
    assert shapes.min() < 0.2
    assert shapes.max() > 0.8
    assert len({run.garments[0].material for run in scenes.values()}) > 3
    assert not set(scenes.values()) & {case.job.run for case in other.cases}


def test_each_network_runs_alone_and_as_it_comes_each_beside_its_own_floor() -> None:
    planned = plan(replace(REQUEST, scenes=1))
    alone, as_it_comes, solver, solver_comes = planned.cases
    assert planned.protocol.models == (
        "pb4u-small, alone", "pb4u-small, by default", "solver, alone", "solver, by default"
    )  # fmt: skip
    for case, options in ((alone, ALONE), (as_it_comes, BY_DEFAULT)):
        assert {name: getattr(case.job.run, name) for name in options} == options
    for case, floor in ((alone, solver), (as_it_comes, solver_comes)):
        assert isinstance(case.floor, RunJob)
        assert case.floor.key == floor.job.key
    # A floor that is a model of the run as well is made once.
    assert len(planned.jobs) == 4
    defaults = load_simulator("pb4u-small")
    as_run = load_simulator("pb4u-small", refine=5, contact=True, self_contact=True)
    assert as_run.settings() == defaults.settings()
    assert load_simulator("pb4u-small", self_contact=False).settings() != defaults.settings()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"contact": True}, "leave out --contact, --refine and"),
        ({"refine": 3}, "leave out --contact, --refine and"),
        ({"scenes": 0}, "scenes must be a whole number, 1 or more"),
        ({"seed": -1}, "seed must be a whole number, 0 or more"),
        ({"protocol": "unseen"}, "--scenes applies only to protocols that draw scenes at random: robustness"),
    ],
)
def test_what_does_not_fit_drawn_scenes_is_refused(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        plan(replace(REQUEST, **change))


def test_what_holds_a_garment_has_moved_as_far_as_it_was_moved() -> None:
    scene = ball_scene(12, 1, cells=5)
    trajectory = load_simulator("skinning").simulate(scene)
    assert hold_shifts(scene, trajectory) == pytest.approx(0.0, abs=1e-6)
    moved = trajectory.positions.copy()
    moved[5:, :, 1] -= 0.1
    # Half of the cloth slides back again: the other half is what counts.
    right = trajectory.header.rest_positions[:, 0] < 0
    moved[8:, right, 1] += 0.1
    shifts = hold_shifts(scene, replace(trajectory, positions=moved))
    assert shifts[:, 0] == pytest.approx([0.0] * 5 + [0.1] * 7, abs=1e-6)


def test_a_garment_has_slid_where_it_stays_away_for_a_third_of_a_second() -> None:
    shifts = np.zeros((40, 2))
    shifts[3 : 3 + SLID_FRAMES - 1, 0] = 2 * SLID
    assert slid_from(shifts) is None
    shifts[20 : 20 + SLID_FRAMES, 1] = 2 * SLID
    assert slid_from(shifts) == 20
    shifts[10:, 0] = np.nan
    assert slid_from(shifts) == 3
    assert slid_from(np.full((4, 1), 2 * SLID)) == 0


def _result(**changes: Any) -> dict[str, Any]:
    metrics = {
        "penetration_percent": {"mean": 0.1},
        "penetration_depth_max": {"max": 0.004},
        "self_intersections": {"mean": 2.0},
    }
    return {
        "ms_per_step": 5.0, "frames": 60, "failed_at": None, "diverged": False, "diverged_at": None, "slid_at": None,
        "hold_shift": {"max": 0.01}, "metrics": metrics, "metrics_paper": {},
    } | changes  # fmt: skip


def test_failures_are_counted_and_named_with_what_makes_them_again() -> None:
    planned = plan(replace(REQUEST, scenes=4))
    alone = [case for case in planned.cases if case.job.label == "pb4u-small, alone"]
    results = [
        (_result(), 1.1),
        (_result(diverged=True, diverged_at=7), 80.0),
        (_result(slid_at=12, hold_shift={"max": 0.2}), 1.3),
        (_result(), 4.0),
    ]
    rows = tuple(Row(case, made, None, ratio, "stored") for case, (made, ratio) in zip(alone, results, strict=True))
    summary = Summary(planned, rows, (), lambda job: Path("absent"))
    (whole,) = robustness_table(summary)
    assert isinstance(whole, Table)
    assert list(whole.rows[0][1:8]) == [
        "4",
        "1 of 4 (5 to 70 %)",
        "1 of 4 (5 to 70 %)",
        "3 of 4 (30 to 95 %)",
        "1.30",
        "3.73",
        "4.00",
    ]
    # Of the solver nothing is done yet.
    assert set(whole.rows[2][5:]) == {"-"}
    (failures,) = failure_table(summary)
    assert isinstance(failures, Table)
    assert [(row[0], row[3]) for row in failures.rows] == [
        ("1", "diverged in frame 7"), ("2", "slid from frame 12, 20 cm"), ("3", "4.0 times the reference energy")
    ]  # fmt: skip
    made = alone[1].job.run
    garment = made.garments[0].garment
    for part in (
        f"--garment {garment} ",
        f"--seed {made.seed} ",
        f"--body-shape height={made.body_shape['height']:g} ",
    ):
        assert part in failures.rows[0][2]
    by_garment = next(table for table in parts_tables(summary) if table.title == "By garment")
    assert isinstance(by_garment, Table)
    assert {row[0]: row[1] for row in by_garment.rows}[garment] == "-, -; 1 of 1"
    assert failure_pictures(summary) == []


def test_a_run_of_drawn_scenes_ends_in_a_page_and_is_not_made_twice(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(run_job, "_scene", lambda asked, fps: ball_of(asked, cells=5, speed=0.3))
    request = replace(REQUEST, models=("skinning",), scenes=2, frames=3, lead_in=1)
    pool = Here(attempt)
    first = evaluate(request, tmp_path / "run", lambda: pool)
    assert len(pool.did) == 4
    assert [row["floor"] for row in first["rollouts"]] == ["solver run", "solver run"]
    assert all(row["ratio_to_floor"] > 0.0 for row in first["rollouts"])
    page = (tmp_path / "run" / "tables.md").read_text()
    assert "## All scenes" in page
    assert "| skinning | 2 |" in page
    # Its floors are kept with it; more scenes leave the first as they are.
    further = Here(attempt)
    evaluate(replace(request, scenes=3), tmp_path / "run", lambda: further)
    assert len(further.did) == 2


def test_kept_frames_are_those_of_the_moment_and_of_the_worst(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(run_job, "_scene", lambda asked, fps: ball_of(asked, cells=5, speed=0.3))
    job = plan(replace(REQUEST, models=("skinning",), scenes=1, frames=6, lead_in=1)).cases[0].job
    kept = make(job)
    assert kept.trajectory is not None
    (tmp_path / "still.npz").write_bytes(kept.trajectory)
    still = Trajectory.open(tmp_path / "still.npz")
    inside = kept.result["metrics"]["penetration_percent"]["per_frame"]
    whole = load_simulator("skinning").simulate(ball_scene(6, 1, cells=5, speed=0.3))
    assert still.positions[0] == pytest.approx(whole.positions[kept.result["pictured_frame"]])
    assert still.positions[-1] == pytest.approx(whole.positions[int(np.argmax(inside))])
