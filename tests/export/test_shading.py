"""Colours of cloth: those of its fabric, and others that tell garments apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pb4u.export.selection import on_source
from pb4u.export.shading import LOOKS, PLAIN, cloth_parts, garment_colours
from pb4u.export.threads import THREADS
from pb4u.garment.material import BUILT_IN, material_names
from pb4u.scene.trajectory import Trajectory


def test_each_of_five_garments_of_one_fabric_has_a_colour_of_its_own_and_the_first_keeps_the_usual() -> None:
    colours = garment_colours(["denim"] * 7)
    assert colours[0] == LOOKS["denim"].colour
    assert len(set(colours[:5])) == 5
    assert set(colours[5:]) < set(colours[1:5])
    assert garment_colours(["denim", "", "silk"], [(0.1, 0.2, 0.3)]) == [
        (0.1, 0.2, 0.3), PLAIN.colour, LOOKS["silk"].colour,
    ]  # fmt: skip


@pytest.mark.parametrize("name", material_names())
def test_each_built_in_material_has_a_look_whose_threads_are_known(name: str) -> None:
    assert LOOKS[name].threads in ("", *THREADS)


def test_parts_are_the_faces_of_one_garment_each(trajectory: Trajectory) -> None:
    upper = trajectory.positions[0][:, 1] > 0.9
    parts = cloth_parts(replace(trajectory.header, vertex_garment=upper.astype(np.int32)))
    assert [part.name for part in parts] == ["garment 1", "garment 2"]
    for part, expected in zip(parts, (False, True), strict=True):
        np.testing.assert_array_equal(part.faces, np.flatnonzero(upper[trajectory.faces[:, 0]] == expected))


def made_of(trajectory: Trajectory, *ranges: tuple[str, list[list[int]]]) -> Trajectory:
    """The same with its faces made of built-in materials."""
    entries: list[dict[str, Any]] = [{**vars(BUILT_IN[name]), "faces": faces} for name, faces in ranges]
    return replace(trajectory, header=trajectory.header.with_metadata(materials=entries))


def test_parts_take_the_colours_of_their_fabrics(trajectory: Trajectory) -> None:
    faces = len(trajectory.faces)
    two = made_of(trajectory, ("denim", [[0, 100]]), ("leather", [[100, faces]]))
    body, patch = cloth_parts(two.header)
    assert (body.colour, patch.colour) == (LOOKS["denim"].colour, LOOKS["leather"].colour)
    np.testing.assert_array_equal(patch.faces, np.arange(100, faces))
    assert patch.name == "garment, leather"
    red = (1.0, 0.0, 0.0)
    assert [part.colour for part in cloth_parts(two.header, [red])] == [red, red]
    assert [part.fabric for part in cloth_parts(two.header, [red])] == [LOOKS["denim"], LOOKS["leather"]]


def test_a_material_of_other_numbers_is_plain(trajectory: Trajectory) -> None:
    odd = made_of(trajectory, ("denim", [[0, len(trajectory.faces)]]))
    odd.metadata["materials"][0]["density"] *= 1.001
    assert cloth_parts(odd.header)[0].colour == PLAIN.colour


def test_fabrics_go_with_the_authors_mesh(trajectory: Trajectory) -> None:
    source = trajectory.header.source
    assert source is not None
    split = int(np.median(source.triangle[source.faces[:, 0]]))
    two = made_of(trajectory, ("denim", [[0, split + 1]]), ("silk", [[split + 1, len(trajectory.faces)]]))
    for part in cloth_parts(on_source(two).header):
        under = source.triangle[source.faces[part.faces, 0]]
        assert ((under <= split) == (part.fabric is LOOKS["denim"])).all()
