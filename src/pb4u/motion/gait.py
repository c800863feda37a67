"""Walking and running: periodic gaits planned from their footsteps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.geometry.rotation import rotate
from pb4u.motion.curves import bump, ease, hermite, wave
from pb4u.motion.footwork import FootShape
from pb4u.motion.humanoid import Humanoid
from pb4u.motion.performance import FULL_STRETCH, Arm, Foot, Performance, Turn

# Leg length of the person that the numbers below are for [m]; others are scaled from it (Froude number kept).
REFERENCE_LEG = 0.86


@dataclass(frozen=True)
class Gait:
    """A gait of a person with legs of `REFERENCE_LEG`; angles in degrees, phases from the foot's landing.

    Args:
        cycle: time of two steps [s].
        stride: length of two steps [m].
        stance: share of the cycle that a foot is on the ground.
        half_width: from the middle to each foot [m].
        landing: pitch of the foot at landing, toes up negative.
        flat: phase at which the foot lies flat.
        heel_off: phase at which the heel leaves the ground.
        toe_off: pitch of the foot when it leaves the ground.
        stopping: deceleration of the foot before it lands [strides per cycle^2].
        lift: how much higher than its natural swing the ankle is lifted [m], and when in the swing.
        bounce: vertical travel of the hips, half [m]; highest at phase `top`.
        sway: sideways travel of the hips, half [m].
        lean: forward lean of the trunk.
        hip_yaw: half turn of the pelvis about the vertical.
        hip_list: half tilt of the pelvis sideways.
        chest_yaw: half turn of the chest about the vertical.
        arm_swing: amplitude of the swing of the upper arm, about a middle 4 degrees forward of hanging.
        elbow: bend of the elbow.
        elbow_swing: half of how much that changes.
    """

    cycle: float
    stride: float
    stance: float
    half_width: float
    landing: float
    flat: float
    heel_off: float
    toe_off: float
    stopping: float
    lift: tuple[float, float]
    bounce: float
    top: float
    sway: float
    lean: float
    hip_yaw: float
    hip_list: float
    chest_yaw: float
    arm_swing: float
    elbow: float
    elbow_swing: float


WALK = Gait(
    cycle=1.05, stride=1.38, stance=0.62, half_width=0.075, landing=-17.0, flat=0.10, heel_off=0.34, toe_off=56.0,
    stopping=38.0, lift=(0.042, 0.36), bounce=0.020, top=0.32, sway=0.018, lean=3.0, hip_yaw=5.0, hip_list=3.0,
    chest_yaw=5.0, arm_swing=21.0, elbow=24.0, elbow_swing=11.0,
)  # fmt: skip

RUN = Gait(
    cycle=0.72, stride=2.02, stance=0.33, half_width=0.055, landing=-6.0, flat=0.06, heel_off=0.15, toe_off=58.0,
    stopping=15.0, lift=(0.21, 0.43), bounce=0.042, top=0.415, sway=0.012, lean=9.0, hip_yaw=8.0, hip_list=4.0,
    chest_yaw=9.0, arm_swing=34.0, elbow=82.0, elbow_swing=14.0,
)  # fmt: skip


class Gaiting:
    """A gait fitted to one body: the hips are at the height at which its legs reach the planned feet.

    Args:
        gait: the gait of a person with legs of `REFERENCE_LEG`.
        humanoid: the body.
        amplitude: size of the movement relative to the original, which is 1.
    """

    def __init__(self, gait: Gait, humanoid: Humanoid, amplitude: float = 1.0) -> None:
        self.gait = gait
        self.humanoid = humanoid
        self.amplitude = amplitude
        self.size = humanoid.leg_length / REFERENCE_LEG
        self.shapes = {side: FootShape.of(humanoid, side) for side in "LR"}
        self.height = float(humanoid.hip_midpoint[1])
        # Feet land as far in front of the hips as lets them stay highest.
        leads = np.linspace(0.15, 0.5, 15) * gait.stance
        headrooms = []
        for self.lead in leads:
            headrooms.append(min(self._headroom(side) for side in "LR"))
        self.lead = float(leads[np.argmax(headrooms)])
        self.height += max(headrooms)

    @property
    def cycle(self) -> float:
        """Time of two steps of this body [s]."""
        return self.gait.cycle * float(np.sqrt(self.size))

    def __call__(self, time: np.ndarray) -> Performance:
        """The performance at `time` (frames,) [s]."""
        cycles = time / self.cycle
        g, a = self.gait, self.amplitude
        side_phase = {"L": cycles, "R": cycles + 0.5}
        arms = {}
        for side, phase in side_phase.items():
            swing = -a * wave(phase, 0.03)
            arms[side] = Arm(
                flexion=4.0 + g.arm_swing * swing,
                abduction=15.0 + 2.0 * swing,
                elbow=g.elbow + g.elbow_swing * -a * wave(phase, 0.08),
                twist=4.0 + 8.0 * swing,
            )
        return Performance(
            hips=self._hips(cycles),
            pelvis=self._pelvis(cycles),
            chest=Turn(
                pitch=0.6 * g.lean + 0.8 * wave(2 * cycles, 0.1),
                yaw=a * (g.hip_yaw + g.chest_yaw) * wave(cycles, 0.02),
                roll=-a * (g.hip_list + 1.0) * wave(cycles, 0.28),
            ),
            head=Turn(
                pitch=-0.8 * g.lean,
                yaw=-a * 0.85 * g.chest_yaw * wave(cycles, 0.02),
                roll=0.8 * wave(cycles, 0.28),
            ),
            arms=arms,
            feet={side: self._foot(phase, side) for side, phase in side_phase.items()},
        )

    def _pelvis(self, cycles: np.ndarray) -> Turn:
        g, a = self.gait, self.amplitude
        return Turn(
            pitch=0.4 * g.lean + 1.0 * wave(2 * cycles, 0.1),
            yaw=-a * g.hip_yaw * wave(cycles, 0.02),
            roll=a * g.hip_list * wave(cycles, 0.28),
        )

    def _hips(self, cycles: np.ndarray) -> np.ndarray:
        g = self.gait
        y = self.height + self.size * g.bounce * (wave(2 * cycles, 2 * g.top) - 1.0)
        x = self.size * g.sway * wave(cycles, 0.5 * g.stance)
        return np.stack([x, y, self.size * g.stride * cycles], axis=1)

    def _foot(self, cycles: np.ndarray, side: str) -> Foot:
        """A foot over its own cycles, which begin when it lands; the right one is half a cycle ahead of the body's."""
        g, shape = self.gait, self.shapes[side]
        number, phase = np.floor(cycles), np.mod(cycles, 1.0)
        stride = self.size * g.stride
        pitch = self._pitch(phase)
        # The toes stay flat while the heel rises, and straighten early in the swing.
        straight = 1.0 - ease((phase - g.flat) / (g.heel_off - g.flat))
        straight += ease((phase - g.stance) / (0.5 * (1.0 - g.stance)))
        first = stride * (number + self.lead - (0.5 if side == "R" else 0.0))
        x = (1.0 if side == "L" else -1.0) * self.size * g.half_width
        place = np.stack([np.full_like(phase, x), np.zeros_like(phase), first], axis=1)
        foot = shape.foot(place, np.zeros_like(phase), pitch, pitch * straight)
        swinging = phase > g.stance
        ankle = foot.ankle.copy()
        ankle[swinging] = place[swinging] + self._swing(shape, phase[swinging])
        return replace(foot, ankle=ankle)

    def _pitch(self, phase: np.ndarray) -> np.ndarray:
        g = self.gait
        rate = (g.toe_off) / (g.stance - g.heel_off)
        swing = 1.0 - g.stance
        return hermite(
            phase,
            [0.0, g.flat, g.heel_off, g.stance, g.stance + 0.28 * swing, 1.0],
            [g.landing, 0.0, 0.0, g.toe_off, 0.75 * g.toe_off, g.landing],
            [0.0, 0.0, 0.0, 1.2 * rate, -1.6 * g.toe_off / swing, 0.0],
        )

    def _swing(self, shape: FootShape, phase: np.ndarray) -> np.ndarray:
        """Ankle (frames, 3) in swing, from the place it left: C2 from rolling off to landing one stride on."""
        g = self.gait
        step = 1e-3
        leave = shape.rolled(self._pitch(g.stance + step * np.array([-2.0, -1.0, 0.0])))
        velocity = (leave[2] - leave[1]) / step
        acceleration = (leave[2] - 2.0 * leave[1] + leave[0]) / step**2
        landing = shape.rolled(self._pitch(np.zeros(1)))[0] + np.array([0.0, 0.0, self.size * g.stride])
        still = np.zeros(3)
        # A foot comes down still moving forward until it is stopped, rather than waiting for the body in the air.
        stopping = np.array([0.0, 0.0, -g.stopping * self.size * g.stride])
        path = hermite(phase, [g.stance, 1.0], [leave[2], landing], [velocity, still], [acceleration, stopping])
        lift = self.size * g.lift[0] * bump((phase - g.stance) / (1.0 - g.stance), g.lift[1])
        return path + np.array([0.0, shape.ankle[1], 0.0]) + lift[:, None] * np.array([0.0, 1.0, 0.0])

    def _headroom(self, side: str) -> float:
        """How much higher than planned the hips could be for a leg to just reach its foot throughout the cycle."""
        cycles = np.linspace(0.0, 1.0, 150)
        body_cycles = cycles if side == "L" else cycles - 0.5
        hips = self._hips(body_cycles)
        joint = self.humanoid.joint(f"thigh.{side}") - self.humanoid.hip_midpoint
        hip = hips + rotate(self._pelvis(body_cycles).quaternions(len(cycles)), joint)
        ankle = self._foot(cycles, side).ankle
        level = np.hypot(*(hip - ankle)[:, [0, 2]].T)
        reach = FULL_STRETCH * self.humanoid.leg_length
        return float((ankle[:, 1] + np.sqrt(np.maximum(reach**2 - level**2, 0.01)) - hip[:, 1]).min())
