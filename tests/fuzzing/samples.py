"""A small sound file of every kind that is read, and what reads it."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import random
import struct
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch
import trimesh
from safetensors.numpy import save as save_safetensors
from tests.body.characters import write_doll
from tests.body.test_smpl import synthetic
from tests.compat.test_garment_dictionary import garment_fields
from tests.fuzzing.mutation import damaged
from tests.garment.cloth_shapes import quad_tube, tube_arrays
from tests.motion.recordings import write_acclaim, write_bvh
from tests.pattern.patterns import DRAWN_PANELS, DRAWN_SEAMS, square
from tests.scene.test_trajectory import make_trajectory
from tests.simulation.released_files import made_checkpoint
from tests.training.ball_data import ball_data

from pb4u import __version__
from pb4u.body.body_model import ShapedBody
from pb4u.body.character import Character, PosedCharacter
from pb4u.body.library import load_body
from pb4u.body.sequence_files import write_vertex_sequence
from pb4u.body.smpl import read_contact
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.cli.main import main
from pb4u.compat.garment_dictionary import read_dictionary_garment
from pb4u.compat.recording_as_released import RecordingAsItIs
from pb4u.compat.released_weights import read_released
from pb4u.compat.result_pickle import open_trajectory, write_result
from pb4u.dataset.dataset_folder import DatasetFolder
from pb4u.dataset.jobs_file import read_jobs
from pb4u.errors import InputError
from pb4u.export.registry import export
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment
from pb4u.garment.material import MATERIALS, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.geometry.obj_file import write_obj
from pb4u.jobs.job_folder import FOLDER_VERSION
from pb4u.motion.character_lead_in import character_lead_in
from pb4u.motion.library import load_motion
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.pattern.dressing import Dressed
from pb4u.pattern.files import read_dressed, read_pattern, write_dressed
from pb4u.pattern.garmentcode import record_of
from pb4u.pattern.mesh import mesh_pattern
from pb4u.pattern.pattern import Pattern
from pb4u.pattern.sewing import sewn_garment
from pb4u.progress import no_progress
from pb4u.run import Run
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.checkpoint import load_checkpoint, save_checkpoint, weights_file
from pb4u.simulation.models import load_checkpoint_of
from pb4u.training.packed_data import load_training_data, save_training_data
from pb4u.training.run_folder import RunFolder

Read = Callable[[Path], object]
CLOTH = MATERIALS["default"]


class NotFiniteError(AssertionError):
    """A file was taken, and what came of it is no number."""


@dataclass(frozen=True, eq=False)
class Sample:
    """A sound file and its readers.

    Args:
        name: of the kind of file.
        files: content by name; the first is what the readers are given, the others lie beside it.
        readers: what reads it; one that takes seconds is asked less often.
        slow: readers that are asked for one damaged file in twenty.
    """

    name: str
    files: dict[str, bytes]
    readers: tuple[Read, ...]
    slow: tuple[Read, ...] = ()

    def written(self, folder: Path) -> Path:
        """Path of the first file, after all are written into a folder."""
        for name, content in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder / next(iter(self.files))


@dataclass(frozen=True, eq=False)
class Case:
    """A damaged file and who reads it.

    Args:
        sample: with the damaged content.
        read: the reader.
    """

    sample: Sample
    read: Read

    @property
    def name(self) -> str:
        """The kind of file and the reader, in words."""
        return f"{self.sample.name}, {getattr(self.read, '__name__', self.read)}"


def case(seed: str, only: str = "") -> Case:
    """The case of a seed; the same each time.

    Args:
        seed: any text.
        only: part of the names of the kinds of files to choose from.
    """
    rng = random.Random(seed)
    sample = rng.choice([each for each in samples() if only in each.name])
    readers = sample.slow if sample.slow and (not sample.readers or rng.random() < 0.05) else sample.readers
    read = rng.choice(readers)
    name = rng.choice(list(sample.files))
    changed = damaged(name, sample.files[name], rng)
    return Case(replace(sample, files={**sample.files, name: changed}), read)


def _require_finite(*arrays: Any) -> None:
    for array in arrays:
        if not np.isfinite(np.asarray(array)).all():
            raise NotFiniteError("what was read is taken, and not finite")


def body(path: Path) -> None:
    loaded = load_body(path)
    if isinstance(loaded, VertexSequence):
        _require_finite(loaded.positions(0, min(loaded.frame_count, 4)), loaded.resampled(60.0).positions(0, 2))
        return
    _require_finite(loaded.vertices, loaded.skeleton.joints, loaded.weights.weights)
    _perform("walk", loaded)


def clip_of_character(path: Path) -> None:
    loaded = load_body(path)
    assert isinstance(loaded, Character)
    poses = character_lead_in(loaded, loaded.clip_poses(30.0, 3), 30.0, 2)
    _require_finite(PosedCharacter(loaded, poses, 30.0).positions(0, 5))


def body_of_folder(path: Path) -> None:
    body(path.parent)


def _perform(name: str, performer: ShapedBody) -> None:
    motion = load_motion(name)
    frames = min(motion.available_frames(30.0) or 3, 3)
    poses = motion.poses(performer, 30.0, frames)
    _require_finite(poses.rotations, poses.root_positions, performer.posed(poses).positions(0, frames))


def performed(path: Path) -> None:
    _perform(str(path), _woman())


@cache
def _woman() -> ShapedBody:
    loaded = load_body("woman")
    assert isinstance(loaded, ShapedBody)
    return loaded


def as_recorded(path: Path) -> None:
    motion = RecordingAsItIs(path)
    _require_finite(list(motion.shape.values()), motion._local, motion._translations)


def garment(path: Path) -> None:
    _require_finite(read_garment(path, CLOTH).vertices)


def remeshed(path: Path) -> None:
    _require_finite(read_garment(path, CLOTH, triangles=200).vertices)


def of_dictionary(path: Path) -> None:
    entry = DictionaryEntry.parse(f"{path}:sheet")
    assert entry is not None
    _require_finite(read_dictionary_garment(entry, CLOTH).vertices)


def exported(path: Path) -> None:
    trajectory = open_trajectory(path)
    for name in ("again.npz", "again.pc2", "again.glb", "again.pkl"):
        export(trajectory, path.parent / name)


def pins(path: Path) -> None:
    resolve_pins(path, _sheet())


@cache
def _sheet() -> Garment:
    vertices, quads = tube_arrays(around=8, rows=3)
    return Garment("tube", vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]), CLOTH)


def omitted(path: Path) -> None:
    read_contact(path, 90)


def training_run(path: Path) -> None:
    run = RunFolder.open(path.parent)
    run.configuration()
    run.load_state()
    run.metrics()


def made_dataset(path: Path) -> None:
    DatasetFolder(path.parent, None, False)


def command(*arguments: str) -> Read:
    """Reads by the command line: `FILE` stands for the file, `BESIDE` for its folder."""

    def read(path: Path) -> None:
        given = [each.replace("FILE", str(path)).replace("BESIDE", str(path.parent)) for each in arguments]
        said, before = io.StringIO(), sys.argv
        sys.argv = ["pb4u", *given]
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
                main()
        except SystemExit as ended:
            if ended.code not in (0, None):
                raise InputError(said.getvalue().strip().rpartition("\n")[2]) from None
        finally:
            sys.argv = before

    read.__name__ = f"`pb4u {' '.join(arguments)}`"
    return read


SKINNED = ("--model", "skinning", "--frames", "2", "--lead-in", "0", "--out", "BESIDE/out.npz")
CHECKED = (command("check", "FILE"), command("check", "FILE", "--fix", "BESIDE/out.obj"))


@cache
def samples() -> tuple[Sample, ...]:
    """Every kind of file."""
    with tempfile.TemporaryDirectory() as folder:
        return tuple(_samples(Path(folder)))


def _samples(folder: Path) -> Iterator[Sample]:
    yield from _bodies(folder)
    yield from _recordings(folder)
    yield from _garments()
    yield from _trajectories(folder)
    yield from _networks(folder)
    yield from _texts()


def _npz(**arrays: Any) -> bytes:
    written = io.BytesIO()
    np.savez(written, **arrays)
    return written.getvalue()


def _bodies(folder: Path) -> Iterator[Sample]:
    for family in ("smpl", "smplx"):
        members = synthetic(family)
        yield Sample(f"{family} body in an npz", {"body.npz": _npz(**members)}, (body,))
        yield Sample(f"{family} body in a pickle", {"body.pkl": pickle.dumps(members, protocol=2)}, (body,))
    yield Sample("baked body", {"body.npz": _npz(**_baked(200))}, (body,))
    post = trimesh.creation.cylinder(radius=0.24, height=1.7, sections=16)
    post.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0], [0, 0, 0.0]))
    post.apply_translation([0, 0.85, 0])
    faces = np.asarray(post.faces, dtype=np.int64)
    moving = np.array([post.vertices + [0.1 * k, 0.0, 0.0] for k in range(4)]).astype(np.float32)
    write_vertex_sequence(folder / "post.npz", moving, faces, 24.0)
    worn = ("--garment", "BESIDE/tube.obj", "--body", "FILE")
    simulated = (body,), (command("simulate", *worn, *SKINNED), command("check", *worn))
    tube = {"tube.obj": _obj()}
    npz = {"post.npz": (folder / "post.npz").read_bytes()}
    yield Sample("moving body in an npz", npz | tube, *simulated)
    verts = pickle.dumps({"verts": moving, "faces": faces})
    yield Sample("moving body in a pickle", {"post.pkl": verts} | tube, *simulated)
    surface = trimesh.exchange.obj.export_obj(post, digits=6, header=None).encode()
    yield Sample("body in an obj", {"post.obj": surface} | tube, *simulated)
    pc2 = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, len(moving[0]), 0.0, 1.0, 4) + moving.astype("<f4").tobytes()
    yield Sample("body in a pc2", {"post.pc2": pc2, "post.obj": surface} | tube, *simulated)
    mdd = (
        struct.pack(">ii", 4, len(moving[0]))
        + (np.arange(4) / 30).astype(">f4").tobytes()
        + moving.astype(">f4").tobytes()
    )
    yield Sample("body in an mdd", {"post.mdd": mdd, "post.obj": surface} | tube, *simulated)
    ply = trimesh.exchange.ply.export_ply(post)
    doll = write_doll(folder / "doll.glb").read_bytes()
    yield Sample("rigged character", {"doll.glb": doll}, (body, clip_of_character))
    seen = {"pred_vertices": (moving[0] * [1, -1, -1]).astype(np.float32), "pred_cam_t": np.zeros(3, dtype=np.float32)}
    frame = _npz(**seen, faces=faces)
    yield Sample("body of SAM 3D Body", {"f/0.npz": frame, "f/1.npz": frame}, (body_of_folder,))
    yield Sample("body in a folder of obj", {"f/0.obj": surface, "f/1.obj": surface}, (body_of_folder,))
    yield Sample("body in a folder of ply", {"f/0.ply": ply, "f/1.ply": ply}, (body_of_folder,))
    yield Sample(
        "body vertices left out", {"aux.pkl": pickle.dumps({"vertex_type": np.ones((90, 1), int)})}, (omitted,)
    )
    yield Sample("body vertices left out, as text", {"left.txt": b"0\n1, 2\n89\n"}, (omitted,))


def _baked(vertices: int) -> dict[str, np.ndarray]:
    """The first vertices of a built-in body."""
    with np.load(str(files("pb4u.body").joinpath("data", "man.npz"))) as archive:
        members = dict(archive)
    for name in ("weight_bones", "weights", "contact"):
        members[name] = members[name][:vertices]
    members["term_vertices"] = members["term_vertices"][:, :vertices]
    members["faces"] = members["faces"][(members["faces"] < vertices).all(axis=1)]
    return members


def _recordings(folder: Path) -> Iterator[Sample]:
    rng = np.random.default_rng(3)
    poses, places = 0.3 * rng.normal(size=(6, 156)), 0.1 * rng.normal(size=(6, 3))
    amass = _npz(poses=poses, trans=places, betas=np.zeros(16), mocap_framerate=60.0, gender=np.array("female"))
    checked = command("check", "--motion", "FILE")
    yield Sample("AMASS recording", {"clip.npz": amass}, (performed, as_recorded), (checked,))
    vto = {"poses": poses[:, :72], "trans": places}
    yield Sample("VTO recording", {"clip.pkl": pickle.dumps(vto)}, (performed,), (checked,))
    vto = {"pose": poses[:, :72], "translation": places, "shape": np.zeros((6, 10))}
    yield Sample("VTO recording as released", {"clip.pkl": pickle.dumps(vto)}, (performed, as_recorded))
    hood = {"body_pose": poses[:, 3:72], "global_orient": poses[:, :3], "transl": places, "betas": np.zeros((1, 10))}
    yield Sample("HOOD recording", {"clip.pkl": pickle.dumps({**hood, "trans": places})}, (performed, as_recorded))
    torch_file, joblib_file, track = io.BytesIO(), io.BytesIO(), io.BytesIO()
    split = {"global_orient": poses[:, :3], "body_pose": poses[:, 3:66], "transl": places, "betas": np.zeros((6, 10))}
    torch.save({"smpl_params_global": {k: torch.from_numpy(v).float() for k, v in split.items()}}, torch_file)
    yield Sample("GVHMR recording", {"clip.pt": torch_file.getvalue()}, (performed,), (checked,))
    person = {"pose_world": poses[:, :72].astype(np.float32), "trans_world": places, "frame_ids": np.arange(6) * 2}
    joblib.dump({np.int64(1): person}, joblib_file)
    yield Sample("WHAM recording", {"clip.pkl": joblib_file.getvalue()}, (performed,), (checked,))
    turns = torch.eye(3).repeat(6, 24, 1, 1)
    found = {"pred_rotmat": turns, "pred_trans": torch.zeros(6, 1, 3), "frame": torch.arange(6)}
    np.save(track, found)  # type: ignore[arg-type]
    camera = io.BytesIO()
    np.save(camera, {"pred_cam_R": np.tile(np.eye(3), (6, 1, 1)), "pred_cam_T": np.zeros((6, 3))})  # type: ignore[arg-type]
    tram = {"clip.npy": track.getvalue(), "camera.npy": camera.getvalue()}
    yield Sample("TRAM recording", tram, (performed,), (checked,))
    amc = write_acclaim(folder, 4, {"lfemur": [10.0, 0.0, 5.0]})
    pair = {"07_01.amc": amc.read_bytes(), "07.asf": (folder / "07.asf").read_bytes()}
    yield Sample("Acclaim recording", pair, (performed,), (checked,))
    yield Sample("Biovision recording", {"clip.bvh": write_bvh(folder).read_bytes()}, (performed,), (checked,))


def meshed_pattern(path: Path) -> None:
    mesh_pattern(read_pattern(path), 60)


def _garments() -> Iterator[Sample]:
    vertices, quads = tube_arrays(around=16, rows=6)
    triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    dressed = (*CHECKED, command("simulate", "--garment", "FILE", *SKINNED))
    files = {
        "tube.obj": _obj(),
        "tube.ply": trimesh.exchange.ply.export_ply(mesh),
        "text.ply": trimesh.exchange.ply.export_ply(mesh, encoding="ascii"),
        "tube.stl": trimesh.exchange.stl.export_stl(mesh),
        "text.stl": trimesh.exchange.stl.export_stl_ascii(mesh).encode(),
        "tube.off": trimesh.exchange.off.export_off(mesh).encode(),
        "tube.glb": trimesh.exchange.gltf.export_glb(mesh),
    }
    for name, content in files.items():
        yield Sample(f"garment {name}", {name: content}, (garment, remeshed), dressed)
    gltf = dict(trimesh.exchange.gltf.export_gltf(mesh))
    whole = {"tube.gltf": gltf.pop("model.gltf"), **gltf}
    yield Sample("garment tube.gltf", whole, (garment,), dressed)
    pattern = Pattern("square", [square("front")], [])
    whole_pattern = json.dumps(record_of(pattern)).encode()
    yield Sample("sewing pattern", {"square.json": whole_pattern}, (meshed_pattern,))
    yield Sample("drawn pattern", {"skirt.toml": DRAWN_SEAMS, "skirt.svg": DRAWN_PANELS}, (meshed_pattern,))
    mesh = mesh_pattern(pattern, 20)
    sewn = sewn_garment(mesh, np.zeros((mesh.vertex_count, 3)), MATERIALS["default"])
    with tempfile.TemporaryDirectory() as folder:
        write_dressed(Path(folder) / "worn.npz", Dressed(sewn, mesh, 0, 0, 0.0, 0.0), load_body("woman", {}))
        worn = (Path(folder) / "worn.npz").read_bytes()
    yield Sample("dressed garment", {"worn.npz": worn}, (read_dressed,))
    many = {"sheet": garment_fields(), "other": garment_fields(3, 3)}
    yield Sample("garments dictionary", {"all.pkl": pickle.dumps(many)}, (of_dictionary,))


def _obj(**shape: float) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_obj(Path(folder) / "tube.obj", quad_tube(around=16, rows=6, **shape))
        return (Path(folder) / "tube.obj").read_bytes()


def _trajectories(folder: Path) -> Iterator[Sample]:
    made = make_trajectory(frames=3, vertices=40, with_source=True)
    converted = (
        command("convert", "FILE", "BESIDE/out.obj"),
        command("convert", "FILE", "BESIDE/out.usda", "--every", "2"),
    )
    whole = made.save(folder / "whole.npz").read_bytes()
    yield Sample("trajectory", {"t.npz": whole}, (exported,), converted)
    yield Sample("trajectory in half precision", {"t.npz": made.encode(half=True)}, (exported,), converted)
    write_result(made, folder / "result.pkl", no_progress)
    yield Sample("result of the released code", {"t.pkl": (folder / "result.pkl").read_bytes()}, (exported,), converted)
    long = make_trajectory(frames=3, vertices=700).save(folder / "long.npz").read_bytes()
    yield Sample("trajectory that is mapped", {"t.npz": long}, (Trajectory.open,), converted)


def _networks(folder: Path) -> Iterator[Sample]:
    with weights_file("pb4u-small") as path:
        whole = load_checkpoint(path)
    configuration = replace(whole.configuration, width=8, blocks=1)
    model = AccelerationModel(configuration.network())
    save_checkpoint(folder / "small.safetensors", model, configuration, whole.record, "MIT")
    content = (folder / "small.safetensors").read_bytes()
    yield Sample("checkpoint", {"small.safetensors": content}, (load_checkpoint, _network))
    torch.save(made_checkpoint(), folder / "released.pth")
    weights = {key: value.numpy() for key, value in made_checkpoint()["training_module"].items()}
    for name, kept in (("m.pth", (folder / "released.pth").read_bytes()), ("m.safetensors", save_safetensors(weights))):
        yield Sample(f"released weights {name}", {name: kept}, (read_released,))
    save_training_data(ball_data((3,)), folder / "pack.npz")
    yield Sample("training pack", {"pack.npz": (folder / "pack.npz").read_bytes()}, (load_training_data,))
    run = RunFolder.create(folder / "run", {"preset": "small", "budget": {"steps": 3, "minutes": None}})
    run.save_state({"a": torch.zeros(3)}, {"step": 2, "seconds": 1.0})
    run.append_metrics({"step": 1, "loss": 0.5})
    names = ("configuration.json", "last.safetensors", "metrics.jsonl")
    yield Sample("folder of a training", {name: (run.path / name).read_bytes() for name in names}, (training_run,))


def _network(path: Path) -> None:
    load_checkpoint_of(str(path))


def _texts() -> Iterator[Sample]:
    material = {"density": 0.2, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-5, "thickness": 5e-4}
    yield Sample("material", {"m.json": json.dumps(material).encode()}, (load_material,))
    fabric = {f"{name}_stiffness": 100.0 for name in ("warp", "weft", "shear")} | {"coupling_stiffness": 10.0}
    fabric |= {"density": 0.2, "bending_stiffness": {"warp": 1e-5, "weft": 1e-5, "bias": 1e-5}, "source": "a mill"}
    yield Sample("fabric", {"m.json": json.dumps(fabric).encode()}, (load_material,))
    measured = {"density": 0.2, "stretching": 6 * [[20.0, 5.0, 40.0, 10.0]], "bending": 3 * [5 * [2e-5]]}
    yield Sample("material of ARCSim", {"m.json": json.dumps(measured).encode()}, (load_material,))
    yield Sample("pins", {"pins.txt": b"0 1 2\n3,4\n"}, (pins,))
    yield Sample("pins in JSON", {"pins.json": b"[0, 1, 2, 5]"}, (pins,))
    with tempfile.TemporaryDirectory() as folder:
        described = Run().save(Path(folder) / "scene.toml").read_bytes()
    scene = described + b'\n[[garments]]\ngarment = "skirt"\ntriangles = 500\npins = [1, 2]\nmaterial = "silk"\n'
    yield Sample("scene file", {"scene.toml": scene}, (Run.open,))
    jobs = b'[fixed]\nframes = 8\n[product]\nmotion = ["walk", "run"]\nseed = {first = 0, count = 3}\n'
    jobs += b'[[clips]]\ngarment = ["tanktop", "skirt"]\nbody_shape = {height = 0.6}\nscene = "scene.toml"\n'
    yield Sample("jobs file", {"jobs.toml": jobs, "scene.toml": scene}, (read_jobs,))
    manifest = {
        "version": FOLDER_VERSION,
        "pb4u": __version__,
        "kind": "a dataset",
        "format": "folder",
        "precision": "full",
    }
    shard = io.BytesIO()
    with tarfile.open(fileobj=shard, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("abc.npz"), io.BytesIO(b""))
    dataset = {"d/manifest.json": json.dumps(manifest).encode(), "d/shards/shard-00000.tar": shard.getvalue()}
    yield Sample("folder of a dataset", dataset, (made_dataset,))
