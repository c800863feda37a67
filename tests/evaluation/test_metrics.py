"""Metrics against trajectories whose values are known."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import trimesh
from ball_scene import sheet

from pb4u.evaluation.metrics import measure
from pb4u.garment.material import Material
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

MATERIAL = Material(density=0.2, lame_mu=23600.0, lame_lambda=44400.0, bending=4e-5)


def trajectory_of(positions: np.ndarray, velocity: float = 0.0) -> Trajectory:
    """Frames of the sheet over a ball of radius 0.2 around the origin."""
    garment = sheet(height=0.0)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    header = TrajectoryHeader(
        faces=garment.faces,
        rest_positions=garment.vertices,
        pinned=garment.pinned,
        vertex_garment=np.zeros(len(garment.vertices), dtype=np.int32),
        body_faces=np.asarray(ball.faces),
        body_contact=np.ones(len(ball.vertices), dtype=bool),
        fps=30.0,
        metadata={"material": asdict(MATERIAL), "ground_height": None},
    )
    velocities = np.full_like(positions, velocity)
    rows = (Frame(p, v, np.asarray(ball.vertices)) for p, v in zip(positions, velocities, strict=True))
    return Trajectory.collect(header, rows)


REST = sheet(height=0.0).vertices


def test_rest_far_from_the_body_costs_nothing_but_height() -> None:
    measured = measure(trajectory_of(np.stack([REST + [0, 5.0, 0]] * 3)))
    metrics = measured["metrics"]
    for name in ("stretch", "bending", "collision", "friction", "inertia", "strain_p95", "penetration_percent"):
        assert metrics[name]["max"] == pytest.approx(0.0, abs=1e-6), name
    weight = MATERIAL.density * 0.5**2 * 9.81
    assert metrics["gravity"]["mean"] == pytest.approx(5.0 * weight, rel=1e-5)
    assert measured["metrics_paper"]["gravity"]["mean"] == pytest.approx(5.0 * weight, rel=1e-5)
    assert not measured["diverged"]


def test_uniform_stretch_has_its_closed_form() -> None:
    s = 1.1
    metrics = measure(trajectory_of(np.stack([s * REST + [0, 5.0, 0]] * 2)))["metrics"]
    g = (s * s - 1) / 2
    area, h = 0.25, MATERIAL.thickness
    expected = area * h * (2 * MATERIAL.lame_mu * g * g + 2 * MATERIAL.lame_lambda * g * g)
    assert metrics["stretch"]["mean"] == pytest.approx(expected, rel=1e-5)
    assert metrics["strain_p95"]["mean"] == pytest.approx(0.1, abs=1e-5)
    assert metrics["strain_max"]["mean"] == pytest.approx(0.1, abs=1e-5)


def test_depth_inside_the_body_is_exact() -> None:
    measured = measure(trajectory_of(np.stack([REST * 1e-3 + [0, 0.15, 0]] * 2)))["metrics"]
    assert measured["penetration_percent"]["mean"] == pytest.approx(100.0)
    assert measured["penetration_depth_max"]["max"] == pytest.approx(0.05, abs=1.5e-3)


def test_inertia_is_that_of_a_change_of_velocity() -> None:
    positions = np.stack([REST + [0, 5.0, 0], REST + [0.01, 5.0, 0]])
    metrics = measure(trajectory_of(positions))["metrics"]
    mass = MATERIAL.density * 0.25
    assert metrics["inertia"]["per_frame"][0] == pytest.approx(0.0, abs=1e-12)
    assert metrics["inertia"]["per_frame"][1] == pytest.approx(0.5 * mass * (0.01 * 30) ** 2, rel=1e-4)


def test_divergence_is_stretch_or_falling_off_or_nan() -> None:
    still = np.stack([REST + [0, 5.0, 0]] * 2)
    assert measure(trajectory_of(1.7 * still))["diverged"]
    skinned = still.mean(axis=1)
    assert not measure(trajectory_of(still), skinned)["diverged"]
    assert measure(trajectory_of(still), skinned)["diverged_at"] is None
    assert measure(trajectory_of(still), skinned + [0, 0.6, 0])["diverged"]
    broken = still.copy()
    broken[1, 3] = np.nan
    measured = measure(trajectory_of(broken))
    assert measured["diverged"]
    assert measured["diverged_at"] == 1
    assert np.isfinite(measured["metrics"]["stretch"]["per_frame"][0])


def test_open_body_reports_no_penetration() -> None:
    trajectory = trajectory_of(np.stack([REST + [0, 5.0, 0]] * 2))
    opened = replace(trajectory.header, body_faces=trajectory.header.body_faces[5:])
    assert "penetration_percent" not in measure(replace(trajectory, header=opened))["metrics"]
