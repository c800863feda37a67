import json
from dataclasses import replace

import numpy as np
import pytest
from cloth_shapes import CLOTH, saved, triangle_tube, tube_garment, with_open_seam

from pb4u.errors import InputError
from pb4u.garment.garment_file import read_garment
from pb4u.garment.pins import resolve_pins


def test_names_pick_borders():
    garment = tube_garment()
    assert not resolve_pins("none", garment).any()
    waist, hem = resolve_pins("waist", garment), resolve_pins("hem", garment)
    assert waist.sum() == hem.sum() == 40
    assert garment.vertices[waist, 1].min() == pytest.approx(1.0)
    assert garment.vertices[hem, 1].max() == pytest.approx(0.5)
    both = resolve_pins("loop:0", garment) | resolve_pins("loop:1", garment)
    np.testing.assert_array_equal(both, waist | hem)


def test_a_collar_is_the_uppermost_part_of_the_border_that_reaches_highest():
    upright = tube_garment()
    x, y, z = upright.vertices.T
    leaning = replace(upright, vertices=np.stack([x, y + 0.5 * z, z], axis=1))
    collar = resolve_pins("collar", leaning)
    height = leaning.vertices[:, 1]
    np.testing.assert_array_equal(collar, resolve_pins("waist", leaning) & (height > height.max() - 0.04))
    assert 3 < collar.sum() < 20


def test_a_loose_vertex_leaves_pins_by_index_where_they_are(tmp_path):
    torn = with_open_seam(triangle_tube())
    loose = replace(torn, vertices=np.concatenate([torn.vertices, [[0.0, 0.7, 0.4]]]))
    for listed in (0, len(torn.vertices) - 1):
        pinned = [resolve_pins([listed], read_garment(saved(tmp_path, mesh, "a.obj"), CLOTH)) for mesh in (torn, loose)]
        np.testing.assert_array_equal(*pinned)


def test_unknown_pins_list_the_choices():
    with pytest.raises(InputError, match=r"waist, collar, hem, loop:0 .*loop:1"):
        resolve_pins("lapel", tube_garment())
    with pytest.raises(InputError, match='no border "loop:2"'):
        resolve_pins("loop:2", tube_garment())


def test_files_of_indices_in_the_authors_order(tmp_path):
    garment = tube_garment()
    for name, text in (("a.txt", "3\n5, 8\n"), ("a.json", json.dumps([3, 5, 8]))):
        (tmp_path / name).write_text(text)
        np.testing.assert_array_equal(np.flatnonzero(resolve_pins(tmp_path / name, garment)), [3, 5, 8])
    np.testing.assert_array_equal(np.flatnonzero(resolve_pins([3, 5, 8], garment)), [3, 5, 8])


@pytest.mark.parametrize("text", ["3 four", "[1, 2.5]", "[1, [2]]", "[1, 2", '["a"]', "99999", "-1"])
def test_bad_files_of_indices(tmp_path, text):
    (tmp_path / "pins.txt").write_text(text)
    with pytest.raises(InputError, match=r"pins.txt"):
        resolve_pins(tmp_path / "pins.txt", tube_garment())


@pytest.mark.parametrize("text", ["", "\n", "[]"])
def test_a_file_without_indices_is_refused(tmp_path, text):
    (tmp_path / "pins.txt").write_text(text)
    with pytest.raises(InputError, match='"none"'):
        resolve_pins(tmp_path / "pins.txt", tube_garment())


@pytest.mark.parametrize("triangles", [600, 2500])
def test_pins_of_the_author_hold_the_whole_border_at_any_count(tmp_path, triangles):
    mesh = triangle_tube()
    border = np.flatnonzero(mesh.vertices[:, 1] > 0.999)
    garment = read_garment(saved(tmp_path, mesh), CLOTH, triangles=triangles, pins=border.tolist())
    expected = resolve_pins("waist", garment)
    assert (garment.pinned | ~expected).all()
    assert garment.vertices[garment.pinned, 1].min() > 0.97
    one = resolve_pins([int(border[0])], garment)
    assert one.any()
    assert np.linalg.norm(garment.vertices[one] - mesh.vertices[border[0]], axis=1).max() < 0.04
