"""Values over time without what is faster than a frequency."""

from __future__ import annotations

import numpy as np


def is_sampled_enough(frames: int, fps: float, cutoff: float) -> bool:
    """Whether frames are numerous and close enough for `low_passed` to separate frequencies above `cutoff`.

    Args:
        frames: number of frames.
        fps: frames per second.
        cutoff: frequency [Hz].
    """
    return fps > 2.5 * cutoff and frames >= 10


def low_passed(values: np.ndarray, fps: float, cutoff: float) -> np.ndarray:
    """Values without frequencies above `cutoff`: a Butterworth filter forwards and backwards, without delay.

    Args:
        values: (frames, ...) in any unit, sampled enough.
        fps: frames per second.
        cutoff: frequency above which they are removed [Hz].

    Returns:
        (frames, ...) in the same unit.
    """
    from scipy.signal import butter, sosfiltfilt

    sections = butter(2, cutoff, fs=fps, output="sos")
    reach = min(len(values) - 1, round(3.0 * fps / cutoff))
    return sosfiltfilt(sections, values, axis=0, padlen=reach)
