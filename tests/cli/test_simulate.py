"""`pb4u simulate`: what it writes, and how it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pb4u.scene.trajectory import Trajectory

SMALL = ("--triangles", 1000, "--lead-in", 0, "--model", "skinning")


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
    assert set(report["metrics_paper"]) == names
    assert set(report["metrics"]) == names | {
        "strain_p95", "strain_max", "penetration_percent", "penetration_depth_max",
    }  # fmt: skip
    assert all(len(entry["per_frame"]) == 3 for entry in report["metrics"].values())
    assert report["diverged"] is False


def test_json_alone_goes_to_standard_output(pb4u: Callable, tmp_path: Path) -> None:
    ended = pb4u("simulate", *SMALL, "--frames", 1, "--out", tmp_path / "a.npz", "--json", "-")
    assert json.loads(ended.out)["frames"] == 1


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
        (("--body-shape", "height"), "KEY=VALUE"),
        (("--body-shape", "hight=0.5"), "height"),
        (("--crop", "5"), "A:B"),
        (("--fps", 0), "between 1 and 1000"),
        (("--lead-in", -1), "0 frames or more"),
        (("--pins", "sleeve"), "loop"),
        (("--refine", -1, "--model", "solver"), "0 or more"),
        (("--seed", -1), "0 or more"),
        (("--fps", "nan"), "between 1 and 1000"),
        (("--arms-away", "nan"), "0 to 90"),
        (("--json", "absent/r.json"), "does not exist"),
    ],
)
def test_bad_values_are_refused_in_one_sentence(
    pb4u: Callable, tmp_path: Path, flags: tuple[object, ...], says: str
) -> None:
    ended = pb4u(
        "simulate", "--model", "skinning", "--frames", 1, "--triangles", 1000, *flags, "--out", tmp_path / "a.npz"
    )
    assert ended.code == 1
    last = ended.err.strip().splitlines()[-1]
    assert last.startswith("pb4u: ")
    assert says in last
    assert "Traceback" not in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("flags", [("--frames", "many"), ("--colour", "red"), ("--contact", "perhaps")])
def test_flags_that_cannot_be_understood_end_with_2(pb4u: Callable, flags: tuple[str, str]) -> None:
    assert pb4u("simulate", *flags).code == 2


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
