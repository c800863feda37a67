"""Cloth on a still ball: its energy never rises over what it began with, by either rule of integration."""

from __future__ import annotations

import pytest
from ball_scene import ball_scene

from pb4u.physics.integrator import INTEGRATORS
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

FRAMES = 300


@pytest.mark.slow
@pytest.mark.parametrize("rule", list(INTEGRATORS))
def test_energy_never_rises_on_what_stands_still(rule: str) -> None:
    """Kinetic, elastic, gravity's and the barriers' together, without air and wind."""
    scene = ball_scene(frames=FRAMES, lead_in=0, cells=8, speed=0.0)
    simulator = load_simulator("solver", time_integration=rule, air="off", first_frame="placed")
    timeline = simulator.timeline(scene)
    masses = timeline.garments.vertex_masses[:, None]
    potential = simulator.potential
    kept = [name for name in potential.names if name != "inertia" and "friction" not in name and "damping" not in name]
    totals = []
    # As it is simulated: what is written is moved off the skin, which strains it.
    for state in simulator._moved(timeline, simulator.method(timeline, RunRecord()), scene):
        energies = potential.of(timeline.step_from(state)).energies(state.positions).floats()
        kinetic = 0.5 * float((masses * state.velocities**2).sum())
        totals.append(kinetic + sum(energies.get(name, 0.0) for name in kept))
    assert len(totals) == FRAMES
    fall = totals[0] - min(totals)
    assert fall > 0.01
    assert max(totals) - totals[0] <= 1e-3 * totals[0]
