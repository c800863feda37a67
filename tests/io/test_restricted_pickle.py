import collections
import os
import pickle
import sys
import types
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import torch

from pb4u.errors import InputError
from pb4u.io.restricted_pickle import load_pickle, load_tensors


class Calls:
    """Pickles into a call of `function` with `arguments`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return self.function, self.arguments


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_data_survives(tmp_path: Path, protocol: int) -> None:
    shared = np.arange(12.0).reshape(3, 4)
    data = {
        "poses": shared,
        "again": shared,
        "fortran": np.asfortranarray(np.arange(6, dtype=np.int32).reshape(2, 3)),
        "transposed": np.arange(24).reshape(2, 3, 4).transpose(2, 0, 1),
        "big_endian": np.arange(4, dtype=">f4"),
        "text": np.array(["a", "bcd"]),
        "objects": np.array([np.zeros(2), "x", None], dtype=object),
        "empty": np.zeros((0, 3)),
        "scalar": np.float32(1.5),
        "nested": [1, (2.0, {3}), collections.OrderedDict(a=b"\x00\xff")],
        "sparse": scipy.sparse.csc_matrix(np.eye(3)),
        "sparse_array": scipy.sparse.csc_array(np.eye(2)),
    }
    path = tmp_path / "data.pkl"
    path.write_bytes(pickle.dumps(data, protocol=protocol))
    read = load_pickle(path)
    for key in ("poses", "again", "fortran", "transposed", "big_endian", "text", "empty"):
        np.testing.assert_array_equal(read[key], data[key])
        assert read[key].dtype.newbyteorder("=") == data[key].dtype.newbyteorder("=")
    assert read["poses"] is read["again"]
    np.testing.assert_array_equal(read["objects"][0], np.zeros(2))
    assert read["objects"][1:].tolist() == ["x", None]
    assert read["scalar"] == 1.5
    assert read["nested"] == data["nested"]
    assert type(read["nested"][2]) is collections.OrderedDict
    for key in ("sparse", "sparse_array"):
        np.testing.assert_array_equal(read[key].toarray(), data[key].toarray())


def test_a_pickle_of_python_2_is_read_as_latin_1(tmp_path: Path) -> None:
    # What Python 2 writes for {"x": numpy.array([1.5])} with protocol 2: text is bytes, module names are the old ones.
    raw = (
        b"\x80\x02}q\x00U\x01xq\x01cnumpy.core.multiarray\n_reconstruct\nq\x02cnumpy\nndarray\nq\x03K\x00\x85U\x01b\x87Rq\x04"
        b"(K\x01K\x01\x85cnumpy\ndtype\nq\x05U\x02f8K\x00K\x01\x87Rq\x06(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
        b"\x89U\x08\x00\x00\x00\x00\x00\x00\xf8?tbs."
    )
    path = tmp_path / "old.pkl"
    path.write_bytes(raw)
    np.testing.assert_array_equal(load_pickle(path)["x"], [1.5])


def test_chumpy_objects_become_arrays_without_chumpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chumpy, ch = types.ModuleType("chumpy"), types.ModuleType("chumpy.ch")
    reordering = types.ModuleType("chumpy.reordering")
    ch.Ch = type("Ch", (), {"__module__": "chumpy.ch"})  # type: ignore[attr-defined]
    reordering.Select = type("Select", (ch.Ch,), {"__module__": "chumpy.reordering"})  # type: ignore[attr-defined]
    for module in (chumpy, ch, reordering):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    leaf = ch.Ch()
    leaf.x, leaf._dirty_vars = np.arange(12.0).reshape(3, 4), {"x"}
    selection = reordering.Select()
    selection.a, selection.idxs, selection.preferred_shape = leaf, np.array([0, 1, 4, 5]), (2, 2)
    files = []
    for protocol in (0, 2):
        files.append(tmp_path / f"{protocol}.pkl")
        files[-1].write_bytes(pickle.dumps({"v": leaf, "s": selection}, protocol=protocol))
    for module in (chumpy, ch, reordering):
        monkeypatch.delitem(sys.modules, module.__name__)
    for path in files:
        read = load_pickle(path)
        np.testing.assert_array_equal(read["v"], np.arange(12.0).reshape(3, 4))
        np.testing.assert_array_equal(read["s"], [[0, 1], [4, 5]])
    assert "chumpy" not in sys.modules


def test_a_malicious_pickle_is_refused_and_did_not_run(tmp_path: Path) -> None:
    proof = tmp_path / "proof"
    source = f"open({str(proof)!r}, 'w').close()"
    attacks = {
        "system": Calls(os.system, f"touch {proof}"),
        "eval": Calls(eval, source),
        "exec": Calls(exec, source),
        "open": Calls(open, str(proof), "w"),
        "getattr": Calls(getattr, 1, "real"),
        "import": Calls(__import__, "os"),
        "save": Calls(np.save, str(proof), np.zeros(1)),
        "load": Calls(np.load, str(proof)),
        "nested": {"poses": [np.zeros(3), Calls(os.system, f"touch {proof}")]},
    }
    for name, attack in attacks.items():
        path = tmp_path / f"{name}.pkl"
        path.write_bytes(pickle.dumps(attack))
        with pytest.raises(InputError, match="nothing in the file was run"):
            load_pickle(path)
        assert not list(tmp_path.glob("proof*")), name
    for name in ("system", "eval", "nested"):
        pickle.loads((tmp_path / f"{name}.pkl").read_bytes())
        assert proof.exists(), "the attack must work where pickles are trusted, or this test proves nothing"
        proof.unlink()


@pytest.mark.parametrize(
    "raw",
    [
        b"cnumpy\nndarray\n(K\x08tR.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cbuiltins\nlist\nK\x00U\x01btR.",
        b"cnumpy\nsave\n.",
        b"cnumpy.f2py\nrun_main\n.",
        b"cscipy.sparse\nload_npz\n.",
        b"ccopyreg\n_reconstructor\n(cbuiltins\nset\ncbuiltins\nobject\nNtR.",
        b"c_codecs\nencode\n(X\x01\x00\x00\x00aX\x05\x00\x00\x00rot13tR.",
        b"Pelsewhere\n.",
        b"cnumpy\ndtype\n(X\x03\x00\x00\x00V16I00\nI01\ntR.",
        b"cbuiltins\nobject\n)\x81.",
    ],
)
def test_misuse_of_known_names_is_refused(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "misuse.pkl"
    path.write_bytes(raw)
    with pytest.raises(InputError, match=r"misuse\.pkl"):
        load_pickle(path)


def test_forged_array_sizes_do_not_read_foreign_memory(tmp_path: Path) -> None:
    raw = pickle.dumps(np.arange(3, dtype=np.int8), protocol=2)
    forged = raw.replace(b"K\x03\x85", b"K\x7f\x85", 1)
    assert forged != raw
    path = tmp_path / "forged.pkl"
    path.write_bytes(forged)
    with pytest.raises(InputError, match="not a complete pickle"):
        load_pickle(path)


@pytest.mark.parametrize("cut", [0, 1, 10, 60])
def test_a_cut_or_foreign_file_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "cut.pkl"
    path.write_bytes(pickle.dumps({"poses": np.zeros((4, 3))})[:cut])
    with pytest.raises(InputError, match=r"cut\.pkl"):
        load_pickle(path)


def test_the_class_that_was_asked_for_is_named(tmp_path: Path) -> None:
    path = tmp_path / "network.pkl"
    path.write_bytes(pickle.dumps(Path("x")))
    with pytest.raises(InputError, match="pathlib"):
        load_pickle(path)


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_pickle(tmp_path / "absent.pkl")


def test_a_torch_archive_is_read(tmp_path: Path) -> None:
    shared = torch.arange(12.0).reshape(3, 4)
    content = {
        "weights": collections.OrderedDict(a=shared, b=shared.T, c=torch.nn.Parameter(shared[1:, 2:])),
        "config": {"model": {"width": 8, "name": None}, "rate": 1e-4},
    }
    path = tmp_path / "model.pth"
    torch.save(content, path)
    read = load_tensors(path)
    torch.testing.assert_close(read["weights"]["b"], shared.T)
    torch.testing.assert_close(read["weights"]["c"].detach(), shared[1:, 2:])
    assert read["config"] == content["config"]


def test_a_torch_archive_that_asks_for_code_is_refused_and_did_not_run(tmp_path: Path) -> None:
    proof = tmp_path / "proof"
    path = tmp_path / "model.pth"
    for attack in (Calls(os.system, f"touch {proof}"), Calls(eval, f"open({str(proof)!r}, 'w').close()")):
        torch.save({"weights": torch.zeros(2), "config": attack}, path)
        with pytest.raises(InputError, match="nothing in the file was run"):
            load_tensors(path)
        assert not proof.exists()
    torch.load(path, weights_only=False)
    assert proof.exists(), "the attack must work where pickles are trusted, or this test proves nothing"


def test_a_torch_archive_that_is_damaged_or_forged_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.pth"
    torch.save({"weights": torch.zeros(1000)}, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"model\.pth"):
        load_tensors(path)

    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("m/data.pkl", pickle.dumps({}))
        archive.writestr("m/data/0", bytes(10_000_000))
    with pytest.raises(InputError, match="compressed"):
        load_tensors(path)

    with zipfile.ZipFile(path, "w") as archive:
        # A tensor of 1000 x 1000 out of a storage of one number.
        archive.writestr(
            "m/data.pkl",
            b"ctorch._utils\n_rebuild_tensor_v2\n((S'storage'\nctorch\nFloatStorage\nS'0'\nS'cpu'\nI1\ntQI0\n(I1000\n"
            b"I1000\nt(I0\nI0\ntI00\nNtR.",
        )
        archive.writestr("m/data/0", bytes(4))
    with pytest.raises(InputError, match=r"model\.pth"):
        load_tensors(path)

    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "not a model")
    with pytest.raises(InputError, match="not a complete file that torch"):
        load_tensors(path)
