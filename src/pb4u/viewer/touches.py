"""What a page does to the cloth of a simulation that runs: pulls at it, blows at it, dresses it anew, takes it back."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.environment import Environment
from pb4u.errors import InputError, unknown_name
from pb4u.garment.material import load_material, material_names
from pb4u.simulation.live_run import LiveRun
from pb4u.simulation.touch import Hand, Touch, finite
from pb4u.viewer.clip import Clip, GrowingClip, middle

MOST_FRAMES = 600
"""20 s at 30 frames per second; at the most triangles about one and a half gigabytes, all of which is held in memory:
half a gigabyte of what is shown, and the states that the simulation can go on from."""

STRONGEST_WIND = 20.0
"""Speed [m/s] of a gale, the most that the page offers: garments of the library fly off in more."""

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class _Grasp:
    """A hand as the page knows it.

    Args:
        vertices: (held,) int64.
        point: (3,) [m] in the view.
        follows: whether the view follows the body.
    """

    vertices: Tensor
    point: Point
    follows: bool


class Touches:
    """Actions of a page, set from any thread; the simulation reads them once a step.

    Attributes:
        endless: whether the simulation continues after its last frame, up to the largest number of frames, with a body
            at rest.
    """

    def __init__(self) -> None:
        self.endless = False
        self._lock = threading.Lock()
        # Each is replaced as a whole.
        self._grasp: _Grasp | None = None
        self._wind: tuple[float, float, int | None] | None = None
        self._requests: deque[Callable[[LiveRun, GrowingClip], GrowingClip]] = deque()

    def begin(self) -> None:
        """Discard requests for another simulation; the wind does not change."""
        self.let_go()
        self._requests.clear()

    def grab(self, live: LiveRun, clip: Clip, frame: int, point: Point, follows: bool) -> None:
        """Grab the cloth nearest to a point of the view.

        Args:
            live: the run that is touched.
            clip: its frames.
            frame: number of the frame that is seen.
            point: (3,) [m] in the view: from the origin, or from below the body where the view follows it.
            follows: whether it does.

        Raises:
            InputError: the point is none.
        """
        at = np.add(finite(point), middle(clip.body(frame)) if follows else 0.0)
        cloth = torch.from_numpy(clip.garment(frame))
        self._grasp = _Grasp(Hand.at(live.packed, cloth, tuple(at)).vertices, finite(point), follows)

    def draw(self, point: Point) -> None:
        """Pull the cloth in the hand to another point of the view.

        Args:
            point: (3,) [m] in the view.

        Raises:
            InputError: the point is none.
        """
        to = finite(point)
        with self._lock:
            if self._grasp is not None:
                self._grasp = replace(self._grasp, point=to)

    def let_go(self) -> None:
        """Hold nothing."""
        with self._lock:
            self._grasp = None

    @property
    def held_at(self) -> Point | None:
        """Position of the hand in the view, (3,) [m]; None if nothing is held."""
        grasp = self._grasp
        return None if grasp is None else grasp.point

    def blow(self, speed: float, degrees: float, gusts: bool) -> None:
        """Let a wind blow from the next step on.

        Args:
            speed: [m/s]; none for still air.
            degrees: direction from which it blows: 0 is the body's first heading, positive to its left.
            gusts: whether it has gusts.

        Raises:
            InputError: a value is not a finite number, or out of range.
        """
        for what, value, most in (("speed of the wind [m/s]", speed, STRONGEST_WIND), ("direction", degrees, 360.0)):
            if not isinstance(value, int | float) or not 0.0 <= value <= most:
                raise InputError(f"The {what} must be a number from 0 to {most:g}, not {value!r}.")
        self._wind = (float(speed), math.radians(degrees), 0 if gusts else None) if speed else None

    def dress(self, number: int, name: str) -> None:
        """Make a garment of another fabric from the next step on.

        Args:
            number: of the garment, from 0 for the innermost.
            name: of a built-in material.

        Raises:
            InputError: there is no such material.
        """
        if name not in material_names():
            raise unknown_name("material", name, material_names())
        material = load_material(name)

        def dressed(live: LiveRun, clip: GrowingClip) -> GrowingClip:
            live.dress(number, material)
            other = clip.until(clip.frame_count, live.header)
            garment = live.scene.garments[number].garment.name
            other.note(f"From frame {clip.frame_count} on, {garment} was made of {name}.")
            return other

        self._requests.append(dressed)

    def go_back(self, frame: int) -> None:
        """Go on from a frame, the nearest there is, before the next step.

        Args:
            frame: number of the frame.
        """

        def back(live: LiveRun, clip: GrowingClip) -> GrowingClip:
            if not live.written_count:
                return clip
            number = min(max(frame, 0), live.written_count - 1)
            live.go_back(number)
            return clip.until(number + 1)

        self._requests.append(back)

    def before_a_step(self, live: LiveRun, clip: GrowingClip) -> GrowingClip:
        """Apply the requests since the last step, in the computing thread; returns the clip to continue.

        Args:
            live: the run.
            clip: its frames.
        """
        while self._requests:
            clip = self._requests.popleft()(live, clip)
        return clip

    def of_step(self, live: LiveRun, clip: GrowingClip) -> Touch | None:
        """Hand and wind of the next step; None for neither.

        Args:
            live: the run.
            clip: its frames; actions are recorded in its metadata.
        """
        grasp, wind = self._grasp, self._wind
        if not live.feels or (grasp is None and wind is None):
            return None
        hand = environment = None
        if grasp is not None:
            away = middle(live.body(live.frame + 1)) if grasp.follows else np.zeros(3)
            x, y, z = np.add(grasp.point, away).tolist()
            hand = Hand(grasp.vertices, (x, y, z))
            clip.note("A hand pulled at the cloth while it was simulated.")
        if wind is not None:
            environment = _blown(live.scene.environment, wind, float(clip.header.metadata.get("heading", 0.0)))
            clip.note("The wind was set while the cloth was simulated.")
        return Touch(hand, environment)


def _blown(environment: Environment, wind: tuple[float, float, int | None], heading: float) -> Environment:
    """An environment with a wind of a speed [m/s] from an angle [rad] to the left of `heading` [rad]."""
    speed, angle, gusts = wind
    toward = heading + angle + math.pi
    return replace(environment, wind=(speed * math.sin(toward), 0.0, speed * math.cos(toward)), gusts=gusts)
