"""What is read is never written over, and what ends a command leaves nothing half-written."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from filelock import FileLock
from tests.garment.cloth_shapes import quad_tube, saved

from pb4u.body.sequence_files import write_vertex_sequence
from pb4u.errors import Interrupted
from pb4u.io.atomic_file import MARK, replace_file, sweep, working_folder
from pb4u.run import Run
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.run_simulation import roll_out
from pb4u.simulation.simulator import RunRecord, SkinningSimulator

PB4U = [sys.executable, "-c", "from pb4u.cli.main import main; main()"]
HOLDS_A_LOCK = """
import sys
from filelock import FileLock
lock = FileLock(sys.argv[1])
lock.acquire()
print("held", flush=True)
input()
"""
KEPT_FOR = ", for `pb4u view` and `pb4u convert`; `pb4u simulate` cannot continue from there."
FRAMES = ("--model", "skinning", "--lead-in", 0, "--frames", 2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one of every kind of input."""
    folder = tmp_path_factory.mktemp("made")
    saved(folder, quad_tube(), "my.obj")
    (folder / "m.json").write_text('{"density": 0.2, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-5}')
    (folder / "pins.txt").write_text("0 1 2")
    run = Run().with_entries({"triangles": 1000, "model": "skinning", "lead_in": 0, "frames": 2}, Path())
    run.save(folder / "s.toml")
    clip = run.simulate()
    clip.save(folder / "t.npz")
    write_vertex_sequence(folder / "b.npz", clip.body_positions, clip.header.body_faces, clip.fps)
    return folder


@pytest.fixture
def files(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of `made`."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "kept"),
    [
        (("check", "my.obj", "--json", "my.obj"), "my.obj"),
        (("check", "my.obj", "--body", "b.npz", "--fix", "f.obj", "--json", "b.npz"), "b.npz"),
        (("simulate", "--garment", "my.obj", *FRAMES, "--out", "a.npz", "--json", "my.obj"), "my.obj"),
        (("simulate", "--material", "m.json", *FRAMES, "--out", "a.npz", "--json", "m.json"), "m.json"),
        (("simulate", "--pins", "pins.txt", *FRAMES, "--out", "a.npz", "--json", "pins.txt"), "pins.txt"),
        (("simulate", "--body", "b.npz", *FRAMES, "--out", "b.npz"), "b.npz"),
        (("simulate", "--body", "b.npz", *FRAMES, "--out", "./b.npz"), "b.npz"),
        (("simulate", "s.toml", *FRAMES, "--out", "a.npz", "--json", "s.toml"), "s.toml"),
        (("simulate", "s.toml", *FRAMES, "--out", "a.npz", "--save-scene", "s.toml"), "s.toml"),
        (("convert", "t.npz", "z.glb", "--json", "t.npz"), "t.npz"),
        (("convert", "t.npz", "t.npz", "--every", 2), "t.npz"),
        (("evaluate", "--garments", "my.obj", "--json", "my.obj"), "my.obj"),
        (("train", "--pack", "t.npz", "--out", "run", "--json", "t.npz"), "t.npz"),
    ],
)
def test_no_flag_writes_over_what_is_read(files: Path, pb4u: Callable, arguments: tuple, kept: str) -> None:
    before = {file: file.read_bytes() for file in files.iterdir()}
    ended = pb4u(*arguments)
    assert ended.code == 1
    assert f"would overwrite {kept}, which is read" in ended.err
    assert ("OUT t.npz would" in ended.err) is ("--every" in arguments), "convert has no --out"
    assert {file: file.read_bytes() for file in files.iterdir()} == before


@pytest.mark.parametrize("image", ["new.texture1.png", "new.pb4u.mtl"])
def test_a_mended_garment_takes_no_file_of_the_one_it_is_made_of(files: Path, pb4u: Callable, image: str) -> None:
    mtl = files / ("my.mtl" if image.endswith(".png") else image)
    mtl.write_text("newmtl a\nmap_Kd new.texture1.png\n")
    (files / "new.texture1.png").write_bytes(b"an image")
    (files / "my.obj").write_text(f"mtllib {mtl.name}\n{(files / 'my.obj').read_text()}")
    ended = pb4u("check", "my.obj", "--fix", "new.obj")
    assert ended.code == 1
    assert f"--fix new.obj would overwrite {image}, which is read" in ended.err
    assert (files / "new.texture1.png").read_bytes() == b"an image"


