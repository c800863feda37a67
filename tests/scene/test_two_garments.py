"""A scene of two garments on one body: one world, simulated together, written as one file and told apart in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import pb4u
from pb4u.geometry.principal_stretch import face_strains
from pb4u.scene.packed import pack
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.timeline import Timeline

FRAMES = 3
NAMES = ("tanktop", "skirt")


@pytest.fixture(scope="module")
def alone() -> list[Scene]:
    """A tank top, and a skirt of another material, each by itself."""
    return [
        pb4u.make_scene(name, motion="walk", triangles=400, frames=FRAMES, lead_in=0, material=material)
        for name, material in zip(NAMES, ("default", "denim"), strict=True)
    ]


@pytest.fixture(scope="module")
def scene(alone: list[Scene]) -> Scene:
    return replace(alone[0], garments=tuple(part.garments[0] for part in alone))


def test_the_frames_of_a_scene_are_one_world(scene: Scene) -> None:
    timeline = Timeline.of(scene)
    garments, bodies = timeline.garments, timeline.colliders
    assert garments.worlds == (0, 0)
    assert (garments.world_count, garments.garment_count) == (1, 2)
    assert garments.vertex_world.tolist() == [0] * garments.vertex_count
    assert len(bodies.surfaces) == 1
    assert bodies.vertex_world.tolist() == [0] * len(scene.colliders[0].contact)
    cut = garments.vertex_offsets[1]
    for worn, rows in zip(scene.garments, (slice(0, cut), slice(cut, None)), strict=True):
        for frame in (0, FRAMES - 1):
            expected = worn.placement.positions(frame, frame + 1)[0].double()
            assert torch.equal(timeline.skinned(frame)[rows], expected)
    step = timeline.step_from(timeline.skinned_state(1))
    for pose, frame in ((step.collider.previous, 0), (step.collider.now, 1), (step.collider.following, 2)):
        assert torch.equal(pose.positions, scene.colliders[0].positions(frame, frame + 1)[0].double())
    assert torch.equal(step.pin_positions, timeline.skinned(2))


def test_skinning_of_two_garments_is_that_of_each_joined(scene: Scene, alone: list[Scene]) -> None:
    simulator = pb4u.load_simulator("skinning")
    together, parts = simulator.simulate(scene), [simulator.simulate(part) for part in alone]
    for name in ("positions", "velocities"):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        np.testing.assert_array_equal(getattr(together, name), joined)
    np.testing.assert_array_equal(together.body_positions, parts[0].body_positions)


def test_what_is_written_tells_the_garments_apart(scene: Scene, alone: list[Scene], tmp_path: Path) -> None:
    written = pb4u.load_simulator("solver").simulate(scene)
    read = Trajectory.open(written.save(tmp_path / "two.npz"))
    for name in ("positions", "velocities", "body_positions"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    garments = [worn.garment for worn in scene.garments]
    counts = [len(garment.vertices) for garment in garments]
    assert read.positions.shape == (FRAMES, sum(counts), 3)
    np.testing.assert_array_equal(read.header.vertex_garment, np.repeat([0, 1], counts))
    assert [entry["name"] for entry in read.header.garments] == [garment.name for garment in garments]
    rest = np.asarray(read.header.rest_positions)
    for g, (entry, garment) in enumerate(zip(read.header.garments, garments, strict=True)):
        (first, stop), (face, last) = entry["vertices"], entry["triangles"]
        np.testing.assert_array_equal(np.flatnonzero(read.header.vertex_garment == g), np.arange(first, stop))
        np.testing.assert_array_equal(read.header.faces[face:last] - first, garment.faces)
        np.testing.assert_array_equal(rest[first:stop], garment.vertices.astype(np.float32))
        assert entry["material"] == garment.material.five_numbers
    assert read.header.garments[0]["material"] != read.header.garments[1]["material"]
    assert read.metadata["triangles"] == sum(garment.triangle_count for garment in garments)


def test_the_solver_moves_both_garments_as_it_would_move_each(scene: Scene, alone: list[Scene]) -> None:
    """Without self-contact nothing passes between them; folds of garments settled together may still differ."""
    simulator, record = pb4u.load_simulator("solver", self_contact=False), RunRecord()
    together = np.stack([frame.positions for frame in simulator.written_frames(scene, record)])
    assert (len(record.solver_iterations), record.unsolved) == (FRAMES - 1, 0)
    skinned = pb4u.load_simulator("skinning").simulate(scene)
    for entry, part, worn in zip(skinned.header.garments, alone, scene.garments, strict=True):
        first, stop = entry["vertices"]
        own, by_itself, garments = together[:, first:stop], simulator.simulate(part).positions, pack([worn.garment])
        away = np.linalg.norm(own - by_itself, axis=2)
        fallen = np.linalg.norm(own - skinned.positions[:, first:stop], axis=2)
        strains = [
            float(face_strains(torch.from_numpy(x[-1]).double(), garments.faces, garments.inverse_rest_shape).mean())
            for x in (own, by_itself)
        ]
        assert np.median(away) < 0.2 * np.median(fallen)
        assert strains[0] == pytest.approx(strains[1], rel=0.05)


def test_a_file_of_one_garment_and_no_list_of_garments_is_still_read(alone: list[Scene], tmp_path: Path) -> None:
    """As versions wrote it that knew one garment."""
    written = pb4u.load_simulator("skinning").simulate(alone[1])
    metadata = {name: value for name, value in written.metadata.items() if name != "garments"}
    older = replace(written, header=replace(written.header, metadata=metadata)).save(tmp_path / "older.npz")
    read = Trajectory.open(older)
    garment = alone[1].garments[0].garment
    (entry,) = read.header.garments
    assert entry["vertices"] == [0, len(garment.vertices)]
    assert entry["triangles"] == [0, garment.triangle_count]
    assert entry["material"] == garment.material.five_numbers
    assert entry["name"] == read.metadata["garment"]
