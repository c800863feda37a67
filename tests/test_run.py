"""What a specification of a scene holds, refuses and says at another frame rate."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.library import build_garment
from pb4u.run import Run, WornGarment
from pb4u.scene_file import named_file


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"frames": 0}, "frames must be a whole number, 1 or more, not 0"),
        ({"frames": "many"}, "frames must be a whole number, 1 or more, not 'many'"),
        ({"frames": 2.5}, "whole number, 1 or more, not 2.5"),
        ({"frames": True}, "whole number, 1 or more, not True"),
        ({"lead_in": -1}, "lead_in must be a whole number, 0 or more, not -1"),
        ({"lead_in": 2.5}, "lead_in must be a whole number, 0 or more, not 2.5"),
        ({"fps": 0}, "fps must be a number from 1 to 1,000, not 0"),
        ({"fps": float("nan")}, "from 1 to 1,000, not nan"),
        ({"fps": "fast"}, "must be a number from 1 to 1,000, not 'fast'"),
        ({"seed": -1}, "seed must be a whole number, 0 or more"),
        ({"arms_away": 91}, "arms_away must be a number from 0 to 90, not 91"),
        ({"keep_lead_in": 1}, "true or false, not 1"),
        ({"crop": 5}, "the first and the one after the last, not 5"),
        ({"crop": (1, 2, 3)}, "the first and the one after the last"),
        ({"crop": ("a", 2)}, "the first and the one after the last"),
        ({"body": 3}, "body must be a name, a path or a loaded object, not 3"),
        ({"body": ""}, "body must be a name"),
        ({"motion": ["walk"]}, "motion must be a name"),
        ({"body_shape": "height=0.7"}, "numbers by name"),
        ({"body_shape": {"height": "tall"}}, "shape parameter height must be a number"),
        ({"garments": ()}, "at least one garment"),
        ({"garments": ("tshirt",)}, "WornGarment objects, not 'tshirt'"),
    ],
)
def test_what_a_scene_cannot_be_is_refused_in_one_sentence(given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as refused:
        Run(**given)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"garment": None}, "garment must be a name"),
        ({"material": 0.2}, "material must be a name"),
        ({"triangles": "few"}, "triangles must be a whole number"),
        ({"pins": 4}, "list of vertex indices, not 4"),
        ({"pins": [1, "b"]}, "list of vertex indices"),
        ({"grain": [0, 1]}, "direction of three numbers, such as"),
        ({"grain": [0, 0, 0]}, "direction of three numbers, such as"),
        ({"grain": "up"}, "three numbers, such as"),
    ],
)
def test_what_a_garment_cannot_be_is_refused(given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        WornGarment(**given)


def test_one_garment_is_not_worn_twice_but_files_of_one_name_are() -> None:
    shirt = WornGarment("tshirt")
    with pytest.raises(InputError, match="tshirt is worn twice"):
        Run((shirt, replace(shirt, triangles=900)))
    with pytest.raises(InputError, match="shirt is worn twice"):
        Run((WornGarment("a/shirt.obj"), WornGarment(Path("a/shirt.obj"))))
    with pytest.raises(InputError, match="shirt is worn twice"):
        Run((WornGarment("a/shirt.obj"), WornGarment(Path("a/shirt.obj").absolute())))
    two = Run((WornGarment("a/shirt.obj"), WornGarment("b/shirt.obj")))
    assert [each.name for each in two.garments] == ["shirt", "shirt"]
    loaded = build_garment("tanktop", load_body("woman"), 400)
    with pytest.raises(InputError, match="tanktop is worn twice"):
        Run((WornGarment(loaded), WornGarment(loaded, "silk")))


def test_a_specification_is_a_value() -> None:
    skirt = WornGarment("skirt", pins=np.array([3, 4]))
    made = [Run([skirt], body_shape={"height": 0.7}, crop=[2, 9]) for _ in range(2)]
    assert made[0] == made[1] == pickle.loads(pickle.dumps(made[0]))
    assert hash(made[0]) == hash(made[1])
    assert made[0].crop == (2, 9)
    assert made[0].garments[0].pins == (3, 4)
    assert made[0] != replace(made[0], seed=1)
    shape = {"height": 0.7}
    kept = Run(body_shape=shape)
    shape["height"] = 0.1
    assert kept.body_shape == {"height": 0.7}


def test_another_frame_rate_covers_the_same_stretch_of_time() -> None:
    scene = Run(frames=25, lead_in=24, fps=24.0, keep_lead_in=True)
    assert scene.written_frames == 49
    faster = scene.at_rate(30.0)
    assert (faster.frames, faster.lead_in, faster.fps) == (31, 30, 30.0)
    assert (faster.frames - 1) / faster.fps == (scene.frames - 1) / scene.fps
    assert scene.at_rate(24.0) == scene
    assert replace(scene, frames=None).at_rate(30.0).frames is None
    assert replace(scene, frames=None).written_frames is None
    assert replace(scene, keep_lead_in=False).written_frames == 25


@pytest.mark.parametrize(
    ("value", "file"),
    [
        ("tshirt", "tshirt"),
        (Path("folder/shirt.obj"), "folder/shirt.obj"),
        ("garments.pkl:dress@73", "garments.pkl"),
        ("people.pkl:2", "people.pkl"),
        ("walk.npz:1", "walk.npz"),
        ("at 12:30.obj", "at 12:30.obj"),
    ],
)
def test_the_file_that_a_value_names(value: str | Path, file: str) -> None:
    assert named_file(value) == Path(file)


def test_another_motion_is_played_at_its_own_rate() -> None:
    first = Run(motion="a.bvh", recorded_fps=60.0, crop=(0, 50), raw_motion=True)
    other = first.with_entries({"motion": "b.bvh"})
    assert (other.recorded_fps, other.crop, other.raw_motion) == (None, None, False)
    assert first.with_entries({"motion": "b.bvh", "recorded_fps": 24.0}).recorded_fps == 24.0
    assert first.with_entries({"frames": 9}).recorded_fps == 60.0


def test_one_garment_alone_and_a_tuple_of_several_are_taken() -> None:
    assert Run(WornGarment("skirt")) == Run((WornGarment("skirt"),))
    given = {"garment": ("tshirt", "skirt"), "triangles": (900, None)}
    worn = Run().with_entries(given).garments
    assert [(each.name, each.triangles) for each in worn] == [("tshirt", 900), ("skirt", None)]


def test_the_lead_in_is_a_second_at_any_rate_where_it_is_left_open() -> None:
    fast = Run(fps=120)
    assert (Run().led_frames, fast.led_frames, fast.at_rate(30).led_frames) == (30, 120, 30)
    assert replace(fast, frames=10, keep_lead_in=True).written_frames == 130
    assert (Run(fps=60, lead_in=8).led_frames, Run(fps=60, lead_in=8).at_rate(30).led_frames) == (8, 4)
