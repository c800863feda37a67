"""What surrounds cloth, by flags and scene files: gravity, air and ground, and no body."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.simulation.ball_scene import sheet

from pb4u.run import Run
from pb4u.scene.trajectory import Trajectory

ALONE = ("--body", "none", "--frames", 12, "--first-frame", "settled", "--contact", "off")


@pytest.fixture(scope="module")
def napkin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sheet 0.2 m above the ground, as a file."""
    made = sheet(6, 0.4, 0.2)
    lines = [f"v {x} {y} {z}" for x, y, z in made.vertices]
    lines += ["f {} {} {}".format(*(face + 1)) for face in made.faces]
    file = tmp_path_factory.mktemp("napkin") / "napkin.obj"
    file.write_text("\n".join(lines))
    return file


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--wind", "0,0,3", "--air", "off"], "wind has no effect without air"),
        (["--gravity", "0,9"], "it takes three numbers X,Y,Z such as 0,-1.62,0; not '0,9'"),
        (["--gravity", "0,nan,0"], "--gravity must be three finite numbers"),
        (["--air-density", "-1"], "--air-density must be a number, 0 or more, not -1.0"),
        (["--ground", "low"], "it takes a number or none; 'low' is neither"),
        (["--gravity", "0,-1,0", "--model", "skinning"], "--gravity does nothing with --model skinning"),
    ],
)
def test_its_flags_are_refused_by_name(flags: list[str], says: str, pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("simulate", *flags, "--frames", 1, "--out", tmp_path / "a.npz")
    assert ended.code != 0
    assert says in " ".join(ended.err.replace("│", " ").split())


@pytest.mark.parametrize("model", ["solver", "quick-solver", "pb4u-light", "warm-start"])
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_a_file_falls_to_the_ground_without_a_body(pb4u: Callable, napkin: Path, tmp_path: Path, model: str) -> None:
    out, scene, report = tmp_path / "a.npz", tmp_path / "s.toml", tmp_path / "a.json"
    more = ("--model", model, "--out", out, "--save-scene", scene, "--json", report)
    ended = pb4u("simulate", "--garment", napkin, *ALONE, *more)
    assert ended.code == 0, ended.err
    made = Trajectory.open(out)
    heights = np.asarray(made.positions)[..., 1]
    assert heights[0] == pytest.approx(0.2)
    assert (np.diff(heights.mean(1))[:4] < 0.0).all()
    # A start without refinement may dip; where it refines, the ground holds.
    assert heights.min() > (-0.2 if model == "warm-start" else -1e-3)
    assert (made.metadata["body"], made.metadata["motion"], made.metadata["lead_in"]) == ("none", "none", 0)
    assert made.body_positions.shape == (12, 0, 3)
    assert json.loads(report.read_text())["frames"] == 12
    assert 'body = "none"' in scene.read_text()
    assert Run.open(scene).body is None


def test_pins_hold_it_in_another_gravity(pb4u: Callable, napkin: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(
        f'[scene]\nbody = "none"\nframes = 3\n[[garments]]\ngarment = "{napkin}"\npins = [0, 6]\n'
        '[run]\nmodel = "solver"\n[environment]\ngravity = [9.81, 0, 0]\nground = "none"\n'
    )
    ended = pb4u("simulate", scene, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    last = np.asarray(Trajectory.open(tmp_path / "a.npz").positions)[-1]
    rest = sheet(6, 0.4, 0.2).vertices
    np.testing.assert_allclose(last[[0, 6]], rest[[0, 6]], atol=1e-6)
    # It is pulled along its own plane, away from the pins.
    np.testing.assert_allclose(last[:, 1], 0.2, atol=1e-3)
    assert last[:, 0].max() > 0.2


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--garment", "dress"], "dress is fitted to the body that wears it, but --body none gives none"),
        (["--motion", "walk"], "motion needs a body, but --body none gives none; leave it out"),
        (["--body-shape", "height=0.7"], "body-shape needs a body"),
        (["--as-recorded"], "as-recorded needs a body"),
        (["--ground", "0.5"], "napkin reaches 0.30 m below the ground; raise it, or give --ground 0.20 or"),
    ],
)
def test_what_needs_a_body_is_refused_without_one(
    pb4u: Callable, napkin: Path, tmp_path: Path, flags: list[str], says: str
) -> None:
    ended = pb4u("simulate", "--garment", napkin, *flags, *ALONE, "--model", "solver", "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert says in ended.err
    assert not (tmp_path / "a.npz").exists()


def test_a_flag_takes_the_body_of_a_scene_file_away(pb4u: Callable, napkin: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('[scene]\nbody_shape = { height = 0.7 }\nmotion = "twist"\nlead_in = 3\nframes = 2\n')
    flags = ("--garment", napkin, "--body", "none", "--model", "skinning")
    ended = pb4u("simulate", scene, *flags, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    np.testing.assert_allclose(
        np.asarray(Trajectory.open(tmp_path / "a.npz").positions)[1], sheet(6, 0.4, 0.2).vertices
    )
