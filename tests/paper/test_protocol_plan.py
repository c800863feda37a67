"""From what was asked for to the rollouts: what is combined, what is left out, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from pb4u.errors import InputError
from pb4u.measures.run_job import RunJob
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation_control import FixedSteps
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.protocol_plan import plan
from pb4u.paper.protocols import PROTOCOLS
from pb4u.paper.reference_energies import stored_reference
from pb4u.simulation.checkpoint import TrainingRecord, save_checkpoint

SMALL = EvaluationRequest(models=("skinning",), garments=("tshirt",), motions=("walk",), levels=("400",), frames=3)


def triangles(job: RunJob) -> int:
    return job.run.garments[0].triangles or 0


def weights(path: Path, dt: float = 1 / 30, seed: int = 0) -> Path:
    torch.manual_seed(seed)
    configuration = Pb4uConfiguration(width=8, blocks=1)
    record = TrainingRecord(dt, (0.012, 0.016), (1, 30), 10, {})
    path.parent.mkdir(exist_ok=True)
    save_checkpoint(path, AccelerationModel(configuration.network()), configuration, record)
    return path


def test_every_protocol_plans_without_any_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.simulation.checkpoint.built_in_models", lambda: ())
    for name in PROTOCOLS:
        if name == "robustness":
            continue
        if name == "depth":
            with pytest.raises(InputError, match="propagation steps"):
                plan(EvaluationRequest(name))
            continue
        planned = plan(EvaluationRequest(name))
        protocol = PROTOCOLS[name]
        scenes = len(protocol.garments) * len(protocol.motions) * len(protocol.levels)
        assert len(planned.cases) == scenes * len(planned.protocol.models)
        assert "solver" in planned.protocol.models
        assert len({job.key for job in planned.jobs}) == len(planned.jobs)


def test_models_without_weights_are_one_line_unless_they_were_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.simulation.checkpoint.built_in_models", lambda: ("comparison-pb4u",))
    (line,) = plan(EvaluationRequest("ablation")).absent
    assert "comparison-literal-without-control" in line
    with pytest.raises(InputError, match="'pb4u-smal'"):
        plan(replace(SMALL, models=("pb4u-smal",)))


def test_the_ablation_has_each_network_with_its_scaling_and_without() -> None:
    planned = plan(EvaluationRequest("ablation", models=("comparison-literal", "comparison-mgn", "solver")))
    scalings = {case.job.label: case.job.run.scaling for case in planned.cases}
    # Of a method without update scaling there is nothing to leave out.
    own, without = "comparison-literal", "comparison-literal, scaling none"
    assert scalings == {own: None, without: "none", "comparison-mgn": None, "solver": None}


def test_levels_go_by_name_or_number() -> None:
    planned = plan(replace(SMALL, levels=("11k", "2500", "12K", "1.2K", "11000")))
    assert planned.protocol.levels == ("11K", "base", "12K", "1200")
    assert [triangles(job) for job in planned.jobs if job.run.model == "skinning"] == [1200, 2500, 11000, 12000]


def test_jobs_of_a_scene_stand_together_coarse_ones_first() -> None:
    planned = plan(EvaluationRequest("resolution", garments=("tshirt",), levels=("1200", "400")))
    scenes = [job.run.scene for job in planned.jobs]
    assert [scenes[i] for i in range(len(scenes)) if i == 0 or scenes[i] != scenes[i - 1]] == list(
        dict.fromkeys(scenes)
    )
    assert [triangles(job) for job in planned.jobs] == sorted(triangles(job) for job in planned.jobs)


def test_floors_are_the_runs_own_solver_then_stored_then_a_job_or_absent() -> None:
    own = plan(replace(SMALL, models=("skinning", "solver")))
    assert [job.run.model for job in own.jobs] == ["skinning", "solver"]
    assert {str(case.floor) for case in own.cases} == {str(own.jobs[1])}

    stored = plan(replace(SMALL, levels=("base", "400"), frames=30))
    assert stored.cases[0].floor == stored_reference("test/tshirt/walk-2000", "base", 30)
    assert isinstance(stored.cases[1].floor, RunJob)
    for change in ({"frames": 29}, {"lead_in": 0}, {"bodies": ("man",)}, {"motions": ("walk-7",)}):
        (case,) = plan(replace(SMALL, **{"levels": ("base",), "frames": 30, **change})).cases
        assert isinstance(case.floor, RunJob), change

    (case,) = plan(replace(SMALL, floors="stored")).cases
    assert case.floor is None


def test_with_contact_the_floor_stays_the_bare_solver() -> None:
    planned = plan(replace(SMALL, models=("solver",), contact=True))
    assert [job.run.contact for job in planned.jobs] == [True, False]
    assert isinstance(planned.cases[0].floor, RunJob)
    assert not planned.cases[0].floor.run.contact


def test_settings_reach_only_what_has_them(tmp_path: Path) -> None:
    file = weights(tmp_path / "net.safetensors")
    planned = plan(
        replace(SMALL, models=(str(file), "skinning", "solver"), propagation_steps=(2, 5), refine=3, device="cpu")
    )
    asked = [(case.job.label, case.job.run.propagation_steps, case.job.run.refine) for case in planned.cases]
    assert asked == [("net", 2, 3), ("net", 5, 3), ("skinning", None, 0), ("solver", None, 0)]


def test_the_quick_solver_refines_where_networks_run_alone() -> None:
    (case,) = plan(replace(SMALL, models=("quick-solver",), levels=("400",), contact=True)).cases
    assert (case.job.run.refine, case.job.run.contact) == (5, True)
    (case,) = plan(replace(SMALL, models=("quick-solver",), levels=("400",), refine=2)).cases
    assert case.job.run.refine == 2


def test_weights_count_by_content_and_equal_names_are_told_apart(tmp_path: Path) -> None:
    a, b = weights(tmp_path / "a" / "best.safetensors"), weights(tmp_path / "b" / "best.safetensors", seed=1)
    planned = plan(replace(SMALL, models=(str(a), str(b))))
    assert planned.protocol.models == ("a-best", "b-best")
    first, second = (case.job.key for case in planned.cases)
    assert first != second
    b.write_bytes(a.read_bytes())
    first, second = (case.job.key for case in plan(replace(SMALL, models=(str(a), str(b)))).cases)
    assert first == second


def test_recordings_take_the_place_of_built_in_motions(test_data: Path) -> None:
    folder = test_data / "motions" / "cmu_asfamc"
    planned = plan(EvaluationRequest("efficiency", models=("skinning",), levels=("400",), recordings=folder))
    (case,) = planned.cases
    assert case.motion == "07_02"
    assert case.job.contents[0][0] == case.job.run.motion


def test_a_motion_file_goes_by_its_label_and_is_pictured(tmp_path: Path) -> None:
    file = tmp_path / "jive.bvh"
    file.touch()
    planned = plan(EvaluationRequest("resolution", models=("skinning",), levels=("400",), motions=(str(file),)))
    assert planned.protocol.motions == ("jive",)
    assert all(planned.protocol.pictures(case.level, case.motion, "woman") for case in planned.cases)
    assert {job.run.model for job in planned.jobs} == {"skinning", "solver"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"protocol": "resolutoin"}, "did you mean resolution"),
        ({"models": ("absent.safetensors",)}, "no model file absent.safetensors"),
        ({"models": ("sovler",)}, "did you mean solver"),
        ({"models": ("pb4u",)}, "name of the method; the paper's network to the letter is `literal`"),
        ({"garments": ("tshrt",)}, "did you mean tshirt"),
        ({"garments": ("absent.obj",)}, "no garment file absent.obj"),
        ({"motions": ("wlak",)}, "did you mean walk"),
        ({"motions": ("07_02",)}, "--recordings"),
        ({"motions": ("99_99",), "recordings": Path(".")}, "99_99.amc"),
        ({"motions": ("absent.bvh",)}, "no motion file absent.bvh"),
        ({"bodies": ("womn",)}, "did you mean woman"),
        ({"levels": ("11Q",)}, "no level '11Q'"),
        ({"levels": ("100",)}, "between 200 and 200000"),
        ({"frames": 0}, "1 or more, not 0"),
        ({"lead_in": -1}, "lead_in must be a whole number, 0 or more, not -1"),
        ({"propagation_steps": (0, 1), "models": ("pb4u-small",)}, "from 1 to 500, not 0"),
        ({"levels": ()}, "--levels is empty"),
        ({"recordings": Path("absent")}, "no folder of recordings absent"),
        ({"device": "tpu"}, "no device 'tpu'"),
        ({"seed": 7}, "--seed is for the scenes of robustness"),
        ({"protocol": "controls", "motions": None, "recordings": Path(".")}, "has no recordings of its own"),
    ],
)
def test_what_cannot_be_used_is_refused(change: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        plan(replace(SMALL, **change))


def test_weights_of_another_rate_are_refused(tmp_path: Path) -> None:
    file = weights(tmp_path / "fast.safetensors", dt=1 / 60)
    with pytest.raises(InputError, match=r"60 frames per second.* 30"):
        plan(replace(SMALL, models=(str(file),)))


def test_networks_with_fixed_steps_too_can_be_told(tmp_path: Path) -> None:
    configuration = Pb4uConfiguration(width=8, blocks=1, control=FixedSteps(3))
    record = TrainingRecord(1 / 30, (0.012, 0.016), (1, 30), 10, {})
    save_checkpoint(tmp_path / "a.safetensors", AccelerationModel(configuration.network()), configuration, record)
    planned = plan(replace(SMALL, protocol="depth", models=(str(tmp_path / "a.safetensors"),)))
    assert [case.job.run.propagation_steps for case in planned.cases] == list(PROTOCOLS["depth"].steps)


def test_garments_that_tables_would_call_the_same_are_refused() -> None:
    with pytest.raises(InputError, match=r"Two garments .*shirt"):
        plan(replace(SMALL, garments=("a/shirt.obj", "b/shirt.obj")))
