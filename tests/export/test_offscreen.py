"""Whatever the environment tells OpenGL, pictures are drawn or refused in one sentence, and the process goes on."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

from pb4u.errors import Pb4uError
from pb4u.export import offscreen
from pb4u.export.offscreen import choose_opengl
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory


@pytest.fixture(autouse=True)
def untold() -> Iterator[None]:
    # What is chosen stays in the environment; each test begins with what it was.
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)
    offscreen._working.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("window", ["", "vtkOSOpenGLRenderWindow", "vtkXOpenGLRenderWindow", "vtkNoSuchWindow"])
def test_a_window_that_ends_the_process_is_replaced(trajectory: Trajectory, window: str) -> None:
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = window
    (picture,) = render(trajectory, [0], View(width=64, height=96))
    assert picture.shape == (96, 64, 3)
    assert np.ptp(picture) > 50


def test_what_works_is_taken_as_it_is_and_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    monkeypatch.setattr(offscreen, "_draws", lambda told: tried.append(dict(told)) or True)
    os.environ["MESA_DEBUG"] = "silent"
    before = dict(os.environ)
    choose_opengl()
    choose_opengl()
    assert dict(os.environ) == before
    assert len(tried) == 1
    assert tried[0]["MESA_DEBUG"] == "silent"


def test_the_window_alone_is_changed_where_that_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offscreen, "_draws", lambda told: told.get("VTK_DEFAULT_OPENGL_WINDOW") == "vtkEGLRenderWindow")
    os.environ |= {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow", "MESA_DEBUG": "silent"}
    choose_opengl()
    assert os.environ["VTK_DEFAULT_OPENGL_WINDOW"] == "vtkEGLRenderWindow"
    assert os.environ["MESA_DEBUG"] == "silent"


def test_where_nothing_draws_one_sentence_says_so(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offscreen, "_TRIAL", "import os; os.abort()")
    offscreen._working.cache_clear()
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = ""
    with pytest.raises(Pb4uError, match=r"^Pictures need off-screen OpenGL.*take VTK_DEFAULT_OPENGL_WINDOW out"):
        next(render(trajectory, [0], View(width=64, height=96)))
