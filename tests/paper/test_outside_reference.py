"""The outside reference: the same Scene in, a Trajectory out, and the same cloth by its own constants."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from benchmarks.outside_reference import hinge_stiffness, newton_membrane, wave_speed
from tests.physics.shapes import nobody
from tests.readable_stiffness import dihedral_angles
from tests.simulation.ball_scene import MATERIAL, Ball, ball_scene, sheet
from torch import Tensor

from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.garment.dressing import Placement
from pb4u.garment.garment import Garment
from pb4u.measures.metrics import measure
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.bending import Bending
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import pack
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.state import State

newton_installed = pytest.mark.skipif(find_spec("newton") is None, reason="newton is not installed")


class Held(Placement):
    """The garment's start pose, its pins lowered at a constant speed [m/s]."""

    def __init__(self, garment: Garment, speed: float = 0.0) -> None:
        self._start = torch.from_numpy(garment.vertices.astype(np.float32))
        self._fall = torch.from_numpy(garment.pinned[:, None] * np.array([0.0, -speed / 30.0, 0.0], dtype=np.float32))

    def positions(self, start: int, stop: int) -> Tensor:
        return self._start + torch.arange(start, stop)[:, None, None] * self._fall


def strip(cells: int = 8, width: float = 0.05, height: float = 0.4) -> Garment:
    """A vertical strip in the XY plane, far from any body, its upper end pinned."""
    flat = sheet(cells)
    side = np.ptp(flat.vertices[:, 0])
    x, y = flat.vertices[:, 0] / side * width + 3.0, flat.vertices[:, 2] / side * height + 1.5
    pinned = y > y.max() - 1e-9
    return replace(flat, vertices=np.column_stack([x, y, np.zeros_like(x)]), faces=flat.faces[:, ::-1], pinned=pinned)


def scene_of(garment: Garment, frames: int, placement: Placement | None = None) -> Scene:
    return Scene((DressedGarment(garment, placement or Held(garment)),), (Ball(frames),), frames)


def simulator(**options: float):  # type: ignore[no-untyped-def]
    from benchmarks.outside_reference import NewtonOptions, NewtonSimulator

    return NewtonSimulator("cpu", NewtonOptions(**options))  # type: ignore[arg-type]


@newton_installed
def test_a_sheet_lands_on_the_ball_twice_alike() -> None:
    scene = ball_scene(frames=8, lead_in=2)
    first, second = (simulator(substeps=6).simulate(scene) for _ in range(2))
    np.testing.assert_array_equal(first.positions, second.positions)
    assert first.positions.shape == (8, 121, 3)
    assert first.metadata["model"] == "newton"
    metrics = measure(first)["metrics"]
    assert metrics["strain_p95"]["max"] < 0.2
    assert metrics["penetration_depth_max"]["max"] < 1e-3
    corners = first.positions[:, [0, 10, 110, 120], 1]
    assert (corners[-1] < corners[0] - 0.05).all()


@newton_installed
def test_velocities_are_displacements_over_a_frame() -> None:
    trajectory = simulator(substeps=3).simulate(ball_scene(frames=4, lead_in=0))
    moved = np.diff(trajectory.positions, axis=0) * 30.0
    np.testing.assert_allclose(trajectory.velocities[1:], moved, atol=1e-4)
    np.testing.assert_array_equal(trajectory.velocities[0], 0.0)


@newton_installed
def test_free_fall_is_gravitys() -> None:
    garment = sheet(4)
    lifted = replace(garment, vertices=garment.vertices + np.array([1.0, 0.2, 0.0]))
    scene = scene_of(lifted, frames=7)
    fallen = simulator(substeps=10).simulate(scene).positions[:, :, 1]
    time = 6 / 30.0
    expected = -0.5 * 9.81 * time * (time + 1 / 300.0)
    np.testing.assert_allclose(fallen[6] - fallen[0], expected, rtol=2e-3)


