"""The paper's own figures, to stand beside a run's: other data (VTO, SMPL), other meshes, an unnamed test machine.

Source: Pb4U-GNet (AAAI 2026), tables on unseen resolutions, unseen garments, efficiency and ablation. Energies in J
by the released convention, latency in milliseconds a step.
"""

from __future__ import annotations

import re

TERMS = ("stretch", "bending", "collision", "inertia", "gravity", "friction", "total")
"""The rows of the paper's tables."""

_RESOLUTION = """
level  quantity   MGN       HOOD      ESLR      CCRAFT    Pb4U-GNet
11K    stretch    5.30e-2   6.83e-2   2.97e-2   1.22e-1   3.06e-2
11K    bending    3.39e-3   2.34e-3   1.81e-3   2.96e-3   2.92e-3
11K    collision  1.71e-2   2.16e-2   1.99e-4   1.14e-6   1.62e-3
11K    inertia    2.02e-3   1.80e-3   1.72e-3   1.91e-3   1.78e-3
11K    gravity    -7.20e-2  -8.59e-2  -6.01e-2  -8.56e-2  -5.49e-2
11K    friction   1.25e-3   1.30e-3   1.09e-3   1.19e-3   1.34e-3
11K    total      4.70e-3   9.45e-3   -2.56e-2  4.24e-2   -1.66e-2
18K    stretch    4.13e-1   3.56e-1   8.32e-2   1.89e-1   4.17e-2
18K    bending    4.80e-3   4.67e-3   2.08e-3   4.12e-3   4.23e-3
18K    collision  1.12e-1   1.13e-4   5.60e-2   6.10e-4   1.21e-2
18K    inertia    3.66e-3   2.83e-3   1.89e-3   1.88e-3   1.72e-3
18K    gravity    -1.02e-1  -1.15e-1  -8.38e-2  -8.68e-2  -5.30e-2
18K    friction   1.36e-3   1.36e-3   1.17e-3   1.20e-3   1.43e-3
18K    total      4.32e-1   2.49e-1   6.06e-2   1.10e-1   8.13e-3
25K    stretch    1.43e3    3.89e-1   2.27e-1   2.51e-1   5.70e-2
25K    bending    1.23e-1   4.88e-3   2.52e-3   4.59e-3   5.83e-3
25K    collision  3.39e0    2.40e-4   4.64e-2   4.37e-6   4.69e-2
25K    inertia    1.08e-2   2.93e-3   2.10e-3   1.82e-3   1.70e-3
25K    gravity    -3.66e-1  -1.20e-1  -1.07e-1  -8.68e-2  -4.95e-2
25K    friction   1.47e-3   1.35e-3   1.27e-3   1.22e-3   1.50e-3
25K    total      1.44e3    2.78e-1   1.73e-1   1.72e-1   6.34e-2
38K    stretch    1.24e6    2.52e0    1.07e5    3.60e-1   1.30e-1
38K    bending    1.03e1    1.56e-2   9.14e-1   6.13e-3   1.43e-2
38K    collision  8.22e0    1.97e-1   2.46e1    3.84e-4   1.03e-1
38K    inertia    4.07e-2   5.08e-3   9.95e-3   1.87e-3   1.64e-3
38K    gravity    -2.55e0   -1.78e-1  -3.25e-2  -8.72e-2  -2.81e-2
38K    friction   1.70e-3   1.65e-3   1.66e-3   1.24e-3   1.68e-3
38K    total      1.24e6    2.57e0    1.07e5    2.82e-1   2.22e-1
"""

_UNSEEN = """
level  quantity   MGN      ESLR      HOOD      CCRAFT    Pb4U-GNet
38K    stretch    7.16e4   1.49e0    1.87e0    3.11e-1   1.05e-1
38K    bending    8.63e0   1.23e-2   1.77e-2   1.03e-2   2.13e-2
38K    collision  3.40e1   8.03e-5   2.06e-4   4.63e-4   3.05e-2
38K    inertia    3.80e-2  2.15e-3   2.57e-3   1.88e-3   1.57e-3
38K    gravity    -2.08e0  -1.21e-1  -1.52e-1  -6.16e-2  -5.33e-3
38K    friction   2.52e-3  1.96e-3   1.75e-3   1.79e-3   2.33e-3
38K    total      7.16e4   1.39e0    1.74e0    2.64e-1   1.55e-1
"""

_EFFICIENCY = """
level  quantity  MGN       HOOD      ESLR      CCRAFT    Pb4U-GNet
12K    total     -4.22e-1  -4.38e-1  -4.33e-1  -3.53e-1  -4.11e-1
12K    ms        46.4      50.8      54.6      97.2      50.0
25K    total     -3.65e-1  -3.81e-1  -4.11e-1  -2.10e-1  -3.84e-1
25K    ms        81.8      81.5      98.2      171.4     105.3
48K    total     5.75e3    6.40e-1   1.38e-1   2.13e-1   -2.42e-1
48K    ms        144.5     141.1     184.8     761499.3  196.4
"""

# The paper's 11K, 25K and 38K, under our levels that are as many times finer than the mesh of the training.
_ABLATION = """
level  quantity  Pb4U-GNet  w/o propagation control  w/o update scaling  w/o both
1200   total     -1.66e-2   -1.61e-3                 -5.78e-3            4.70e-3
2730   total     6.34e-2    1.08e6                   1.55e13             1.44e3
4140   total     2.22e-1    1.08e9                   7.34e13             1.24e6
"""


def _parsed(table: str) -> dict[str, dict[str, dict[str, float]]]:
    """Level -> model -> quantity of a table whose columns stand two spaces or more apart."""
    (_, _, *models), *rows = (re.split(r"  +", line) for line in table.strip().splitlines())
    figures: dict[str, dict[str, dict[str, float]]] = {}
    for level, quantity, *values in rows:
        for model, value in zip(models, values, strict=True):
            figures.setdefault(level, {}).setdefault(model, {})[quantity] = float(value)
    return figures


PAPER = {
    "resolution": _parsed(_RESOLUTION),
    "unseen": _parsed(_UNSEEN),
    "efficiency": _parsed(_EFFICIENCY),
    "ablation": _parsed(_ABLATION),
}
"""Protocol -> level -> model -> quantity. Figures that the paper only draws (loss against K) have no entry."""


def paper_figures(protocol: str, level: str) -> dict[str, dict[str, float]]:
    """The paper's own table at a level.

    Args:
        protocol: its name.
        level: name of the resolution.

    Returns:
        Model -> quantity -> energy [J] or latency [ms]; empty where the paper has none.
    """
    return PAPER.get(protocol, {}).get(level, {})
