"""A clip baked to bones as three.js plays it, in a real browser without a screen."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tests.viewer.clips import header, tube
from tests.viewer.test_page import BROWSER, DRIVER, FLAGS, wait_for

from pb4u.export.registry import export
from pb4u.geometry.appearance import Appearance, Appearances
from pb4u.scene.trajectory import Frame, Trajectory

viser = pytest.importorskip("viser", reason='three.js comes with the "view" extra')
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium, which drives the browser, is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="there is no chromium with its chromedriver here"),
]

FIELD, AWAY, MIDDLE = np.radians(30.0), 4.0, 0.8


def swinging_skirt(frames: int = 60) -> Trajectory:
    """A skirt whose hem swings from side to side once, later than its waist."""
    rest, _ = tube(0.20, 0.5, 1.1, lids=False)
    body, _ = tube(0.05, 0.0, 1.7, lids=True)
    drop = 1.1 - rest[:, 1]
    rest[:, [0, 2]] *= 1.0 + drop[:, None]
    clip = []
    for t in range(frames):
        angle = (0.8 * np.sin(2 * np.pi * (t / frames - 0.1 * drop)))[:, None] * [0.0, 0.0, 1.0]
        clip.append(Rotation.from_rotvec(angle).apply(rest - [0, 1.1, 0]) + [0, 1.1, 0])
    as_float = [Frame(places.astype("f4"), np.zeros_like(places, "f4"), body.astype("f4")) for places in clip]
    blue = Appearances((Appearance("blue", (0.16, 0.36, 0.62)),), np.zeros(len(header().faces), dtype=np.int64))
    return Trajectory.collect(replace(header(), rest_positions=rest.astype("f4"), appearances=blue), as_float)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Any]:
    """A window that shows a file of glTF, seen from the front."""
    server = viser.ViserServer(port=0, verbose=False)
    server.scene.world_axes.visible = False
    server.gui.set_panel_label("")
    server.scene.set_up_direction("+y")
    server.scene.set_background_image(np.full((4, 4, 3), 255, dtype=np.uint8))
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path / 'profile'}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))

    def show(file: Path) -> Any:
        server.scene.add_glb("/clip", file.read_bytes(), cast_shadow=False, receive_shadow=False)
        driver.get(f"http://localhost:{server.get_port()}")
        (client,) = wait_for(lambda: list(server.get_clients().values()), "the page is connected")
        with client.atomic():
            client.camera.up_direction = (0.0, 1.0, 0.0)
            client.camera.position, client.camera.look_at = (0.0, MIDDLE, AWAY), (0.0, MIDDLE, 0.0)
            client.camera.fov = FIELD
        return driver

    try:
        yield show
    finally:
        driver.quit()
        server.stop()


ALONE = """document.querySelectorAll("body *").forEach(each => {
    if (each.tagName != "CANVAS" && !each.querySelector("canvas")) each.style.visibility = "hidden";
})"""


def outline(picture: np.ndarray) -> np.ndarray:
    """Leftmost and rightmost column and lowest row of the blue of the cloth in (height, width, 3); NaN without any."""
    rows, columns = np.nonzero(picture[..., 2] - picture[..., 0] > 50)
    return np.array([columns.min(), columns.max(), rows.max()] if len(rows) else 3 * [np.nan])


def projected(places: np.ndarray, width: int, height: int) -> np.ndarray:
    """The same (frames, 3) of vertices (frames, vertices, 3), by a pinhole camera."""
    size = 0.5 * height / np.tan(0.5 * FIELD) / (AWAY - places[..., 2])
    columns, rows = 0.5 * width + size * places[..., 0], 0.5 * height - size * (places[..., 1] - MIDDLE)
    return np.stack([columns.min(axis=1), columns.max(axis=1), rows.max(axis=1)], axis=1)


def test_a_page_plays_the_clip_by_its_bones(page: Any, tmp_path: Path) -> None:
    clip = swinging_skirt()
    driver = page(export(clip, tmp_path / "skirt.glb", bones=12))

    def picture() -> np.ndarray:
        driver.execute_script(ALONE)
        return np.asarray(Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")).astype(int)

    def apart() -> np.ndarray:
        return np.abs(outline(picture()) - wanted).max(axis=1)

    height, width = picture().shape[:2]
    posed = np.concatenate([clip.positions, 0.5 * (clip.positions + np.roll(clip.positions, 1, axis=0))])
    wanted = projected(posed, width, height)
    # The camera is set some moments after the page has opened.
    wait_for(lambda: apart().min() < 5.0, "it is seen from the front")
    seen = []
    for _ in range(8):
        found = apart()
        assert found.min() < 5.0, "pixels, half of them by twelve bones"
        seen.append(wanted[found.argmin(), :2].mean())
        time.sleep(0.2)
    assert np.ptp(seen) > 0.5 * np.ptp(wanted[:, :2].mean(axis=1))
