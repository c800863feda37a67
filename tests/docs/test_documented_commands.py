"""Every command and snippet of the README and the documentation.

What stands in `console` blocks, and every Python snippet, is run, on meshes of a few hundred triangles:
`made_small` and `small_scenes` say how. What stands in `sh` blocks takes minutes, accelerators or absent files:
its verbs, flags and values are parsed, its scripts and extras queried, and it is not run, but for those of one page
(`test_walks.py`). Other files are read.
"""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer

import pb4u
from pb4u.cli.application import app
from pb4u.cli.main import main
from pb4u.dataset.jobs_file import read_jobs
from pb4u.garment.library import garment_names
from pb4u.io.toml_file import tomllib
from pb4u.pattern.files import read_pattern
from pb4u.run import Run

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", *sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md")))
_FENCE = re.compile(r"^```(?P<language>\w*)\n(?P<text>.*?)^```", re.MULTILINE | re.DOTALL)
SMALL = {"--triangles": "450", "--frames": "3", "--lead-in": "1"}


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}: {self.text.strip().splitlines()[0][:60]}"


def blocks(*languages: str) -> list[Block]:
    found = []
    for page in PAGES:
        for fence in _FENCE.finditer((ROOT / page).read_text()):
            if fence["language"] in languages:
                found.append(Block(page, fence["language"], fence["text"]))
    return found


def commands(block: Block) -> list[list[str]]:
    """Words of each command: joined where a line goes on, comments and prompts left out, `&&` and `;` taken apart."""
    text = re.sub(r"\\\n\s*", " ", block.text)
    settings: dict[str, str] = {}
    found = []
    for line in text.splitlines():
        line = line.removeprefix("$ ").strip()
        for name, value in settings.items():
            line = line.replace(f"${name}", value)
        if setting := re.fullmatch(r"([A-Z]+)=(.*)", line):
            settings[setting[1]] = shlex.split(setting[2])[0]
            continue
        for part in re.split(r"\s&&\s|;\s", line):
            if words := shlex.split(part, comments=True):
                found.append(words)
    return found


def test_there_is_something_to_test() -> None:
    assert len(blocks("console")) >= 7
    assert len(blocks("sh")) >= 10
    assert len(blocks("python")) >= 8
    assert all(block.language for page in PAGES[:1] for block in blocks("") if block.page == page)


@pytest.mark.parametrize("block", blocks("sh", "console", "bash"), ids=str)
def test_every_command_can_be_understood(block: Block) -> None:
    for words in commands(block):
        understood(words)


def understood(words: list[str]) -> None:
    """Refuse a verb, flag, value, script or extra that does not exist; programs of others are let by."""
    name = Path(words[0]).name
    if name in ("uvx", "pipx"):
        assert "pb4u" in words
        understood(words[words.index("pb4u") :])
    for word in words:
        if extras := re.search(r"(?:pb4u|\.whl|\.)\[([\w,]+)\]", word):
            known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
            assert set(extras[1].split(",")) <= set(known), word
    if name == "pb4u":
        command: Any = typer.main.get_command(app)
        rest, path = words[1:], ["pb4u"]
        while getattr(command, "commands", None) and rest and rest[0] in command.commands:
            command, rest, path = command.commands[rest[0]], rest[1:], [*path, rest[0]]
        assert len(path) > 1, f"no such verb: {' '.join(words)}"
        assert not [word for word in rest if word in ("|", ">", "..")], words
        command.make_context(" ".join(path), list(rest), resilient_parsing=False)
    elif name == "python" and len(words) > 1 and words[1].endswith(".py"):
        script = ROOT / words[1]
        assert script.is_file(), words[1]
        for flag in words[2:]:
            assert not flag.startswith("--") or flag.partition("=")[0] in script.read_text() + shared_flags(script), (
                flag
            )


def shared_flags(script: Path) -> str:
    """What the scripts beside it add to its flags."""
    return "".join(file.read_text() for file in script.parent.glob("*.py") if file.stem in script.read_text())


def test_what_does_not_exist_is_found() -> None:
    for wrong, why in (
        ("pb4u simulat", "no such verb"),
        ("pb4u simulate --garmet dress", "[Nn]o such option"),
        ("pb4u evaluate --workers two", "integer"),
        ("python tools/none.py", "none.py"),
    ):
        with pytest.raises(Exception, match=why):
            understood(wrong.split())
    with pytest.raises(AssertionError, match="viewer"):
        understood(["pip", "install", "pb4u[viewer]"])


