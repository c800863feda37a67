"""Runs `python -m pb4u.training` as on a machine that has torch, numpy and safetensors only."""

from __future__ import annotations

import runpy
import sys

ABSENT = ("scipy", "igl", "trimesh", "pyvista", "pyacvd", "typer", "rich", "matplotlib", "numba", "anny", "skimage")

for name in ABSENT:
    sys.modules[name] = None  # type: ignore[assignment]
if __name__ == "__main__":
    sys.argv = ["pb4u.training", *sys.argv[1:]]
    runpy.run_module("pb4u.training", run_name="__main__")