@newton_installed
def test_pins_go_where_the_placement_says() -> None:
    garment = strip()
    scene = scene_of(garment, 5, Held(garment, speed=0.4))
    trajectory = simulator(substeps=4).simulate(scene)
    expected = garment.vertices[garment.pinned][:, 1] - 0.4 * 4 / 30.0
    np.testing.assert_allclose(trajectory.positions[4][garment.pinned][:, 1], expected, atol=1e-6)


@newton_installed
def test_a_hanging_strip_stretches_by_its_weight() -> None:
    """Its mean strain is density g height / (2 E), E the two-dimensional Young's modulus of the Lame pair."""
    garment = strip(cells=4)
    mu, lam = newton_membrane(MATERIAL)
    young = 4 * mu * (mu + lam) / (2 * mu + lam)
    expected = MATERIAL.density * 9.81 * 0.4 / (2 * young)
    y = simulator(substeps=12, iterations=10).simulate(scene_of(garment, 16)).positions[:, :, 1]
    # It swings around its stretched length with a period of 4 frames: a mean over whole periods is where it rests.
    stretched = np.mean(y[4:, garment.pinned].mean(1) - y[4:].min(1)) / 0.4 - 1.0
    assert stretched == pytest.approx(expected, rel=0.1)


@newton_installed
def test_the_ground_holds_the_sheet() -> None:
    garment = sheet(4)
    low = replace(garment, vertices=garment.vertices + np.array([3.0, -0.68, 0.0]))
    lowest = simulator(substeps=5).simulate(scene_of(low, 12)).positions[-1, :, 1]
    np.testing.assert_allclose(lowest, 2e-3, atol=5e-4)


@newton_installed
def test_a_moving_body_is_met_where_it_has_moved_to() -> None:
    """The ball leaves the box that Newton drew around it at the start; without mending it would meet nothing there."""
    garment = sheet(6, side=0.3, height=0.75)
    away = replace(garment, vertices=garment.vertices + np.array([0.5, 0.0, 0.0]))
    scene = Scene((DressedGarment(away, Held(away)),), (Ball(16, speed=1.2),), 16)
    trajectory = simulator(substeps=6).simulate(scene)
    centres = np.array([0.0, 0.5, 0.0]) + np.outer(np.arange(16) / 30.0 * 1.2, [1.0, 0.0, 0.0])
    distance = np.linalg.norm(trajectory.positions - centres[:, None], axis=2)
    assert distance.min() > 0.2 - 1e-3
    assert distance.min() < 0.205


@newton_installed
def test_a_leaping_body_is_not_passed_through() -> None:
    """The ball jumps up by 0.4 m, twice its radius, in one frame and takes the sheet above it along."""
    garment = sheet(8, side=0.3, height=0.71)

    class Leap(Ball):
        def positions(self, start: int, stop: int) -> Tensor:
            height = 0.4 * (np.arange(start, stop) > 0)[:, None, None] * np.array([0.0, 1.0, 0.0])
            return torch.from_numpy((self.rest_vertices + height).astype(np.float32))

    scene = Scene((DressedGarment(garment, Held(garment)),), (Leap(2),), 2)
    lifted = simulator(substeps=4).simulate(scene).positions[1]
    centre = np.array([0.0, 0.9, 0.0])
    assert np.linalg.norm(lifted - centre, axis=1).min() > 0.19
    assert lifted[:, 1].max() > 1.09


