"""Garments, bodies and materials from arrays in Python: what is taken, and one sentence on what is not."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pb4u
from pb4u.run import Run, WornGarment

CLOTH = pb4u.Material.named("cotton")


@pytest.fixture(scope="module")
def skirt() -> pb4u.Garment:
    return pb4u.build_garment("skirt", pb4u.load_body("woman"), 1000)


def garment(skirt: pb4u.Garment, **changes: Any) -> pb4u.Garment:
    given: dict[str, Any] = {"name": "mine", "vertices": skirt.vertices, "faces": skirt.faces, "material": CLOTH}
    return pb4u.Garment(**{**given, **changes})


def test_lists_are_taken_for_arrays_and_simulated(skirt: pb4u.Garment) -> None:
    mine = garment(skirt, vertices=skirt.vertices.tolist(), faces=skirt.faces.tolist())
    np.testing.assert_array_equal(mine.vertices, skirt.vertices)
    scene = pb4u.make_scene(mine, "woman", pins="waist", frames=2, lead_in=0)
    assert pb4u.load_simulator("skinning").simulate(scene, pb4u.no_progress).frame_count == 2
    assert pb4u.Material.named("cotton").density == 0.15


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (lambda g: {"vertices": g.vertices.T}, r"shape \(3, \d+\); it must be \(vertices, 3\); transpose"),
        (lambda g: {"faces": np.zeros((4, 4), dtype=int)}, "cut each quad into two triangles"),
        (lambda g: {"faces": np.where(g.faces == 5, -1, g.faces)}, r"face \d+ is .*indices run from 0 to"),
        (lambda g: {"faces": g.faces.astype(float)}, "must be whole numbers"),
        (lambda g: {"faces": [[0, 1, 2], [1, 2]]}, "lists of different lengths"),
        (lambda g: {"vertices": np.where(g.vertices > 1.0, np.nan, g.vertices)}, "are NaN or infinite, the first"),
        (lambda g: {"vertices": "skirt.obj"}, "must be numbers"),
        (lambda g: {"pinned": [0, 1, 2]}, r"pinned must hold one bool for each of its \d+ vertices"),
        (lambda g: {"material": "cotton"}, r"such as pb4u\.Material\.named"),
        (lambda g: {"uvs": g.vertices[:, :2]}, "belong together"),
        (lambda g: {"uvs": g.vertices, "uv_faces": g.faces}, r"it must be \(uv points, 2\)"),
    ],
)
def test_arrays_that_cannot_be_a_garment_are_refused_in_one_sentence(
    skirt: pb4u.Garment, changes: Any, says: str
) -> None:
    with pytest.raises(pb4u.InputError, match=rf"^garment mine: .*{says}"):
        garment(skirt, **changes(skirt))


@pytest.mark.parametrize(
    ("moved", "says"),
    [
        (lambda v: 100.0 * v, "seems to be in centimetres"),
        (lambda v: v + np.array([1000.0, 0.0, 0.0]), r"nearest point is 9\d\d"),
        (lambda v: 0.1 * (v - v.mean(axis=0)) + np.array([0.0, 1.0, 0.0]), "lies wholly inside the body"),
    ],
)
def test_what_no_body_wears_is_noticed(skirt: pb4u.Garment, moved: Any, says: str) -> None:
    with pytest.raises(pb4u.InputError, match=says):
        pb4u.make_scene(garment(skirt, vertices=moved(skirt.vertices)), "woman", frames=1, lead_in=0)


def test_vertices_that_no_face_has_are_counted_and_refused(skirt: pb4u.Garment) -> None:
    mine = garment(skirt, vertices=[*skirt.vertices, [0.0, 1.0, 0.3], [0.1, 1.0, 0.3]])
    count = len(skirt.vertices)
    with pytest.raises(
        pb4u.InputError, match=rf"^garment mine: 2 of its {count + 2} vertices .*\[{count}, {count + 1}\]"
    ):
        pb4u.make_scene(mine, "woman", frames=1, lead_in=0)


def test_a_body_from_arrays_is_worn_by(skirt: pb4u.Garment) -> None:
    woman = pb4u.load_body("woman")
    body = pb4u.body_from_arrays(woman.vertices.tolist(), woman.faces.tolist(), name="me")
    assert isinstance(body, pb4u.AnimatedBody)
    scene = pb4u.make_scene(garment(skirt), body, pins="waist", frames=2, lead_in=0)
    assert (scene.colliders[0].name, scene.frames) == ("me", 2)
    for vertices, faces, says in (
        (woman.vertices, woman.faces - 1, "indices run from 0"),
        (woman.vertices.T, woman.faces, r"\(frames, vertices, 3\) or \(vertices, 3\)"),
        (
            10.0 * woman.vertices,
            woman.faces,
            'coordinates must be in metres, and these seem to be decimetres: give units="decim',
        ),
    ):
        with pytest.raises(pb4u.InputError, match=says):
            pb4u.body_from_arrays(vertices, faces)
    with pytest.raises(pb4u.InputError, match="body_from_arrays"):
        pb4u.make_scene("tshirt", woman.vertices)
    with pytest.raises(pb4u.InputError, match=r"pb4u\.Garment"):
        pb4u.make_scene(skirt.vertices)


def test_the_ground_is_put_under_a_body_that_does_not_stand_on_it(skirt: pb4u.Garment) -> None:
    woman, heights = pb4u.load_body("woman"), list[np.ndarray]()
    for down in (0.0, 0.95):
        shift = np.array([0.0, down, 0.0])
        body = pb4u.body_from_arrays(np.stack([woman.vertices - shift] * 2), woman.faces, name="me")
        mine = garment(skirt, vertices=skirt.vertices - shift, pinned=skirt.pinned)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", pb4u.InputWarning)
            scene = pb4u.make_scene(mine, body, frames=2, lead_in=0)
        said = [note for note in scene.notes if "below height 0, so the ground is put there" in note]
        assert (len(said), said) == (down > 0.0, [str(each.message) for each in told if "ground" in str(each.message)])
        assert scene.environment.ground == pytest.approx(-down, abs=0.02)
        made = pb4u.load_simulator("quick-solver").simulate(scene, pb4u.no_progress)
        heights.append(np.asarray(made.positions)[-1, :, 1] + down)
    # It was crushed on the ground before: 15 cm high.
    assert np.ptp(heights[1]) == pytest.approx(np.ptp(heights[0]), abs=0.01)


def test_a_scene_is_shown_in_five_lines_and_is_not_measured(skirt: pb4u.Garment) -> None:
    scene = pb4u.make_scene(garment(skirt), "woman", pins="waist", frames=2, lead_in=0)
    told = repr(scene).splitlines()
    assert len(told) == 5
    assert "mine" in told[1]
    assert "walk" in told[3]
    with pytest.raises(pb4u.InputError, match="measure takes a Trajectory"):
        pb4u.measure(scene)


@pytest.mark.parametrize("as_text", [True, False])
def test_an_interrupt_in_python_keeps_the_frames(skirt: pb4u.Garment, tmp_path: Path, as_text: bool) -> None:
    scene = pb4u.make_scene(garment(skirt), "woman", pins="waist", frames=5, lead_in=0)

    def interrupt(done: int, _: int) -> None:
        if done == 4:
            raise KeyboardInterrupt

    file = tmp_path / "a.npz"
    with pytest.raises(KeyboardInterrupt, match="first 3 frames are in"):
        pb4u.load_simulator("skinning").simulate_to(scene, str(file) if as_text else file, progress=interrupt)
    assert pb4u.Trajectory.open(tmp_path / "a.interrupted.npz").frame_count == 3


@pytest.mark.parametrize("as_text", [True, False])
def test_an_interrupt_of_a_run_that_is_resampled_keeps_the_frames(tmp_path: Path, as_text: bool) -> None:
    run = Run(WornGarment("skirt", triangles=500), frames=8, lead_in=0, fps=60.0, model="pb4u-light", refine=1)

    def interrupt(done: int, _: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    file = tmp_path / "a.npz"
    with pytest.raises(KeyboardInterrupt, match="first 2 frames are in"), warnings.catch_warnings():
        warnings.simplefilter("ignore", pb4u.InputWarning)
        run.simulate(str(file) if as_text else file, interrupt)
    kept = pb4u.Trajectory.open(tmp_path / "a.interrupted.npz")
    assert (kept.frame_count, kept.fps) == (2, 30.0)
