"""Plots: what is measured, how it is drawn; and export for the browser."""

from __future__ import annotations

import contextlib
import io
import os
import threading
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from tests.viewer.clips import header, trajectory

from pb4u.errors import InputError
from pb4u.measures.metrics import Ruler, measure
from pb4u.scene.trajectory import Trajectory
from pb4u.viewer.clip import GrowingClip, RecordedClip
from pb4u.viewer.export_panel import deliver
from pb4u.viewer.plot_panel import Measurement, chart_data, on_timeline


def test_measurements_are_those_of_the_command_line() -> None:
    made = trajectory(4, lost=(2,), widen=0.01)
    measurement = Measurement(RecordedClip(made, "a"))
    measurement.start()
    assert measurement.join(30.0)
    expected = measure(made)["metrics"]
    for name in ("stretch", "total", "strain_p95", "penetration_percent"):
        np.testing.assert_allclose(measurement.series(name), expected[name]["per_frame"], rtol=1e-9)
    assert np.isnan(measurement.series("stretch")[2])


def test_measuring_can_be_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    one, go_on = threading.Event(), threading.Event()

    class Slow(Ruler):
        def frame(self, t: int) -> tuple[dict[str, float], dict[str, float]]:
            measured = super().frame(t)
            one.set()
            go_on.wait(10.0)
            return measured

    monkeypatch.setattr("pb4u.viewer.plot_panel.Ruler", Slow)
    measurement = Measurement(RecordedClip(trajectory(8), "a"))
    measurement.start()
    assert one.wait(10.0)
    measurement.cancel()
    go_on.set()
    assert measurement.join(10.0)
    assert measurement.done == 1
    assert np.isfinite(measurement.series("stretch")).tolist() == [True] + 7 * [False]


def test_what_cannot_be_measured_says_so() -> None:
    clip = GrowingClip(header().with_metadata(material={"density": 1.0}), 2, "bare")
    measurement = Measurement(clip)
    measurement.start()
    assert measurement.join(10.0)
    assert measurement.failure is not None


def test_the_line_stands_at_the_frame_and_spans_the_curves() -> None:
    curve, gap = np.array([1.0, 3.0, 5.0, 4.0]), np.array([2.0, np.nan, np.nan, np.nan])
    abscissa, first, second, line = chart_data([curve, gap], frame=1.0)
    assert abscissa.tolist() == [0.0, 1.0, 1.0, 1.0, 2.0, 3.0]
    assert first.tolist() == [1.0, 3.0, 3.0, 3.0, 5.0, 4.0]
    assert np.isnan(second[1:]).all()
    assert abscissa[np.isfinite(line)].tolist() == [1.0, 1.0]
    assert line[np.isfinite(line)].tolist() == [1.0, 5.0]
    assert (np.diff(abscissa) >= 0).all()


def test_a_chart_of_nothing_is_still_a_chart() -> None:
    abscissa, _, line = chart_data([np.full(3, np.nan)], frame=2.0)
    assert len(abscissa) == 5
    assert np.isfinite(line).sum() == 2


def test_an_export_is_the_file_and_can_be_kept(tmp_path: Path) -> None:
    clip = RecordedClip(trajectory(3), "a walk, the solver")
    name, content, kept = deliver(clip, ".npz", tmp_path)
    assert name == "a_walk_the_solver.npz"
    assert kept == tmp_path / name
    assert kept.read_bytes() == content
    assert Trajectory.open(kept).frame_count == 3
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("label", "named"),
    [("dress.npz", "dress.glb"), ("платье.npz", "платье.glb"), ("v1.2", "v1_2.glb"), ("..", "garment.glb")],
)
def test_an_export_is_called_as_its_clip_is(label: str, named: str) -> None:
    assert deliver(RecordedClip(trajectory(3), label), ".glb")[0] == named


def test_an_export_replaces_nothing_in_the_folder(tmp_path: Path) -> None:
    (tmp_path / "walk.npz").write_text("somebody's")
    clip = RecordedClip(trajectory(3), "walk")
    assert [deliver(clip, ".npz", tmp_path)[2] for _ in range(2)] == [tmp_path / "walk-2.npz", tmp_path / "walk-3.npz"]
    assert (tmp_path / "walk.npz").read_text() == "somebody's"


def test_two_windows_may_keep_the_same_name_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both would write the same file beside the one to be replaced, if they met there."""
    meeting, written = threading.Barrier(2), os.fsync

    def meet(descriptor: int) -> None:
        with contextlib.suppress(threading.BrokenBarrierError):
            meeting.wait(1.0)
        written(descriptor)

    monkeypatch.setattr("pb4u.io.atomic_file.os.fsync", meet)
    clip = RecordedClip(trajectory(3), "walk")
    with ThreadPoolExecutor(2) as windows:
        kept = [future.result() for future in [windows.submit(deliver, clip, ".obj", tmp_path) for _ in range(2)]]
    assert {kept[0][2], kept[1][2]} == {tmp_path / "walk_0000.obj", tmp_path / "walk-2_0000.obj"}
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        f"walk{which}_000{t}.obj" for which in ("-2", "") for t in range(3)
    ]


def test_several_files_come_as_one_archive() -> None:
    name, content, kept = deliver(RecordedClip(trajectory(3), "walk"), ".obj")
    assert kept is None
    assert name == "walk.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert len([entry for entry in archive.namelist() if entry.endswith(".obj")]) == 3


@pytest.mark.parametrize(("suffix", "frames", "says"), [(".exe", 1, "no format"), (".npz", 0, "no frame to export")])
def test_exports_are_refused_in_a_sentence(suffix: str, frames: int, says: str) -> None:
    clip = RecordedClip(trajectory(1), "a") if frames else GrowingClip(header(), 1, "a")
    with pytest.raises(InputError, match=says):
        deliver(clip, suffix)


def test_curves_of_other_frame_rates_are_read_at_the_moments_that_are_shown() -> None:
    sixty, fifteen = np.arange(9.0), np.arange(3.0)
    np.testing.assert_array_equal(on_timeline(sixty, 2.0), [0, 2, 4, 6, 8])
    np.testing.assert_array_equal(on_timeline(fifteen, 0.5), [0, 0, 1, 2, 2])
    assert len(on_timeline(sixty[:0], 2.0)) == 0