@newton_installed
def test_newtons_membrane_force_is_ours_at_small_strain() -> None:
    """One triangle, two corners held, the third let go for one tiny step: force = mass displacement / dt^2."""
    import warp
    from newton import Axis, ModelBuilder
    from newton.solvers import SolverVBD

    mu, lam = newton_membrane(MATERIAL)
    builder = ModelBuilder(up_axis=Axis.Y)
    corners = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]])
    builder.add_cloth_mesh(
        pos=warp.vec3(0.0, 0.0, 0.0),
        rot=warp.quat_identity(),
        scale=1.0,
        vel=warp.vec3(0.0, 0.0, 0.0),
        vertices=corners.tolist(),
        indices=[0, 1, 2],
        density=1.0,
        tri_ke=mu,
        tri_ka=lam,
        tri_kd=0.0,
    )
    builder.particle_flags[:2] = [0, 0]
    builder.color()
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, 0.0))
    before, after = model.state(), model.state()
    stretched = corners.copy()
    stretched[2] = [2e-4, 0.0202, 0.0]
    before.particle_q.assign(stretched.astype(np.float32))
    dt, area = 1e-4, 2e-4
    SolverVBD(model, iterations=10).step(before, after, None, None, dt)
    mass = area / 3.0
    force = after.particle_qd.numpy()[2] * mass / dt
    strain_yy, shear_xy = 0.01, 0.01
    expected = -area / 0.02 * np.array([mu * shear_xy, (2 * mu + lam) * strain_yy, 0.0])
    np.testing.assert_allclose(force, expected, rtol=0.05, atol=1e-5)


def test_hinge_stiffness_gives_our_bending_energy() -> None:
    """ke l theta^2 / 2 over Newton's edges equals our bending term on a sheet folded without stretching."""
    garment = sheet(6)
    hinges = garment.topology.hinges
    borders = np.array([[0, -1, *edge] for edge in garment.topology.boundary_edges])
    edges = np.concatenate([hinges[:, [2, 3, 0, 1]], borders])
    folded = garment.vertices.copy()
    past = folded[:, 0] > 1e-9
    folded[past, 1] += folded[past, 0] * np.sin(0.4)
    folded[past, 0] *= np.cos(0.4)
    stiffness = hinge_stiffness(garment, edges)
    assert (stiffness[len(hinges) :] == 0).all()
    x = torch.from_numpy(folded)
    angles = dihedral_angles(x, torch.from_numpy(hinges)).numpy()
    lengths = np.linalg.norm(folded[hinges[:, 1]] - folded[hinges[:, 0]], axis=1)
    theirs = float((0.5 * stiffness[: len(hinges)] * lengths * angles**2).sum())
    step = TimeStep(pack([garment]), State(x, torch.zeros_like(x), 0), nobody(), 1 / 30.0, Environment((0, 0, 0)))
    assert theirs == pytest.approx(float(Bending().energies(step, ContactSet(), x)), rel=1e-9)


def test_wave_speed_of_the_default_cloth() -> None:
    assert wave_speed(MATERIAL) == pytest.approx(np.sqrt((44400 + 2 * 23600) * 4.7e-4 / 0.2))


@newton_installed
def test_finer_garments_get_shorter_substeps() -> None:
    from benchmarks.outside_reference import needed_substeps

    coarse, fine = (needed_substeps(ball_scene(cells=cells)) for cells in (10, 40))
    assert coarse * 4 - 4 <= fine <= coarse * 4


@newton_installed
def test_a_missing_gpu_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    import warp
    from benchmarks.outside_reference import NewtonSimulator

    monkeypatch.setattr(warp, "get_cuda_device_count", lambda: 0)
    with pytest.raises(InputError, match="no CUDA device"):
        NewtonSimulator("cuda")
    assert NewtonSimulator("auto").device == "cpu"


@newton_installed
def test_a_state_that_fails_ends_the_run_and_says_when(monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.outside_reference import NewtonCloth

    from pb4u.simulation.simulator import RunRecord

    advanced: list[float] = []
    monkeypatch.setattr(NewtonCloth, "advance", lambda self, *_: advanced.append(0.0))
    real = NewtonCloth.positions
    monkeypatch.setattr(
        NewtonCloth,
        "positions",
        property(lambda self: real.fget(self) * (np.nan if len(advanced) > 3 else 1.0)),  # type: ignore[attr-defined]
    )
    record = RunRecord()
    states = list(simulator(substeps=1).rollout(ball_scene(frames=6, lead_in=2), record))
    assert len(states) == 4
    assert record.failed_at == 2
