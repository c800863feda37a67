"""The wheel: what is in it, how large it is, and that it runs from an environment and a folder that know no clone.

The environment is new and holds the wheel alone. Its dependencies are those of the environment that the tests run in,
found through a path file: that they can be installed as the wheel declares them is not shown here, but by the release
workflow and by whoever installs it. That no module of the clone is used is shown.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

import pb4u

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
MOST_BYTES = 25_000_000


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the sdist, and the wheel built from it: what the sdist lacks, the wheel lacks."""
    for needed in ("build", "hatchling"):
        pytest.importorskip(needed, reason='needs the "test" extra')
    out = tmp_path_factory.mktemp("dist")
    call = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    ended = subprocess.run(call, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return out


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (found,) = built.glob("*.whl")
    return found


def test_bodies_weights_and_licences_are_inside(wheel: Path) -> None:
    assert wheel.name == f"pb4u-{pb4u.__version__}-py3-none-any.whl"
    assert wheel.stat().st_size < MOST_BYTES
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        record = next(name for name in names if name.endswith("METADATA"))
        metadata = Parser().parsestr(archive.read(record).decode())
    source = ROOT / "src"
    wanted = {
        str(file.relative_to(source)) for file in source.rglob("*") if file.is_file() and "__pycache__" not in str(file)
    }
    carried = {name for name in names if ".dist-info/" not in name}
    assert {name for name in wanted if not name.endswith((".pyc", ".nbi", ".nbc"))} == carried
    for part in ("body/data/woman.npz", "body/data/man.npz", "simulation/weights/pb4u-small.safetensors", "py.typed"):
        assert f"pb4u/{part}" in names
    folder = record.rpartition("/")[0]
    assert {f"{folder}/licenses/LICENSE", f"{folder}/licenses/NOTICE"} <= names
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Requires-Python"] == "<3.14,>=3.10"
    assert {"render", "view", "usd", "dataset", "ray", "all"} <= set(metadata.get_all("Provides-Extra"))


def test_the_sdist_builds_and_tests_itself_and_carries_no_training(built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    assert sdist.stat().st_size < 2 * MOST_BYTES
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "README.md",
        "LICENSE",
        "NOTICE",
        "CHANGELOG.md",
        "pyproject.toml",
        "constraints.txt",
        "mkdocs.yml",
    } <= names
    assert {".ci/run", "tests/conftest.py", "docs/index.md", "examples/00_simulate_and_save.py"} <= names
    assert not [name for name in names if "__pycache__" in name or name.endswith((".nbi", ".nbc"))]
    assert not [name for name in names if name.startswith(("build/", "dist/", ".venv/", "runs/"))]


def test_an_empty_environment_simulates_from_another_folder(wheel: Path, tmp_path: Path) -> None:
    home = tmp_path / "environment"
    venv.create(home, with_pip=False, symlinks=True)
    bin_ = home / ("Scripts" if os.name == "nt" else "bin")
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(home), "platbase": str(home)}))
    call = [sys.executable, "-m", "pip", "--python", str(bin_ / "python"), "install", "-q", "--no-deps", str(wheel)]
    ended = subprocess.run(call, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    # A folder named in a path file is looked in after the environment's own, and its path files are not read: an
    # editable install of the clone, which is one, stays unknown.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}

    def run(*command: str) -> str:
        ended = subprocess.run(command, cwd=elsewhere, env=environment, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    # The network is loaded from the wheel, and not run: the kernels of its steps would be compiled anew.
    program = "import pb4u; pb4u.load_simulator('pb4u-small'); print(pb4u.__file__, pb4u.__version__)"
    where = run(str(bin_ / "python"), "-c", program)
    assert where.split() == [str(packages / "pb4u" / "__init__.py"), pb4u.__version__]
    small = ("--triangles", "300", "--frames", "2", "--lead-in", "1", "--model", "skinning")
    run(str(bin_ / "pb4u"), "simulate", *small, "--out", "walk.npz", "--out", "walk.glb")
    assert {file.name for file in elsewhere.iterdir()} == {"walk.npz", "walk.glb"}


def test_the_changelog_dates_the_version_and_all_that_names_it_has_it() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    heading = f"## [{pb4u.__version__}] - 20"
    assert text.index("## [Unreleased]") < text.index(heading)
    manifest = (ROOT / "integrations" / "blender" / "blender_manifest.toml").read_text()
    assert f'\nversion = "{pb4u.__version__}"' in manifest
    date = text[text.index(heading) :].partition(" - ")[2][:10]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {pb4u.__version__}\ndate-released: {date}\n" in citation
    assert f"pb4u-{pb4u.__version__}.zip" in (ROOT / "docs" / "blender.md").read_text()
