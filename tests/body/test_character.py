"""Rigged characters: skinning, morphs and clips by the specification, and what is made of real files' oddities."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.body.characters import GltfWriter, rewritten, slow_vertices, write_woman

from pb4u.body import character_file
from pb4u.body.bone_names import smpl_names
from pb4u.body.character import Character, PosedCharacter
from pb4u.body.library import load_body
from pb4u.body.node_animation import Channel
from pb4u.body.skeleton import branch
from pb4u.errors import InputError
from pb4u.motion.character_lead_in import character_lead_in
from pb4u.motion.library import load_motion


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Which vertices cloth can reach takes seconds and is asked by one test."""
    if "slow_contact" not in request.fixturenames:
        monkeypatch.setattr(character_file, "reachable", lambda v, f, candidates, rays: candidates)


@pytest.fixture
def slow_contact() -> None:
    """Ask for the real search of reachable vertices."""


@pytest.fixture(scope="module")
def woman_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_woman(tmp_path_factory.mktemp("character") / "woman.glb", unit=0.01)


def loaded(path: Path, **options) -> Character:
    body = load_body(path, **options)
    assert isinstance(body, Character)
    return body


def in_file(body: Character, time: float) -> np.ndarray:
    """Vertices (vertices, 3) of a clip at a time from its first key [s], in the file's own space."""
    poses = body.rig.tree.posed(body.clip, np.array([time]))
    places = PosedCharacter(body, poses, 30.0).positions(0, 1)[0].double().numpy()
    world = body.rig.tree.world
    return (places - world[:3, 3]) @ np.linalg.inv(world[:3, :3]).T


@pytest.mark.parametrize("key", [0, 5, 11])
@pytest.mark.parametrize("clip", ["walk", "arms"])
def test_vertices_are_those_of_the_specification(woman_file, clip, key):
    body = loaded(woman_file, clip=clip)
    slow = slow_vertices(woman_file, ["walk", "arms"].index(clip), 0.5 + key / 30, "Body0")
    ours = in_file(body, key / 30)[body.source_vertices]
    assert np.abs(ours - slow).max() < 2e-6


def test_the_bind_pose_is_the_pose_that_garments_are_fitted_to(woman_file):
    body, woman = loaded(woman_file), load_body("woman")
    # The file has vertices twice, at seams, and a belly that is out by a quarter at rest.
    assert len(body.vertices) == len(woman.vertices)
    assert body.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-9)
    legs = woman.vertices[:, 1] < 0.5
    moved = np.sort(body.vertices[:, 1])[: legs.sum()]
    np.testing.assert_allclose(moved, np.sort(woman.vertices[legs, 1]), atol=1e-5)
    assert body.is_human
    assert body.posed(load_motion("walk").poses(body, 30.0, 2)).is_closed
    for ours, theirs in (("left_shoulder", "upperarm01.L"), ("right_knee", "lowerleg01.R"), ("pelvis", "root")):
        apart = body.skeleton.joints[body.skeleton.index(ours)] - woman.skeleton.joints[woman.skeleton.index(theirs)]
        assert abs(apart[1]) < 1e-4


def test_hair_and_eyes_are_left_out_and_can_be_chosen(woman_file):
    body = loaded(woman_file)
    assert "left out of the body: Hair, EyeIris; --body-parts chooses" in body.notes[0]
    both = loaded(woman_file, parts=("Skin", "Hair"))
    assert len(both.source_vertices) > len(body.source_vertices)
    with pytest.raises(InputError, match=r'"Torso".*Body0'):
        load_body(woman_file, parts=("Torso",))


@pytest.mark.parametrize("split", [2, 3])
def test_several_meshes_and_skins_are_one_closed_body(tmp_path, woman_file, split):
    body = loaded(write_woman(tmp_path / "split.glb", unit=0.01, split=split))
    whole = loaded(woman_file)
    assert len(body.vertices) == len(whole.vertices)
    assert body.skeleton.bone_count == whole.skeleton.bone_count
    apart = np.sort(body.vertices, axis=0) - np.sort(whole.vertices, axis=0)
    assert np.abs(apart).max() < 1e-5
    assert not any("hole" in note for note in body.notes)


