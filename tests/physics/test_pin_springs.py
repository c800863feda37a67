"""Pins on springs: they give way by the weight over their stiffness, and let go at a frame."""

from __future__ import annotations

import numpy as np
import pytest
from ball_scene import sheet

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.run import Run, WornGarment
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator

STIFFNESS = 40.0


def curtain() -> Garment:
    """A sheet that hangs from one of its sides."""
    flat = sheet(5, 0.3, 0.0)
    vertices = flat.vertices[:, [0, 2, 1]] + [0.0, 1.0, 0.0]
    return Garment("curtain", vertices, flat.faces, flat.material, vertices[:, 1] > vertices[:, 1].max() - 1e-6)


def hung(frames: int, fps: float = 30.0, **options: float | None) -> Trajectory:
    worn = WornGarment(curtain(), **options)  # type: ignore[arg-type]
    scene = make_scene(worn, None, frames=frames, fps=fps)
    return load_simulator("solver", time_integration="implicit-euler", air="off").simulate(scene)


def test_pins_give_way_by_the_weight_over_their_stiffness() -> None:
    still = hung(60, fps=5.0, pin_stiffness=STIFFNESS)
    pinned, weight = curtain().pinned, 9.81 * curtain().vertex_masses.sum()
    fallen = curtain().vertices[pinned, 1] - np.asarray(still.positions)[-1, pinned, 1]
    assert fallen.mean() == pytest.approx(weight / STIFFNESS, rel=0.01)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_pins_let_go_at_their_frame(fps: float) -> None:
    """And are firm until then; the cloth falls freely afterwards."""
    gone = 6
    heights = np.asarray(hung(12, fps, pins_until=gone).positions)[:, curtain().pinned, 1].mean(axis=1)
    assert np.abs(heights[: gone + 1] - 1.15).max() < 1e-3
    assert (np.diff(heights[gone:]) < 0.0).all()
    assert heights[-1] < 1.15 - 0.4 * 9.81 * (5 / fps) ** 2


def test_a_frame_of_letting_go_is_of_the_same_time_at_another_rate() -> None:
    assert Run((WornGarment("skirt", pins_until=10),)).at_rate(60.0).garments[0].pins_until == 20


@pytest.mark.parametrize(
    ("garment", "options", "says"),
    [
        ("skirt", {"pins_until": 4}, "The pins of skirt cannot be released at frame 4: the last frame is 3"),
        ("tshirt", {"pin_stiffness": 100.0}, "Nothing pins tshirt, so it has no pins to soften or release"),
    ],
)
def test_pins_that_cannot_give_way_are_refused(garment: str, options: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        make_scene(WornGarment(garment, triangles=500, **options), frames=4)  # type: ignore[arg-type]


@pytest.mark.parametrize("stiffness", [0.0, -3.0, float("nan")])
def test_an_absurd_stiffness_is_refused(stiffness: float) -> None:
    with pytest.raises(InputError, match="pin_stiffness must be a number"):
        WornGarment("skirt", pin_stiffness=stiffness)
