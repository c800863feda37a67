"""Scenes of rigged characters, and of recordings from videos."""

from __future__ import annotations

import warnings

import pytest
import torch
from tests.body.characters import write_doll, write_woman

from pb4u.body import character_file
from pb4u.errors import InputError
from pb4u.run import Run
from pb4u.scene.assembly import make_scene


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Which vertices cloth can reach takes seconds."""
    monkeypatch.setattr(character_file, "reachable", lambda v, f, candidates, rays: candidates)


def test_a_shirt_is_cut_for_a_character_and_goes_with_its_clip(tmp_path):
    path = write_woman(tmp_path / "woman.glb", unit=0.01, clips=("walk", "arms"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = make_scene("tshirt", path, triangles=600, frames=5, lead_in=6, clip="arms")
    assert scene.labels["motion"] == "arms"
    assert any("left out of the body: Hair, EyeIris" in note for note in scene.notes)
    body = scene.colliders[0]
    assert body.frame_count >= 11
    assert body.is_closed
    shirt = scene.garments[0].placement.positions(0, 11)
    assert torch.isfinite(shirt).all()
    # It goes with the skin under it: the nearest of the body stays as far.
    for frame in (0, 10):
        near = torch.cdist(shirt[frame], body.positions(frame, frame + 1)[0]).min(dim=1).values
        assert near.median() < 0.04


def test_what_a_clip_leaves_no_room_for_is_refused(tmp_path):
    doll = write_doll(tmp_path / "doll.glb")
    with pytest.raises(InputError, match="clip slide or --motion"):
        make_scene("tshirt", doll, "walk", clip="slide")
    with pytest.raises(InputError, match="--crop"):
        make_scene("tshirt", doll, crop=(0, 2))
    with pytest.raises(InputError, match="--recorded-fps"):
        make_scene("tshirt", doll, recorded_fps=60.0)
    with pytest.raises(InputError, match=r'"run".*slide'):
        make_scene("tshirt", doll, clip="run")


def test_new_options_go_through_a_scene_file(tmp_path):
    doll = write_doll(tmp_path / "doll.glb")
    text = f'[scene]\nbody = "{doll.name}"\nclip = "slide"\nbody_parts = "Skin"\nraw_motion = true\nrecorded_fps = 60\n'
    (tmp_path / "scene.toml").write_text(text)
    scene = Run.open(tmp_path / "scene.toml")
    assert (scene.clip, scene.body_parts, scene.raw_motion, scene.recorded_fps) == ("slide", "Skin", True, 60)
    Run.open(tmp_path / "scene.toml").save(tmp_path / "again.toml")
    assert Run.open(tmp_path / "again.toml").body_parts == "Skin"


def test_a_rate_that_nothing_is_recorded_at_is_refused():
    with pytest.raises(InputError, match=r"recorded_fps .*1 to 1,000, not 0\.0"):
        make_scene("tshirt", motion="walk", recorded_fps=0.0)
