"""The core runs without `pb4u.paper` and `pb4u.compat`, which register what they have; it has no name of theirs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "pb4u"
RESEARCH = ("paper", "compat")
ABOVE = (*RESEARCH, "dataset", "viewer", "cli")
"""Packages that may name research: itself, and those above it."""
CORE = sorted(
    file
    for file in SOURCE.rglob("*.py")
    if file.relative_to(SOURCE).parts[0] not in ABOVE and file != SOURCE / "__init__.py"
)

BLOCKED = """\
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name in ("pb4u.paper", "pb4u.compat"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocker())
"""


def told(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_no_file_of_the_core_names_research() -> None:
    assert len(CORE) > 250
    names = [f"pb4u.{package}" for package in RESEARCH] + [f"from pb4u import {package}" for package in RESEARCH]
    assert not [(file.name, name) for file in CORE for name in names if name in file.read_text(encoding="utf-8")]


def test_the_default_network_simulates_without_research() -> None:
    program = """
import numpy, pb4u
scene = pb4u.make_scene("tshirt", triangles=600, frames=2, lead_in=0)
made = pb4u.load_simulator("pb4u-light").simulate(scene)
assert made.frame_count == 2 and numpy.isfinite(made.positions).all()
assert abs(made.positions[1] - made.positions[0]).max() > 1e-4
assert not [name for name in sys.modules if name.startswith(("pb4u.paper", "pb4u.compat"))]
"""
    told(BLOCKED + program)


def test_what_needs_no_research_imports_none() -> None:
    program = """
import sys, pb4u
from pb4u.scene.assembly import build_scene
from pb4u.simulation.checkpoint import from_pretrained

from_pretrained("pb4u-light")
pb4u.load_simulator(refine=0), pb4u.load_simulator("quick-solver")
build_scene(pb4u.Run(frames=2))
print(*(name for name in sys.modules if name.startswith("pb4u.")))
"""
    loaded = told(program).split()
    assert "pb4u.registry" in loaded
    assert not [name for name in loaded if name.split(".")[1] in RESEARCH]


REFUSALS = {
    "pb4u.load_simulator('comparison-hood')": "unknown type 'HoodConfiguration'",
    "pb4u.load_simulator('pb4u-light', first_frame='mgn')": "no first frame 'mgn'; there are settled, long_step,",
    "pb4u.load_simulator('warm-start')": "no control 'warm-start'; there are none.",
    "pb4u.load_simulator('literal')": "no model 'literal';",
    "pb4u.load_simulator('absent.pth')": "There is no model file absent.pth",
    "pb4u.make_scene('absent.pkl:dress')": "no dictionary of garments '.pkl'; there are none.",
    "pb4u.make_scene(motion='absent.pkl', as_recorded=True)": "To play a recording as recorded, give its",
    "check_target(Path('a.pkl'))": ".pkl is not a format that is written",
    "with_settings(TrainingConfiguration(), ['network=hood'])": "no network preset 'hood'; there are none.",
    "TRAININGS.named('small')": "no training preset 'small'; there are none.",
}
"""What uses research -> how it is refused where that is not installed."""


@pytest.mark.parametrize("installed", [False, True])
def test_what_uses_research_is_refused_where_that_is_absent_alone(installed: bool) -> None:
    attempts = "".join(f"try:\n    {use}\nexcept pb4u.InputError as error:\n    print(error)\n" for use in REFUSALS)
    program = f"""
from pathlib import Path
import pb4u
from pb4u.export.registry import check_target
from pb4u.training.configuration import TRAININGS, TrainingConfiguration, with_settings
{attempts}"""
    said = told(program if installed else BLOCKED + program)
    assert [refusal in said for refusal in REFUSALS.values()] == [not installed] * len(REFUSALS)