def made_small(words: list[str], model: str = "skinning", sizes: dict[str, str] = SMALL) -> list[str]:
    """The same command on a small mesh for a few frames, by `model` unless it names one."""
    verb, rest = words[1], list(words[2:])
    if verb == "check" and has_built_in_garment(rest):
        return [*words, "--triangles", sizes["--triangles"]]
    if verb == "assets" and rest[:1] == ["write"] and rest[1] in garment_names() and "--triangles" not in rest:
        return [*words, "--triangles", "1000"]  # fewer are refused as a file of one's own
    if verb != "simulate":
        return words
    for flag, value in sizes.items():
        places = [k for k, word in enumerate(rest) if word == flag]
        for k in places:
            name, equals, _ = rest[k + 1].rpartition("=")
            rest[k + 1] = f"{name}{equals}{value}"
        if not places and (flag != "--triangles" or has_built_in_garment(rest)):
            rest += [flag, value]
    return ["pb4u", verb, *rest, *(() if "--model" in rest else ("--model", model))]


def has_built_in_garment(words: list[str]) -> bool:
    named = [words[k + 1] for k, word in enumerate(words) if word == "--garment"]
    positional = words[:1] if words and not words[0].startswith("-") else []
    return not any(Path(name).suffix for name in [*named, *positional])


@pytest.fixture
def small_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes of Python snippets, at a few hundred triangles for a few frames."""
    from pb4u.scene import assembly

    make_scene, build_garment = assembly.make_scene, pb4u.build_garment

    def small(*arguments: Any, **options: Any) -> Any:
        garment = arguments[0] if arguments else options.get("garment")
        built_in = not isinstance(garment, pb4u.Garment) and not Path(str(garment)).suffix
        small_mesh = {"triangles": 450} if built_in else {}
        return make_scene(*arguments, **{**options, **small_mesh, "frames": 3, "lead_in": 1})

    monkeypatch.setattr(pb4u, "make_scene", small, raising=False)
    tiny = lambda name, body, **_: build_garment(name, body, triangles=450)  # noqa: E731
    monkeypatch.setattr(pb4u, "build_garment", tiny, raising=False)


PAGES_THAT_RUN = sorted({block.page for block in blocks("console", "python")})
SLOW_PAGES = (
    "docs/guides/own_garment.md",
    "docs/guides/outfits.md",
    "docs/guides/datasets.md",
    "docs/guides/own_body.md",
)


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] if page in SLOW_PAGES else []) for page in PAGES_THAT_RUN]
)
def test_the_page_runs_from_top_to_bottom(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], small_scenes: None
) -> None:
    monkeypatch.chdir(tmp_path)
    prepared(tmp_path, page)
    for block in [each for each in blocks("console", "python") if each.page == page]:
        if block.language == "python":
            exec(compile(block.text, str(block), "exec"), {"__name__": "__main__"})
            continue
        for words in commands(block):
            ended = run(made_small(words), monkeypatch)
            streams = capsys.readouterr()
            assert ended == 0, f"{' '.join(words)}\n{streams.out}\n{streams.err}"


def run(words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", words)
    try:
        main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def prepared(folder: Path, page: str) -> None:
    """Files that a page takes for granted: those it shows itself; of datasets, one clip in place of two hundred."""
    if page.endswith("datasets.md"):
        pytest.importorskip("pyarrow", reason='needs the "dataset" extra')
        pytest.importorskip("pandas")
        pytest.importorskip("duckdb")
        shown = next(block for block in blocks("toml") if block.page == page and "clips.toml" in block.text)
        jobs = tomllib.loads(shown.text)
        fixed = "".join(f"{name} = {value!r}\n" for name, value in jobs["fixed"].items() if name != "refine")
        first = {name: values[0] for name, values in jobs["product"].items() if name != "seed"}
        chosen = "".join(f'{name} = "{value}"\n' for name, value in first.items())
        (folder / "clips.toml").write_text(f'[fixed]\n{fixed}model = "skinning"\n[[clips]]\n{chosen}')


@pytest.mark.parametrize("block", blocks("toml"), ids=str)
def test_every_file_that_is_shown_can_be_read(block: Block, tmp_path: Path) -> None:
    record = tomllib.loads(block.text)
    file = tmp_path / f"shown.{block.language}"
    file.write_text(block.text)
    if "svg" in record:
        loops = [f'<path id="{name}" d="M0 0 H500 V600 H0 Z"/>' for name in record["panels"]]
        (tmp_path / record["svg"]).write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{"".join(loops)}</svg>')
        assert len(read_pattern(file).seams) == len(record["seams"])
        return
    if not set(record) & {"fixed", "product", "clips"}:
        assert Run.open(file).garments
        return
    (tmp_path / "outfits").mkdir()
    for name in re.findall(r"outfits/\w+\.toml", block.text):
        (tmp_path / name).write_text('[[garments]]\ngarment = "skirt"\n')
    runs = read_jobs(file)
    counts = {"clips.toml": 200, "outfits/office": 17, "fifty.toml": 50}
    (wanted,) = [count for mark, count in counts.items() if mark in block.text]
    assert len(runs) == wanted


def test_json_that_is_shown_is_a_material(tmp_path: Path) -> None:
    shown = list(blocks("json"))
    assert shown
    for block in shown:
        (tmp_path / "shown.json").write_text(block.text)
        from pb4u.garment.material import load_material

        assert load_material(tmp_path / "shown.json").density > 0.0
