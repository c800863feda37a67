"""`pb4u simulate`: what it writes, and how it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.export.readers import pc2_frames
from tests.garment.cloth_shapes import quad_tube, saved

from pb4u.errors import InputError
from pb4u.export.live_caches import PROGRESS
from pb4u.export.selection import on_source
from pb4u.geometry.obj_file import read_obj
from pb4u.measures.divergence import skinned_centres
from pb4u.measures.limbs import LimbWatch
from pb4u.measures.metrics import ENERGIES, GEOMETRY, first_diverged, measure
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation import run_simulation
from pb4u.simulation.simulator import RunRecord, SkinningSimulator

SMALL = ("--triangles", 1000, "--lead-in", 0, "--model", "skinning")


def test_pictures_take_their_look_from_flags_and_other_files_do_not_mind(pb4u: Callable, tmp_path: Path) -> None:
    flags = ("simulate", *SMALL, "--frames", 2, "--garment", "tshirt", "--garment", "skirt", "--size", "60x90")
    look = ("--view", "back", "--elevation", 20, "--colour", "crimson", "--colour", "lime", "--background", "#204060")
    ended = pb4u(*flags, *look, "--out", tmp_path / "a.npz", "--out", tmp_path / "a.png")
    assert ended.code == 0, ended.err
    strip = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    assert strip.shape == (90, 2 * 60, 3)
    assert np.abs(strip[0, 0] - [0x20, 0x40, 0x60]).max() <= 2
    red, green = (strip[..., k] > 2 * strip[..., 1 - k] for k in (0, 1))
    assert min(red.sum(), green.sum()) > 100
    refused = pb4u(*flags, "--out", tmp_path / "b.npz")
    assert refused.code == 1
    assert ".npz is not a picture" in refused.err
    assert not (tmp_path / "b.npz").exists()


def test_writes_trajectory_objs_and_report_by_the_contract(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u(
        "simulate", *SMALL, "--frames", 3, "--fps", 24, "--material", "silk", "--seed", 5,
        "--out", tmp_path / "a.npz", "--out", tmp_path / "b.obj", "--json", tmp_path / "r.json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    trajectory = Trajectory.open(tmp_path / "a.npz")
    assert trajectory.positions.shape[0] == trajectory.body_positions.shape[0] == 3
    assert trajectory.fps == 24.0
    assert {"garment", "triangles", "motion", "body", "model", "propagation_steps", "seed", "versions"} <= set(
        trajectory.metadata
    )
    assert set(trajectory.metadata["material"]) == {"density", "lame_mu", "lame_lambda", "bending", "thickness"}
    assert sorted(p.name for p in tmp_path.glob("b_*.obj")) == ["b_0000.obj", "b_0001.obj", "b_0002.obj"]
    written = np.array([row.split()[1:] for row in (tmp_path / "b_0001.obj").open() if row.startswith("v ")], float)
    np.testing.assert_allclose(written, trajectory.positions[1], atol=1e-6)

    report = json.loads((tmp_path / "r.json").read_text())
    assert report["triangles"] == len(trajectory.faces)
    assert report["frames"] == 3
    assert abs(report["triangles"] - 1000) <= 50
    names = {"stretch", "bending", "collision", "gravity", "friction", "inertia", "total"}
    assert names <= set(report["metrics_paper"]) == set(ENERGIES)
    assert set(report["metrics"]) == {*ENERGIES, *GEOMETRY, "limbs_through_cloth"}
    assert set(GEOMETRY) == {
        "strain_p95", "strain_max", "penetration_percent", "penetration_depth_max", "visible_skin_percent",
        "self_intersections", "body_intersections", "body_intersections_pinched",
    }  # fmt: skip
    assert all(len(entry["per_frame"]) == 3 for entry in report["metrics"].values())
    assert report["diverged"] is False


def stopped(*_: object) -> None:
    raise InputError("No step is taken here.")


def test_json_alone_goes_to_standard_output(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("simulate", *SMALL, "--frames", 1, "--out", tmp_path / "a.npz", "--json", "-")
    assert json.loads(ended.out)["frames"] == 1


def test_a_limb_through_the_cloth_is_warned_of_with_and_without_a_report(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flags = (
        "simulate",
        *SMALL,
        "--garment",
        "skirt",
        "--material",
        "default",
        "--frames",
        2,
        "--out",
        tmp_path / "a.npz",
    )
    assert "through the cloth" not in pb4u(*flags).err

    def through(watch: LimbWatch, t: int, cloth: np.ndarray, body: np.ndarray) -> np.ndarray:
        searched.append(t)
        watch.needs = dict.fromkeys(watch.bones.names[:1], ("tshirt", 5000))
        return np.arange(len(watch.bones.names)) == 0

    searched: list[int] = []
    monkeypatch.setattr(LimbWatch, "through", through)
    for report in ((), ("--json", tmp_path / "r.json")):
        searched.clear()
        ended = pb4u(*flags, *report)
        assert searched == [0, 1], "each frame once"
        assert "Limbs have passed through the cloth from frame 0 on" in ended.err
        assert ended.err.count("skinning has no physics, --model quick-solver has") == 1
        assert "--triangles" not in ended.err
    assert json.loads((tmp_path / "r.json").read_text())["limbs_through_cloth"][0]["triangles"] == 5000
    assert "Limbs have passed through the cloth" in json.loads((tmp_path / "r.json").read_text())["notes"][-1]


def test_tells_the_files_that_it_wrote_when_they_are_there(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("simulate", *SMALL, "--frames", 3)
    ended = pb4u(*flags, "--out", "a.npz", "--out", "b.obj", "--out", "b.pc2", "--json", "r.json")
    assert ended.out == "Wrote a.npz, b_0000.obj to b_0002.obj, b.pc2, b.obj\n"
    monkeypatch.setattr("pb4u.cli.simulate._export", lambda *_: None)
    assert pb4u(*flags).out.startswith("Wrote tshirt_walk.npz, tshirt_walk.glb, tshirt_walk.png, tshirt_walk.")
    assert pb4u(*flags, "--garment", "tshrt").out == ""


def test_what_was_done_with_an_input_is_a_note_and_no_warning(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_simulation, "roll_out", stopped)
    assert pb4u("assets", "write", "skirt", tmp_path / "skirt.obj", "--triangles", 1500).code == 0
    flags = ("simulate", "--model", "skinning", "--frames", 1, "--out", tmp_path / "a.npz")
    said = pb4u(*flags, "--garment", tmp_path / "skirt.obj").err
    assert "pb4u: note: skirt: its waistband, " in said
    assert "warning: skirt: its waistband" not in said


def test_a_result_of_another_scene_is_replaced_with_a_note(pb4u: Callable, tmp_path: Path) -> None:
    flags = ("simulate", *SMALL, "--out", tmp_path / "a.npz", "--frames")
    (tmp_path / "a.npz").write_bytes(b"no trajectory")
    assert [pb4u(*flags, 2).err.count("note: ") for _ in range(2)] == [0, 0]
    assert "a.npz holds another scene (tshirt, walk, 2 frames) and will be replaced" in pb4u(*flags, 3).err


def test_cuda_is_no_use_to_what_runs_on_the_processor(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_simulation, "roll_out", stopped)
    flags = ("simulate", *SMALL[:4], "--frames", 1, "--out", tmp_path / "a.npz")
    for model in ("skinning", "solver"):
        said = pb4u(*flags, "--model", model, "--device", "cuda").err
        assert f"pb4u: warning: {model} always runs on the CPU; --device cuda is for networks.\n" in said
    assert "CPU" not in pb4u(*flags, "--model", "skinning", "--device", "auto").err


def test_same_seed_same_bytes(pb4u: Callable, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert pb4u("simulate", *SMALL, "--frames", 2, "--seed", 3, "--out", tmp_path / f"{name}.npz").code == 0
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--frames", -3), "1 or more"),
        (("--triangles", -5), "between 200 and 200"),
        (("--garment", "tshrt"), "tshirt"),
        (("--body", "womn"), "woman"),
        (("--motion", "wlak"), "walk"),
        (("--material", "slik"), "silk"),
        (("--model", "sovler"), "solver"),
        (("--garment", "absent.obj"), "absent.obj"),
        (("--motion", "absent.bvh"), "absent.bvh"),
        (("--body-shape", "hight=0.5"), "height"),
        (("--fps", 0), "from 1 to 1,000"),
        (("--fps", "1e-9"), "from 1 to 1,000"),
        (("--fps", "1e9"), "from 1 to 1,000"),
        (("--lead-in", -1), "0 or more"),
        (("--pins", "sleeve"), "loop"),
        (("--refine", -1, "--model", "solver"), "from 0 to 10,000"),
        (("--seed", -1), "0 or more"),
        (("--fps", "nan"), "from 1 to 1,000"),
        (("--arms-away", "nan"), "0 to 90"),
        (("--json", "absent/r.json"), "does not exist"),
    ],
)
def test_bad_values_are_refused_in_one_sentence(
    pb4u: Callable, tmp_path: Path, flags: tuple[object, ...], says: str
) -> None:
    count = () if flags[0] == "--triangles" else ("--triangles", 1000)
    ended = pb4u("simulate", "--model", "skinning", "--frames", 1, *count, *flags, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    last = ended.err.strip().splitlines()[-1]
    assert last.startswith("pb4u: ")
    assert says in last
    assert "Traceback" not in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "flags",
    [
        ("--frames", "many"), ("--flavour", "red"), ("--contact", "perhaps"), ("--crop", "abc"), ("--crop", "9:3"),
        ("--body-shape", "height"), ("--body-shape", "height=tall"),
    ],
)  # fmt: skip
def test_flags_that_cannot_be_understood_end_with_2(pb4u: Callable, flags: tuple[str, str]) -> None:
    ended = pb4u("simulate", *flags)
    assert ended.code == 2
    assert "Traceback" not in ended.err


def test_ranges_and_shapes_that_are_understood_arrive(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("simulate", *SMALL, "--frames", 1, "--crop", "3:9", "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert "no end to crop" in ended.err
    for shape, out in (("height=0.9", "tall.npz"), ("height=0.1, weight=0.5", "short.npz")):
        assert pb4u("simulate", *SMALL, "--frames", 1, "--body-shape", shape, "--out", tmp_path / out).code == 0
    tall, short = (Trajectory.open(tmp_path / out).body_positions[0, :, 1].max() for out in ("tall.npz", "short.npz"))
    assert tall > short + 0.1


def test_the_lead_in_can_be_written(pb4u: Callable, tmp_path: Path) -> None:
    flags = ("simulate", *SMALL[:2], "--model", "skinning", "--frames", 3, "--lead-in", 4)
    assert pb4u(*flags, "--out", tmp_path / "a.npz").code == 0
    assert pb4u(*flags, "--keep-lead-in", "--out", tmp_path / "b.npz").code == 0
    written, kept = Trajectory.open(tmp_path / "a.npz"), Trajectory.open(tmp_path / "b.npz")
    assert (written.frame_count, kept.frame_count) == (3, 7)
    np.testing.assert_array_equal(kept.positions[4:], written.positions)
    # It starts in the rest pose, turned and placed where the motion begins.
    np.testing.assert_allclose(kept.positions[0, :, 1], kept.header.rest_positions[:, 1], atol=1e-5)
    assert "first 4 frames lead" in kept.metadata["notes"][-1]


@pytest.fixture
def moving_body(pb4u: Callable, tmp_path: Path) -> Path:
    assert pb4u("assets", "write", "walk", tmp_path / "moving.npz", "--frames", 3).code == 0
    assert pb4u("assets", "write", "dress", tmp_path / "dress.obj", "--triangles", 1000).code == 0
    return tmp_path / "moving.npz"


@pytest.mark.slow
def test_a_sequence_of_vertices_takes_no_motion_crop_or_pose(pb4u: Callable, moving_body: Path, tmp_path: Path) -> None:
    call = ("simulate", "--garment", tmp_path / "dress.obj", "--body", moving_body, *SMALL[2:])
    for flags in (("--crop", "0:2"), ("--arms-away", 8)):
        ended = pb4u(*call, *flags, "--out", tmp_path / "a.npz")
        assert ended.code == 1
        assert f"so {flags[0]} cannot be applied" in ended.err.strip().splitlines()[-1]
        assert not (tmp_path / "a.npz").exists()
    warned = pb4u(*call, "--motion", "dance", "--out", tmp_path / "a.npz")
    assert warned.code == 0, warned.err
    assert "the motion dance is not used" in warned.err
    silent = pb4u(*call, "--out", tmp_path / "b.npz")
    assert silent.code == 0, silent.err
    assert "not used" not in silent.err
    assert Trajectory.open(tmp_path / "b.npz").metadata["motion"] == "moving"
    slower = pb4u(*call, "--recorded-fps", 15, "--out", tmp_path / "c.npz")
    assert slower.code == 0, slower.err
    played, halved = (Trajectory.open(tmp_path / name).body_positions for name in ("b.npz", "c.npz"))
    np.testing.assert_array_equal(halved[0], played[0])
    np.testing.assert_allclose(halved[1], 0.5 * (played[0] + played[1]), atol=1e-6)


def test_a_moving_body_given_as_motion_is_told_apart(pb4u: Callable, moving_body: Path, tmp_path: Path) -> None:
    ended = pb4u("simulate", *SMALL, "--motion", moving_body, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert ended.err == (
        f"pb4u: {moving_body} is a body that moves, not a recording; give it as --body {moving_body}.\n"
    )


@pytest.mark.parametrize("json_flag", [(), pytest.param(("--json", "r.json"), marks=pytest.mark.slow)])
def test_a_run_that_diverged_is_written_and_warned_of(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, json_flag: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("simulate", *SMALL, "--frames", 4, "--out", "a.npz", *json_flag)
    assert "diverged" not in pb4u(*flags).err
    rollout = SkinningSimulator.rollout

    def falling(self: SkinningSimulator, scene: Scene, record: RunRecord) -> Iterator[State]:
        for frame, state in enumerate(rollout(self, scene, record)):
            yield replace(state, positions=state.positions - 0.2 * max(0, frame - 1))

    monkeypatch.setattr(SkinningSimulator, "rollout", falling)
    ended = pb4u(*flags)
    assert ended.code == 0
    assert "warning: The run diverged at frame 3: " in ended.err
    assert "try --model solver" in ended.err


def test_divergence_is_judged_as_the_report_does() -> None:
    scene = make_scene(triangles=1000, lead_in=0, frames=5)
    plain = SkinningSimulator().simulate(scene)
    centres = skinned_centres(scene, plain)
    wide, lost, fallen = (plain.positions.copy() for _ in range(3))
    wide[2:] = wide[2:] * (1.8, 1.0, 1.8)
    lost[4, 7, 1] = np.nan
    fallen[3:, :, 1] -= 0.6
    found = []
    for positions in (plain.positions, wide, lost, fallen):
        run = replace(plain, positions=positions)
        found.append(first_diverged(run, centres))
        assert found[-1] == measure(run, centres)["diverged_at"]
    assert found == [None, 2, 4, 3]


def test_the_author_s_quads_come_back_moved(pb4u: Callable, tmp_path: Path) -> None:
    mesh = quad_tube(low=0.6, high=1.0, radius=0.22)
    garment = saved(tmp_path, mesh)
    ended = pb4u("simulate", "--garment", garment, *SMALL, "--frames", 2, "--out", tmp_path / "a.npz")
    assert ended.code == 0, ended.err
    assert "`pb4u convert --on source` writes them whole" in ended.err
    assert pb4u("convert", tmp_path / "a.npz", tmp_path / "mine.obj", "--on", "source").code == 0
    moved = read_obj(tmp_path / "mine_0001.obj")
    np.testing.assert_array_equal(np.stack(moved.polygons), np.stack(mesh.polygons))
    assert moved.polygon_uvs is not None
    np.testing.assert_array_equal(np.stack(moved.polygon_uvs), np.stack(mesh.polygon_uvs))
    assert moved.vertices.shape == mesh.vertices.shape


def test_targets_are_checked_before_any_work(pb4u: Callable, tmp_path: Path) -> None:
    unknown = pb4u("simulate", *SMALL, "--out", tmp_path / "a.xyz")
    assert unknown.code == 1
    assert ".npz" in unknown.err
    absent = pb4u("simulate", *SMALL, "--out", tmp_path / "absent" / "a.npz")
    assert absent.code == 1
    assert "does not exist" in absent.err


def test_recording_that_ends_early_says_so(pb4u: Callable, test_data: Path, tmp_path: Path) -> None:
    clip = test_data / "motions" / "cmu_asfamc" / "07" / "07_02.amc"
    ended = pb4u("simulate", *SMALL, "--motion", clip, "--frames", 500, "--out", tmp_path / "a.npz")
    assert ended.code == 0
    assert "ends after 83 frames" in ended.err
    assert Trajectory.open(tmp_path / "a.npz").frame_count == 83


def test_debug_shows_where_an_error_came_from(pb4u: Callable) -> None:
    assert "Traceback" in pb4u("simulate", "--garment", "tshrt", "--debug").err


@pytest.mark.parametrize(
    ("model", "flags"),
    [
        ("solver", ("--refine", 3)), ("solver", ("--passes", 2)), ("solver", ("--propagation-steps", 5)),
        ("quick-solver", ("--passes", 2)), ("solver", ("--precision", "bfloat16")),
        ("skinning", ("--propagation-steps", 5)), ("skinning", ("--contact", "off")),
    ],
)  # fmt: skip
def test_a_flag_that_would_do_nothing_is_refused(pb4u: Callable, tmp_path: Path, model: str, flags: tuple) -> None:
    ended = pb4u("simulate", "--model", model, *flags, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert ended.err == f"pb4u: {flags[0]} does nothing with --model {model}; leave it out.\n"


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--propagation-steps", -1), "--propagation-steps must be a whole number from 1 to 500"),
        (("--refine", 99999999999), "from 0 to 10,000"),
        (("--frames", 0), "--frames must be a whole number, 1 or more, not 0."),
        (("--passes", 0), "--passes must be a whole number from 1 to 1,000"),
        (("--passes", 1000000), "from 1 to 1,000"),
    ],
)
def test_a_number_out_of_range_is_refused_whatever_the_model(
    pb4u: Callable, tmp_path: Path, flags: tuple, says: str
) -> None:
    ended = pb4u("simulate", "--model", "skinning", *flags, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert says in ended.err


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("tshirt",), "give it as --garment tshirt."),
        (("shirt.obj",), "give it as --garment shirt.obj."),
        (("clip.npz",), "pb4u view clip.npz plays it"),
        (("--motion", "clip.mp4"), "GVHMR, WHAM or TRAM"),
        (("--body", "figure.fbx"), "import it in Blender"),
        (("--garment", "shirt.fbx"), "import it in Blender"),
        (("--garment", "pants"), "did you mean trousers"),
        (("--garment", "coat"), "did you mean cardigan"),
        (("--body", "female"), "did you mean woman"),
        (("--body", "smpl"), "give the file of the model"),
        (("--material", "polyester"), "did you mean polyester-plain"),
        (("--recorded-fps", 60), "was not recorded; leave out"),
        (("--texture", "clip.mp4"), "is not an image"),
    ],
)
def test_what_was_meant_is_told(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: tuple, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("shirt.obj", "clip.npz", "clip.mp4", "figure.fbx", "shirt.fbx"):
        Path(name).write_text("no such thing")
    ended = pb4u("simulate", *given)
    assert ended.code == 1
    assert says in ended.err


def test_shape_parameters_add_up_and_none_is_given_twice(pb4u: Callable, tmp_path: Path) -> None:
    out = tmp_path / "a.npz"
    flags = ("simulate", *SMALL, "--frames", 1, "--out", out)
    assert pb4u(*flags, "--body-shape", "height=0.7", "--body-shape", "weight=0.4").code == 0
    shape = Trajectory.open(out).metadata["body_shape"]
    assert (shape["height"], shape["weight"]) == (0.7, 0.4)
    assert "twice" in pb4u(*flags, "--body-shape", "height=0.5,height=0.9").err
    assert "twice" in pb4u(*flags, "--body-shape", "height=0.5", "--body-shape", "height=0.9").err


def test_a_run_that_is_broken_from_its_start_fails(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pb4u.measures.metrics.first_diverged", lambda *_, **__: 0)
    ended = pb4u("simulate", *SMALL, "--frames", 1, "--out", tmp_path / "a.npz")
    assert ended.code == 1
    assert "broken at its first frame" in ended.err
    assert (tmp_path / "a.npz").exists()


def test_a_run_of_the_command_line_is_followed(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    skirt = quad_tube(low=0.6, high=0.95, radius=0.21)
    saved(tmp_path, skirt, "skirt.obj")
    body = ("--body", "woman", "--model", "skinning", "--lead-in", 3, "--frames", 4, "--out", "run.npz")
    worn = ("--garment", "skirt.obj", "--garment", "tanktop", "--triangles", 500, "--live", "live")
    for _ in range(2):  # the second run takes the folder over
        assert pb4u("simulate", *body, *worn).code == 0
    whole = on_source(Trajectory.open("run.npz"))
    lower, upper = (pc2_frames(Path("live", name)) for name in ("skirt.pc2", "tanktop.pc2"))
    assert lower.shape[1] == len(skirt.vertices)
    np.testing.assert_array_equal(np.concatenate([lower, upper], axis=1), whole.positions)
    told = [json.loads(line) for line in Path("live", PROGRESS).read_text().splitlines()]
    assert [line["step"] for line in told] == list(range(1, 8))
    assert {line["steps"] for line in told} == {7}
    assert told[-1]["frames"] == 3  # told at the step, before its own frame is there


def test_a_folder_that_holds_something_else_is_not_written_to(pb4u: Callable, tmp_path: Path) -> None:
    (tmp_path / "shirt.pc2").write_bytes(b"kept")
    ended = pb4u("simulate", "--live", tmp_path, "--out", tmp_path / "a.npz")
    assert (ended.code, "holds other files" in ended.err) == (1, True)
    assert (tmp_path / "shirt.pc2").read_bytes() == b"kept"


@pytest.mark.parametrize(
    ("name", "how"),
    [
        (
            "pb4u_paper",
            "`pb4u train --set network=pb4u_paper` trains it; the paper's network to the letter is `literal`",
        ),
        ("paper", "`pb4u train --preset paper` trains it; the paper's network"),
        ("literal", "`pb4u train --preset literal` trains it, the paper's network to the letter"),
    ],
)
@pytest.mark.parametrize("verb", [("simulate", "--frames", 1), ("info",)], ids=["simulate", "info"])
def test_a_network_without_weights_says_how_to_train_it_and_which_is_the_papers(
    pb4u: Callable, verb: tuple[object, ...], name: str, how: str
) -> None:
    ended = pb4u(*verb, "--model", name)
    assert ended.code == 1
    assert ended.err.startswith(f"pb4u: There is no model {name!r} with weights: {how}")
    assert "pb4u-light" in ended.err