def test_frames_are_not_written_among_those_that_are_read(files: Path, pb4u: Callable) -> None:
    assert pb4u("convert", "t.npz", "seq.obj").code == 0
    Path("frames").mkdir()
    for file in files.glob("seq_*.obj"):
        file.rename(Path("frames") / file.name)
    ended = pb4u("simulate", "--body", "frames", *FRAMES, "--out", "frames/seq.obj")
    assert "would overwrite frames, which is read" in ended.err
    ended = pb4u("simulate", "--garment", "frames/seq_0001.obj", *FRAMES, "--out", "frames/seq.obj")
    assert "would overwrite frames/seq_0001.obj, which is read" in ended.err


def test_the_dictionary_that_a_garment_is_read_from_is_kept(files: Path, pb4u: Callable) -> None:
    Path("garments.pkl").write_bytes(b"mine")
    for flags in (("--garment", "garments.pkl:dress@73"), ("--motion", "garments.pkl:2")):
        ended = pb4u("simulate", *flags, *FRAMES, "--out", "garments.pkl")
        assert "would overwrite garments.pkl, which is read" in ended.err
    assert Path("garments.pkl").read_bytes() == b"mine"


def test_two_outputs_are_not_one_file(files: Path, pb4u: Callable) -> None:
    ended = pb4u("simulate", *FRAMES, "--out", "a.npz", "--json", "a.npz")
    assert "would both be written to a.npz" in ended.err
    ended = pb4u("simulate", *FRAMES, "--out", "a.pc2", "--out", "a.mdd")
    assert "would both be written to a.obj" in ended.err
    assert not Path("a.npz").exists()


def test_a_shorter_sequence_leaves_no_frames_of_the_longer_one(files: Path, pb4u: Callable) -> None:
    assert pb4u("convert", "t.npz", "seq.obj").code == 0
    assert pb4u("convert", "t.npz", "seq.obj", "--range", "0:1").code == 0
    assert [file.name for file in files.glob("seq_*.obj")] == ["seq_0000.obj"]


def test_frames_are_not_written_among_those_of_others(files: Path, pb4u: Callable) -> None:
    (files / "seq_0007.obj").write_text("v 0 0 0\n")
    for arguments in (("convert", "t.npz", "seq.obj"), ("simulate", *FRAMES, "--out", "seq.obj")):
        assert "seq_0007.obj exists and is not from pb4u" in pb4u(*arguments).err
    assert [file.name for file in files.glob("seq_*.obj")] == ["seq_0007.obj"]