def test_a_mirrored_scene_is_turned_outward(tmp_path, woman_file):
    body, plain = loaded(write_woman(tmp_path / "a.glb", mirrored=True)), loaded(woman_file)
    apart = np.sort(body.vertices, axis=0) - np.sort(plain.vertices, axis=0)
    assert np.abs(apart).max() < 1e-5
    a, b, c = (body.vertices[body.faces[:, k]] for k in range(3))
    assert np.einsum("fc,fc->", a, np.cross(b, c)) > 0.0


@pytest.mark.parametrize(
    ("scale", "told"), [([-0.01, -0.01, -0.01], "turned upright and to face"), ([0.01, 0.01, -0.01], "turned to face")]
)
def test_a_body_mirrored_by_a_negative_scale_stands_and_faces_as_others(tmp_path, woman_file, scale, told):
    def mirror(document):
        document["nodes"][0]["scale"] = scale

    body, plain = loaded(rewritten(woman_file, tmp_path / "a.glb", mirror)), loaded(woman_file)
    assert "the scale of a node mirrors it, so its left and right are swapped" in body.notes[1]
    assert told in body.notes[2]
    skeleton, wanted = body.skeleton, plain.skeleton
    size = body.vertices[:, 1].max() / plain.vertices[:, 1].max()
    for name in ("left_wrist", "right_ankle", "head"):
        place = skeleton.joints[skeleton.index(name)] / size
        np.testing.assert_allclose(place, wanted.joints[wanted.index(name)], atol=1e-4)
    a, b, c = (body.vertices[body.faces[:, k]] for k in range(3))
    assert np.einsum("fc,fc->", a, np.cross(b, c)) > 0.0
    slow = slow_vertices(tmp_path / "a.glb", 0, 0.5, "Body0")
    assert np.abs(in_file(body, 0.0)[body.source_vertices] - slow).max() < 2e-6 * size


def test_holes_are_closed(tmp_path):
    def cut(writer: GltfWriter) -> None:
        faces = writer.document["accessors"][writer.document["meshes"][0]["primitives"][0]["indices"]]
        faces["count"] -= 3 * 600

    body = loaded(write_woman(tmp_path / "a.glb", change=cut))
    assert body.posed(load_motion("walk").poses(body, 30.0, 2)).is_closed
    assert any("hole(s) of the surface" in note for note in body.notes)


def test_hands_and_the_inside_of_the_mouth_take_no_part_in_contact(woman_file, slow_contact):
    body, woman = loaded(woman_file), load_body("woman")
    hands = branch(woman.skeleton.parents, [woman.skeleton.index(f"wrist.{side}") for side in "LR"])
    touched = woman.contact & (woman.weights.share_of(hands) <= 0.5)
    assert body.contact.mean() == pytest.approx(touched.mean(), abs=0.02)


def test_it_performs_any_motion(woman_file):
    body, woman = loaded(woman_file), load_body("woman")
    poses = [load_motion("walk").poses(each, 30.0, 20) for each in (body, woman)]
    feet = []
    for each, pose, ankle in ((body, poses[0], "left_ankle"), (woman, poses[1], "foot.L")):
        feet.append(each.posed(pose).joints[:, each.skeleton.index(ankle)])
    # The hips are over the origin in the one, and where the model has them in the other.
    # A foot rolls over the first of the toes' bones in the one, and over the second in the other.
    assert np.abs((feet[0] - feet[0][0]) - (feet[1] - feet[1][0])).max() < 0.02


def test_the_clip_is_led_into_from_the_bind_pose(woman_file):
    body = loaded(woman_file)
    poses = body.clip_poses(30.0, 12)
    led = character_lead_in(body, poses, 30.0, 20)
    assert len(led) == 32
    moving = PosedCharacter(body, led, 30.0)
    frames = moving.positions(0, 32).numpy()
    first = frames[0] - frames[0].mean(axis=0)
    rest = body.vertices - body.vertices.mean(axis=0)
    # The same pose, standing where the walk begins.
    assert np.abs(np.sort(np.linalg.norm(first, axis=1)) - np.sort(np.linalg.norm(rest, axis=1))).max() < 1e-4
    step = np.linalg.norm(np.diff(frames, axis=0), axis=2).max(axis=1)
    assert step[:20].max() < 0.16
    np.testing.assert_allclose(frames[20:], PosedCharacter(body, poses, 30.0).positions(0, 12).numpy(), atol=1e-6)
    assert np.abs(frames[:20, :, 1].min(axis=1)).max() < 0.03


