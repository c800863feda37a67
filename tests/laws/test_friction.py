"""Coulomb's law of friction: on slopes, and of stretched bands on a pole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tests.laws.test_bodies import FELT, NO_GROUND, Rigid, upright
from tests.laws.test_self_contact import OneMethod
from tests.physics.shapes import tube
from tests.simulation.ball_scene import MATERIAL, sheet

from pb4u.environment import STANDARD_GRAVITY
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.physics.terms.collision import REFERENCE_AREA, Collision
from pb4u.physics.terms.friction import CoulombFriction
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.state import State
from pb4u.simulation.first_frame import AsPlaced
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import ImplicitSteps
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod

SETTLING, FREE = 6, 18
"""Frames in which cloth comes to bear, and those after them: 0.6 s."""


def states(
    garment: Garment, start: np.ndarray, body: trimesh.Trimesh, law: str, contact: ContactResponse | None = None
) -> list[State]:
    """States from `SETTLING` on of a garment that begins at `start` (vertices, 3) [m] on a body that stands still."""
    frames = SETTLING + FREE
    placed = PrescribedPlacement(np.repeat(start[None], frames, axis=0))
    scene = Scene(
        (DressedGarment(garment, placed),), (Rigid(body, np.zeros((frames, 3))),), frames, environment=NO_GROUND
    )
    potential = FELT.with_friction(law)
    method = StepMethod(refinement=ImplicitSteps(potential), contact=contact, potential=potential)
    return list(OneMethod(AsPlaced(), method).rollout(scene, RunRecord()))[SETTLING - 1 :]


def creep(share: float) -> float:
    """Way [m] of what holds a share of its limit: friction is smoothed below a millimetre a second."""
    return FREE / 30.0 * CoulombFriction().smoothing * share / np.sqrt(1.0 - share**2)


def on_slope(coefficient: float, degrees: float) -> tuple[float, float]:
    """Way [m] down a slope and gain of speed [m/s] of a sheet that lies on it."""
    turn = trimesh.transformations.rotation_matrix(np.radians(degrees), [0.0, 0.0, 1.0])
    slope = trimesh.creation.box(extents=[8.0, 0.1, 0.6])
    slope.apply_translation([0.0, -0.05, 0.0])
    slope.apply_transform(turn)
    garment = sheet(3, 0.15, 1.8e-3)
    garment = garment.with_material(replace(garment.material, friction=coefficient))
    first, *_, last = states(garment, garment.vertices @ turn[:3, :3].T, slope, "coulomb")
    down = -turn[:3, 0]
    way, gain = last.positions - first.positions, last.velocities - first.velocities
    return float(way.numpy().mean(0) @ down), float(gain.numpy().mean(0) @ down)


@pytest.mark.parametrize("coefficient", [0.2, 0.5, 1.0, 2.7])
def test_a_sheet_holds_up_to_the_angle_of_friction(coefficient: float) -> None:
    angle = np.arctan(coefficient)
    share = np.tan(angle - np.radians(4.0)) / coefficient
    way, speed = on_slope(coefficient, np.degrees(angle) - 4.0)
    assert way == pytest.approx(creep(share), rel=0.02)
    assert abs(speed) < 1e-4
    steeper = angle + np.radians(4.0)
    gained = STANDARD_GRAVITY * (np.sin(steeper) - coefficient * np.cos(steeper)) * FREE / 30.0
    way, speed = on_slope(coefficient, np.degrees(steeper))
    assert speed == pytest.approx(gained, rel=0.02)
    assert way > 0.5 * gained * FREE / 30.0


def fallen(stretch: float, share: float, law: str = "coulomb", contact: ContactResponse | None = None) -> float:
    """Way [m] down a pole of a band that is stretched round it, by its weight as a share of what friction can hold.

    Its tension T is that of a strip whose sides are free. It presses the pole by 2 pi T in all.
    """
    radius, height = 0.1, 0.05
    stiff, across = MATERIAL.warp_stiffness, MATERIAL.coupling_stiffness
    per_width = (stiff - across**2 / stiff) * ((1.0 + stretch) ** 2 - 1.0) / 2.0 * (1.0 + stretch)
    depth = np.sqrt(per_width / radius * REFERENCE_AREA / (3.0 * Collision().weight))
    worn = radius + Collision().clearance - depth
    rest = worn / (1.0 + stretch)
    weight = 2.0 * np.pi * rest * height * MATERIAL.density * STANDARD_GRAVITY
    coefficient = weight / (share * 2.0 * np.pi * per_width * height)
    garment = tube(48, 4, rest, height, replace(MATERIAL, friction=coefficient))
    start = garment.vertices * [1.0 + stretch, 1.0, 1.0 + stretch]
    pole = upright(trimesh.creation.cylinder(radius=radius, height=1.6, sections=96))
    first, *_, last = states(garment, start, pole, law, contact)
    return float((first.positions - last.positions)[:, 1].mean())


@pytest.mark.parametrize("stretch", [0.05, 0.1, 0.2])
def test_a_stretched_band_holds_what_its_pressure_can(stretch: float) -> None:
    assert fallen(stretch, 1.0 / 1.1) == pytest.approx(creep(1.0 / 1.1), rel=0.35)
    assert fallen(stretch, 0.5) == pytest.approx(creep(0.5), rel=0.25)
    assert fallen(stretch, 1.0 / 0.9) > 0.1


def test_a_tight_band_holds_by_its_tension_though_it_is_pushed_out_of_the_pole() -> None:
    # It presses by 0.6 kPa, which holds it a millimetre inside; where it is pushed to, contact presses by 0.2 kPa.
    assert 0.0 < fallen(0.6, 0.5, contact=ContactResponse()) < 2.0 * creep(0.5)
    assert fallen(0.6, 1.0 / 0.8, contact=ContactResponse()) > 0.1


def test_by_the_law_of_the_paper_it_falls_off() -> None:
    assert fallen(0.1, 0.05, "paper") > 0.5
    assert fallen(0.1, 0.05) < 1e-4
