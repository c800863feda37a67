"""A scene without a body: cloth that falls to the ground or hangs from its pins, simulated, measured and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.simulation.ball_scene import ball_scene, sheet

import pb4u
from pb4u.export.registry import WRITERS
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.measures.excess import excess_heights
from pb4u.simulation.timeline import Timeline

QUIET = pb4u.no_progress


def alone(height: float, held: bool = False, frames: int = 16) -> pb4u.Scene:
    """A sheet over the ground, held along one border or not at all."""
    garment = sheet(8, 0.4, height)
    if held:
        garment = garment.with_pins(garment.vertices[:, 0] < -0.199)
    placed = pb4u.DressedGarment(garment, PrescribedPlacement(garment.vertices[None]))
    return pb4u.Scene((placed,), (), frames)


@pytest.fixture(scope="module")
def fallen() -> pb4u.Trajectory:
    return pb4u.load_simulator("solver", first_frame="placed").simulate(alone(0.2), QUIET)


@pytest.mark.parametrize("model", ["quick-solver", "pb4u-small"])
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_a_sheet_falls_to_the_ground(model: str) -> None:
    """By implicit Euler, of which none bounces."""
    laws = {"first_frame": "placed", "self_contact": False, "time_integration": "implicit-euler"}
    made, solved = (pb4u.load_simulator(name, **laws).simulate(alone(0.2), QUIET) for name in (model, "solver"))
    height, expected = (np.asarray(each.positions)[..., 1] for each in (made, solved))
    # A step that ends 0.03 g out of balance falls by some of that farther.
    np.testing.assert_allclose(height.mean(1), expected.mean(1), atol=5e-3)
    assert -1e-3 < height[-1].min() <= height[-1].max() < 5e-3


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_a_network_alone_sees_no_body() -> None:
    alone_, options = {"refine": 0, "contact": False, "self_contact": False}, {"first_frame": "placed"}
    made = pb4u.load_simulator("pb4u-small", **alone_, **options).simulate(alone(0.2), QUIET)
    height = np.asarray(made.positions)[..., 1].mean(1)
    assert (np.diff(height) < 0.0).all()
    assert height[-1] < 0.05


def test_a_sheet_hangs_from_its_pins() -> None:
    made = pb4u.load_simulator("solver").simulate(alone(1.0, held=True, frames=3), QUIET)
    last, rest = np.asarray(made.positions)[-1], made.header.rest_positions
    pinned = made.header.pinned
    np.testing.assert_allclose(last[pinned], rest[pinned], atol=1e-6)
    assert last[~pinned, 1].max() < 1.0
    assert last[:, 1].min() < 1.0 - 0.3


def test_it_is_measured_and_has_no_excess(fallen: pb4u.Trajectory) -> None:
    measured = pb4u.measure(fallen)
    assert measured["metrics"]["self_intersections"]["max"] == 0.0
    assert not {"penetration_depth_max", "body_intersections", "visible_skin_percent"} & measured["metrics"].keys()
    assert measured["metrics"]["total"]["per_frame"][-1] < measured["metrics"]["total"]["per_frame"][0]
    assert max(excess_heights(fallen)[1:]) < 1e-5


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITERS if suffix not in (".jpg", ".mp4")])
def test_it_is_written_in_every_format(suffix: str, fallen: pb4u.Trajectory, tmp_path: Path) -> None:
    pb4u.export_trajectory(fallen, tmp_path / f"a{suffix}")
    assert any(file.stat().st_size > 0 for file in tmp_path.iterdir())
    if suffix == ".npz":
        again = pb4u.Trajectory.open(tmp_path / "a.npz")
        np.testing.assert_array_equal(again.positions, fallen.positions)
        assert again.body_positions.shape == (16, 0, 3)


def test_a_world_without_a_body_stands_beside_one_with_a_body() -> None:
    both = Timeline.of_worlds([ball_scene(frames=4, lead_in=0), alone(0.2, frames=4)])
    step = both.step_from(both.skinned_state(0))
    planes = step.contacts.now
    assert planes is not None
    mine = step.garments.vertex_world == 1
    assert not planes.touchable[mine].any()
    assert planes.touchable[~mine].any()


def test_a_scene_without_a_garment_is_refused() -> None:
    with pytest.raises(pb4u.InputError, match="A scene has no garment"):
        pb4u.Scene((), (), 2)