def test_a_lead_in_that_an_uneven_scale_shears_is_refused(tmp_path):
    def tilted(writer):
        writer.document["nodes"][0] |= {"scale": [1.0, 1.0, 2.0], "rotation": [np.sin(0.2), 0.0, 0.0, np.cos(0.2)]}

    body = load_body(write_woman(tmp_path / "woman.glb", change=tilted))
    poses = body.clip_poses(30.0, 3)
    with pytest.raises(InputError, match=r"sheared.*--lead-in 0"):
        character_lead_in(body, poses, 30.0, 2)
    assert len(character_lead_in(body, poses, 30.0, 0)) == 3


@pytest.mark.parametrize(
    "names",
    [
        {"upperleg01": "UpLeg", "lowerleg01": "Leg", "upperarm01": "Arm", "lowerarm01": "ForeArm", "wrist": "Hand"},
        {
            "upperleg01": "thigh",
            "lowerleg01": "calf",
            "upperarm01": "upperarm",
            "lowerarm01": "lowerarm",
            "wrist": "hand",
        },
        {"upperleg01": "Thigh", "lowerleg01": "Shin", "upperarm01": "Shldr", "lowerarm01": "ForeArm", "wrist": "Hand"},
        {"upperleg01": "hip", "lowerleg01": "knee", "upperarm01": "shoulder", "lowerarm01": "elbow", "foot": "ankle"},
    ],
)
@pytest.mark.parametrize("side", ["mixamorig:{side}{name}", "{name}_{letter}", "{letter}{name}", "CC_Base_{L}_{name}"])
def test_rigs_of_many_programs_are_known(names, side):
    skeleton = load_body("woman").skeleton

    def renamed(bone: str) -> str:
        stem, dot, letter = bone.partition(".")
        if not dot:
            return bone
        known = names.get(stem, stem) if not stem.endswith("02") and stem != "shoulder01" else "twist"
        word = {"L": "Left", "R": "Right"}[letter]
        known = known[0].upper() + known[1:] if not side.startswith("{name}") else known
        return side.format(side=word, letter=letter.lower(), L=letter, name=known)

    found = smpl_names([renamed(name) for name in skeleton.names], skeleton.parents.tolist())
    assert found is not None
    wanted = {"left_knee": "lowerleg01.L", "right_shoulder": "upperarm01.R", "pelvis": "root", "left_wrist": "wrist.L"}
    for joint, bone in wanted.items():
        assert found[skeleton.index(bone)] == joint


def test_vrm_names_its_bones_itself(tmp_path):
    skeleton = load_body("woman").skeleton
    bones = {
        "head": "head", "leftUpperLeg": "upperleg01.L", "leftLowerLeg": "lowerleg01.L", "leftFoot": "foot.L",
        "leftUpperArm": "upperarm01.L", "leftLowerArm": "lowerarm01.L", "leftHand": "wrist.L",
    }  # fmt: skip
    bones |= {n.replace("left", "right"): b.replace(".L", ".R") for n, b in bones.items() if n != "head"}
    number = {name: k + 1 for k, name in enumerate(skeleton.names)}  # node 0 is the armature
    for version, extension in (
        ("0", {"VRM": {"humanoid": {"humanBones": [{"bone": n, "node": number[b]} for n, b in bones.items()]}}}),
        ("1", {"VRMC_vrm": {"humanoid": {"humanBones": {n: {"node": number[b]} for n, b in bones.items()}}}}),
    ):

        def change(writer: GltfWriter, extension=extension) -> None:
            writer.document["extensions"] = extension

        path = write_woman(tmp_path / f"{version}.vrm", rename=lambda name: f"b{len(name)}", change=change, clips=())
        body = loaded(path)
        assert body.is_human
        assert body.clip is None
        assert "left_elbow" in body.skeleton.names


def test_bones_of_no_human_move_by_their_clips_alone(tmp_path):
    body = loaded(write_woman(tmp_path / "a.glb", rename=lambda name: f"part {len(name)}"))
    assert not body.is_human
    assert any("its bone names are not those of a human" in note for note in body.notes)
    assert len(body.clip_poses(30.0, 5)) == 5


def test_a_buffer_beside_the_file_is_read(tmp_path, woman_file):
    body = loaded(write_woman(tmp_path / "a.gltf", unit=0.01, clips=()))
    assert len(body.vertices) == len(loaded(woman_file).vertices)
    (tmp_path / "a.bin").unlink()
    with pytest.raises(InputError, match=r"needs a\.bin beside it"):
        load_body(tmp_path / "a.gltf")


