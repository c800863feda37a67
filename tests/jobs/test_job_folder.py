"""The folder of a run: half of anything is not believed, and nothing is written over what is something else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.paper.quick_rollouts import job

from pb4u.errors import InputError, Pb4uError
from pb4u.jobs import job_folder
from pb4u.jobs.job import Failure, Made, attempted
from pb4u.jobs.job_folder import JobFolder

JOB = job("walk")


def opened(path: Path, protocol: str = "resolution") -> JobFolder:
    return JobFolder(path, "an evaluation", {"protocol": protocol})


def kept(path: Path) -> Path:
    with opened(path) as folder:
        folder.write_manifest((JOB,))
        folder.take(JOB, Made({"value": 1.5}, b"frame"))
    return path / "jobs" / f"{JOB.key}.json"


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (InputError("no such\n garment."), "no such garment."),
        (MemoryError(), "There is not enough memory for this; ask for fewer triangles or frames."),
        (OSError(28, "No space left on device", "clip.npz"), "No space left on device (clip.npz)."),
        (KeyError("a"), "It ended with an unexpected error: KeyError: 'a'"),
    ],
)
def test_whatever_goes_wrong_is_told_in_a_sentence(error: Exception, sentence: str) -> None:
    def run(work: object) -> Made:
        raise error

    failure = attempted(run, JOB)
    assert isinstance(failure, Failure)
    assert failure.sentence == sentence
    assert type(error).__name__ in failure.trace


def test_results_are_there_again(tmp_path: Path) -> None:
    kept(tmp_path / "run")
    with opened(tmp_path / "run") as folder:
        assert folder.result(JOB) == {"value": 1.5}
        assert folder.trajectory(JOB).read_bytes() == b"frame"
        assert folder.result(job("jump")) is None


def test_results_of_long_runs_are_there_again_too(tmp_path: Path) -> None:
    series = [0.1234567890123456] * 500_000
    with opened(tmp_path / "run") as folder:
        folder.take(JOB, Made({"series": series}))
        assert folder.result(JOB) == {"series": series}


@pytest.mark.parametrize("length", [0, 1, 40, -3])
def test_half_written_results_are_not_believed(tmp_path: Path, length: int) -> None:
    file = kept(tmp_path / "run")
    file.write_bytes(file.read_bytes()[:length])
    with opened(tmp_path / "run") as folder:
        assert folder.result(JOB) is None


def test_altered_or_misplaced_results_are_not_believed(tmp_path: Path) -> None:
    file = kept(tmp_path / "run")
    whole = file.read_text()
    (file.parent / f"{job('jump').key}.json").write_text(whole)
    file.write_text(whole.replace("1.5", "1.4"))
    with opened(tmp_path / "run") as folder:
        assert folder.result(JOB) is None
        assert folder.result(job("jump")) is None


def test_what_a_killed_run_had_begun_to_write_is_swept_away(tmp_path: Path) -> None:
    file = kept(tmp_path / "run")
    leftovers = [tmp_path / "run" / ".manifest.json.17", file.with_name(f".{file.name}.17")]
    for leftover in leftovers:
        leftover.write_text("half")
    with opened(tmp_path / "run") as folder:
        assert folder.result(JOB) is not None
    assert not any(leftover.exists() for leftover in leftovers)


def test_failures_are_kept_until_they_are_forgotten_or_mended(tmp_path: Path) -> None:
    with opened(tmp_path / "run") as folder:
        folder.take(JOB, Failure("No garment.", "trace"))
    with opened(tmp_path / "run") as folder:
        failure = folder.failure(JOB)
        assert failure is not None
        assert failure == Failure("No garment.", "trace")
        folder.forget_failure(JOB)
        assert folder.failure(JOB) is None
        folder.take(JOB, Failure("No garment.", "trace"))
        folder.take(JOB, Made({}))
        assert folder.failure(JOB) is None


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(tmp_path / "run")
    present = job_folder.FOLDER_VERSION
    monkeypatch.setattr(job_folder, "FOLDER_VERSION", 70)
    with pytest.raises(InputError, match=rf"version {present} .*version 70"):
        opened(tmp_path / "run")
    monkeypatch.undo()
    monkeypatch.setattr(job_folder, "__version__", "9.9")
    with pytest.raises(InputError, match=r"by pb4u .* and this is pb4u 9\.9"):
        opened(tmp_path / "run")


@pytest.mark.parametrize("held", [{"protocol_version": 2, "protocol": "resolution"}, {"dataset_version": 1}])
def test_folders_of_before_say_what_they_hold(tmp_path: Path, held: dict) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps({"pb4u": "0.3.0", **held}))
    with pytest.raises(InputError, match=r"version \d by pb4u 0\.3\.0.*--out"):
        opened(tmp_path)


def test_other_protocols_and_other_folders_are_refused(tmp_path: Path) -> None:
    kept(tmp_path / "run")
    with pytest.raises(InputError, match="protocol resolution, not depth"):
        opened(tmp_path / "run", "depth")
    with pytest.raises(InputError, match="evaluation, not of a dataset"):
        JobFolder(tmp_path / "run", "a dataset", {})
    (tmp_path / "run" / "manifest.json").write_text(json.dumps({"jobs": []}))
    with pytest.raises(InputError, match="is not the manifest of an evaluation"):
        opened(tmp_path / "run")
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.tex").write_text("...")
    with pytest.raises(InputError, match="not a folder of an evaluation"):
        opened(other)
    with pytest.raises(InputError, match="not a folder of an evaluation"):
        opened(other / "chapter.tex")
    assert [entry.name for entry in other.iterdir()] == ["chapter.tex"]


def test_a_folder_is_one_process_at_a_time(tmp_path: Path) -> None:
    with opened(tmp_path / "run"), pytest.raises(InputError, match="Another process"):
        opened(tmp_path / "run")
    opened(tmp_path / "run").__exit__(None, None, None)


def test_a_disk_that_refuses_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with opened(tmp_path / "run") as folder:
        monkeypatch.setattr(job_folder, "replace_file", full)
        with pytest.raises(Pb4uError, match="No space left"):
            folder.take(JOB, Made({}))
