"""Every example runs as it is, on a mesh of a few hundred triangles, and does what its first lines say."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import pc2_frames
from tests.garment.cloth_shapes import quad_tube, saved

import pb4u
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.geometry.obj_file import read_obj
from pb4u.scene.trajectory import Trajectory

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TINY = ("--triangles", 400, "--frames", 6)

Run = Callable[..., str]


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Runs an example in an empty folder and returns what it printed."""

    def run(name: str, *arguments: object) -> str:
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(str(EXAMPLES))
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_each_is_tested() -> None:
    tested = Path(__file__).read_text()
    assert [file.name for file in EXAMPLES.glob("*.py") if f'"{file.name}"' not in tested] == []


def test_simulate_and_save(example: Run, tmp_path: Path) -> None:
    said = example("00_simulate_and_save.py", "--model", "skinning", *TINY)
    assert "skinning: 6 frames" in said
    assert Trajectory.open(tmp_path / "walk.npz").frame_count == 6
    assert (tmp_path / "walk.glb").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_your_own_garment(example: Run, tmp_path: Path) -> None:
    mesh = quad_tube(low=0.6, high=1.0, radius=0.22)
    saved(tmp_path, type(mesh)(100.0 * mesh.vertices, mesh.polygons, mesh.uvs, mesh.polygon_uvs), "mine.obj")
    said = example("01_your_own_garment.py", "mine.obj", "--model", "skinning", *TINY)
    assert "refused: The garment is in centimetres" in said
    assert "Scaled by 0.01" in said
    moved = read_obj(tmp_path / "moved_0005.obj")
    np.testing.assert_array_equal(np.stack(moved.polygons), np.stack(mesh.polygons))
    assert read_obj(tmp_path / "mine.obj").vertices.max() > 50.0


@pytest.mark.slow
def test_recorded_motion(example: Run, tmp_path: Path) -> None:
    poses = np.zeros((90, 156))
    poses[:, [16 * 3 + 2, 17 * 3 + 2]] = -1.1, 1.1  # both arms down
    poses[:, 3] = 0.2 * np.sin(np.arange(90) / 9)
    height = np.tile([0.0, 0.0, 0.95], (90, 1))
    np.savez(tmp_path / "clip.npz", poses=poses, trans=height, mocap_framerate=60.0)
    flags = ("--crop", 30, 42, "--arms-away", 5, "--triangles", 400, "--model", "skinning")
    said = example("02_recorded_motion.py", "clip.npz", *flags)
    assert "6 frames at 30 per second" in said
    assert Trajectory.open(tmp_path / "recorded.npz").frame_count == 6


@pytest.mark.slow
def test_choose_a_resolution(example: Run, tmp_path: Path) -> None:
    said = example("03_choose_a_resolution.py", "--triangles", 400, 900, "--frames", 3, "--model", "skinning")
    rows = [line.split() for line in said.splitlines()[2:]]
    assert [abs(int(row[0]) / asked - 1) < 0.05 for row, asked in zip(rows, (400, 900), strict=True)] == [True, True]
    assert float(rows[0][1]) > float(rows[1][1])
    assert (tmp_path / "resolution_900.npz").is_file()


@pytest.mark.slow
def test_change_the_material(example: Run, tmp_path: Path) -> None:
    said = example("04_change_the_material.py", "--materials", "silk", "--model", "skinning", *TINY)
    masses = [float(line.split(":")[1].split("g")[0]) for line in said.splitlines()[1:]]
    assert masses[1] == pytest.approx(masses[0] * 0.5 / 0.06, rel=0.02)
    assert Trajectory.open(tmp_path / "cloth_felt.npz").metadata["material"]["thickness"] == pytest.approx(2e-3)


@pytest.mark.slow
def test_compare_with_the_solver(example: Run, tmp_path: Path) -> None:
    said = example(
        "05_compare_with_the_solver.py", "--model", "skinning", "--triangles", 600, "--frames", 3, "--lead-in", 2
    )
    energies = {row[0]: (float(row[-2]), float(row[-1])) for row in map(str.split, said.splitlines()) if "[J]" in row}
    assert energies["total"][1] < energies["total"][0]
    solver = Trajectory.open(tmp_path / "compared_solver.npz")
    assert solver.metadata["model"] == "solver"
    assert Trajectory.open(tmp_path / "compared_model.npz").positions.shape == solver.positions.shape


