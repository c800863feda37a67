"""A run as a scene file: what is written comes back, what cannot be meant is refused."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.material import Material
from pb4u.motion.library import load_motion
from pb4u.run import Run, WornGarment
from pb4u.scene_file import OF_BEFORE
from pb4u.simulation.first_frame import OneLongStep, Settled
from pb4u.simulation.models import simulator_of
from pb4u.simulation.stepwise_simulator import StepwiseSimulator

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
garments = st.builds(
    WornGarment,
    garment=st.sampled_from(["tshirt", "dress", "skirt"]) | st.integers(0, 99).map(lambda n: f"/clothes/{n} ä.obj"),
    material=st.none() | st.sampled_from(["silk", "denim"]),
    pins=st.none() | st.just("waist") | st.lists(st.integers(0, 10_000), max_size=4),
    triangles=st.none() | st.integers(200, 200_000),
    tucked=st.booleans(),
)
runs = st.builds(
    Run,
    garments=st.lists(garments, min_size=1, max_size=3, unique_by=lambda each: each.garment).map(tuple),
    body=st.sampled_from(["woman", "man"]),
    body_shape=st.dictionaries(st.sampled_from(["height", "weight", 'a "b" = ü']), numbers),
    motion=st.none() | st.just("dance"),
    frames=st.none() | st.integers(1, 9999),
    lead_in=st.integers(0, 99),
    keep_lead_in=st.booleans(),
    crop=st.none() | st.tuples(st.integers(0, 9), st.integers(10, 99)),
    fps=st.floats(1.0, 1000.0),
    arms_away=st.floats(0.0, 90.0),
    seed=st.integers(0, 2**31),
    model=st.sampled_from(["auto", "solver", "pb4u-small"]),
    contact=st.booleans(),
    self_contact=st.none() | st.booleans(),
    refine=st.integers(0, 50),
    passes=st.none() | st.integers(1, 9),
    propagation_steps=st.none() | st.integers(1, 99),
    device=st.sampled_from(["auto", "cpu", "cuda"]),
    first_frame=st.sampled_from(["auto", "settled", "long_step"]),
    precision=st.sampled_from(["auto", "float32", "bfloat16"]),
)


@given(run=runs)
@settings(max_examples=60, deadline=None)
def test_what_is_written_comes_back(run: Run, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = run.save(tmp_path_factory.mktemp("scenes") / "scene.toml")
    read = Run.open(file)
    assert _texts(read) == _texts(run)
    assert Run.open(read.save(file)) == read


def _texts(run: Run) -> str:
    return repr(run).replace("PosixPath(", "").replace("WindowsPath(", "").replace(".obj')", ".obj'")


def test_files_are_found_from_the_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.makedirs("scenes")
    run = Run(
        (WornGarment("my/shirt.obj", "silk", Path("pinned")),),
        motion="07_02.amc",
        model="best.safetensors",
    )
    text = run.save("scenes/a.toml").read_text()
    for written in ('garment = "../my/shirt.obj"', 'pins = "../pinned"', 'motion = "../07_02.amc"', 'body = "woman"'):
        assert written in text
    monkeypatch.chdir("/")
    read = Run.open(tmp_path / "scenes" / "a.toml")
    assert Path(read.garments[0].garment).resolve() == (tmp_path / "my" / "shirt.obj").resolve()
    assert Path(read.garments[0].pins).resolve() == (tmp_path / "pinned").resolve()
    assert Path(read.model).resolve() == (tmp_path / "best.safetensors").resolve()
    assert (read.body, read.garments[0].material) == ("woman", "silk")


def test_a_few_lines_by_hand_are_enough(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text('[[garments]]\ngarment = "dress"\n[scene]\nfps = 24\nbody_shape = { height = 1 }\n')
    expected = Run((WornGarment("dress"),), fps=24, body_shape={"height": 1}, **OF_BEFORE)
    assert Run.open(file) == expected
    file.write_text("")
    assert Run.open(file) == Run(**OF_BEFORE)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[scene]\nframe = 3", "[scene] has no entry 'frame'; did you mean frames"),
        ("[run]\nmodle = 'solver'", "[run] has no entry 'modle'; did you mean model"),
        ("[run]\nscene = 'x'", "[run] has no entry 'scene'"),
        ("[[garments]]\nmateriel = 'silk'", "[[garments]] has no entry 'materiel'; did you mean material"),
        ("[scen]\nframes = 3", "no section 'scen'; did you mean scene"),
        ("[garments]\ngarment = 'dress'", "written [[garments]]"),
        ("scene = 3", "section [scene] must hold entries"),
        ("garments = ['dress']", "section [[garments]] must hold entries"),
        ("format_version = 2", "format version 2; this version reads 1"),
        ("[scene]\nframes = '60'", "frames must be a whole number, 1 or more, not '60'"),
        ("[scene]\nfps = true", "must be a number from 1 to 1,000, not True"),
        ("[run]\ncontact = 'on'", "true or false, not 'on'"),
        ("[run]\nrefine = -1", "refine must be a whole number from 0 to 10,000, not -1"),
        ("[run]\npasses = 0", "passes must be a whole number from 1 to 1,000, not 0"),
        ("[run]\ndevice = 'gpu'", "no device 'gpu'"),
        ("[run]\nfirst_frame = 'setled'", "did you mean settled"),
        ("[run]\nprecision = 'float16'", "no precision 'float16'"),
        ("[run]\nmodel = 3", "model must be a name"),
        ("[scene]\nframes = 3\nframes = 4", "cannot be read as TOML"),
        ("\x00", "cannot be read as TOML"),
    ],
)
def test_what_a_scene_file_cannot_hold_is_refused(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        Run.open(file)
    assert str(refused.value).startswith(str(file))
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_absent_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.toml"):
        Run.open(tmp_path / "absent.toml")
    (tmp_path / "walk.npz").write_bytes(b"PK\x03\x04\xff\xfe")
    with pytest.raises(InputError, match="cannot be read as TOML"):
        Run.open(tmp_path / "walk.npz")


def test_loaded_objects_cannot_be_written(tmp_path: Path) -> None:
    cloth = Material.isotropic(0.2, 2e4, 4e4, 3e-5)
    for scene, says in (
        (Run(body=load_body("woman")), "The body woman is a loaded object"),
        (Run(motion=load_motion("dance")), "The motion dance is a loaded object"),
        (Run((WornGarment(material=cloth),)), "The material .* is a loaded object"),
    ):
        with pytest.raises(InputError, match=says):
            scene.save(tmp_path / "scene.toml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("asked", "first"),
    [
        ({"refine": 0}, OneLongStep),
        ({"refine": 5}, Settled),
        ({"refine": 0, "first_frame": "settled"}, Settled),
        ({"refine": 5, "first_frame": "long_step"}, OneLongStep),
        ({"model": "solver", "refine": 0}, Settled),
        ({"model": "solver", "first_frame": "long_step"}, OneLongStep),
    ],
)
def test_the_first_frame_left_open_is_settled_where_the_solver_runs(asked: dict[str, Any], first: type) -> None:
    simulator = simulator_of(Run(**{"model": "pb4u-small", "device": "cpu", **asked}))
    assert isinstance(simulator, StepwiseSimulator)
    assert isinstance(simulator.first_frame, first)


def test_a_model_with_a_start_of_its_own_takes_no_other() -> None:
    with pytest.raises(InputError, match="skinning starts in a way of its own"):
        simulator_of(Run(model="skinning", first_frame="settled"))


def test_self_contact_is_refused_where_it_cannot_be() -> None:
    with pytest.raises(InputError, match=r"^skinning .*--self-contact"):
        simulator_of(Run(model="skinning", self_contact=True))
    assert simulator_of(Run(model="skinning", self_contact=False)).name == "skinning"
    with pytest.raises(InputError, match=r"^self_contact "):
        Run(self_contact="on")


@pytest.mark.parametrize("steps", [0, 1_000_000])
def test_a_senseless_number_of_propagation_steps_is_refused_before_a_scene_is_assembled(steps: int) -> None:
    with pytest.raises(InputError, match=f"from 1 to 500, not {steps}"):
        simulator_of(Run(model="pb4u-small", propagation_steps=steps))


@pytest.mark.parametrize(("refine", "passes"), [(0, None), (5, None), (5, 2)])
def test_the_simulator_is_as_described(refine: int, passes: int | None) -> None:
    run = Run(model="pb4u-small", refine=refine, passes=passes, propagation_steps=4, device="cpu")
    settings = simulator_of(run).settings()
    own = simulator_of(Run(model="pb4u-small", refine=0)).settings()["passes"]
    assert settings["refine"] == refine
    assert settings["passes"] == (passes or (1 if refine else own))
