"""Metrics against trajectories whose values are known."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import trimesh
from ball_scene import sheet

from pb4u.errors import InputError
from pb4u.garment.material import Material
from pb4u.measures.metrics import ENERGIES, first_diverged, measure, visible_skin
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

MATERIAL = Material.isotropic(density=0.2, lame_mu=23600.0, lame_lambda=44400.0, bending=4e-5)


def trajectory_of(positions: np.ndarray, velocity: float = 0.0, *parts: trimesh.Trimesh) -> Trajectory:
    """Frames of the sheet over a ball of radius 0.2 around the origin, and other `parts` of its body."""
    garment = sheet(height=0.0)
    ball = trimesh.util.concatenate([trimesh.creation.icosphere(subdivisions=3, radius=0.2), *parts])
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


def test_crossings_are_counted_frame_by_frame() -> None:
    folded = REST.copy()
    # The right half is laid back over the left one and dips through it along its middle.
    right = folded[:, 0] > 1e-9
    folded[right, 0] *= -0.9
    folded[right, 1] += 0.02 - 0.2 * np.abs(folded[right, 0])
    above = np.array([0.0, 5.0, 0.0])
    metrics = measure(trajectory_of(np.stack([REST + above, folded + above, REST])))["metrics"]
    flat, through, in_the_ball = metrics["self_intersections"]["per_frame"]
    assert (flat, in_the_ball) == (0, 0)
    assert through > 5
    assert metrics["self_intersections"]["max"] == through
    outside, still_outside, inside = metrics["body_intersections"]["per_frame"]
    assert (outside, still_outside) == (0, 0)
    assert inside > 20


def test_what_is_inside_another_part_of_the_body_is_no_skin_that_shows() -> None:
    # Just below the top of the ball, which shows through the sheet there, or is buried in a second one.
    positions = np.stack([REST + [0.0, 0.19, 0.0]])
    hood = trimesh.creation.icosphere(subdivisions=3, radius=0.12)
    hood.apply_translation([0.003, 0.23, 0.002])
    bare, worn = (measure(trajectory_of(positions, 0.0, *parts))["metrics"] for parts in ([], [hood]))
    assert bare["visible_skin_percent"]["max"] > 1.0
    assert worn["visible_skin_percent"]["max"] == 0.0
    assert bare["body_intersections_pinched"]["max"] == 0.0
    assert worn["body_intersections_pinched"]["max"] > 0.0


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


HEAVY = Material.isotropic(density=0.5, lame_mu=40000.0, lame_lambda=50000.0, bending=2e-4, thickness=1e-3)


def two_garments(outer: np.ndarray, inner: np.ndarray) -> tuple[Trajectory, list[Trajectory]]:
    """A trajectory of two sheets, the inner of another material, and one of each alone."""
    alone = [trajectory_of(outer), trajectory_of(inner)]
    alone[1] = replace(alone[1], header=alone[1].header.with_metadata(material=asdict(HEAVY)))
    header, vertices, triangles = alone[0].header, outer.shape[1], len(alone[0].faces)
    entries = [
        {
            "name": name,
            "material": asdict(material),
            "vertices": [g * vertices, (g + 1) * vertices],
            "triangles": [g * triangles, (g + 1) * triangles],
            "source": f"{name}.obj",
        }
        for g, (name, material) in enumerate([("outer", MATERIAL), ("inner", HEAVY)])
    ]
    both = replace(
        header.with_metadata(garments=entries),
        faces=np.concatenate([header.faces, header.faces + vertices]),
        rest_positions=np.tile(header.rest_positions, (2, 1)),
        pinned=np.tile(header.pinned, 2),
        vertex_garment=np.repeat(np.arange(2, dtype=np.int32), vertices),
    )
    positions = np.concatenate([each.positions for each in alone], axis=1)
    velocities = np.concatenate([each.velocities for each in alone], axis=1)
    return Trajectory(both, positions, velocities, alone[0].body_positions), alone


def test_each_of_two_garments_is_measured_as_it_is_alone_and_energies_add_up() -> None:
    # The outer lies stretched on the ball's top, the inner has sunk into it and slides.
    outer = np.stack([1.1 * REST + [0, 0.2, 0]] * 3)
    inner = np.stack([0.4 * REST + [0.01 * t, 0.15, 0] for t in range(3)])
    trajectory, alone = two_garments(outer, inner)
    measured = measure(trajectory)
    singles = [measure(each) for each in alone]
    assert [each["name"] for each in measured["garments"]] == ["outer", "inner"]
    for each, single in zip(measured["garments"], singles, strict=True):
        assert set(each["metrics"]) == {*ENERGIES, "strain_p95", "strain_max"}
        for name, series in each["metrics"].items():
            assert series["per_frame"] == pytest.approx(single["metrics"][name]["per_frame"], rel=1e-9), name
    for table in ("metrics", "metrics_paper"):
        assert measured[table]["collision"]["mean"] > singles[0][table]["collision"]["mean"]
        for name in ENERGIES:
            summed = sum(single[table][name]["mean"] for single in singles)
            assert measured[table][name]["mean"] == pytest.approx(summed, rel=1e-9), (table, name)
    strains = [single["metrics"]["strain_max"]["mean"] for single in singles]
    assert measured["metrics"]["strain_max"]["mean"] == pytest.approx(max(strains))
    inside = [single["metrics"]["penetration_percent"]["mean"] for single in singles]
    assert measured["metrics"]["penetration_percent"]["mean"] == pytest.approx(sum(inside) / 2)


def test_a_run_diverged_where_one_of_its_garments_did() -> None:
    still = np.stack([REST + [0, 5.0, 0]] * 4)
    fallen, stretched = still.copy(), still.copy()
    fallen[2:, :, 1] -= 0.6
    stretched[1:] *= 1.7
    centres = np.stack([still.mean(axis=1)] * 2, axis=1)
    for outer, inner, found in ((still, fallen, [None, 2]), (stretched, fallen, [1, 2]), (still, still, [None, None])):
        trajectory, _ = two_garments(outer, inner)
        measured = measure(trajectory, centres)
        assert [each["diverged_at"] for each in measured["garments"]] == found
        first = min((t for t in found if t is not None), default=None)
        assert (measured["diverged"], measured["diverged_at"]) == (first is not None, first)
        assert first_diverged(trajectory, centres) == first
    broken = still.copy()
    broken[3, 0, 1] = np.nan
    trajectory, _ = two_garments(still, broken)
    assert [each["diverged_at"] for each in measure(trajectory)["garments"]] == [None, 3]


def test_a_file_of_one_garment_reads_as_a_list_of_one() -> None:
    measured = measure(trajectory_of(np.stack([1.1 * REST + [0, 0.2, 0]] * 2)))
    (alone,) = measured["garments"]
    assert alone["metrics"] == {name: measured["metrics"][name] for name in alone["metrics"]}
    assert set(alone["metrics"]) >= set(ENERGIES)


@pytest.mark.parametrize("metadata", [{}, {"garments": [{"name": "skirt"}]}, {"material": "silk"}])
def test_garments_of_unknown_material_are_refused(metadata: dict) -> None:
    trajectory = trajectory_of(np.stack([REST] * 2))
    with pytest.raises(InputError, match="do not say what its garments are made of"):
        measure(replace(trajectory, header=replace(trajectory.header, metadata=metadata)))


def shell(radius: float) -> trimesh.Trimesh:
    """The upper half of a ball's surface: cloth over the body of `trajectory_of`, which has the radius 0.2."""
    whole = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    upper = whole.vertices[whole.faces][:, :, 1].min(axis=1) > -1e-9
    return trimesh.Trimesh(whole.vertices, whole.faces[upper], process=False)


