"""Off-screen OpenGL that works here, found by drawing in a process of its own.

VTK ends its process where OpenGL is not as it expects: where the environment names a window that this machine lacks (as
advice for machines without a display does), where it names none, or where no driver is there. What is tried in another
process ends that one alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache

from pb4u.errors import Pb4uError

_WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
_WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
"""Windows of VTK that need no display, by its names."""
# What else sends OpenGL elsewhere: by these beginnings of names Mesa, glvnd and VTK are told so.
_TOLD = ("VTK_", "MESA_", "LIBGL_", "GALLIUM_", "EGL_", "__EGL_", "__GLX_", "DISPLAY")
_SECONDS = 60.0
"""Time that a trial has: a driver that waits for a display which does not answer never ends."""

_TRIAL = """
from vtkmodules.vtkCommonCore import vtkLogger
vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
from vtkmodules.vtkFiltersSources import vtkSphereSource
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFXAAPass, vtkRenderStepsPass, vtkSSAOPass
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter,
)
ball, mapper, actor = vtkSphereSource(), vtkPolyDataMapper(), vtkActor()
mapper.SetInputConnection(ball.GetOutputPort())
actor.SetMapper(mapper)
actor.GetProperty().SetAmbient(1.0)
window, renderer, hollows, smooth = vtkRenderWindow(), vtkRenderer(), vtkSSAOPass(), vtkOpenGLFXAAPass()
window.SetOffScreenRendering(True)
window.SetMultiSamples(0)
window.SetSize(16, 16)
renderer.AddActor(actor)
hollows.SetDelegatePass(vtkRenderStepsPass())
smooth.SetDelegatePass(hollows)
renderer.SetPass(smooth)
window.AddRenderer(renderer)
window.Render()
picture = vtkWindowToImageFilter()
picture.SetInput(window)
picture.Update()
assert picture.GetOutput().GetScalarRange()[1] > 100
"""


def choose_opengl() -> None:
    """Set the environment of this process so that VTK draws off screen, unless it already does.

    Raises:
        Pb4uError: this machine has no off-screen renderer.
    """
    settings = tuple(sorted((name, value) for name, value in os.environ.items() if name.startswith(_TOLD)))
    chosen = _working(settings)
    if chosen is None:
        remedy = f", or take {_WINDOW} out of the environment" if _WINDOW in os.environ else ""
        raise Pb4uError(
            "Pictures need off-screen OpenGL, which this machine lacks; on Debian or Ubuntu install libegl1 and "
            f"libgl1-mesa-dri{remedy}. The trajectory itself does not need it."
        )
    for name, _ in settings:
        if name not in dict(chosen):
            del os.environ[name]
    os.environ.update(chosen)


@lru_cache
def _working(settings: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...] | None:
    """What of the environment leads to a picture: all of it; else another window; else a window alone."""
    if not sys.executable:
        return settings
    variables = dict(settings)
    without = {name: value for name, value in variables.items() if name != _WINDOW}
    tried = [variables, without, *({**base, _WINDOW: window} for base in (without, {}) for window in _WINDOWS), {}]
    ways = dict.fromkeys(tuple(sorted(way.items())) for way in tried)
    return next((way for way in ways if _draws(dict(way))), None)


def _draws(settings: Mapping[str, str]) -> bool:
    """Whether VTK draws with this much told to OpenGL."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(_TOLD)}
    environment = {**others, **settings, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", _TRIAL]
    try:
        process = subprocess.run(command, env=environment, capture_output=True, timeout=_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return process.returncode == 0