@pytest.mark.parametrize("height", [177.0, 1770.0, 17.7, 69.6, 5.8])
def test_a_file_in_another_unit_is_told(tmp_path, height):
    def grow(writer: GltfWriter) -> None:
        armature = writer.document["nodes"][0]
        armature["scale"] = [height / 1.77] * 3

    body = loaded(write_woman(tmp_path / "a.glb", change=grow, clips=()))
    assert body.height == pytest.approx(load_body("woman").height, rel=0.01)
    assert any("so it is read in" in note for note in body.notes)


def test_a_pose_that_is_not_the_bind_pose_is_no_matter(tmp_path, woman_file):
    def pose(writer: GltfWriter) -> None:
        for node in writer.document["nodes"]:
            if node["name"] in ("upperarm01.L", "upperleg01.R", "root"):
                node["rotation"] = [0.3, 0.0, 0.0, 0.95]

    body = loaded(write_woman(tmp_path / "a.glb", unit=0.01, change=pose))
    apart = np.sort(body.vertices, axis=0) - np.sort(loaded(woman_file).vertices, axis=0)
    assert np.abs(apart).max() < 1e-5


@pytest.mark.parametrize(("kind", "wanted"), [("STEP", 1.0), ("LINEAR", 1.5), ("CUBICSPLINE", 1.5)])
def test_key_frames_are_interpolated(kind, wanted):
    values = np.array([[1.0], [2.0]])
    values = (
        np.stack([np.zeros_like(values), values, np.zeros_like(values)], axis=1) if kind == "CUBICSPLINE" else values
    )
    channel = Channel(0, "translation", np.array([0.0, 2.0]), values, kind)
    np.testing.assert_allclose(channel.at(np.array([-1.0, 1.0, 2.0, 9.0]))[:, 0], [1.0, wanted, 2.0, 2.0])


# What cannot be used.


def _without_skin(document):
    for node in document["nodes"]:
        node.pop("skin", None)


def _draco(document):
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]


def _nan(document):
    document["nodes"][3]["translation"] = [1e9, 0.0, 0.0]


def _circle(document):
    document["nodes"][5]["children"] = [0]


def _all_hair(document):
    for material in document["materials"]:
        material["name"] = "Hair"


def _bone_not_there(document):
    document["skins"][0]["joints"] = document["skins"][0]["joints"][:4]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_without_skin, "has no skin: no mesh in it is bound to bones"),
        (_draco, "is compressed by Draco, which pb4u does not read"),
        (_nan, "is damaged"),
        (_circle, "is damaged .*cycle"),
        (_all_hair, r"none of its meshes has the name of a body \(Hair\); name it with --body-parts"),
        (_bone_not_there, "is bound to a bone that does not exist"),
        (lambda document: document["asset"].update(version="1.0"), "not a glTF file of version 2"),
        (lambda document: document["accessors"][0].update(count=10**9), "is cut short"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, woman_file, change, sentence):
    with pytest.raises(InputError, match=sentence):
        load_body(rewritten(woman_file, tmp_path / "b.glb", change))


def test_a_clip_that_is_not_there_is_refused(woman_file, tmp_path):
    with pytest.raises(InputError, match=r'"run".*arms, walk'):
        load_body(woman_file, clip="run")
    with pytest.raises(InputError, match='"run"'):
        load_body(write_woman(tmp_path / "a.glb", clips=()), clip="run")


def test_a_clip_or_parts_of_another_body_are_refused():
    with pytest.raises(InputError, match="--clip"):
        load_body("woman", clip="walk")
    with pytest.raises(InputError, match="leave out --body-parts"):
        load_body("woman", parts=("Skin",))


def test_a_shape_is_refused(woman_file):
    with pytest.raises(InputError, match="height"):
        load_body(woman_file, {"height": 0.5})


def test_a_file_cut_short_is_refused(tmp_path, woman_file):
    whole = woman_file.read_bytes()
    for share in (0.001, 0.5, 0.999):
        (tmp_path / "b.glb").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"b\.glb"):
            load_body(tmp_path / "b.glb")
    shutil.copy(__file__, tmp_path / "c.glb")
    with pytest.raises(InputError, match="not a complete glTF file"):
        load_body(tmp_path / "c.glb")