def test_skin_under_cloth_is_covered_and_skin_above_it_shows() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    body, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    upper = body[:, 1] > 0.03
    for radius, which in ((0.21, 1), (0.19, 0)):
        cloth = shell(radius)
        masks = visible_skin(body, faces, np.asarray(cloth.vertices), np.asarray(cloth.faces))
        assert masks[which][upper].all()
        assert not masks[1 - which].any()
        assert not masks[which][body[:, 1] < -0.03].any()
        assert len(masks[2]) == masks[0].sum()
    far = shell(0.3)
    assert not visible_skin(body, faces, np.asarray(far.vertices), np.asarray(far.faces))[0].any()


def test_skin_shows_between_vertices_that_are_all_outside() -> None:
    # An octahedron around the ball: its corners are outside, and the middles of its faces within.
    corners = 0.24 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    hull = trimesh.convex.convex_hull(corners)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    shown, covered, under = visible_skin(
        np.asarray(ball.vertices), np.asarray(ball.faces), np.asarray(hull.vertices), np.asarray(hull.faces)
    )
    # The plane of a face is 0.24 / sqrt 3 from the middle, deeper than what counts as come through around its centre.
    assert 0.05 < shown.mean() < 0.95
    assert shown.any()
    assert set(under.tolist()) == set(range(8))
    assert not (shown & covered).any()