def test_a_killed_process_s_leftovers_are_swept_by_the_next_one(tmp_path: Path) -> None:
    dead = tmp_path / f".a.npz.xyz{MARK}"
    dead.mkdir()
    (dead / ".lock").touch()
    (dead / "positions").write_bytes(b"half")
    file = tmp_path / f".b.json.99999999{MARK}"
    file.write_text("half")
    os.utime(file, (0, 0))
    fresh = tmp_path / f".c.npz.new{MARK}"
    fresh.mkdir()
    young = tmp_path / f".d.json.99999999{MARK}"
    young.write_text("half")
    mine = tmp_path / f".e.json.{os.getpid()}{MARK}"
    mine.write_text("half")
    os.utime(mine, (0, 0))
    other = tmp_path / ".npz.hidden"
    other.mkdir()
    used = tmp_path / f".used.npz.xyz{MARK}"
    used.mkdir()
    held = subprocess.Popen(
        [sys.executable, "-c", HOLDS_A_LOCK, used / ".lock"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert held.stdout is not None
    held.stdout.readline()
    with working_folder(tmp_path / "f.npz") as folder:
        assert {p.name for p in tmp_path.iterdir()} == {p.name for p in (fresh, young, mine, other, used, folder)}
    held.kill()
    held.wait()
    sweep(tmp_path)
    assert used.name not in {p.name for p in tmp_path.iterdir()}


def test_a_working_folder_holds_its_lock_and_goes(tmp_path: Path) -> None:
    with working_folder(tmp_path / ("n" * 240 + ".npz")) as folder:
        with pytest.raises(TimeoutError):
            FileLock(folder / ".lock").acquire(timeout=0)
        sweep(tmp_path)
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("old")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pb4u.io.atomic_file.os.fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "a", b"new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]


def test_links_permissions_and_pipes_stay(tmp_path: Path, pb4u: Callable) -> None:
    (tmp_path / "kept").mkdir()
    file, link, pipe = tmp_path / "kept" / "a.json", tmp_path / "link.json", tmp_path / "pipe"
    file.write_text("old")
    file.chmod(0o600)
    link.symlink_to(file)
    assert pb4u("info", "--json", link).code == 0
    assert link.is_symlink()
    assert file.read_text().startswith("{")
    assert file.stat().st_mode & 0o777 == 0o600
    os.mkfifo(pipe)
    reader = subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE, text=True)
    assert pb4u("info", "--json", pipe).code == 0
    assert pipe.is_fifo()
    assert reader.communicate()[0].startswith("{")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.json", "kept", "link.json", "pipe"]


@pytest.mark.parametrize("to_file", [True, False], ids=["streamed", "in memory"])
def test_an_interrupt_keeps_the_frames_until_then(tmp_path: Path, to_file: bool) -> None:
    scene = make_scene("tshirt", triangles=1000, frames=6, lead_in=2)
    whole = SkinningSimulator().simulate(scene)
    (tmp_path / "a.npz").write_text("an earlier one")
    kept = tmp_path / "a.interrupted.npz"

    def stop(done: int, total: int) -> None:
        if done == 6:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match=f"the first 3 frames are in {kept}"):
        roll_out(
            Run(), SkinningSimulator(), scene, tmp_path / "a.npz" if to_file else None, progress=stop, interrupted=kept
        )
    np.testing.assert_array_equal(Trajectory.open(kept).positions, whole.positions[:3])
    assert {p.name for p in tmp_path.iterdir()} == {"a.npz", kept.name}
    assert (tmp_path / "a.npz").read_text() == "an earlier one"


class InCompiledCode(SkinningSimulator):
    """A simulator that an interrupt meets in compiled code, which raises an error of its own instead."""

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        for state in super().rollout(scene, record):
            if state.frame == 4:
                try:
                    raise Interrupted(signal=15)
                except Interrupted as error:
                    raise SystemError("returned a result with an exception set") from error
            yield state


