"""Threads of cloth in pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pb4u.export.shading import LOOKS
from pb4u.export.still_renderer import render
from pb4u.export.threads import PITCH, SIDE, THREADS, thread_image, uvs_in_metres
from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory

_IMAGES: dict[str, np.ndarray] = {}


def image_of(name: str) -> np.ndarray:
    if name not in _IMAGES:
        _IMAGES[name] = thread_image(THREADS[name], (0.5, 0.5, 0.5)).astype(float) / 255.0
    return _IMAGES[name]


@pytest.mark.parametrize("name", THREADS)
def test_threads_are_of_the_colour_from_afar_and_make_no_plaid(name: str) -> None:
    image = image_of(name)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), 0.5, atol=0.01)
    assert image.std() > 0.02
    # Over the length of the image, no thread and no rib is lighter than its neighbours of 10 mm.
    width = round(0.01 / SIDE * len(image))
    for axis in (0, 1):
        bands = image[..., 0].mean(axis=axis)[: len(image) // width * width].reshape(-1, width).mean(axis=1)
        assert bands.std() < 0.006


def test_a_thread_is_as_wide_as_it_should_be_and_the_image_goes_on_at_its_edges() -> None:
    image = image_of("plain")[..., 0]
    power = np.abs(np.fft.rfft(image - image.mean(), axis=1)).mean(axis=0)
    assert SIDE / (power[20:].argmax() + 20) == pytest.approx(PITCH, rel=0.01)
    seam, within = (np.abs(image[:, a] - image[:, b]).mean() for a, b in ((0, -1), (512, 511)))
    assert seam < 1.3 * within


@pytest.mark.parametrize("degrees", [0.0, 90.0, 205.0])
def test_uvs_are_metres_of_cloth_and_the_warp_goes_up_however_they_lie(trajectory: Trajectory, degrees: float) -> None:
    header, turn = trajectory.header, np.deg2rad(degrees)
    assert header.uvs is not None
    assert header.uv_faces is not None
    # The circumference and the height of the tube, side by side in one square.
    flat = header.uvs * [2.0 * np.pi * 0.2, 0.6 / 0.8]
    turned = 0.3 * flat @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    metres = uvs_in_metres(replace(header, uvs=turned))
    assert metres is not None
    heights = np.asarray(header.rest_positions)[header.faces, 1]
    offset = metres[header.uv_faces, 1] - heights
    assert np.ptp(offset) < 0.05
    assert np.ptp(metres[:, 0]) == pytest.approx(2.0 * np.pi * 0.2, rel=0.08)


def test_the_warp_goes_as_panels_were_cut(trajectory: Trajectory) -> None:
    header = trajectory.header
    assert header.uvs is not None
    # Cut with the warp around the body.
    rest_uv = np.asarray(header.uvs * [2.0 * np.pi * 0.2, 0.6 / 0.8])[header.uv_faces][..., ::-1]
    metres = uvs_in_metres(replace(header, rest_uv=rest_uv))
    assert metres is not None
    assert np.corrcoef(metres[:, 1], header.uvs[:, 0])[0, 1] > 0.98


def picture(trajectory: Trajectory, **look: object) -> np.ndarray:
    view = View(**{"width": 240, "height": 240, "cloths": (LOOKS["denim"].colour,), **look})  # type: ignore[arg-type]
    return next(iter(render(trajectory, [0], view))).astype(int)


def test_pictures_show_them_where_the_cloth_has_uvs_and_they_are_asked_for(trajectory: Trajectory) -> None:
    bare = replace(trajectory, header=replace(trajectory.header, uvs=None, uv_faces=None))
    assert (picture(trajectory) != picture(trajectory, weave=False)).any(axis=2).mean() > 0.02
    np.testing.assert_array_equal(picture(bare), picture(bare, weave=False))


def test_a_flag_leaves_them_out(
    convert: Callable[..., tuple[int, str]], trajectory: Trajectory, tmp_path: Path
) -> None:
    file, strips = trajectory.save(tmp_path / "t.npz"), []
    for flag in ("on", "off"):
        assert convert(file, tmp_path / "t.png", "--size", "90x120", "--weave", flag) == (0, "")
        strips.append(np.asarray(Image.open(tmp_path / "t.png").convert("RGB")))
    assert (strips[0] != strips[1]).any()
