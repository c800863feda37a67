from pathlib import Path

import numpy as np
import pytest

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import body_names, load_body
from pb4u.body.sequence_files import write_vertex_sequence
from pb4u.errors import InputError


@pytest.mark.parametrize("name", body_names())
def test_built_in_bodies_load_by_name(name: str) -> None:
    body = load_body(name, {"weight": 0.7})
    assert isinstance(body, ShapedBody)
    assert (body.name, body.family, body.shape["weight"]) == (name, "anny", 0.7)


def test_a_baked_file_is_a_body_too() -> None:
    body = load_body(Path(__file__).parents[2] / "src/pb4u/body/data/man.npz")
    assert isinstance(body, ShapedBody)
    assert body.height == pytest.approx(1.908, abs=1e-3)


@pytest.mark.parametrize(("name", "near"), [("womn", "did you mean woman"), ("Man", "man"), ("xyzzy", "woman, man")])
def test_unknown_names_list_near_ones(name: str, near: str) -> None:
    with pytest.raises(InputError, match=near):
        load_body(name)


def test_an_absent_file_is_named() -> None:
    with pytest.raises(InputError, match=r"nowhere/body\.npz"):
        load_body("nowhere/body.npz")


def test_unknown_kinds_of_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "body.fbx").write_bytes(b"Kaydara")
    with pytest.raises(InputError, match="it reads"):
        load_body(tmp_path / "body.fbx")
    (tmp_path / "body.npz").write_bytes(b"not a zip")
    with pytest.raises(InputError, match="not a readable"):
        load_body(tmp_path / "body.npz")


def test_shape_parameters_are_validated(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'"tallness".*height'):
        load_body("woman", {"tallness": 0.5})
    with pytest.raises(InputError, match="give 0 to 1"):
        load_body("woman", {"weight": -0.1})
    vertices = np.random.default_rng(0).normal(size=(2, 8, 3))
    write_vertex_sequence(tmp_path / "moving.npz", vertices, np.zeros((1, 3), dtype=np.int64), 30.0)
    with pytest.raises(InputError, match="without shape parameters"):
        load_body(tmp_path / "moving.npz", {"height": 0.5})


def test_a_body_whose_extra_is_not_installed_is_not_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    for there, names in ((None, "woman, man"), (object(), "woman, man, anny")):
        monkeypatch.setattr("pb4u.body.library.find_spec", lambda _, there=there: there)
        with pytest.raises(InputError, match=f"did you mean woman\\? There are {names}\\."):
            load_body("womn")


@pytest.mark.parametrize("height", [1.9, 190.0])
def test_a_height_in_metres_is_refused_with_the_share_that_it_is(height: float) -> None:
    with pytest.raises(InputError, match=r"1\.90 m.*height=") as refused:
        load_body("woman", {"height": height, "weight": 0.3})
    share = float(str(refused.value).rstrip(".").rpartition("=")[2])
    body = load_body("woman", {"height": share, "weight": 0.3})
    assert isinstance(body, ShapedBody)
    assert body.height == pytest.approx(1.9, abs=0.01)
    with pytest.raises(InputError, match=r"1\.22 to 2\.31 m"):
        load_body("woman", {"height": 2.9})
    with pytest.raises(InputError, match="is 5; give 0 to 1"):
        load_body("woman", {"height": 5.0})
