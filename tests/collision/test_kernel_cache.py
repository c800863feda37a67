"""Machine code on disk is that of the kernels as they are, in whatever file, at whatever time they were written."""

import importlib.util
import os
import sys

import numba
import pytest

from pb4u.collision import kernel_cache
from pb4u.collision.kernel_cache import is_trusted, kernel_folder

HEADER = "from pb4u.collision.jit import compiled\n"
INNER = HEADER + "@compiled\ndef inner(x):\n    return x + {added}\n"
OUTER = HEADER + "from callee import inner\nFACTOR = {factor}\n@compiled\ndef outer(x):\n    return FACTOR * inner(x)\n"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))


def _outer(folder, monkeypatch, added=1, factor=10):
    """`outer` of a caller's file, whose callee has a file of its own, as a new process would import them."""
    folder.mkdir(exist_ok=True)
    (folder / "callee.py").write_text(INNER.format(added=added))
    (folder / "caller.py").write_text(OUTER.format(factor=factor))
    for name in ("callee", "caller"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
    return module.outer


def _hits(kernel):
    return sum(kernel.stats.cache_hits.values())


def test_a_kernel_is_kept_once_it_is_compiled(tmp_path, monkeypatch):
    kernel = _outer(tmp_path, monkeypatch)
    assert not kernel._cache.is_kept
    kernel(1)
    assert kernel._cache.is_kept


def test_an_edited_callee_recompiles_its_callers(tmp_path, monkeypatch):
    assert _outer(tmp_path, monkeypatch)(1) == 20
    edited = _outer(tmp_path, monkeypatch, added=100)
    assert edited(1) == 1010
    assert _hits(edited) == 0


def test_an_edited_constant_recompiles_its_kernel(tmp_path, monkeypatch):
    assert _outer(tmp_path, monkeypatch)(1) == 20
    assert _outer(tmp_path, monkeypatch, factor=3)(1) == 6


def test_a_copied_tree_of_other_times_compiles_nothing(tmp_path, monkeypatch):
    _outer(tmp_path / "a", monkeypatch)(1)
    copied = _outer(tmp_path / "b", monkeypatch)
    for path in (tmp_path / "b").iterdir():
        os.utime(path, (1, 1))
    assert copied(1) == 20
    assert _hits(copied) == 1


def test_code_of_a_folder_that_others_may_write_is_not_loaded(tmp_path, monkeypatch):
    _outer(tmp_path, monkeypatch)(1)
    folder = kernel_folder()
    assert folder == tmp_path / "cache" / "kernels"
    assert is_trusted(folder)
    folder.chmod(0o777)
    assert not is_trusted(folder)
    again = _outer(tmp_path, monkeypatch)
    assert again(1) == 20
    assert _hits(again) == 0


def test_a_filled_folder_that_cannot_be_written_is_read(tmp_path, monkeypatch):
    _outer(tmp_path, monkeypatch)(1)
    monkeypatch.setattr(kernel_cache.os, "access", lambda *_: False)
    read = _outer(tmp_path, monkeypatch)
    assert read(1) == 20
    assert _hits(read) == 1


def test_what_cannot_be_kept_is_said_once_with_the_way_out(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr(kernel_cache, "is_trusted", lambda _: False)
    monkeypatch.setattr(kernel_cache, "warn", said.append)
    kernel_cache._say_where_kernels_could_be_kept.cache_clear()
    assert _outer(tmp_path, monkeypatch)(1) == 20
    (sentence,) = said
    assert "NUMBA_CACHE_DIR" in sentence
    kernel_cache._say_where_kernels_could_be_kept.cache_clear()


def test_an_edited_intrinsic_recompiles_its_callers(tmp_path, monkeypatch):
    made = "from numba.extending import intrinsic\nfrom numba.core import types\n"
    made += HEADER + "@intrinsic\ndef inner(_, x):\n    def make(context, builder, signature, arguments):\n"
    made += "        return context.get_constant(types.int64, {added})\n    return types.int64(x), make\n"
    monkeypatch.setattr(f"{__name__}.INNER", made)
    assert _outer(tmp_path, monkeypatch)(1) == 10
    assert _outer(tmp_path, monkeypatch, added=100)(1) == 1000


def test_what_stands_beside_an_intrinsic_is_part_of_the_name_of_its_callers(tmp_path, monkeypatch):
    made = "from numba.extending import intrinsic\nfrom numba.core import types\nBESIDE = {added}\n"
    made += "@intrinsic\ndef inner(_, x):\n    def make(context, builder, signature, arguments):\n"
    made += "        return context.get_constant(types.int64, BESIDE)\n    return types.int64(x), make\n"
    monkeypatch.setattr(f"{__name__}.INNER", made)
    assert _outer(tmp_path, monkeypatch)(1) == 10
    assert _outer(tmp_path, monkeypatch, added=100)(1) == 1000


def test_a_renamed_type_of_an_argument_recompiles_its_kernel(tmp_path, monkeypatch):
    pair = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    first: int\n" + HEADER
    pair += "@compiled\ndef inner(x: Pair):\n    return x.first + 1\nINPUT = Pair(1)\n"
    monkeypatch.setattr(f"{__name__}.OUTER", "from callee import INPUT, inner as outer\n")
    for name in ("Pair", "Couple"):
        monkeypatch.setattr(f"{__name__}.INNER", pair.replace("Pair", name))
        kernel = _outer(tmp_path, monkeypatch)
        assert kernel(sys.modules["callee"].INPUT) == 2
        assert _hits(kernel) == 0


def test_damaged_code_is_compiled_again_and_written_over(tmp_path, monkeypatch):
    _outer(tmp_path, monkeypatch)(1)
    for index in kernel_folder().glob("*.nbi"):
        index.write_bytes(index.read_bytes()[:-20])
    assert _outer(tmp_path, monkeypatch)(1) == 20
    again = _outer(tmp_path, monkeypatch)
    assert again(1) == 20
    assert _hits(again) == 1
