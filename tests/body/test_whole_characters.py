"""Six characters as programs and artists leave them: what of each is the body, and what is said of the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.body import characters
from tests.body.characters import GltfWriter, write_woman
from tests.body.test_skin_pieces import cubes, shell, skirt, sphere, woman

from pb4u.body.character import Character
from pb4u.body.contact_region import share_out_of_contact
from pb4u.body.library import load_body
from pb4u.errors import InputWarning
from pb4u.geometry.triangle_mesh import vertex_normals

Extra = tuple[str, str, np.ndarray, np.ndarray, str | None]
_MIXAMO = {
    "root": "Hips", "spine05": "Spine", "spine03": "Spine1", "spine01": "Spine2", "neck01": "Neck", "head": "Head",
    "clavicle": "Shoulder", "upperarm01": "Arm", "lowerarm01": "ForeArm", "wrist": "Hand", "upperleg01": "UpLeg",
    "lowerleg01": "Leg", "foot": "Foot", "toe1-1": "ToeBase",
}  # fmt: skip


def mixamo(bone: str) -> str:
    stem, _, side = bone.partition(".")
    return f"mixamorig:{ {'L': 'Left', 'R': 'Right', '': ''}[side] }{_MIXAMO.get(stem, stem + '_twist')}"


def coat() -> tuple[np.ndarray, np.ndarray]:
    """From the neck to the shins, closed over the shoulders."""
    body = woman()
    normals = vertex_normals(torch.from_numpy(body.vertices), torch.from_numpy(body.faces)).numpy()
    kept = (body.vertices[:, 1] > 0.3) & (body.vertices[:, 1] < 1.45) & (np.abs(body.vertices[:, 0]) < 0.35)
    return body.vertices + 0.02 * normals, body.faces[kept[body.faces].all(axis=1)]


def sword() -> tuple[np.ndarray, np.ndarray]:
    hand = woman().skeleton.joints[woman().skeleton.index("wrist.R")]
    places, faces = sphere(0.0, 0.0, 0.0, 1.0)
    return places * [0.02, 0.03, 0.5] + hand + [0.0, 0.0, 0.4], faces


def vrm(writer: GltfWriter) -> None:
    skeleton = woman().skeleton
    bones = {"hips": "root", "spine": "spine04", "chest": "spine02", "neck": "neck01", "head": "head"}
    for side, letter in (("left", "L"), ("right", "R")):
        limbs = {"UpperLeg": "upperleg01", "LowerLeg": "lowerleg01", "Foot": "foot", "UpperArm": "upperarm01"}
        limbs |= {"LowerArm": "lowerarm01", "Hand": "wrist"}
        bones |= {side + name: f"{bone}.{letter}" for name, bone in limbs.items()}
    nodes = {name: {"node": 1 + skeleton.index(bone)} for name, bone in bones.items()}
    writer.document["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": nodes}}}


def hung_on_a_bone(writer: GltfWriter) -> None:
    """The last mesh as props mostly are: below the bone of a hand, without a skin."""
    node = len(writer.document["nodes"]) - 1
    writer.document["nodes"][0]["children"].remove(node)
    del writer.document["nodes"][node]["skin"]
    writer.document["nodes"][1 + woman().skeleton.index("wrist.R")].setdefault("children", []).append(node)


def tops(over: float = 0.015) -> Extra:
    return ("Tops", "Ch01_body", *shell(0.86, 1.44, 0.33, over), None)


CHARACTERS: dict[str, tuple[dict, list[str]]] = {
    "MakeHuman with its helpers": (
        {
            "extra": [
                ("Base", "Skin", *cubes(), "root"), ("Base", "Skin", *skirt(), "root"),
                ("Base", "Skin", *shell(0.05, 1.3, 0.22, 0.006), None),
            ],
        },
        ["Base"],
    ),
    "Mixamo with clothes over a whole skin": (
        {
            "rename": mixamo,
            "extra": [tops(), ("Bottoms", "Bottoms", *shell(0.08, 0.97, 0.3, 0.01), None),
                      ("Shoes", "Shoes", *shell(-1.0, 0.12, 2.0, 0.012), None)],
        },
        ["Ch01_body", "Bottoms", "Shoes"],
    ),
    "VRM with hair and a coat": (
        {"rename": lambda name: f"J_Bip_{len(name)}_{name[0]}", "change": vrm,
         "extra": [("Coat", "N00_007_01_Tops_01_CLOTH", *coat(), None),
                   ("Hair001", "N00_000_Hair_00_HAIR", *shell(1.5, 3.0, 2.0, 0.03), "head")]},
        ["N00_007_01_Tops_01_CLOTH", "N00_000_Hair_00_HAIR"],
    ),
    "several skins": ({"split": 3}, []),
    "centimetres under a scale of 0.01": ({"unit": 0.01}, []),
    "a prop in the hand": ({"extra": [("Sword", "Steel", *sword(), "wrist.R")], "change": hung_on_a_bone}, ["Sword"]),
}  # fmt: skip


@pytest.mark.parametrize("case", CHARACTERS)
def test_the_body_is_taken_and_the_rest_is_named(tmp_path: Path, case: str) -> None:
    options, left = CHARACTERS[case]
    suffix = ".vrm" if case.startswith("VRM") else ".glb"
    body = load_body(write_woman(tmp_path / f"a{suffix}", clips=(), **options))
    assert isinstance(body, Character)
    assert body.is_human
    assert body.vertices[:, 1].max() == pytest.approx(woman().height, rel=0.02)
    # Seams of a body in three parts double some of its vertices, or close a hole.
    assert len(body.faces) == pytest.approx(len(woman().faces), rel=0.02)
    first = body.notes[0]
    taken, _, rest = first.partition("; left out of the body: ")
    assert taken.startswith(f"a{suffix}: the body is Skin")
    assert all(name in rest for name in left), first
    out = share_out_of_contact(body.vertices, body.faces, body.contact)
    assert 0.02 < out < 0.1
    assert any(f"{100 * out:.0f} % of its skin" in note for note in body.notes)


def cut_under_clothes(path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A character whose skin is there only where its clothes leave it bare, as many of Mixamo's are."""
    body = woman()
    trunk = (body.vertices[:, 1] > 0.88) & (body.vertices[:, 1] < 1.42) & (np.abs(body.vertices[:, 0]) < 0.3)
    seen = replace(body, faces=body.faces[~trunk[body.faces].any(axis=1)])
    load: Callable = load_body
    monkeypatch.setattr(characters, "load_body", lambda name: seen if name == "woman" else load(name))
    return write_woman(path, clips=(), rename=mixamo, extra=[("Tops", "Tops", *shell(0.84, 1.46, 0.36, 0.006), None)])


def test_skin_that_is_cut_away_under_clothes_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = cut_under_clothes(tmp_path / "a.glb", monkeypatch)
    with pytest.warns(InputWarning, match=r"hole of \d\d cm, .* cover it: --body-parts Skin,Tops\."):
        load_body(path)
    body = load_body(path, parts=("Skin", "Tops"))
    chest = (body.vertices[:, 1] > 1.0) & (body.vertices[:, 1] < 1.3) & (np.abs(body.vertices[:, 0]) < 0.1)
    assert (chest & body.contact).sum() > 300
