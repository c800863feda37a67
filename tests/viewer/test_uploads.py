"""Files that a page hands over: which are kept, under what names, how large, and for how long."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
from tests.garment.cloth_shapes import quad_tube, saved

from pb4u.errors import InputError
from pb4u.run import Run, WornGarment
from pb4u.viewer import uploads as module
from pb4u.viewer.export_panel import pack_scene
from pb4u.viewer.live_simulation import require_offered
from pb4u.viewer.uploads import KINDS, Uploads, bound_uploads


@pytest.mark.parametrize(
    ("given", "kept"),
    [("shirt.obj", "shirt.obj"), ("../../etc/my shirt.OBJ", "my_shirt.OBJ"), ("C:\\x\\a&b.ply", "a_b.ply")],
)
def test_a_file_stays_in_the_folder_of_its_window_and_goes_with_it(given: str, kept: str) -> None:
    files = Uploads()
    assert files.keep("garment", given, b"v 0 0 0") == kept
    path = files.find("garment", kept)
    assert path == files.folder / "garment" / kept
    assert path.read_bytes() == b"v 0 0 0"
    assert files.names("garment") == (kept,)
    assert files.find("body", kept) is None
    files.close()
    assert not files.folder.exists()


def test_what_is_read_beside_a_file_cannot_be_chosen() -> None:
    files = Uploads()
    for name in ("07.asf", "07_02.amc"):
        files.keep("motion", name, b"x")
    assert files.names("motion") == ("07_02.amc",)
    assert {path.name for path in files.files} == {"07.asf", "07_02.amc"}
    files.close()


def test_what_is_no_such_file_or_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    files = Uploads()
    for kind, name in (("garment", "a.npz"), ("motion", "a.obj"), ("garment", ".obj"), ("body", "a.exe")):
        with pytest.raises(InputError, match=f"as a {kind} file"):
            files.keep(kind, name, b"x")
    monkeypatch.setattr(module, "MOST_BYTES", 2**20)
    monkeypatch.setattr(module, "MOST_BYTES_TOGETHER", 2**20 + 100)
    with pytest.raises(InputError, match=r"a\.obj .*2 MB.* 1 MB"):
        files.keep("garment", "a.obj", b"x" * 2**21)
    files.keep("garment", "a.obj", b"x" * 2**20)
    with pytest.raises(InputError, match="exceed 1 MB; reload the page"):
        files.keep("garment", "b.obj", b"x" * 200)
    assert [path.name for path in files.files] == ["a.obj"]
    assert set(KINDS) == {"garment", "body", "motion"}
    files.close()


def test_what_is_too_large_is_dropped_while_it_arrives() -> None:
    pytest.importorskip("viser", reason='the studio needs the "view" extra')
    from viser import _messages

    gui, said = MagicMock(), []
    gui._current_file_upload_states = {}
    bound_uploads(gui, said.append)
    listeners = {call.args[0]: call.args[1] for call in gui._websock_interface.register_handler.call_args_list}
    for announced, arrived, kept in (
        (10, 10, True),
        (module.MOST_BYTES + 1, 0, False),
        (10, module.MOST_BYTES + 1, False),
    ):
        state = {"filename": "a.obj", "total_bytes": announced, "transferred_bytes": arrived}
        gui._current_file_upload_states["one"] = state
        for kind in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
            listeners[kind](0, SimpleNamespace(transfer_uuid="one"))
        assert ("one" in gui._current_file_upload_states) == kept
    assert len(said) == 2
    assert all("at most 256 MB are allowed" in sentence for sentence in said)


def test_a_page_may_name_the_files_it_handed_over_and_no_others(tmp_path: Path) -> None:
    files = Uploads()
    files.keep("garment", "tube.obj", saved(tmp_path, quad_tube()).read_bytes())
    tube = files.find("garment", "tube.obj")
    assert tube is not None
    run = Run((WornGarment(tube),), frames=2, model="skinning")
    require_offered(run, files.files)
    with pytest.raises(InputError, match="There is no garment"):
        require_offered(run)
    other = Run((WornGarment(tmp_path / "tube.obj"),), model="skinning")
    with pytest.raises(InputError, match="There is no garment"):
        require_offered(other, files.files)
    files.close()


def test_a_scene_is_packed_with_its_files_and_opens_elsewhere(tmp_path: Path) -> None:
    files = Uploads()
    files.keep("garment", "tube.obj", b"v 0 0 0")
    files.keep("motion", "07.ASF", b"a")
    files.keep("motion", "07_02.AMC", b"b")
    files.keep("motion", "other.bvh", b"c")
    worn = (
        WornGarment(files.find("garment", "tube.obj"), "silk"),
        WornGarment("skirt", triangles=900),
    )
    run = Run(worn, motion=files.find("motion", "07_02.AMC"), frames=7, model="solver")
    name, content = pack_scene(run, files.folder)
    files.close()
    assert name == "scene.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")) == [
        "garment/tube.obj",
        "motion/07.ASF",
        "motion/07_02.AMC",
        "scene.toml",
    ]
    opened = Run.open(tmp_path / "scene.toml")
    assert opened.motion == tmp_path / "motion" / "07_02.AMC"
    assert [each.garment for each in opened.garments] == [tmp_path / "garment" / "tube.obj", "skirt"]
    assert (opened.model, opened.frames) == ("solver", 7)
    assert pack_scene(Run(), tmp_path)[0] == "scene.toml"
