"""Bones that cross cloth: found, counted and said, and none of a garment that is worn."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pb4u.body.body_model import PosedBody
from pb4u.collision.crossings import segments_through_faces
from pb4u.measures.limbs import Bones, LimbWatch, limbs_sentence, limbs_through_cloth, watched
from pb4u.measures.run_report import run_report
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord, SkinningSimulator

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("start", "end", "through"),
    [
        ((0.2, 0.2, -1.0), (0.2, 0.2, 1.0), True),
        ((0.2, 0.2, 1.0), (0.4, 0.3, -0.1), True),
        ((0.6, 0.6, -1.0), (0.6, 0.6, 1.0), False),
        ((0.2, 0.2, 0.1), (0.2, 0.2, 1.0), False),
        ((0.2, 0.2, 0.3), (0.9, 0.2, 0.3), False),
    ],
)
def test_a_segment_passes_through_a_face_or_beside_it(start: tuple, end: tuple, through: bool) -> None:
    pairs, places = segments_through_faces(np.array([start]), np.array([end]), TRIANGLE, np.array([[0, 1, 2]]))
    assert len(pairs) == through
    assert places[:, 2] == pytest.approx(0.0)
    turned, again = segments_through_faces(np.array([end]), np.array([start]), TRIANGLE, np.array([[2, 1, 0]]))
    assert len(turned) == through
    np.testing.assert_allclose(again, places)


def test_every_segment_and_face_is_compared() -> None:
    vertices = np.concatenate([TRIANGLE + [0.0, 0.0, height] for height in (0.0, 1.0, 2.0)])
    faces = np.arange(9).reshape(3, 3)
    starts = np.array([[0.1, 0.1, -0.5], [0.1, 0.1, 0.5], [5.0, 0.1, 0.5]])
    pairs, _ = segments_through_faces(starts, starts + [0.0, 0.0, 2.0], vertices, faces)
    assert pairs.tolist() == [[0, 0], [0, 1], [1, 1], [1, 2]]


@cache
def worn() -> tuple[Scene, Trajectory]:
    scene = make_scene("tshirt", "woman", "arms", triangles=300, frames=4, lead_in=2)
    return scene, SkinningSimulator().simulate(scene)


def bones_of(scene: Scene, trajectory: Trajectory) -> Bones:
    return Bones.of(scene, trajectory.frame_count, trajectory.fps)


@cache
def skewered(bone: int | None = None, along: float = 0.5, size: float = 0.05) -> tuple[Scene, Trajectory]:
    """From frame 2 on, a face of the shirt lies across a bone: the left forearm, or another by number."""
    scene, trajectory = worn()
    body = scene.colliders[0]
    assert isinstance(body, PosedBody)
    bones = bones_of(scene, trajectory)
    ends = bones.ends[:, bones.names.index("lowerarm01.L") if bone is None else bone]
    way = ends[:, 1] - ends[:, 0]
    middle = ends[:, 0] + along * way
    positions = np.array(trajectory.positions)
    for t in (2, 3):
        aside = np.cross(way[t], [0.0, 0.0, 1.0])
        up, aside = np.cross(aside, way[t]), size * aside / np.linalg.norm(aside)
        up = size * up / np.linalg.norm(up)
        positions[t, trajectory.faces[0]] = middle[t] + np.array([2 * aside, up - aside, -up - aside])
    return scene, replace(trajectory, positions=positions)


def test_a_garment_that_is_worn_is_crossed_by_no_bone() -> None:
    scene, trajectory = worn()
    bones = bones_of(scene, trajectory)
    assert {"lowerarm01.L", "upperleg02.R"} <= set(bones.names)
    assert not any(re.match(r"finger\d-[23]", name) for name in bones.names), "fingers are left out of contact"
    assert not watched(bones, trajectory)[0].any()
    measured = run_report(trajectory, SkinningSimulator(), scene, RunRecord())
    assert measured["limbs_through_cloth"] == []
    assert measured["metrics"]["limbs_through_cloth"]["per_frame"] == [0.0] * 4
    assert limbs_sentence([], trajectory) is None


def test_a_limb_through_cloth_is_counted_and_said() -> None:
    scene, trajectory = skewered()
    report = run_report(trajectory, SkinningSimulator(), scene, RunRecord())
    # The face was taken from where it covered skin.
    found = next(each for each in report["limbs_through_cloth"] if each["bone"] == "lowerarm01.L")
    assert {name: found[name] for name in ("bone", "first_frame", "frames")} == {
        "bone": "lowerarm01.L", "first_frame": 2, "frames": 2,
    }  # fmt: skip
    counts = report["metrics"]["limbs_through_cloth"]["per_frame"]
    assert counts[:2] == [0.0, 0.0]
    assert min(counts[2:]) >= 1.0
    assert (found["garment"], found["triangles"]) == ("tshirt", found["triangles"])
    (note,) = report["notes"][-1:]
    assert "the left forearm (2)" in note
    assert note.endswith("skinning has no physics, --model quick-solver has."), "no advice as if it held cloth off"


def by(model: str, trajectory: Trajectory, **metadata: object) -> Trajectory:
    """The trajectory as if a model had made it."""
    header = trajectory.header
    told = {**header.metadata, "model": model, "contact": True, **metadata}
    return replace(trajectory, header=replace(header, metadata=told))


def test_the_end_of_a_run_names_one_number_a_garment() -> None:
    trajectory = by("solver", worn()[1])
    found = [
        {"bone": bone, "first_frame": 2, "frames": 4 - k, "garment": "tshirt", "triangles": triangles}
        for k, (bone, triangles) in enumerate([("upperarm01.L", 700), ("upperarm02.L", 900), ("left_elbow", None)])
    ]
    assert limbs_sentence(found, trajectory) == (
        "Limbs have passed through the cloth from frame 2 on, each with its number of frames of 4: the left upper arm "
        "(4), the left "
        "forearm (2); --triangles 900 makes the cloth fine enough for these limbs; --arms-away 8 swings arms away "
        "from the body."
    )
    toes = [{"bone": "toes.L", "first_frame": 0, "frames": 1, "garment": "tshirt", "triangles": None}]
    assert "--" not in str(limbs_sentence(toes, trajectory))
    assert str(limbs_sentence(toes, by("solver", trajectory, contact=False))).endswith("leave out --contact off.")


def test_a_bone_without_skin_of_its_own_is_as_thick_as_its_joint() -> None:
    """Of the five bones of a foot, one has the skin that the ankle moves."""
    bones = bones_of(*worn())
    bare = next(k for k, name in enumerate(bones.names) if name == "foot.L" and not (bones.skin == k).any())
    crossed, watch = watched(bones, skewered(bare, along=0.9, size=0.005)[1])
    assert [k for k in np.flatnonzero(crossed[2]).tolist() if bones.names[k] == "foot.L"] == [bare]
    assert watch.needs["foot.L"][1] is not None


def test_a_bone_outside_of_its_skin_says_nothing() -> None:
    scene, trajectory = skewered()
    bones = bones_of(scene, trajectory)
    assert watched(bones, trajectory)[0][2:].any()
    aside = np.array(trajectory.body_positions)
    aside[3] += [0.0, 0.5, 0.0]
    moved, _ = watched(bones, replace(trajectory, body_positions=aside))
    assert moved[:3].any(axis=1).tolist() == [False, False, True]
    assert not moved[3, bones.names.index("lowerarm01.L")]


def test_a_bone_within_two_parts_that_are_in_each_other_says_nothing() -> None:
    scene, trajectory = skewered()
    bones = bones_of(scene, trajectory)
    arm, trunk = bones.names.index("lowerarm01.L"), bones.names.index("spine02")
    body = np.array(trajectory.body_positions)
    # The trunk is moved over the forearm.
    body[3, bones.skin != arm] += bones.ends[3, arm].mean(axis=0) - bones.ends[3, trunk].mean(axis=0)
    pressed, _ = watched(bones, replace(trajectory, body_positions=body))
    assert pressed[2, arm]
    assert not pressed[3, arm]


def test_the_toes_of_a_foot_are_one() -> None:
    bones = bones_of(*worn())
    assert {name for name in bones.names if name.startswith("toe")} == {"toes.L", "toes.R"}


def test_a_run_that_stopped_being_finite_is_reported_as_diverged_after_its_last_frame() -> None:
    scene, trajectory = worn()
    kept, broken = (run_report(trajectory, SkinningSimulator(), scene, RunRecord(failed_at=at)) for at in (None, 4))
    assert (kept["diverged"], kept["diverged_at"]) == (False, None)
    assert (broken["diverged"], broken["diverged_at"]) == (True, trajectory.frame_count)


def test_a_body_without_a_skeleton_has_none() -> None:
    scene, trajectory = worn()
    bare = bones_of(replace(scene, colliders=()), trajectory)
    assert bare.names == ()
    report = run_report(trajectory, SkinningSimulator(), scene, RunRecord(), limbs=watched(bare, trajectory))
    assert "limbs_through_cloth" not in report["metrics"]


def test_many_bones_of_one_name_are_one_and_the_longest_comes_first() -> None:
    crossed = np.array([[0, 0, 1, 0], [1, 0, 1, 0], [0, 1, 1, 0]], dtype=bool)
    names = ("foot", "foot", "shin", "thigh")
    watch = LimbWatch(Bones(names, np.zeros((3, 4, 2, 3)), np.zeros(0, dtype=np.int64)), worn()[1].header)
    watch.needs = {"shin": ("tights", 3000), "foot": ("tights", None)}
    assert limbs_through_cloth(crossed, watch) == [
        {"bone": "shin", "first_frame": 0, "frames": 3, "garment": "tights", "triangles": 3000},
        {"bone": "foot", "first_frame": 1, "frames": 2, "garment": "tights", "triangles": None},
    ]


@cache
def bared() -> tuple[Scene, Trajectory]:
    """From frame 1 on, the right sleeve lies a centimetre beneath the skin of the upper arm, around its bone."""
    scene = make_scene("longsleeve", "woman", "arms", triangles=1200, frames=3, lead_in=2)
    trajectory = SkinningSimulator().simulate(scene)
    bones = bones_of(scene, trajectory)
    number = bones.names.index("upperarm02.R")
    positions = np.array(trajectory.positions)
    for t in (1, 2):
        start, way = bones.ends[t, number, 0], bones.ends[t, number, 1] - bones.ends[t, number, 0]
        along = (positions[t] - start) @ way / (way @ way)
        offset = positions[t] - start - along[:, None] * way
        length = np.linalg.norm(offset, axis=1)
        sleeve = (along > 0.2) & (along < 0.8) & (length < 0.1)
        positions[t, sleeve] -= 0.03 * (offset / length[:, None])[sleeve]
    return scene, replace(trajectory, positions=positions)


def test_skin_that_comes_out_of_a_sleeve_is_found_though_its_bone_is_inside() -> None:
    scene, trajectory = bared()
    bones = bones_of(scene, trajectory)
    crossed, watch = watched(bones, trajectory)
    (found,) = limbs_through_cloth(crossed, watch)
    assert (found["bone"], found["first_frame"], found["frames"]) == ("upperarm02.R", 1, 2)


def test_the_triangles_that_would_hold_go_with_the_limb_and_the_edges() -> None:
    """Edges that span 22 degrees of the arm: the same count for a finer mesh of the same cloth."""
    scene, trajectory = bared()
    watch = watched(bones_of(scene, trajectory), by("pb4u-wide", trajectory))[1]
    garment_name, enough = watch.needs["upperarm02.R"]
    assert garment_name == "longsleeve"
    assert enough is not None
    garment = scene.garments[0].garment
    # An upper arm is 3 to 5 cm from its axis to its skin; no more than eight times as many are named.
    edges = garment.mean_edge_length * np.sqrt(garment.triangle_count / enough)
    assert 0.03 < edges / (2.0 * np.sin(np.radians(11.0))) < 0.06 or enough == 100 * np.ceil(
        0.08 * garment.triangle_count
    )
    said: dict[str, int] = {}
    assert watch.sentences(["upperarm02.R"], 1, said) == [
        f"Frame 1: the right upper arm is through the longsleeve: try --triangles {enough} or --arms-away 8."
    ]
    assert watch.sentences(["upperarm02.R"], 2, said) == ["Frame 2: the right upper arm is through the longsleeve."]


def test_a_warning_names_the_garment_the_limbs_and_one_number() -> None:
    trajectory = worn()[1]
    needs = {"upperleg01.L": ("trousers", 2100), "upperleg02.L": ("trousers", 2200), "foot.R": ("trousers", None)}

    def sentences(model: str, **metadata: object) -> list[str]:
        garments = [{"name": name} for name in ("tshirt", "trousers")]
        watch = LimbWatch(bones_of(*worn()), by(model, trajectory, garments=garments, **metadata).header)
        watch.needs = dict(needs)
        return watch.sentences(list(needs), 0, {})

    assert sentences("pb4u-light") == [
        "Frame 0: the left thigh and the right foot are through the trousers: try --triangles trousers=2200."
    ]
    assert sentences("skinning") == []
    assert sentences("solver", contact=False)[0].endswith("nothing keeps it off the body: leave out --contact off.")
    needs = {"foot.L": ("trousers", None)}
    assert "--model solver." in sentences("quick-solver")[0]
    assert "slower" in sentences("solver")[0]
