"""The paper's own figures, to stand beside a run's: other data (VTO, SMPL), other meshes, an unnamed test machine.

Source: Pb4U-GNet (AAAI 2026), tables on unseen resolutions, unseen garments, efficiency and ablation. Energies in J
by the released convention, latency in milliseconds a step.
"""

from __future__ import annotations

TERMS = ("stretch", "bending", "collision", "inertia", "gravity", "friction", "total")


def _columns(models: str, *rows: str) -> dict[str, dict[str, float]]:
    values = [[float(value) for value in row.split()] for row in rows]
    return {
        model: {term: row[index] for term, row in zip(TERMS, values, strict=True)}
        for index, model in enumerate(models.split())
    }


_RESOLUTION_MODELS = "MGN HOOD ESLR CCRAFT Pb4U-GNet"

PAPER: dict[str, dict[str, dict[str, dict[str, float]]]] = {
    "resolution": {
        "11K": _columns(
            _RESOLUTION_MODELS,
            "5.30e-2 6.83e-2 2.97e-2 1.22e-1 3.06e-2",
            "3.39e-3 2.34e-3 1.81e-3 2.96e-3 2.92e-3",
            "1.71e-2 2.16e-2 1.99e-4 1.14e-6 1.62e-3",
            "2.02e-3 1.80e-3 1.72e-3 1.91e-3 1.78e-3",
            "-7.20e-2 -8.59e-2 -6.01e-2 -8.56e-2 -5.49e-2",
            "1.25e-3 1.30e-3 1.09e-3 1.19e-3 1.34e-3",
            "4.70e-3 9.45e-3 -2.56e-2 4.24e-2 -1.66e-2",
        ),
        "18K": _columns(
            _RESOLUTION_MODELS,
            "4.13e-1 3.56e-1 8.32e-2 1.89e-1 4.17e-2",
            "4.80e-3 4.67e-3 2.08e-3 4.12e-3 4.23e-3",
            "1.12e-1 1.13e-4 5.60e-2 6.10e-4 1.21e-2",
            "3.66e-3 2.83e-3 1.89e-3 1.88e-3 1.72e-3",
            "-1.02e-1 -1.15e-1 -8.38e-2 -8.68e-2 -5.30e-2",
            "1.36e-3 1.36e-3 1.17e-3 1.20e-3 1.43e-3",
            "4.32e-1 2.49e-1 6.06e-2 1.10e-1 8.13e-3",
        ),
        "25K": _columns(
            _RESOLUTION_MODELS,
            "1.43e3 3.89e-1 2.27e-1 2.51e-1 5.70e-2",
            "1.23e-1 4.88e-3 2.52e-3 4.59e-3 5.83e-3",
            "3.39e0 2.40e-4 4.64e-2 4.37e-6 4.69e-2",
            "1.08e-2 2.93e-3 2.10e-3 1.82e-3 1.70e-3",
            "-3.66e-1 -1.20e-1 -1.07e-1 -8.68e-2 -4.95e-2",
            "1.47e-3 1.35e-3 1.27e-3 1.22e-3 1.50e-3",
            "1.44e3 2.78e-1 1.73e-1 1.72e-1 6.34e-2",
        ),
        "38K": _columns(
            _RESOLUTION_MODELS,
            "1.24e6 2.52e0 1.07e5 3.60e-1 1.30e-1",
            "1.03e1 1.56e-2 9.14e-1 6.13e-3 1.43e-2",
            "8.22e0 1.97e-1 2.46e1 3.84e-4 1.03e-1",
            "4.07e-2 5.08e-3 9.95e-3 1.87e-3 1.64e-3",
            "-2.55e0 -1.78e-1 -3.25e-2 -8.72e-2 -2.81e-2",
            "1.70e-3 1.65e-3 1.66e-3 1.24e-3 1.68e-3",
            "1.24e6 2.57e0 1.07e5 2.82e-1 2.22e-1",
        ),
    },
    "unseen": {
        "38K": _columns(
            "MGN ESLR HOOD CCRAFT Pb4U-GNet",
            "7.16e4 1.49e0 1.87e0 3.11e-1 1.05e-1",
            "8.63e0 1.23e-2 1.77e-2 1.03e-2 2.13e-2",
            "3.40e1 8.03e-5 2.06e-4 4.63e-4 3.05e-2",
            "3.80e-2 2.15e-3 2.57e-3 1.88e-3 1.57e-3",
            "-2.08e0 -1.21e-1 -1.52e-1 -6.16e-2 -5.33e-3",
            "2.52e-3 1.96e-3 1.75e-3 1.79e-3 2.33e-3",
            "7.16e4 1.39e0 1.74e0 2.64e-1 1.55e-1",
        ),
    },
    "efficiency": {
        "12K": {
            "MGN": {"total": -4.22e-1, "ms": 46.4},
            "HOOD": {"total": -4.38e-1, "ms": 50.8},
            "ESLR": {"total": -4.33e-1, "ms": 54.6},
            "CCRAFT": {"total": -3.53e-1, "ms": 97.2},
            "Pb4U-GNet": {"total": -4.11e-1, "ms": 50.0},
        },
        "25K": {
            "MGN": {"total": -3.65e-1, "ms": 81.8},
            "HOOD": {"total": -3.81e-1, "ms": 81.5},
            "ESLR": {"total": -4.11e-1, "ms": 98.2},
            "CCRAFT": {"total": -2.10e-1, "ms": 171.4},
            "Pb4U-GNet": {"total": -3.84e-1, "ms": 105.3},
        },
        "48K": {
            "MGN": {"total": 5.75e3, "ms": 144.5},
            "HOOD": {"total": 6.40e-1, "ms": 141.1},
            "ESLR": {"total": 1.38e-1, "ms": 184.8},
            "CCRAFT": {"total": 2.13e-1, "ms": 761_499.3},
            "Pb4U-GNet": {"total": -2.42e-1, "ms": 196.4},
        },
    },
    "ablation": {
        "11K": {
            "Pb4U-GNet": {"total": -1.66e-2},
            "w/o propagation control": {"total": -1.61e-3},
            "w/o update scaling": {"total": -5.78e-3},
            "w/o both": {"total": 4.70e-3},
        },
        "25K": {
            "Pb4U-GNet": {"total": 6.34e-2},
            "w/o propagation control": {"total": 1.08e6},
            "w/o update scaling": {"total": 1.55e13},
            "w/o both": {"total": 1.44e3},
        },
        "38K": {
            "Pb4U-GNet": {"total": 2.22e-1},
            "w/o propagation control": {"total": 1.08e9},
            "w/o update scaling": {"total": 7.34e13},
            "w/o both": {"total": 1.24e6},
        },
    },
}
"""protocol -> level -> model -> quantity. Figures that the paper only draws (loss against K) have no entry."""


def paper_figures(protocol: str, level: str) -> dict[str, dict[str, float]]:
    """model -> quantity of the paper's own table at a level; empty where it has none."""
    return PAPER.get(protocol, {}).get(level, {})
