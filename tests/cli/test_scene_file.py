"""`pb4u simulate SCENE.toml`, `--save-scene`, several garments, and what each flag means for which of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.garment.cloth_shapes import saved as cloth_file, triangle_tube

from pb4u.cli.run_flags import run_of
from pb4u.garment.material import FABRICS, MATERIALS
from pb4u.run import Run, WornGarment
from pb4u.scene.trajectory import Trajectory

SMALL = ("--triangles", 400, "--lead-in", 0, "--model", "skinning", "--frames", 2)

Saved = Callable[..., Run]


class Stopped(Exception):
    """The scene file is written; nothing needs to be simulated."""


def stop(*_: object) -> None:
    raise Stopped


@pytest.fixture
def saved(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Saved:
    """The description that a call would run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pb4u.simulation.run_simulation.build_scene", lambda run, fps: run)
    monkeypatch.setattr("pb4u.cli.simulate._trajectory", stop)

    def call(*arguments: object) -> Run:
        Path("saved.toml").unlink(missing_ok=True)
        with pytest.raises(Stopped):
            pb4u("simulate", "--model", "skinning", *arguments, "--save-scene", "saved.toml")
        return Run.open("saved.toml")

    return call


def test_a_saved_scene_runs_to_the_same_bytes(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--garment", "skirt", "--motion", "dance", "--material", "silk", "--seed", 4, "--body-shape", "height=0.7")
    first = pb4u("simulate", *SMALL, *flags, "--fps", 24, "--out", "a.npz", "--save-scene", "scene.toml")
    assert first.code == 0, first.err
    again = pb4u("simulate", "scene.toml", "--out", "b.npz")
    assert again.code == 0, again.err
    assert Path("a.npz").read_bytes() == Path("b.npz").read_bytes()
    assert Trajectory.open("b.npz").fps == 24.0


def test_without_flags_or_file_everything_has_its_default(saved: Saved) -> None:
    assert saved() == Run(model="skinning")


def test_flags_win_over_the_file(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(
        '[scene]\nframes = 5\nlead_in = 0\nfps = 24\nseed = 3\n[[garments]]\ngarment = "skirt"\ntriangles = 400\n'
        'material = "silk"\n[run]\nmodel = "skinning"\n'
    )
    ended = pb4u("simulate", "scene.toml", "--frames", 2, "--material", "denim", "--fps", 30, "--out", "a.npz")
    assert ended.code == 0, ended.err
    made = Trajectory.open("a.npz")
    assert (made.frame_count, made.fps, made.metadata["seed"]) == (2, 30.0, 3)
    assert made.metadata["garment"] == "skirt"
    assert made.metadata["material"]["density"] == pytest.approx(0.4)


def test_a_flag_also_replaces_what_belonged_to_what_it_replaces(saved: Saved) -> None:
    Path("scene.toml").write_text(
        '[scene]\nbody = "man"\nbody_shape = { height = 0.7, weight = 0.2 }\nmotion = "a.bvh"\ncrop = [3, 9]\n'
        'keep_lead_in = true\n[[garments]]\ngarment = "skirt"\npins = "hem"\n'
    )
    assert saved("scene.toml", "--garment", "dress").garments == (WornGarment("dress"),)
    kept = saved("scene.toml", "--body-shape", "height=0.1")
    assert (kept.body, kept.body_shape) == ("man", {"height": 0.1, "weight": 0.2})
    assert (kept.crop, kept.keep_lead_in, kept.garments[0].pins) == ((3, 9), True, "hem")
    other = saved("scene.toml", "--body", "woman", "--motion", "dance", "--drop-lead-in")
    assert (other.body_shape, other.crop, other.keep_lead_in) == ({}, None, False)
    Path("cast.toml").write_text(
        '[scene]\nbody = "cast.glb"\nbody_parts = "skin"\nclip = "dance"\nomitted = "hands.json"\n'
    )
    alone = saved("cast.toml", "--body", "woman")
    assert (alone.clip, alone.body_parts, alone.omitted) == (None, None, None)
    assert (saved("cast.toml", "--motion", "walk").clip, saved("cast.toml", "--seed", 1).clip) == (None, "dance")


def test_a_tack_of_one_garment_leaves_those_of_the_others(saved: Saved) -> None:
    Path("scene.toml").write_text(
        '[[garments]]\ngarment = "tshirt"\ntacks = [[1, 2]]\n[[garments]]\ngarment = "skirt"\ntacks = [[3, 4]]\n'
    )
    assert [each.tacks for each in saved("scene.toml", "--tack", "skirt=7:8").garments] == [((1, 2),), ((7, 8),)]


def test_as_released_takes_one_pass() -> None:
    assert run_of(Run(), {"as_released": "pb4u"}).passes == 1
    assert run_of(Run(), {"as_released": "pb4u", "passes": 2}).passes == 2


def test_two_garments_are_simulated_and_told_apart(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--garment", "tanktop", "--garment", "cardigan", "--material", "cardigan=wool", "--motion", "dance")
    ended = pb4u("simulate", *SMALL, *flags, "--out", "a.npz")
    assert ended.code == 0, ended.err
    made = Trajectory.open("a.npz")
    assert made.metadata["garment"] == "tanktop+cardigan"
    assert [(each["name"], each["material"]["density"]) for each in made.metadata["garments"]] == [
        ("tanktop", FABRICS["rib"].density), ("cardigan", MATERIALS["wool"].density),
    ]  # fmt: skip
    for garment, each in zip(("tanktop", "cardigan"), made.metadata["garments"], strict=True):
        alone = pb4u("simulate", *SMALL, "--garment", garment, *flags[-2:], "--out", "b.npz")
        assert alone.code == 0, alone.err
        first, stop = each["vertices"]
        # Laid over each other they are some millimetres from where each hangs alone.
        away = np.linalg.norm(made.positions[:, first:stop] - Trajectory.open("b.npz").positions, axis=2)
        assert 0.0 < away.max() < 0.03


@pytest.mark.parametrize(
    ("flags", "materials"),
    [
        ((), [None, None]),
        (("silk",), ["silk", "silk"]),
        (("silk", "wool"), ["silk", "wool"]),
        (("cardigan=wool",), [None, "wool"]),
        (("silk", "cardigan=wool"), ["silk", "wool"]),
        (("cardigan=wool", "tanktop=silk"), ["silk", "wool"]),
    ],
)
def test_a_flag_is_for_all_garments_or_for_each(saved: Saved, flags: tuple[str, ...], materials: list) -> None:
    given = [part for flag in flags for part in ("--material", flag)]
    run = saved("--garment", "tanktop", "--garment", "cardigan", *given, "--triangles", "tanktop=900", "--pins", "none")
    assert [each.garment for each in run.garments] == ["tanktop", "cardigan"]
    assert [each.material for each in run.garments] == materials
    assert [each.triangles for each in run.garments] == [900, None]
    assert [each.pins for each in run.garments] == ["none", "none"]


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--material", "silk", "--material", "wool"), "--material is given 2 times for 1 garments"),
        (("--garment", "tanktop", "--material", "tshirt=silk"), "The scene has no garment 'tshirt'"),
        (("--material", "tshirt=silk", "--material", "tshirt=wool"), "does not say which: it is given 2 times"),
        (("--garment", "tshirt", "--garment", "tshirt"), "tshirt is worn twice"),
        (
            tuple(x for k in range(30) for x in ("--garment", f"{k}.obj")),
            "At most 8 garments can be worn over each other",
        ),
        (("--garment", "tshirt", "--tuck", "shirt"), "The scene has no garment 'shirt'; did you mean tshirt"),
        (("--garment", "tshirt", "--tuck", "tshirt"), "tshirt cannot be tucked in: no other garment has"),
        (("--garment", "tshirt", "--self-contact", "on"), "so --self-contact cannot be on"),
        (("--garment", "a/x.obj", "--garment", "b/x.obj", "--pins", "x=hem"), "the scene has 2 garments of that name"),
        (("absent.toml",), "no scene file absent.toml"),
        (("wrong.toml",), "wrong.toml: [scene] has no entry 'frame'; did you mean frames"),
        (("--save-scene", "absent/s.toml"), "absent for --save-scene does not exist"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: tuple[str, ...], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("wrong.toml").write_text("[scene]\nframe = 3\n")
    ended = pb4u("simulate", *flags, "--model", "skinning", "--out", "a.npz")
    assert ended.code == 1
    assert says in ended.err
    assert len(ended.err.splitlines()) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["wrong.toml"]


@pytest.mark.parametrize(
    "flags",
    [
        ("--triangles", "many"),
        ("--triangles", "tshirt=2.5"),
        ("--body-shape", "height=1,height=2"),
        ("--grain", "0,1"),
        ("--grain", "tshirt=up"),
    ],
)
def test_values_that_are_none_end_with_2(pb4u: Callable, flags: tuple[str, str]) -> None:
    assert pb4u("simulate", *flags).code == 2


def test_shapes_given_apart_add_up_and_the_same_key_twice_is_refused(pb4u: Callable, saved: Saved) -> None:
    assert saved("--body-shape", "height=0.7", "--body-shape", "weight=0.4").body_shape == {
        "height": 0.7, "weight": 0.4,
    }  # fmt: skip
    for verb in (("simulate",), ("check", "tshirt")):
        ended = pb4u(*verb, "--body-shape", "height=0.7", "--body-shape", "height=0.4")
        assert ended.code == 2
        assert "gives height twice" in ended.err


def test_a_file_without_a_rest_shape_means_moulded_and_a_written_one_always_says_it(saved: Saved) -> None:
    assert f'rest_shape = "{Run.rest_shape}"' in saved_text(saved)
    Path("short.toml").write_text('[[garments]]\ngarment = "skirt"\n')
    assert Run.open("short.toml").rest_shape == "moulded"
    assert saved("short.toml").rest_shape == "moulded"
    assert saved("short.toml", "--rest-shape", "flat").rest_shape == "flat"


def saved_text(saved: Saved, *flags: object) -> str:
    """The scene file that a call would write."""
    saved(*flags)
    return Path("saved.toml").read_text()


def test_grain_is_given_by_flag_file_and_in_python(saved: Saved) -> None:
    run = saved("--garment", "skirt", "--garment", "cardigan", "--grain", "skirt=1,0,0.5")
    assert [each.grain for each in run.garments] == [(1.0, 0.0, 0.5), None]
    assert [each.grain for each in run.with_entries({"grain": [0, 1, 0]}).garments] == [(0.0, 1.0, 0.0)] * 2
    assert [each.grain for each in run.with_entries({"grain": [None, [0, 1, 0]]}).garments][1] == (0.0, 1.0, 0.0)


def test_every_entry_has_a_flag(saved: Saved) -> None:
    run = saved(
        "--model", "pb4u-small", "--first-frame", "settled", "--refine", 3, "--passes", 2, "--propagation-steps", 7,
        "--contact", "off", "--self-contact", "off", "--device", "cpu", "--arms-away", 4, "--seed", 9, "--lead-in", 2,
        "--fps", 24, "--frames", 5, "--precision", "bfloat16",
    )  # fmt: skip
    assert run.precision == "bfloat16"
    assert (run.first_frame, run.refine, run.passes, run.propagation_steps) == ("settled", 3, 2, 7)
    assert (run.model, run.contact, run.self_contact, run.device) == ("pb4u-small", False, False, "cpu")
    assert (run.arms_away, run.seed, run.lead_in, run.fps, run.frames) == (4, 9, 2, 24, 5)


def test_a_file_whose_name_holds_an_equals_sign_is_a_file(saved: Saved) -> None:
    Path("a=b.json").write_text("{}")
    assert str(saved("--material", "a=b.json").garments[0].material) == "a=b.json"


def test_a_garment_is_tucked_into_the_trousers(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--garment", "trousers", "--garment", "tanktop", "--tuck", "tanktop", "--save-scene", "s.toml")
    ended = pb4u("simulate", *SMALL, *flags, "--out", "a.npz")
    assert ended.code == 0, ended.err
    assert [each.tucked for each in Run.open("s.toml").garments] == [False, True]
    made = Trajectory.open("a.npz").metadata
    assert made["garment"] == "tanktop+trousers"
    assert [each["source"] for each in made["garments"]] == ["tanktop", "trousers"]


def test_two_files_of_one_name_keep_their_sources(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder, radius in (("a", 0.2), ("b", 0.23)):
        Path(folder).mkdir()
        cloth_file(Path(folder), triangle_tube(low=0.6, high=1.0, radius=radius), "x.obj")
    flags = ("--garment", "a/x.obj", "--garment", "b/x.obj", "--model", "skinning", "--frames", 1, "--lead-in", 0)
    ended = pb4u("simulate", *flags, "--out", "c.npz")
    assert ended.code == 0, ended.err
    garments = Trajectory.open("c.npz").metadata["garments"]
    assert [(each["name"], each["source"]) for each in garments] == [("x", "a/x.obj"), ("x", "b/x.obj")]


def test_check_takes_garments_in_one_way(pb4u: Callable) -> None:
    for flags, says in (
        (("a.obj", "--garment", "tshirt"), "Give a.obj or --garment tshirt, not both; of several garments each as"),
        (("--garment", "skirt", "--garment", "skirt"), "The garment skirt is worn twice"),
        (("--garment", "a.obj", "--garment", "skirt", "--fix", "b.obj"), "--fix repairs one garment at a time"),
    ):
        ended = pb4u("check", *flags)
        assert ended.code == 1
        assert ended.err.startswith(f"pb4u: {says}")