def test_an_interrupt_in_compiled_code_is_one(pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pb4u.simulation.models.simulator_of", lambda _: InCompiledCode())
    ended = pb4u("simulate", "--triangles", 1000, "--lead-in", 0, "--frames", 9, "--out", "a.npz")
    assert ended.code == 143
    assert ended.err.splitlines()[-1] == f"pb4u: interrupted; the first 4 frames are in a.interrupted.npz{KEPT_FOR}"

    def broken(*_: object) -> None:
        raise SystemError("before the first frame") from Interrupted(signal=15)

    monkeypatch.setattr("pb4u.simulation.run_simulation.scene_for", broken)
    ended = pb4u("simulate", "--out", "b.npz")
    assert (ended.code, ended.err) == (143, "pb4u: interrupted; nothing was written.\n")


class Loading(ModuleType):
    """A module that an interrupt meets while it is loaded."""

    @property
    def app(self) -> None:
        raise KeyboardInterrupt


def test_an_interrupt_while_modules_are_loaded_is_one(pb4u: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pb4u.cli.application", Loading("pb4u.cli.application"))
    ended = pb4u("info")
    assert (ended.code, ended.err) == (130, "pb4u: interrupted; nothing was written.\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_the_frames(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip(f"whoever started these tests has {number.name} ignored, as nohup does")

    class Signalled(SkinningSimulator):
        def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
            for state in super().rollout(scene, record):
                if state.frame == 4:
                    os.kill(os.getpid(), number)
                yield state

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pb4u.simulation.models.simulator_of", lambda _: Signalled())
    ended = pb4u("simulate", "--triangles", 1000, "--lead-in", 0, "--frames", 9, "--out", "a.npz")
    assert ended.code == 128 + number
    assert ended.err.splitlines()[-1] == f"pb4u: interrupted; the first 4 frames are in a.interrupted.npz{KEPT_FOR}"
    assert [p.name for p in tmp_path.iterdir()] == ["a.interrupted.npz"]


@pytest.mark.slow
def test_a_process_that_is_ended_leaves_the_frames_and_nothing_else(tmp_path: Path) -> None:
    number = signal.SIGTERM
    flags = ["simulate", "--triangles", "1000", "--lead-in", "0", "--frames", "5000", "--model", "skinning"]
    run = subprocess.Popen([*PB4U, *flags, "--out", "a.npz"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    raw = None
    while run.poll() is None and (raw is None or raw.stat().st_size < 1 << 18):
        time.sleep(0.01)
        raw = next(tmp_path.glob(f".a.npz.*{MARK}/positions"), None)
    run.send_signal(number)
    _, said = run.communicate(timeout=60)
    assert run.returncode == 128 + number
    kept = Trajectory.open(tmp_path / "a.interrupted.npz")
    assert said.splitlines()[-1] == (
        f"pb4u: interrupted; the first {kept.frame_count} frames are in a.interrupted.npz{KEPT_FOR}"
    )
    assert [p.name for p in tmp_path.iterdir()] == ["a.interrupted.npz"]


@pytest.mark.slow
def test_what_a_kill_leaves_the_next_run_sweeps(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ["simulate", "--triangles", "1000", "--lead-in", "0", "--model", "skinning", "--out", "a.npz"]
    run = subprocess.Popen([*PB4U, *flags, "--frames", "5000"])
    while run.poll() is None and not any(tmp_path.glob(f".a.npz.*{MARK}/positions")):
        time.sleep(0.01)
    run.kill()
    run.wait()
    assert any(tmp_path.iterdir())
    assert pb4u(*flags, "--frames", 1).code == 0
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


@pytest.fixture(scope="module")
def long_clip() -> Trajectory:
    return SkinningSimulator().simulate(make_scene("tshirt", triangles=1000, frames=90, lead_in=0))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_conversion_that_is_ended_leaves_no_part_of_a_file(
    tmp_path: Path, pb4u: Callable, long_clip: Trajectory, number: signal.Signals
) -> None:
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("the tests were started where this signal is ignored")
    before = long_clip.save(tmp_path / "t.npz").read_bytes()
    for _ in range(3):
        (tmp_path / "t.gif").write_text("an earlier one")
        run = subprocess.Popen([*PB4U, "convert", "t.npz", "t.gif"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        # A folder that is not locked yet is told from one that another process is about to lock by its age alone.
        while run.poll() is None and not any(tmp_path.glob(f".t.gif.*{MARK}/.lock")):
            time.sleep(0.01)
        run.send_signal(number)
        _, said = run.communicate(timeout=120)
        # On a busy machine it may have written the last picture by then.
        if run.returncode != 0:
            break
    assert "Traceback" not in said
    if number == signal.SIGKILL:
        assert pb4u("convert", tmp_path / "t.npz", tmp_path / "t.pkl").code == 0
        (tmp_path / "t.pkl").unlink()
    else:
        assert (run.returncode, said) == (128 + number, "pb4u: interrupted; nothing was written.\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.gif", "t.npz"]
    assert (tmp_path / "t.npz").read_bytes() == before
    assert (tmp_path / "t.gif").read_text() == "an earlier one"


def test_the_files_that_a_file_names_are_kept(files: Path, pb4u: Callable) -> None:
    Path("skirt.svg").write_text("mine")
    Path("skirt.toml").write_text('svg = "skirt.svg"\nseams = []\n[panels]\n')
    ended = pb4u("dress", "skirt.toml", "--out", "skirt.svg")
    assert "would overwrite skirt.svg, which is read" in ended.err
    Path("a room.bin").write_bytes(b"mine")
    Path("room.gltf").write_text('{"buffers": [{"uri": "a%20room.bin"}, {"uri": "data:,"}], "images": [{}]}')
    ended = pb4u("check", "tshirt", "--body", "room.gltf", "--json", "a room.bin")
    assert "would overwrite a room.bin, which is read" in ended.err
    assert (Path("skirt.svg").read_text(), Path("a room.bin").read_bytes()) == ("mine", b"mine")
    Path("worn.obj").write_text("mtllib   \nmtllib worn.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    Path("worn.mtl").write_text("newmtl a\nmap_Kd -clamp on worn.png\n")
    Path("worn.png").write_bytes(b"mine")
    for kept, flags in (("worn.png", ("--out", "worn.png")), ("worn.mtl", ("--out", "a.npz", "--json", "worn.mtl"))):
        assert f"would overwrite {kept}, which is read" in pb4u("simulate", "--garment", "worn.obj", *flags).err
