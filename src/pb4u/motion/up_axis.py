"""Which axis of a file is up: what its writer or its rest pose says, unless the floor under its frames gainsays it."""

from __future__ import annotations

import numpy as np

from pb4u.motion.recording import Recording

_AXES = np.concatenate([np.eye(3), -np.eye(3)])
_Y, _Z = _AXES[1], _AXES[2]
# Someone stands along an axis on which the shoulders are this share of their height above the feet, on average.
_STANDS = 0.6
# What is above the floor may stand on something, what is beneath it may not: [m/m] in that measure.
_ABOVE = 0.3
# Another axis than the supposed one has a floor at the lowest joints within so much, and better by so much [m]. A root
# that begins so near [m] was put to the origin, and tells no floor.
_FITS, _BETTER, _AT_ORIGIN = 0.12, 0.1, 0.02


def standing_axis(recording: Recording, joints: np.ndarray, rest: np.ndarray | None) -> np.ndarray:
    """The up axis (3,) of a file whose format does not define it.

    It is the axis along which people stand both in the rest pose and in the frames. Otherwise Y is preferred and the
    floor must be at 0; the rest pose lies down if people stand along another axis.

    Args:
        recording: how its bones play the roles.
        joints: (frames, bones, 3) positions of its joints in some frames.
        rest: (3,) direction of a standing person in the rest pose; None if it does not stand.
    """
    feet, hips, shoulders = (
        0.5 * (joints[:, recording.joint_index(f"{role}.L")] + joints[:, recording.joint_index(f"{role}.R")])
        for role in ("foot", "thigh", "upper_arm")
    )
    height = recording.leg_length + float(np.linalg.norm(shoulders - hips, axis=1).max())
    mean = (shoulders - feet).mean(axis=0) / max(height, 1e-12)
    along = nearest_axis(mean)
    stands = [along] if mean @ along > _STANDS else []
    rest_axes = [] if rest is None else [nearest_axis(rest)]
    if stands and rest_axes and np.array_equal(along, rest_axes[0]):
        return along
    supposed = _Y if not rest_axes or np.array_equal(rest_axes[0], _Y) else [*stands, *rest_axes][0]
    axes = np.array([supposed, *stands, *rest_axes, _Y, _Z])
    off = np.abs(recording.metres * (joints @ axes.T).min(axis=1)).mean(axis=0)
    at_origin = recording.metres * np.abs(joints[0, 0]).max() < _AT_ORIGIN
    other = int(off.argmin())
    return supposed if at_origin or off[other] > _FITS or off[other] + _BETTER > off[0] else axes[other]


def floor_misfit(lowest: np.ndarray) -> float:
    """How badly a floor at 0 fits under a body, by its lowest joints [m].

    Args:
        lowest: (frames,) their heights [m].
    """
    return float(np.where(lowest < 0.0, -lowest, _ABOVE * lowest).mean())


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The axis of a file (3,), of length 1, that is nearest to a direction.

    Args:
        direction: (3,) of any length.
    """
    return _AXES[int(np.argmax(_AXES @ direction))]
