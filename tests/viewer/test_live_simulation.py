"""Simulations that a page starts: their frames, their end, and what they say when they cannot run."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.garment.cloth_shapes import quad_tube, saved

from pb4u.errors import InputError, InputWarning
from pb4u.run import Run, WornGarment
from pb4u.viewer.clip import GrowingClip
from pb4u.viewer.live_simulation import Ending, LiveSimulation, require_offered
from pb4u.viewer.worker import route_warnings

WORN = (WornGarment(triangles=400),)
TINY = Run(WORN, frames=5, lead_in=3, model="skinning")


class Hearer:
    """Notes what a simulation tells, and may answer."""

    def __init__(self) -> None:
        self.steps: list[tuple[int, int]] = []
        self.frames: list[int] = []
        self.sentence, self.ending = "", Ending.failed
        self.clip: GrowingClip | None = None

    def advanced(self, clip: GrowingClip, done: int, total: int) -> None:
        self.clip = clip
        self.steps.append((done, total))
        self.frames.append(clip.frame_count)

    def ended(self, clip: GrowingClip | None, sentence: str, ending: Ending) -> None:
        assert clip is self.clip
        self.sentence, self.ending = sentence, ending


def test_frames_arrive_one_by_one() -> None:
    hearer = Hearer()
    simulation = LiveSimulation(TINY, hearer.advanced, hearer.ended)
    simulation.start()
    assert simulation.join(60.0)
    assert hearer.ending is Ending.finished
    assert hearer.sentence.startswith("5 frames of tshirt, walk, skinning")
    assert sorted(set(hearer.frames)) == [0, 1, 2, 3, 4, 5]
    assert hearer.steps[-1] == (8, 8)
    assert hearer.clip is not None
    made = hearer.clip.trajectory()
    assert made.frame_count == 5
    assert np.isfinite(made.positions).all()
    assert made.metadata["model"] == "skinning"


def test_a_garment_of_ones_own_is_worn_under_another(tmp_path: Path) -> None:
    tube = saved(tmp_path, quad_tube(low=0.6, high=1.0, radius=0.22, around=24, rows=12))
    worn = (WornGarment(tube, pins="waist"), WornGarment("tshirt", triangles=400))
    run = replace(TINY, garments=worn, frames=2, lead_in=0)
    for files, ending in (((), Ending.failed), ((tube,), Ending.finished)):
        hearer = Hearer()
        simulation = LiveSimulation(run, hearer.advanced, hearer.ended, files)
        simulation.start()
        assert simulation.join(120.0)
        assert hearer.ending is ending, hearer.sentence
    assert hearer.clip is not None
    assert [entry["name"] for entry in hearer.clip.header.garments] == ["tube", "tshirt"]
    assert hearer.clip.frame_count == 2


def test_a_file_with_too_many_triangles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tube = saved(tmp_path, quad_tube(low=0.6, high=1.0, radius=0.22, around=24, rows=12))
    monkeypatch.setattr("pb4u.viewer.live_simulation.MOST_TRIANGLES", 500)
    hearer = Hearer()
    run = replace(TINY, garments=(WornGarment(tube, pins="waist"),))
    simulation = LiveSimulation(run, hearer.advanced, hearer.ended, (tube,))
    simulation.start()
    assert simulation.join(60.0)
    assert hearer.sentence == "tube has 576 triangles; the studio simulates at most 500: ask for fewer."


@pytest.mark.parametrize("after", [2, 5])
def test_cancelling_ends_it_before_the_next_step(after: int) -> None:
    """In the lead-in, where no frame comes out, as well as later."""

    class Impatient(Hearer):
        def advanced(self, clip: GrowingClip, done: int, total: int) -> None:
            super().advanced(clip, done, total)
            if done == after:
                simulation.cancel()

    hearer = Impatient()
    simulation = LiveSimulation(TINY, hearer.advanced, hearer.ended)
    simulation.start()
    assert simulation.join(60.0)
    assert hearer.ending is Ending.cancelled
    assert hearer.sentence == f"Cancelled; {max(after - 3, 0)} of 5 frames are there."
    assert max(done for done, _ in hearer.steps) == after


def test_what_fails_becomes_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("hidden detail")

    monkeypatch.setattr("pb4u.viewer.live_simulation.build_scene", fail)
    hearer = Hearer()
    simulation = LiveSimulation(TINY, hearer.advanced, hearer.ended)
    simulation.start()
    assert simulation.join(60.0)
    assert hearer.ending is Ending.failed
    assert hearer.sentence == (
        "An unexpected error occurred (ZeroDivisionError); the terminal shows where. The studio keeps running."
    )
    assert "hidden detail" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scene", "worn", "run", "says"),
    [
        ({}, {"garment": "../../etc/passwd"}, {}, "There is no garment"),
        ({}, {"material": "x.json"}, {}, "There is no material"),
        ({"body": "/tmp/body.pkl"}, {}, {}, "There is no body"),
        ({"motion": "walk.npz"}, {}, {}, "There is no motion"),
        ({}, {}, {"model": "weights.safetensors"}, "There is no model"),
        ({}, {"triangles": 399}, {}, "triangles must lie between 400 and 40,000"),
        ({}, {"triangles": 40_001}, {}, "triangles must lie between 400 and 40,000"),
        ({"frames": 601}, {}, {}, "frames must lie between 1 and 600"),
        ({"lead_in": 601}, {}, {}, "lead-in frames must lie between 0"),
        ({}, {}, {"refine": 101}, "refining iterations must lie between 0 and 100"),
    ],
)
def test_a_page_cannot_ask_for_anything_else(scene: dict, worn: dict, run: dict, says: str) -> None:
    """A page is not trusted: it names what is built in, never a file; and every garment of several is looked at."""
    garments = (WornGarment("skirt"), WornGarment(**worn))
    with pytest.raises(InputError, match=says):
        require_offered(Run(garments, **scene, **run))


def test_what_a_simulation_warns_of_is_told_by_the_page_and_not_by_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tube = saved(tmp_path, quad_tube(low=0.6, high=1.0, radius=0.22, around=24, rows=12))
    hearer = Hearer()
    worn = (WornGarment(tube),)
    run = replace(TINY, garments=worn, frames=1, lead_in=0)
    undo = route_warnings()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", InputWarning)
            simulation = LiveSimulation(run, hearer.advanced, hearer.ended, [tube])
            simulation.start()
            assert simulation.join(60.0)
    finally:
        undo()
    assert hearer.ending is Ending.finished, hearer.sentence
    assert "quads or n-gons are cut into triangles" in hearer.sentence
    assert "warning" not in capsys.readouterr().err.lower()