@pytest.mark.slow
def test_into_blender(example: Run, tmp_path: Path) -> None:
    said = example("06_into_blender.py", "--model", "skinning", *TINY, "--garment", "skirt")
    lines = (tmp_path / "skirt_in_blender.py").read_text()
    assert lines in said
    compile(lines, "skirt_in_blender.py", "exec")
    assert str(tmp_path / "skirt.pc2") in lines
    assert len(pc2_frames(tmp_path / "skirt.pc2")) == 6
    assert (tmp_path / "skirt.obj").is_file()
    python = os.environ.get("PB4U_BLENDER_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode == 0:
        ended = subprocess.run([python, tmp_path / "skirt_in_blender.py"], capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr


def test_scene_file(example: Run, tmp_path: Path) -> None:
    said = example("07_scene_file.py", "--model", "skinning", *TINY, "--materials", "silk", "wool")
    assert "scene_silk.toml: 6 frames in silk" in said
    written = [Trajectory.open(tmp_path / f"scene_{name}.npz").metadata["material"] for name in ("silk", "wool")]
    assert [material["density"] for material in written] == pytest.approx([0.06, 0.28])
    assert 'material = "wool"' in (tmp_path / "scene_wool.toml").read_text()
    assert "pb4u simulate scene_wool.toml" in said


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_wear_an_outfit(example: Run, tmp_path: Path) -> None:
    said = example("12_wear_an_outfit.py", "--model", "skinning", *TINY)
    assert "as_it_comes: trousers under tanktop under cardigan" in said
    assert "tucked_in: tanktop under trousers under cardigan" in said
    assert Trajectory.open(tmp_path / "outfit_tucked_in.npz").metadata["garment"] == "tanktop+trousers+cardigan"


def require_uncrossed(said: str, file: Path) -> Trajectory:
    """The trajectory of a standard scene, which crosses nowhere as it is written and left few steps unsolved."""
    trajectory = Trajectory.open(file)
    assert "pairs of triangles that cross: 0 in all frames" in said
    for frame in trajectory.positions:
        assert not len(self_crossings(frame, trajectory.faces, sharing=True))
    unsolved = int(said.split(" steps unsolved")[0].rsplit(maxsplit=1)[-1])
    # The two or three steps of a hard impact may end at the most iterations: rounding decides which.
    assert unsolved <= 0.1 * trajectory.frame_count
    return trajectory


@pytest.mark.slow
def test_cloth_in_folds(example: Run, tmp_path: Path) -> None:
    assert (EXAMPLES / "cloth_scenes.py").is_file()
    small = ("--triangles", 260, "--layers", 3, "--frames", 9)
    trajectory = require_uncrossed(example("08_cloth_in_folds.py", *small), tmp_path / "folds.npz")
    assert trajectory.positions[-1, :, 1].min() < 0.4
    example("08_cloth_in_folds.py", *small, "--self-contact", "off", "--out", "through")
    free = Trajectory.open(tmp_path / "through.npz")
    assert len(self_crossings(free.positions[-1], free.faces)) > 100


@pytest.mark.slow
def test_twisted_sheet(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 160, "--frames", 30)
    trajectory = require_uncrossed(example("09_twisted_sheet.py", *small), tmp_path / "twisted.npz")
    # Wrung to a rope: its middle is a small part as wide as the sheet was.
    middle = np.abs(trajectory.header.rest_positions[:, 0] - 0.5) < 0.05
    width = trajectory.positions[:, middle].std(axis=1)[:, 1:].max(axis=1)
    assert width[-1] < 0.4 * width[0]


@pytest.mark.slow
def test_stack_of_sheets(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 72, "--sheets", 3, "--frames", 60)
    trajectory = require_uncrossed(example("10_stack_of_sheets.py", *small), tmp_path / "stack.npz")
    assert len(np.unique(trajectory.header.vertex_garment)) == 3
    speeds = np.linalg.norm(trajectory.velocities, axis=2).mean(axis=1)
    assert speeds.max() > 0.3, "they fell"
    assert speeds[-8:].min() < 0.02 * speeds.max(), "and come to rest, but for a fold that slips"
    # In the order in which they were stacked.
    tops = [trajectory.positions[-1, trajectory.header.vertex_garment == k, 1].max() for k in range(3)]
    assert (np.diff(tops) > 0).all()


@pytest.mark.slow
def test_through_a_ring(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 160, "--frames", 26, "--hole", 0.09)
    trajectory = require_uncrossed(example("11_through_a_ring.py", *small), tmp_path / "ring.npz")
    pinned = trajectory.header.pinned
    assert trajectory.positions[-1, pinned, 1].max() < 0.6
    below = trajectory.positions[-1, :, 1] < 0.66
    assert pinned.sum() < below.sum()


@pytest.mark.slow
def test_reef_knot(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 120, "--width", 0.02, "--frames", 40)
    trajectory = require_uncrossed(example("13_reef_knot.py", *small), tmp_path / "knot.npz")

    def reach(positions: np.ndarray) -> float:
        """How far the bight that came from the left goes beyond the one that came from the right [m]."""
        ribbon = trajectory.header.vertex_garment
        return float(positions[ribbon == 0, 0].max() - positions[ribbon == 1, 0].min())

    assert reach(trajectory.positions[0]) > 0.25
    assert 0.0 < reach(trajectory.positions[-1]) < 0.1, "drawn tight, and it holds"
    example("13_reef_knot.py", *small, "--self-contact", "off", "--out", "undone")
    assert reach(Trajectory.open(tmp_path / "undone.npz").positions[-1]) < -0.1, "else nothing would hold it"


def require_clear(said: str, file: Path) -> Trajectory:
    """The trajectory of a standard scene in which cloth crosses neither cloth nor the solid."""
    trajectory = require_uncrossed(said, file)
    assert "of cloth and solid that cross: 0 in all frames" in said
    for frame, body in zip(trajectory.positions, trajectory.body_positions, strict=True):
        assert not len(crossings(frame, trajectory.faces, body, trajectory.header.body_faces))
    return trajectory


@pytest.mark.slow
def test_on_a_spike(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 128, "--frames", 26, "--speed", 2)
    trajectory = require_clear(example("15_on_a_spike.py", *small), tmp_path / "spike.npz")
    tips = trajectory.body_positions[:, :, 1].max(axis=1)
    tops, lows = trajectory.positions[:, :, 1].max(axis=1), trajectory.positions[:, :, 1].min(axis=1)
    assert (tops[:16] > tips[:16]).all(), "the sheet hangs on the tip"
    assert lows[15] < tips[15] - 0.1
    assert tips[-1] < tips[0] - 0.1, "which is pulled away"


@pytest.mark.slow
def test_sleeve_over_an_arm(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 200, "--frames", 30)
    trajectory = require_clear(example("16_sleeve_over_an_arm.py", *small), tmp_path / "sleeve.npz")
    assert trajectory.positions[0, :, 0].max() < 0.0, "before the hand"
    worn = trajectory.positions[-1]
    assert worn[trajectory.header.pinned, 1].min() > 0.85, "round the elbow"


@pytest.mark.slow
def test_ball_against_a_sheet(example: Run, tmp_path: Path) -> None:
    small = ("--triangles", 200, "--frames", 20)
    said = example("17_ball_against_a_sheet.py", *small)
    trajectory = require_clear(said, tmp_path / "ball.npz")
    assert "the ball stays behind the sheet" in said
    assert trajectory.positions[-1, :, 1].max() > 0.55, "though it was pushed on"


@pytest.mark.slow
def test_flag_in_the_wind(example: Run, tmp_path: Path) -> None:
    example("18_flag_in_the_wind.py", "--triangles", 200, "--frames", 40)
    trajectory = Trajectory.open(tmp_path / "flag.npz")
    ends = trajectory.positions[:, trajectory.positions[0, :, 0] > 1.2]
    assert ends[10:, :, 1].min() > 0.9, "it does not hang"
    assert np.ptp(ends[10:, :, 2].mean(axis=1)) > 0.1, "it flutters"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning", "ignore::pb4u.errors.InputNote")
def test_throw_off_a_cape(example: Run, tmp_path: Path) -> None:
    example("19_throw_off_a_cape.py", "--triangles", 400, "--frames", 45, "--until", 15)
    heights = Trajectory.open(tmp_path / "cape.npz").positions[:, :, 1]
    assert heights[:15].max(axis=1).min() > 1.2, "the clasps hold"
    assert heights[-1].max() < 0.6, "it lies or falls"


@pytest.mark.slow
def test_sew_a_skirt() -> None:
    names = runpy.run_path(str(EXAMPLES / "14_sew_a_skirt.py"), run_name="example")
    pattern = names["skirt"]()
    assert len(pattern.panels) == len(pattern.seams) == 4
    dressed = pb4u.dress(pattern, pb4u.load_body("woman"), triangles=600)
    assert dressed.crossings == 0
