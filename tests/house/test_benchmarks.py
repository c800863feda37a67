"""Benchmarks run by hand and rarely: what they import, call and replace is there."""

from __future__ import annotations

import time
from argparse import Namespace
from importlib import import_module
from pathlib import Path

import pytest
from benchmarks import comparison, self_contact, training
from benchmarks.network import measure, on_a_body

from pb4u.garment.library import garment_names
from pb4u.motion.library import motion_names
from pb4u.run import Run

BENCHMARKS = sorted(path.stem for path in (Path(__file__).parents[2] / "benchmarks").glob("*.py"))
IN_BLENDER = "blender_cloth"


@pytest.mark.parametrize("name", [name for name in BENCHMARKS if name != IN_BLENDER])
def test_what_a_benchmark_imports_is_there(name: str) -> None:
    assert callable(import_module(f"benchmarks.{name}").main)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_every_way_to_compute_the_network_is_timed(precision: str) -> None:
    row = measure("pb4u_small", precision, 1, on_a_body(200), time.perf_counter)
    assert all(row[f"{name}_ms"] > 0 for name in ("network", "torch", "twin", "graph"))
    assert (1e-9 < row["off"] < 1e-5) if precision == "float32" else (1e-4 < row["off"] < 5e-2)


def test_the_parts_of_a_training_step_that_are_timed_are_there() -> None:
    assert [name for name, owner, attribute in training.PARTS if not callable(getattr(owner, attribute, None))] == []


def test_the_clips_in_contact_are_of_garments_and_motions_that_are_there() -> None:
    args = Namespace(seeds="20:40", frames=None, triangles=None, out=Path("clips"))
    clips = {kind: list(self_contact.runs(kind, args)) for kind in ("motions", "fine", "outfits", "drawn")}
    assert [len(each) for each in clips.values()] == [64, 24, 15, 20]
    for run in (run for each in clips.values() for run in each):
        assert {worn.garment for worn in run.garments} <= set(garment_names())
        assert run.motion in motion_names()
    assert [run.seed for run in clips["drawn"]] == list(range(20, 40))


def test_the_comparison_scenes_say_all_that_keeps_them_as_they_are() -> None:
    scenes = sorted(comparison.SCENES.glob("*.toml"))
    assert len(scenes) == 10
    for scene in scenes:
        text, run = scene.read_text(), Run.open(scene)
        assert [entry for entry in comparison.LATER if f"\n{entry} = " not in text] == []
        assert (run.rest_shape, run.friction_law, run.time_integration, run.air) == (
            "moulded", "paper", "implicit-euler", "off",
        )  # fmt: skip
        assert all(worn.material == "default" and worn.triangles == 2500 for worn in run.garments)


def test_the_ratio_of_two_sides_lies_in_its_interval() -> None:
    middle, low, high = comparison.ratio([2.0, 2.2, 1.9, 2.1], [1.0, 1.1, 0.9, 1.0])
    assert middle == pytest.approx(2.05)
    assert 1.7 < low < middle < high < 2.5
