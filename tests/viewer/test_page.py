"""The page itself, in a real browser without a screen: what a user clicks, and what the server does about it."""

from __future__ import annotations

import shutil
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.garment.cloth_shapes import quad_tube, saved
from tests.viewer.clips import trajectory

from pb4u.run import Run, WornGarment
from pb4u.simulation.models import default_model
from pb4u.viewer.clip import RecordedClip

pytest.importorskip("viser", reason='the studio needs the "view" extra')
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium, which drives the browser, is not installed")

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="there is no chromium with its chromedriver here"),
]

# No screen and no graphics card, and nothing that would call out of the machine.
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-dev-shm-usage", "--window-size=900,820", "--force-device-scale-factor=0.5",
)  # fmt: skip
PATIENCE = 60.0


def wait_for(condition: Callable[[], Any], what: str) -> Any:
    """The first truthy answer of `condition`."""
    until = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < until, f"waited in vain until {what}"
        time.sleep(0.05)
    return found


class Window:
    """What a user does in the browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def find(self, path: str) -> Any:
        return wait_for(lambda: self.driver.find_elements("xpath", path), f"{path} is there")[0]

    def click(self, path: str) -> None:
        # Buttons are dimmed for a moment; a click by script is not kept off by what flies over them.
        element = self.find(path)
        wait_for(element.is_enabled, f"{path} can be clicked")
        self.driver.execute_script("arguments[0].click()", element)

    def button(self, label: str) -> None:
        self.click(f"//button[normalize-space()='{label}']")

    def tab(self, label: str) -> None:
        self.find(f"//*[@role='tab' and @title='{label}']").click()  # by hand: tabs listen to the pointer

    def type(self, label: str, value: int) -> None:
        field = self.find(f"//label[normalize-space()='{label}']/following::input[1]")
        field.click()
        field.send_keys("\ue009a\ue000" + str(value))  # control A, the value
        self.driver.execute_script("arguments[0].blur()", field)  # a tab would open the list that follows

    def choose(self, label: str, option: str) -> None:
        self.find(f"//label[normalize-space()='{label}']/following::input[1]").click()
        self.click(f"//*[@role='option' and normalize-space()='{option}']")

    def says(self, text: str) -> bool:
        return text in self.driver.execute_script("return document.body.innerText")


@pytest.fixture(scope="module")
def downloads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def studio() -> Iterator[Any]:
    from pb4u.viewer.studio import Studio

    made = Studio((RecordedClip(trajectory(20, lost=(19,), widen=0.01), "tube"),), port=0)
    yield made
    made.close()


@pytest.fixture(scope="module")
def window(studio: Any, downloads: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Window]:
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    # Clicks by script are no gestures of a user, and without one a browser keeps a second file back.
    wishes = {
        "download.default_directory": str(downloads),
        "profile.default_content_setting_values.automatic_downloads": 1,
    }
    options.add_experimental_option("prefs", wishes)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        driver.get(studio.url)
        yield Window(driver)
    finally:
        driver.quit()


@pytest.fixture(scope="module")
def session(studio: Any, window: Window) -> Any:
    """The server's side of the first window."""
    return wait_for(lambda: studio.windows, "the server has the window")[0]


def test_it_opens_and_plays(window: Window, session: Any) -> None:
    wait_for(lambda: window.says("frame 0 of 19"), "the trajectory is shown")
    window.button("Play")
    wait_for(lambda: session.state.clock.playing and not window.says("frame 0 of 19"), "it goes on")
    window.button("Pause")
    wait_for(lambda: not session.state.clock.playing, "it stands still")
    window.button("last")
    wait_for(lambda: window.says("Frame 19 of tube is not finite"), "the lost frame is marked")
    window.button("first")
    # The server answers each click on a thread of its own.
    wait_for(lambda: window.says("frame 0 of 19"), "it is at the first frame")
    window.button("+ 1")
    wait_for(lambda: window.says("frame 1 of 19"), "it has gone one frame on")
    window.click("//label[normalize-space()='Body']/following::input[@type='checkbox'][1]")
    wait_for(lambda: not session.state.body, "the body is hidden")


def test_overlays_have_a_legend(window: Window, session: Any) -> None:
    window.choose("Overlay", "strain")
    wait_for(lambda: window.says("25 % and more"), "the legend is there")
    window.choose("Overlay", "K and update scale")
    wait_for(lambda: window.says("K = 2 by the paper's rule"), "K is written")
    window.choose("Overlay", "shaded")
    wait_for(lambda: not window.says("by the paper's rule"), "the legend is gone")


def test_energies_are_plotted(window: Window, session: Any) -> None:
    window.tab("Plots")
    wait_for(lambda: window.driver.find_elements("css selector", ".uplot canvas"), "there is a plot")
    wait_for(lambda: session.measurements[0].done == 20, "every frame is measured")


def test_the_curves_stay_at_every_frame(window: Window, session: Any) -> None:
    blue = """const canvas = document.querySelector(".uplot canvas");
              const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
              let count = 0;
              for (let i = 0; i < pixels.length; i += 4)
                  if (pixels[i] < 90 && pixels[i + 2] > 120 && pixels[i + 3] > 100) count++;
              return count;"""
    for button, frame in (("first", 0), ("+ 1", 1), ("last", 19), ("first", 0), ("+ 1", 1)):
        window.button(button)
        wait_for(lambda frame=frame: window.says(f"frame {frame} of 19"), f"it is at frame {frame}")
        time.sleep(1.0)  # a plot that loses its curves does so with the next data that come
        assert window.driver.execute_script(blue) > 50


