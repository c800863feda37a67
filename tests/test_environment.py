"""Gravity, air and ground: what they may be, how they are kept, and that a simulation falls by them."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.simulation.ball_scene import sheet

import pb4u
from pb4u.cli.run_flags import run_flags, run_of
from pb4u.dataset.jobs_file import read_jobs
from pb4u.environment import USUAL
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.measures.metrics import Ruler
from pb4u.measures.run_job import RunJob

MOON = pb4u.Environment(gravity=(0.0, -1.62, 0.0), air_density=0.0, ground=None)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"gravity": 9.81}, "gravity must be three finite numbers, along X, Y and Z, not 9.81"),
        ({"gravity": (0, -9.81)}, "gravity must be three finite numbers"),
        ({"gravity": "low"}, "gravity must be three finite numbers, along X, Y and Z, not 'low'"),
        ({"gravity": (0, "down", 0)}, "gravity must be three finite numbers"),
        ({"gravity": (0, float("nan"), 0)}, "gravity must be three finite numbers, along X, Y and Z, not (0, nan, 0)"),
        ({"air_density": -1}, "air_density must be a number, 0 or more, not -1"),
        ({"air_density": True}, "air_density must be a number, 0 or more, not True"),
        ({"ground": float("inf")}, "ground must be a finite number, not inf"),
        ({"wind": (0, 0, 300)}, "wind must be 50 m/s or less, not 300"),
        ({"gusts": -1}, "gusts must be a whole number, 0 or more, not -1"),
    ],
)
def test_what_no_environment_is_is_refused_in_one_sentence(given: dict[str, Any], says: str) -> None:
    with pytest.raises(pb4u.InputError) as refused:
        pb4u.Environment(**given)
    assert says in str(refused.value)
    with pytest.raises(pb4u.InputError, match=r"pb4u\.Environment"):
        pb4u.Run(environment=given)  # type: ignore[arg-type]


def test_a_scene_file_keeps_what_is_not_as_usual(tmp_path: Path) -> None:
    text = pb4u.Run(environment=MOON).save(tmp_path / "moon.toml").read_text()
    assert "[environment]" in text
    assert "wind" not in text
    assert pb4u.Run.open(tmp_path / "moon.toml") == pb4u.Run(environment=MOON)
    assert "[environment]" not in pb4u.Run().save(tmp_path / "usual.toml").read_text()
    assert pb4u.Run.open(tmp_path / "usual.toml").environment == USUAL


def test_every_entry_is_read_and_an_unknown_one_refused(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("[environment]\ngravity = [0, -3.7, 0]\nwind = [0, 0, 0]\nair_density = 0.02\nground = -1\n")
    assert pb4u.Run.open(file).environment == pb4u.Environment((0.0, -3.7, 0.0), air_density=0.02, ground=-1.0)
    file.write_text("[environment]\ngravitation = [0, -3.7, 0]\n")
    with pytest.raises(pb4u.InputError, match=r"scene\.toml.*gravitation"):
        pb4u.Run.open(file)


def test_flags_and_jobs_files_have_its_fields(tmp_path: Path) -> None:
    given = {"gravity": (0.0, -1.62, 0.0), "air_density": 0.0, "ground": "none"}
    assert run_of(pb4u.Run(), given).environment == MOON
    assert {each.name for each in fields(pb4u.Environment)} <= {*run_flags()}
    # A flag changes one field of the scene file's, and "none" is as good as None.
    changed = run_of(pb4u.Run(environment=MOON), {"ground": -1.0}).environment
    assert changed == replace(MOON, ground=-1.0)
    jobs = tmp_path / "jobs.toml"
    jobs.write_text('[fixed]\nground = "none"\nair_density = 0\n[product]\ngravity = [[0, -1.62, 0], [0, -9.81, 0]]\n')
    moon, earth = read_jobs(jobs)
    assert moon.environment == MOON
    assert earth.environment == replace(MOON, gravity=USUAL.gravity)
    labels = RunJob(moon).labels
    assert (labels["gravity"], labels["air_density"], labels["ground"]) == ([0.0, -1.62, 0.0], 0.0, None)
    assert len({RunJob(each).key for each in (moon, earth)}) == 2


def test_a_scene_is_made_in_the_environment_of_its_run() -> None:
    scene = pb4u.make_scene(triangles=400, frames=1, lead_in=0, environment=MOON)
    assert scene.environment == MOON
    assert pb4u.make_scene(triangles=400, frames=1, lead_in=0).environment == USUAL


def falling(environment: pb4u.Environment, height: float, frames: int = 6) -> pb4u.Scene:
    """A sheet at rest in the air, without a body."""
    garment = sheet(6, 0.4, height)
    placed = pb4u.DressedGarment(garment, PrescribedPlacement(garment.vertices[None]))
    return pb4u.Scene((placed,), (), frames, environment=environment)


def test_cloth_falls_by_the_gravity_of_its_scene_and_is_measured_in_it() -> None:
    simulator = pb4u.load_simulator("solver", first_frame="placed", time_integration="implicit-euler")
    ways = []
    for gravity in (9.81, 1.62):
        around = replace(MOON, gravity=(0.0, 0.0, gravity))
        made = simulator.simulate(falling(around, 1.0), pb4u.no_progress)
        ways.append(np.asarray(made.positions)[-1, :, 2].mean() - np.asarray(made.positions)[0, :, 2].mean())
        assert Ruler(made).environment == around
        assert ("air_density" in made.metadata, made.metadata["ground_height"]) == (True, None)
    # Implicit Euler falls g dt^2 (1 + 2 + .. + n) in n steps.
    assert ways == pytest.approx([9.81 * 15 / 900, 1.62 * 15 / 900], rel=1e-4)
