"""Cloth pulled with the mouse in a real browser without a screen, while it is simulated."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason='the studio needs the "view" extra')
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium, which drives the browser, is not installed")

from tests.viewer.test_page import BROWSER, DRIVER, FLAGS, Window, wait_for  # noqa: E402

from pb4u.garment.material import FABRICS  # noqa: E402
from pb4u.run import Run, WornGarment  # noqa: E402

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="there is no chromium with its chromedriver here"),
]

RUN = Run((WornGarment("skirt", triangles=400),), frames=4, lead_in=0, model="quick-solver", refine=3)
RIGHT = 30
"""Pixels that the mouse goes to the right."""


@pytest.fixture
def studio() -> Iterator[Any]:
    from pb4u.viewer.studio import Studio

    made = Studio((), port=0)
    yield made
    made.close()


@pytest.fixture
def window(studio: Any) -> Iterator[Window]:
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in FLAGS:
        options.add_argument(flag.replace("900,820", "760,520"))
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        driver.get(studio.url)
        yield Window(driver)
    finally:
        driver.quit()


def test_cloth_is_pulled_with_the_mouse_let_go_and_taken_back(studio: Any, window: Window) -> None:
    session = wait_for(lambda: studio.windows, "the server has the window")[0]
    window.tab("Touch")
    session.state.body = session.state.follow = False  # a body drawn by the processor would hold up every move
    session.touches.endless = True
    session.state.clock.speed = 0.1  # or it would reach the most frames before a slow browser is done
    session.simulate(RUN)
    wait_for(lambda: session.state.touchable and session.state.clock.frame_count > 3, "it is simulated")

    def mouse(kind: str, right: float) -> None:
        box = window.driver.execute_script("return document.querySelector('canvas').getBoundingClientRect().toJSON()")
        at = {"x": box["x"] + box["width"] / 2 + right, "y": box["y"] + 0.55 * box["height"]}
        pressed = int(kind != "mouseReleased")
        told = {"type": kind, **at, "button": "left", "buttons": pressed, "clickCount": 1}
        window.driver.execute_cdp_cmd("Input.dispatchMouseEvent", told)

    mouse("mousePressed", 0)
    for part in (1, 2, 3):
        mouse("mouseMoved", RIGHT * part / 3)
    hand = wait_for(lambda: session.state.hand, "a hand holds the cloth")
    clip, vertex = session.state.clips[0], int(session.touches._grasp.vertices[0])
    assert hand[0] > clip.garment(3)[vertex, 0] + 0.1, "to the right"

    def away(frame: int) -> float:
        return float(np.linalg.norm(clip.garment(frame)[vertex] - hand))

    wait_for(lambda: away(clip.frame_count - 1) < away(3) - 0.05, "the cloth follows")

    mouse("mouseReleased", RIGHT)
    wait_for(lambda: session.state.hand is None, "it is let go")
    wait_for(lambda: clip.frame_count > 8, "it falls")
    window.find("//label[normalize-space()='1: skirt']/following::input[1]").click()
    # The form has a list of the same materials, which is not shown.
    options = window.driver.find_elements("xpath", "//*[@role='option' and normalize-space()='denim-14oz']")
    window.driver.execute_script("arguments[0].click()", next(each for each in options if each.is_displayed()))
    wait_for(lambda: session.state.clips[0] is not clip, "it is made of another fabric")
    clip = session.state.clips[0]
    assert clip.header.garments[0]["material"]["density"] == FABRICS["denim-14oz"].density
    window.driver.find_elements("css selector", "[role=slider]")[1].send_keys("\ue014" * 4)  # arrow to the right
    wait_for(lambda: session.touches._wind, "a wind blows")
    window.button("first")
    wait_for(lambda: session.state.clock.frame == 0, "the first frame is shown")
    window.button("Go on from this frame")
    wait_for(lambda: session.state.clips[0] is not clip, "it is simulated anew")
    assert np.array_equal(session.state.clips[0].garment(0), clip.garment(0))
    session.cancel()