def test_another_window_has_its_own_state_and_its_work_ends_with_it(studio: Any, window: Window, session: Any) -> None:
    first = window.driver.current_window_handle
    window.driver.switch_to.new_window("window")
    window.driver.get(studio.url)
    other = wait_for(lambda: [each for each in studio.windows if each is not session], "the server has it")[0]
    wait_for(lambda: window.says("frame 0 of 19"), "it begins at the start")
    window.button("last")
    wait_for(lambda: other.state.clock.frame == 19, "it has gone to the end")
    assert session.state.clock.frame == 1
    assert other.state.body

    window.click("//label[normalize-space()='Body']/following::input[@type='checkbox'][1]")
    window.tab("Simulate")
    window.type("Triangles", 400)
    window.type("Frames", 600)
    window.button("Simulate")
    wait_for(lambda: other.simulation and other.simulation.running, "it simulates")
    assert session.simulation is None
    window.driver.close()
    window.driver.switch_to.window(first)
    wait_for(lambda: other.closed and not other.simulation.running, "the work of the closed window has ended")
    assert studio.windows == (session,)
    assert not session.closed
    assert [clip.label for clip in session.state.clips] == ["tube"]


def test_the_view_is_kept_as_a_still_and_as_a_video(window: Window, session: Any, downloads: Path) -> None:
    for file in downloads.glob("*"):
        file.unlink()
    shown = session.state.clips
    session._load((RecordedClip(trajectory(5, widen=0.01), "tube"),))
    window.tab("Look")
    window.choose("Overlay", "strain")
    window.tab("Export")
    window.button("Still of this frame")
    (still,) = wait_for(lambda: list(downloads.glob("*.png")), "the still is downloaded")
    width, height = session._client.camera.image_width, session._client.camera.image_height
    wait_for(lambda: window.says("was handed to the browser"), "it says so")
    picture = np.asarray(Image.open(still))
    assert picture.shape[:2] == (height, width)
    assert len(np.unique(picture[..., :3].reshape(-1, 3), axis=0)) > 50
    session.export_panel._film_format.value = ".gif"
    window.button("Video of all frames")
    (video,) = wait_for(lambda: list(downloads.glob("*.gif")), "the video is downloaded")
    with Image.open(video) as frames:
        assert frames.n_frames == 3  # of five, down to about 15 a second
        first = np.asarray(frames.convert("RGB"), dtype=int)
        frames.seek(2)
        assert abs(np.asarray(frames.convert("RGB"), dtype=int) - first).max() > 30
    session._load(shown)


def test_it_simulates_live_cancels_and_exports(window: Window, session: Any, downloads: Path) -> None:
    shown = session.state.clips
    window.tab("Simulate")
    window.type("Triangles", 400)
    window.type("Frames", 600)
    window.type("Lead-in", 0)
    window.button("Simulate")
    wait_for(
        lambda: session.state.clips[0].label == f"tshirt, walk, {default_model()}",
        "frames arrive while they are computed",
    )
    assert session.simulation.running
    assert abs(len(session.state.clips[0].header.faces) - 400) < 80
    window.button("Cancel")
    wait_for(lambda: window.says("Cancelled;"), "it says that it was cancelled")
    assert not session.simulation.running
    frames = session.state.clips[0].frame_count
    assert 1 <= frames < 600

    window.tab("Export")
    window.button("Export")
    wait_for(lambda: window.says("was handed to the browser"), "the export is done")
    (file,) = wait_for(lambda: list(downloads.glob("*.npz")), "the file is downloaded")
    assert file.name == f"tshirt_walk_{default_model().replace('-', '_')}.npz"
    session._load(shown)  # a body drawn by the processor would hold up every click that follows


def test_files_of_ones_own_are_worn_over_each_other_and_kept_as_a_scene(
    window: Window, session: Any, downloads: Path, tmp_path: Path
) -> None:
    tube = saved(tmp_path, quad_tube(low=0.6, high=1.0, radius=0.22, around=24, rows=12), "my tube.obj")
    window.tab("Simulate")
    window.find("//*[normalize-space()='Files of your own']").click()
    chooser = wait_for(
        lambda: window.driver.find_elements("css selector", "input[type=file]"), "there are places for files"
    )[0]
    chooser.send_keys(str(tube))
    wait_for(lambda: window.says("my_tube.obj is here and chosen"), "the file has arrived")
    window.button("Add a garment")
    wait_for(lambda: len(session.simulation_panel.run().garments) == 2, "there are two garments")
    wait_for(lambda: window.says("Garment 2"), "the page shows both")
    window.button("Save scene.toml")
    file = wait_for(lambda: list(downloads.glob("scene.zip")), "the scene is downloaded")[0]
    with zipfile.ZipFile(file) as archive:
        assert set(archive.namelist()) == {"scene.toml", "garment/my_tube.obj"}
        assert archive.read("garment/my_tube.obj") == tube.read_bytes()
    window.button("Take off the last")
    wait_for(lambda: len(session.simulation_panel.run().garments) == 1, "one is taken off")


def test_an_impossible_wish_is_answered_on_the_page(window: Window, session: Any) -> None:
    window.tab("Simulate")
    window.choose("Model", "solver")
    before = session.simulation
    coarse = Run((WornGarment(triangles=7),))
    session.simulation_panel.run = lambda: coarse
    window.button("Simulate")
    wait_for(lambda: window.says("triangles must lie between 400 and 40,000"), "it says what is wrong")
    assert session.simulation is before
    window.button("first")
    wait_for(lambda: session.state.clock.frame == 0, "the page goes on")


def test_the_console_holds_no_error(window: Window) -> None:
    entries = window.driver.get_log("browser")
    assert entries, "the browser keeps a log"
    assert [
        entry["message"] for entry in entries if entry["level"] == "SEVERE" and "favicon" not in entry["message"]
    ] == []
