"""An option of a run is one field of `Run`: what offers, stores, lists or refuses options follows a field more."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyarrow", reason='the index needs the "dataset" extra')

ADDED = r'''
import importlib.util, json, sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from unittest.mock import MagicMock

spec = importlib.util.find_spec("pb4u.run")
source = Path(spec.origin).read_text()
for before, more in {
    "        as_recorded: Play": """\
        gravity_scale: Gravity, as a multiple of the Earth's.
        integration: How velocities follow from positions.
        gust: Wind along each axis.
""",
    "    as_recorded: Annotated": """\
    gravity_scale: Annotated[
        float, Flag(MODEL, "X", least=0, most=2, section="run", applies_to=STEPS, form="Gravity")
    ] = 1.0
    integration: Annotated[Literal["euler", "bdf2"], Flag(SCENE, form="Integration")] = "euler"
    gust: Annotated[tuple[float, float, float] | None, Flag(SCENE, label="gust_asked")] = None
""",
}.items():
    assert source.count(before) == 1
    source = source.replace(before, more + before)
module = importlib.util.module_from_spec(spec)
sys.modules["pb4u.run"] = module
exec(compile(source, spec.origin, "exec"), module.__dict__)

from pb4u.cli.main import main
from pb4u.cli.run_flags import run_flags, run_of
from pb4u.dataset.index import _schema
from pb4u.dataset.jobs_file import read_jobs
from pb4u.measures.run_job import RunJob
from pb4u.run import Run
from pb4u.simulation.models import load_simulator, looks_at
from pb4u.viewer.simulation_panel import SimulationPanel

folder = Path(sys.argv[1])


def refused(*flags):
    sys.argv = ["pb4u", "simulate", *flags, "--frames", "1", "--out", str(folder / "a.npz")]
    with redirect_stderr(StringIO()) as said, redirect_stdout(StringIO()):
        try:
            main()
        except SystemExit as end:
            return end.code, said.getvalue()
    return 0, said.getvalue()


class Page:
    """Notes the controls that are put on a page, and holds what each begins with."""

    def __init__(self):
        self.controls = {}

    def __getattr__(self, kind):
        def add(label=None, *values, **more):
            control = MagicMock(value=more.get("initial_value"))
            self.controls[label] = control, {"kind": kind, **more}
            return control

        return add


run = run_of(Run(), {"gravity_scale": 0.5, "integration": "bdf2"})
run.save(folder / "scene.toml")
saved, run = run, replace(run, gust=(1.0, 0.0, 2.5))
(folder / "jobs.toml").write_text("[product]\ngravity_scale = [0.5, 1.5]\n")
columns = {each.name: str(each.type) for each in _schema()}
page = Page()
panel = SimulationPanel(page, MagicMock(uploads=MagicMock(find=lambda kind, name: None)))
page.controls["Gravity"][0].value = 0.25
page.controls["Integration"][0].value = "bdf2"
filled = panel.run()
print(json.dumps({
    "flags": sorted({"gravity_scale", "integration"} & {*run_flags()}),
    "file": Run.open(folder / "scene.toml") == saved,
    "jobs": [each.gravity_scale for each in read_jobs(folder / "jobs.toml")],
    "labels": {name: RunJob(run).labels.get(name) for name in ("gravity_scale", "integration", "gust_asked")},
    "columns": {name: columns.get(name) for name in ("gravity_scale", "integration", "gust_asked")},
    "keys": len({RunJob(each).key for each in (run, Run(), run.with_entries({"gravity_scale": 0.75}))}),
    "labels without a column": sorted({*RunJob(run).labels} - {*columns}),
    "form": [page.controls[label][1] for label in ("Gravity", "Integration")],
    "filled": [filled.gravity_scale, filled.integration],
    "looked at": [looks_at(name, "gravity_scale") for name in ("solver", "net.safetensors", "skinning")],
    "useless": refused("--model", "skinning", "--gravity-scale", "0.5"),
    "out of range": refused("--gravity-scale", "3"),
    "python": load_simulator("skinning", gravity_scale=0.5).name,
}))
'''


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What follows three fields that are added to the source of `Run` before anything else is imported."""
    call = [sys.executable, "-c", ADDED, str(tmp_path_factory.mktemp("options"))]
    paths = os.pathsep.join(filter(None, (str(Path(__file__).parents[1] / "src"), os.environ.get("PYTHONPATH"))))
    ended = subprocess.run(call, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths})
    assert ended.returncode == 0, ended.stderr
    answer: dict[str, Any] = json.loads(ended.stdout)
    return answer


def test_a_new_field_is_a_flag_and_an_entry_of_scene_and_jobs_files(followed: dict[str, Any]) -> None:
    assert followed["flags"] == ["gravity_scale", "integration"]
    assert followed["file"]
    assert followed["jobs"] == [0.5, 1.5]
    assert followed["python"] == "skinning"
    code, said = followed["out of range"]
    assert (code, said) == (1, "pb4u: --gravity-scale must be a number from 0 to 2, not 3.0.\n")


def test_a_new_field_is_a_label_and_a_column_of_its_type(followed: dict[str, Any]) -> None:
    assert followed["labels"] == {"gravity_scale": 0.5, "integration": "bdf2", "gust_asked": [1.0, 0.0, 2.5]}
    columns = {name: kind.replace("element: ", "item: ") for name, kind in followed["columns"].items()}
    assert columns == {"gravity_scale": "double", "integration": "string", "gust_asked": "list<item: double>"}
    assert followed["labels without a column"] == []
    assert followed["keys"] == 3


def test_a_new_field_is_refused_where_a_model_does_not_look_at_it(followed: dict[str, Any]) -> None:
    assert followed["looked at"] == [True, True, False]
    assert followed["useless"] == [1, "pb4u: --gravity-scale does nothing with --model skinning; leave it out.\n"]


def test_a_new_field_with_a_label_is_in_the_form_of_the_studio(followed: dict[str, Any]) -> None:
    gravity, integration = followed["form"]
    assert gravity.pop("hint") == "Gravity, as a multiple of the Earth's."
    assert gravity == {"kind": "add_number", "initial_value": 1.0, "min": 0, "max": 2, "step": None}
    assert (integration["kind"], integration["options"]) == ("add_dropdown", ["euler", "bdf2"])
    assert followed["filled"] == [0.25, "bdf2"]
