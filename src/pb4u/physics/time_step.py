"""One time step as data: everything known before it, and the state that accelerations lead to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor

from pb4u.environment import Environment
from pb4u.errors import InputError, Pb4uError
from pb4u.physics.contact.contact_set import MOTION_REACH, ContactSet, PlaneSearch, nearest_planes
from pb4u.physics.contact.obstacle import Obstacle, sags
from pb4u.physics.integrator import IMPLICIT_EULER, Integrator
from pb4u.scene.colliders import ColliderFrame
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State


class DivergedError(Pb4uError):
    """A state is no longer finite; frames before `frame` are still good.

    Args:
        frame: index of the frame in its scene, lead-in included.
        reason: which values are not finite, as part of a sentence.
    """

    def __init__(self, frame: int, reason: str) -> None:
        super().__init__(f"The simulation diverged at frame {frame}: {reason}; the frames before it are kept.")
        self.frame = frame


@dataclass(frozen=True, eq=False)
class Pull:
    """Springs that pull vertices to target points during a step, like a hand in the studio.

    Args:
        vertices: (held,) int64.
        places: (held, 3) [m] target points.
        stiffness: of the spring of each [N/m].
    """

    vertices: Tensor
    places: Tensor
    stiffness: float


@dataclass(frozen=True, eq=False)
class TimeStep:
    """Everything known before the step from frame t to t+1.

    Args:
        garments: static quantities.
        state: positions [m] and velocities [m/s] at frame t.
        collider: the bodies around the step, if any.
        dt: length of the step [s].
        environment: gravity, air and ground.
        pin_positions: (vertices, 3) [m] where the pinned vertices will be after the step; other rows are not read. None
            gives them no target: predictions then move them like other vertices.
        skinned_motion: (vertices, 3) [m] how far skinning moves each vertex over the step, or None.
        integrator: gives inertia, and the velocities and history of the state that the step leads to.
        time: since the start of the simulation [s], at frame t.
        pull: springs of a hand in the studio, or None.

    Raises:
        InputError: a time step that is not positive, or shapes that do not match.
    """

    garments: PackedGarments
    state: State
    collider: ColliderFrame
    dt: float
    environment: Environment
    pin_positions: Tensor | None = None
    skinned_motion: Tensor | None = None
    integrator: Integrator = IMPLICIT_EULER
    time: float = 0.0
    pull: Pull | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.dt < float("inf"):
            raise InputError(f"A time step must be a positive number of seconds, not {self.dt}; check the frame rate.")
        if self.state.positions.shape != (self.garments.vertex_count, 3):
            raise InputError(
                f"Garments of {self.garments.vertex_count} vertices were given positions "
                f"{tuple(self.state.positions.shape)}."
            )

    @cached_property
    def bodies(self) -> ColliderFrame | None:
        """The bodies around the step where there are any."""
        return None if self.collider.empty else self.collider

    @property
    def batches(self) -> bool:
        """Whether several positions need as many kernel launches as one: true on an accelerator."""
        return self.bodies is not None and self.bodies.colliders.capacities is not None

    @cached_property
    def is_on_a_processor(self) -> bool:
        """Whether compiled loops compute it: not on an accelerator, nor if autograd differentiates through its
        start."""
        state = self.state
        starts_fixed = not (state.positions.requires_grad or state.velocities.requires_grad)
        return self.garments.device.type == "cpu" and not self.batches and starts_fixed

    @cached_property
    def contacts(self) -> ContactSet:
        """Contacts at the start of the step with the exact surface of the bodies; queried on first use."""
        return self.contacts_by(partial(nearest_planes, within=MOTION_REACH))

    @cached_property
    def raised_contacts(self) -> ContactSet:
        """The same, the planes of the bodies raised by `sags`."""
        return self.contacts.raised_by(self.sags)

    @cached_property
    def records(self) -> dict[Any, Any]:
        """Inputs of the terms' loops that are constant during the step, by term and the contacts that it reads."""
        return {}

    @cached_property
    def obstacle(self) -> Obstacle | None:
        """The moving bodies that cloth may not pass through over the step; made on first use."""
        return Obstacle.over(self.garments, self.bodies, self.state.positions)

    @cached_property
    def sags(self) -> Tensor | None:
        """Heights (vertices,) [m] over the bodies that vertices need so that the cloth between them clears the body;
        None without a body."""
        planes = self.contacts.now
        return None if planes is None else sags(self.garments, planes)

    def contacts_by(self, search: PlaneSearch) -> ContactSet:
        """Contacts at the start of the step that `search` finds with the bodies; none without a body.

        Args:
            search: finds the planes of the bodies.
        """
        return ContactSet.at_start(self.garments, self.bodies, self.state.positions, search)

    @cached_property
    def height_origin(self) -> Tensor:
        """Points (garments, 3) [m] at whose height each garment's gravity energy is zero, so that heights stay small.

        The mean vertex of the bodies of the garment's world at t+1; the origin without a body.
        """
        x, garments = self.state.positions, self.garments
        if self.bodies is None:
            return x.new_zeros((garments.garment_count, 3))
        return self.bodies.following.middles(garments.world_count, x.dtype)[garments.garment_world]

    def with_pins(self, positions: Tensor) -> Tensor:
        """Positions (vertices, 3) [m] with the pinned vertices where they will be after the step.

        Args:
            positions: (vertices, 3) [m].
        """
        if self.pin_positions is None:
            return positions
        return torch.where(self.garments.pinned[:, None], self.pin_positions, positions)

    def part(self, k: int, count: int, state: State) -> TimeStep:
        """The k-th of `count` equal parts of the step.

        Args:
            k: number of the part, from 0.
            count: number of parts.
            state: state at the end of the part before.
        """
        pins, motion, pull, share = self.pin_positions, self.skinned_motion, self.pull, (k + 1) / count
        if pull is not None:
            places = self.state.positions[pull.vertices]
            pull = replace(pull, places=torch.lerp(places, pull.places, share))
        return replace(
            self,
            state=state,
            collider=self.collider.between(k / count, share),
            dt=self.dt / count,
            pin_positions=None if pins is None else torch.lerp(self.state.positions, pins, share),
            skinned_motion=None if motion is None else motion / count,
            time=self.time + k * self.dt / count,
            pull=pull,
        )

    def around(self, moving: Tensor) -> TimeStep:
        """The step of some vertices; the others stay where a solve of it starts from.

        Args:
            moving: (vertices,) bool, vertices whose places are sought.
        """
        return replace(self, garments=self.garments.part(moving))

    @cached_property
    def inertial_dt(self) -> float | Tensor:
        """Time step [s] of the inertia term, one or (vertices,)."""
        return self.integrator.inertial_dt(self.state, self.dt)

    @property
    def free_move(self) -> Tensor:
        """Displacement (vertices, 3) [m] of every vertex, pins included, without forces."""
        return self.integrator.free_move(self.state, self.dt)

    def reached(self, positions: Tensor, struck: Tensor | None = None) -> State:
        """State at the end of the step, with the velocities after a move to it.

        Args:
            positions: (vertices, 3) [m] at the end of the step.
            struck: (vertices,) bool on which contact pushes there; None for none.
        """
        move = positions - self.state.positions
        return self.integrator.arrived(self.state, self.dt, positions, move, struck)

    def turned_aside(self, state: State, positions: Tensor) -> State:
        """State at the end of the step at other positions, to which contact led it.

        Args:
            state: at the end of the step.
            positions: (vertices, 3) [m].
        """
        return self.integrator.turned_aside(state, self.dt, positions)

    def reached_by_parts(self, last: State) -> State:
        """State at the end of a step that was taken in parts, with positions and velocities of the last part.

        Args:
            last: at the end of the last part.
        """
        return self.integrator.joined(self.state, self.dt, last)


def integrate(step: TimeStep, acceleration: Tensor) -> State:
    """State after a step with accelerations, of implicit Euler v' = v + a / dt, x' = x + dt v'; differentiable.

    Pinned vertices get their targets and the velocity towards these. Source: the integrator of MeshGraphNets
    and its descendants, in SI units outside the network.

    Args:
        step: the time step.
        acceleration: (vertices, 3) acceleration times dt^2 [m per step^2].
    """
    before, pins = step.state.positions, step.pin_positions
    move = step.free_move + acceleration
    positions = step.with_pins(before + move)
    if pins is not None:
        move = torch.where(step.garments.pinned[:, None], pins - before, move)
    return step.integrator.arrived(step.state, step.dt, positions, move)


def require_finite(state: State) -> State:
    """Return `state`, or raise DivergedError when a position or velocity is not finite.

    Args:
        state: positions and velocities.
    """
    finite = torch.isfinite(state.positions).all(1) & torch.isfinite(state.velocities).all(1)
    if not bool(finite.all()):
        bad = torch.nonzero(~finite).reshape(-1)
        reason = f"{len(bad)} of {len(finite)} vertices are not finite, first vertex {int(bad[0])}"
        raise DivergedError(state.frame, reason)
    return state
