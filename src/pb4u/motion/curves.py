"""Smooth functions of time from which procedural clips are put together. All are at least C1, most C2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def wave(phase: np.ndarray, peak: float = 0.0) -> np.ndarray:
    """Cosine of a phase, 1 at `peak`.

    Args:
        phase: (n,) [cycles].
        peak: phase of the maximum [cycles].

    Returns:
        (n,) in [-1, 1].
    """
    return np.cos(2.0 * np.pi * (phase - peak))


def ease(s: np.ndarray) -> np.ndarray:
    """Smooth step (n,) from 0 to 1 while s (n,) [1] goes from 0 to 1, at rest (C2) at both ends and beyond them.

    Args:
        s: (n,) dimensionless.
    """
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def soft_ramp(s: np.ndarray) -> np.ndarray:
    """Smooth step (n,) from 0 to 1 while s (n,) [1] goes from 0 to 1, without slope at both ends and beyond them.

    Args:
        s: (n,) dimensionless.
    """
    s = np.clip(s, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def bump(s: np.ndarray, peak: float = 0.5) -> np.ndarray:
    """Smooth pulse from 0 to 1 to 0, at rest (C2) at both ends and beyond them.

    Args:
        s: (n,) share of the pulse's time, 0 to 1 [1].
        peak: s of the maximum.

    Returns:
        (n,) in [0, 1].
    """
    s = np.clip(s, 0.0, 1.0)
    # u maps the peak to the middle.
    u = s ** (np.log(0.5) / np.log(peak)) if peak >= 0.5 else 1.0 - (1.0 - s) ** (np.log(0.5) / np.log(1.0 - peak))
    return 64.0 * (u * (1.0 - u)) ** 3


def hermite(
    time: np.ndarray,
    knots: Sequence[float],
    values: Sequence[float] | Sequence[np.ndarray],
    velocities: Sequence[float] | Sequence[np.ndarray] | None = None,
    accelerations: Sequence[float] | Sequence[np.ndarray] | None = None,
) -> np.ndarray:
    """Piecewise quintic (C2); constant before the first knot and after the last one.

    Args:
        time: (n,) in the unit of `knots`.
        knots: (knots,) times in increasing order [s], or phases [cycles].
        values: (knots,) or (knots, components), value at each knot, in any unit.
        velocities: (knots,) or (knots, components), first derivative by time at each knot; zero by default.
        accelerations: (knots,) or (knots, components), second derivative by time at each knot; zero by default.

    Returns:
        (n,) or (n, components), in the unit of `values`.
    """
    t, p = np.asarray(knots, dtype=np.float64), np.asarray(values, dtype=np.float64)
    v = np.zeros_like(p) if velocities is None else np.asarray(velocities, dtype=np.float64)
    a = np.zeros_like(p) if accelerations is None else np.asarray(accelerations, dtype=np.float64)
    k = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
    h = (t[k + 1] - t[k]).reshape(k.shape + (1,) * (p.ndim - 1))
    s = np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0).reshape(h.shape)
    s3, s4, s5 = s**3, s**4, s**5
    return (
        p[k] * (1 - 10 * s3 + 15 * s4 - 6 * s5)
        + p[k + 1] * (10 * s3 - 15 * s4 + 6 * s5)
        + h * v[k] * (s - 6 * s3 + 8 * s4 - 3 * s5)
        + h * v[k + 1] * (-4 * s3 + 7 * s4 - 3 * s5)
        + h * h * a[k] * (0.5 * s * s - 1.5 * s3 + 1.5 * s4 - 0.5 * s5)
        + h * h * a[k + 1] * (0.5 * s3 - s4 + 0.5 * s5)
    )


def keyframes(phase: np.ndarray, knots: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """Periodic spline (C2).

    Args:
        phase: (n,) [cycles].
        knots: phases in [0, 1), increasing.
        values: number at each knot.

    Returns:
        (n,) in the unit of `values`.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline([*knots, knots[0] + 1.0], [*values, values[0]], bc_type="periodic")
    return np.asarray(spline(np.mod(phase - knots[0], 1.0) + knots[0]))
