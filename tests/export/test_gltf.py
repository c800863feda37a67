"""GLB: judged by the Khronos validator, read by trimesh, its targets and weights blended by hand."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from tests.export.readers import Glb

from pb4u.errors import InputWarning
from pb4u.export.gltf import write_glb
from pb4u.export.registry import export
from pb4u.export.selection import on_source, select_frames
from pb4u.export.shading import garment_colours
from pb4u.scene.trajectory import Trajectory

_VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then(report => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="session")
def validator() -> Any:
    node = shutil.which("node")
    if node is None or subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True).returncode:
        pytest.skip("node with gltf-validator is absent: npm install gltf-validator, and set NODE_PATH")

    def validate(path: Path) -> dict[str, Any]:
        ended = subprocess.run([node, "-e", _VALIDATE, str(path)], capture_output=True, text=True, check=True)
        return json.loads(ended.stdout)["issues"]

    return validate


def test_blends_reproduce_every_frame_of_both_surfaces(trajectory: Trajectory, tmp_path: Path) -> None:
    glb = Glb(export(trajectory, tmp_path / "walk.glb"))
    assert [node["name"] for node in glb.json["nodes"]] == ["garment", "body"]
    for node, expected in enumerate((trajectory.positions, trajectory.body_positions)):
        blended = glb.blended(node, "POSITION", 12)[:, : expected.shape[1]]
        assert np.linalg.norm(blended - expected, axis=-1).max() < 1e-3
        np.testing.assert_allclose(blended[0], expected[0], atol=2e-6)
    times = glb.array(glb.json["animations"][0]["samplers"][0]["input"])
    np.testing.assert_allclose(times[:, 0], np.arange(12) / 25, atol=1e-6)


def test_each_garment_has_a_colour_of_its_own(trajectory: Trajectory, tmp_path: Path) -> None:
    upper = trajectory.positions[0][:, 1] > 0.9
    outfit = replace(trajectory, header=replace(trajectory.header, vertex_garment=upper.astype(np.int32)))
    glb = Glb(export(outfit, tmp_path / "outfit.glb"))
    one, other = glb.json["meshes"][0]["primitives"]
    assert one["attributes"] == other["attributes"]
    assert one["targets"] == other["targets"]
    colours = [glb.json["materials"][k["material"]]["pbrMetallicRoughness"]["baseColorFactor"] for k in (one, other)]
    np.testing.assert_allclose(np.array(colours)[:, :3] ** (1 / 2.2), garment_colours(["", ""]), atol=2e-3)
    counts = [glb.json["accessors"][k["indices"]]["count"] // 3 for k in (one, other)]
    assert counts == np.bincount(upper[trajectory.faces[:, 0]]).tolist()


def test_normals_follow_the_surface(trajectory: Trajectory, tmp_path: Path) -> None:
    normals = Glb(export(trajectory, tmp_path / "walk.glb")).blended(0, "NORMAL", 12)[
        :, : trajectory.positions.shape[1]
    ]
    for t in (0, 5, 11):
        mesh = trimesh.Trimesh(trajectory.positions[t], trajectory.faces, process=False)
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        expected = np.zeros_like(mesh.vertices)
        for k in range(3):
            np.add.at(expected, mesh.faces[:, k], np.cross(b - a, c - a))
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        found = normals[t] / np.linalg.norm(normals[t], axis=1, keepdims=True)
        assert np.einsum("vd,vd->v", expected, found).min() > np.cos(np.deg2rad(3))


def test_trimesh_reads_the_first_frame_with_uvs(trajectory: Trajectory, tmp_path: Path) -> None:
    scene = trimesh.load(export(trajectory, tmp_path / "walk.glb"), process=False)
    garment = scene.geometry["garment"]
    np.testing.assert_allclose(garment.vertices[: len(trajectory.positions[0])], trajectory.positions[0], atol=1e-6)
    np.testing.assert_allclose(garment.vertices[garment.faces], trajectory.positions[0][trajectory.faces], atol=1e-6)
    expected = trajectory.header.uvs[trajectory.header.uv_faces]
    np.testing.assert_allclose(garment.visual.uv[garment.faces], expected, atol=1e-6)
    assert len(garment.vertices) == trajectory.positions.shape[1] + 6, "one copy for each of the six seam vertices"
    np.testing.assert_allclose(scene.geometry["body"].vertices, trajectory.body_positions[0], atol=1e-6)


def test_a_smooth_motion_needs_few_targets(trajectory: Trajectory, tmp_path: Path) -> None:
    t = np.arange(60, dtype=np.float32)[:, None, None]
    start = trajectory.positions[0]
    swaying = start + 0.1 * np.sin(0.2 * t) * start[:, [1, 0, 2]] + np.array([0, 0, 0.04], dtype=np.float32) * t
    long = replace(trajectory, positions=swaying, velocities=swaying, body_positions=np.repeat(start[None], 60, axis=0))
    glb = Glb(export(long, tmp_path / "walk.glb"))
    assert len(glb.json["meshes"][0]["primitives"][0]["targets"]) <= 5
    assert np.linalg.norm(glb.blended(0, "POSITION", 60)[:, : len(start)] - swaying, axis=-1).max() < 1e-3
    assert "targets" not in glb.json["meshes"][1]["primitives"][0], "the body does not move"


def test_a_bound_on_the_targets_is_kept_and_the_error_told(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pb4u.export.gltf._MOST_TARGETS", 4)
    rng = np.random.default_rng(0)
    body = np.repeat(trajectory.body_positions[:1], 12, axis=0)
    shaken = trajectory.positions + rng.normal(0, 0.01, trajectory.positions.shape).astype(np.float32)
    with pytest.warns(InputWarning, match="4 morph targets") as told:
        glb = Glb(export(replace(trajectory, positions=shaken, body_positions=body), tmp_path / "walk.glb"))
    assert len(glb.json["meshes"][0]["primitives"][0]["targets"]) == 4
    error = np.linalg.norm(glb.blended(0, "POSITION", 12)[:, : shaken.shape[1]] - shaken, axis=-1).max()
    assert error == pytest.approx(glb.json["meshes"][0]["extras"]["largest_error"], rel=1e-3)
    assert any(f"{1000 * error:.1f} mm" in str(w.message) for w in told)


@pytest.mark.parametrize("variant", ["whole", "source", "one frame", "bare", "no body", "broken"])
def test_the_khronos_validator_finds_no_fault(
    validator: Any, trajectory: Trajectory, broken: Trajectory, tmp_path: Path, variant: str
) -> None:
    path = tmp_path / "walk.glb"
    if variant == "no body":
        write_glb(trajectory, path, body=False)
    elif variant == "broken":
        with pytest.warns(InputWarning):
            export(broken, path)
    else:
        export(
            {
                "whole": trajectory,
                "source": on_source(trajectory),
                "one frame": select_frames(trajectory, (3, 4), 1),
                "bare": replace(trajectory, header=replace(trajectory.header, uvs=None, uv_faces=None)),
            }[variant],
            path,
        )
    issues = validator(path)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_held_frames_are_listed(broken: Trajectory, tmp_path: Path) -> None:
    with pytest.warns(InputWarning):
        glb = Glb(export(broken, tmp_path / "walk.glb"))
    assert glb.json["asset"]["extras"] == {"held_frames": [0, 5, 6]}
