"""`view`: what it serves, to whom, and what it refuses."""

from __future__ import annotations

import re
import socket
import sys
import urllib.request
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.viewer.clips import trajectory


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return trajectory(3).save(tmp_path / "walk.npz")


def test_it_serves_the_page_on_this_machine_only(
    pb4u: Callable, saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    seen: dict[str, object] = {}

    def interrupted(_: float) -> None:
        """Stands where the verb waits for Ctrl-C: look at the page, then press it."""
        seen["said"] = capsys.readouterr().out
        url = re.search(r"http://localhost:(\d+)", str(seen["said"]))
        assert url is not None
        with urllib.request.urlopen(url[0], timeout=10) as answer:
            seen["page"] = answer.read()
        port = int(url[1])
        with socket.socket() as outside, pytest.raises(OSError, match=r"refused|unreachable"):
            outside.connect((_address_of_this_machine(), port))
        raise KeyboardInterrupt

    monkeypatch.setattr("pb4u.cli.trajectory_verbs.wait", interrupted)
    ended = pb4u("view", saved, saved, "--port", 0, "--no-browser")
    assert ended.code == 0, ended.err
    assert b"<html" in bytes(seen["page"])  # type: ignore[call-overload]
    # The library it stands on says nothing of its own.
    assert str(seen["said"]).count("\n") == 1


def _address_of_this_machine() -> str:
    """An address that others would use; another loopback address where there is no network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.2"


def test_a_taken_port_is_named(pb4u: Callable, saved: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        ended = pb4u("view", saved, "--port", port, "--no-browser")
    assert ended.code == 1
    assert f"Cannot listen on port {port} of 127.0.0.1" in ended.err
    assert "choose another with --port" in ended.err


def test_a_missing_extra_is_named(pb4u: Callable, saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    ended = pb4u("view", saved, "--no-browser")
    assert ended.code == 1
    assert ended.err.strip() == 'pb4u: The studio needs the "view" extra: pip install "pb4u[view]".'


def test_what_cannot_be_shown_is_refused_before_anything_is_served(pb4u: Callable, saved: Path) -> None:
    cut, newer, lost = (saved.with_name(name) for name in ("cut.npz", "newer.npz", "lost.npz"))
    cut.write_bytes(saved.read_bytes()[:2000])
    with zipfile.ZipFile(saved) as old, zipfile.ZipFile(newer, "w") as new:
        for entry in old.namelist():
            if entry != "format_version.npy":
                new.writestr(entry, old.read(entry))
        with new.open("format_version.npy", "w") as member:
            np.lib.format.write_array(member, np.array(99))
    trajectory(2, lost=(0, 1)).save(lost)
    for arguments, says in (
        ((cut,), "cannot be read as a trajectory"),
        ((newer,), "has trajectory format 99"),
        ((saved, lost), "No frame of the trajectory is finite"),
        ((saved.with_name("absent.npz"),), "no trajectory file"),
        ((saved, "--port", 99999), "from 0 to 65535"),
        ((saved, "--out", saved.with_name("absent")), "does not exist; make it first"),
    ):
        ended = pb4u("view", *arguments, "--no-browser")
        assert ended.code == 1, arguments
        assert says in ended.err
        assert ended.err.count("\n") == 1
