"""The benchmark of the network measures the compiled network, and it is the one that its twin describes."""

from __future__ import annotations

import time

import pytest
from benchmarks.network import measure, on_a_body


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_every_way_to_compute_the_network_is_timed(precision: str) -> None:
    row = measure("pb4u_small", precision, 1, on_a_body(200), time.perf_counter)
    assert all(row[f"{name}_ms"] > 0 for name in ("network", "torch", "twin", "products", "graph"))
    assert (1e-9 < row["off"] < 1e-5) if precision == "float32" else (1e-4 < row["off"] < 5e-2)
