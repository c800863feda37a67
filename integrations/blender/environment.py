"""Where the `pb4u` command is, how it is installed, and a process of it that runs beside Blender."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

OLDEST, NEWEST = (3, 10), (3, 13)
"""Versions of Python that pb4u runs on."""
_SCRIPTS = "Scripts" if os.name == "nt" else "bin"
_COMMAND = "pb4u.exe" if os.name == "nt" else "pb4u"
_PYTHON = "python.exe" if os.name == "nt" else "python3"
# What Blender sets for its own Python would lead another one astray.
_BLENDERS_OWN = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")


class PlainError(Exception):
    """Something that cannot be done, in one sentence that says how to mend it."""


def find_command(chosen: str, environment: Path) -> Path:
    """The `pb4u` command: the one that was chosen, else that of the add-on's environment, else that of the system.

    Args:
        chosen: path in the preferences; empty where none is.
        environment: folder of the environment that the add-on makes.

    Raises:
        PlainError: it is not there.
    """
    if chosen:
        path = Path(chosen).expanduser()
        found = path / _SCRIPTS / _COMMAND if path.is_dir() else path
        if not found.is_file():
            raise PlainError(f"There is no pb4u command at {chosen}; choose another in the add-on's preferences.")
        return found
    own = environment / _SCRIPTS / _COMMAND
    on_path = shutil.which("pb4u")
    if own.is_file():
        return own
    if on_path:
        return Path(on_path)
    raise PlainError("The pb4u command was not found; press Install in the add-on's preferences, or choose it there.")


def python_for_environment() -> Path:
    """A Python that pb4u runs on: Blender's own, else the system's.

    Raises:
        PlainError: there is none.
    """
    for candidate in (sys.executable, shutil.which("python3"), shutil.which("python")):
        if not candidate:
            continue
        told = subprocess.run(
            [candidate, "-c", "import sys, venv, ensurepip; print(*sys.version_info[:2])"],
            capture_output=True, text=True, env=plain_environment(),
        )  # fmt: skip
        if told.returncode == 0 and OLDEST <= tuple(map(int, told.stdout.split())) <= NEWEST:
            return Path(candidate)
    versions = f"{'.'.join(map(str, OLDEST))} to {'.'.join(map(str, NEWEST))}"
    raise PlainError(f"No Python from {versions} that can make an environment was found; install one and try again.")


def installation(python: Path, environment: Path, wanted: list[str]) -> list[list[str]]:
    """The commands that make the environment and install pb4u into it.

    Args:
        python: that makes it.
        environment: folder of the environment.
        wanted: what pip installs, from `requirements`.
    """
    own = environment / _SCRIPTS / _PYTHON
    return [
        [str(python), "-m", "venv", str(environment)],
        [str(own), "-m", "pip", "install", "--upgrade", *wanted],
    ]


def requirements(source: str) -> list[str]:
    """What pip is to install: one path where there is such a file or folder, else words, which quotes hold together.

    Args:
        source: a package name, a wheel, a folder or an address, as the preferences have it.

    Raises:
        PlainError: a quote is not closed.
    """
    path = os.path.expanduser(source.strip())
    if os.path.exists(path):
        return [path]
    try:
        # In Windows a backslash is a part of a path.
        return shlex.split(source.replace("\\", "\\\\") if os.name == "nt" else source)
    except ValueError:
        raise PlainError(f"A quote in {source} is not closed.") from None


def plain_environment() -> dict[str, str]:
    """Environment variables of this process without those that Blender sets for its own Python."""
    return {name: value for name, value in os.environ.items() if name not in _BLENDERS_OWN}


def ask(command: Path, *arguments: str) -> str:
    """Standard output of a short call of pb4u.

    Args:
        command: the pb4u command.
        arguments: of the call.

    Raises:
        PlainError: it failed; what it said.
    """
    try:
        ended = subprocess.run(
            [str(command), *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            env=plain_environment(),
        )
    except OSError as error:
        raise PlainError(f"{command} cannot be run: {error.strerror or error}.") from None
    if ended.returncode:
        raise PlainError(last_sentence(ended.stderr) or f"{command.name} ended with {ended.returncode}.")
    return ended.stdout


def names(command: Path) -> dict[str, list[str]]:
    """Names of the built-in materials and models, by kind."""
    listed = json.loads(ask(command, "assets", "--json", "-"))
    return {kind: [entry["name"] for entry in listed[kind]] for kind in ("materials", "models")}


class Process:
    """A command that runs beside Blender, its output in a file.

    Args:
        command: and its arguments.
        log: file that takes what it says.

    Raises:
        PlainError: it cannot be run.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        self.log = log
        # A group of its own, so that a Ctrl-C meant for Blender's terminal does not reach it.
        group = (
            {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}
        )
        with log.open("wb") as stream:
            try:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, env=plain_environment(),
                    cwd=log.parent, **group,
                )  # fmt: skip
            except OSError as error:
                raise PlainError(f"{command[0]} cannot be run: {error.strerror or error}.") from None

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while it runs."""
        return self._process.poll()

    def interrupt(self) -> None:
        """Ask it to end; it keeps the frames that are there."""
        if self.exit_code is None:
            self._process.send_signal(signal.CTRL_BREAK_EVENT if os.name == "nt" else signal.SIGTERM)

    def kill(self, seconds: float = 5.0) -> None:
        """End it: asked first, and after `seconds` [s] not asked."""
        self.interrupt()
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def said(self) -> str:
        """All it has said until now."""
        return self.log.read_text(encoding="utf-8", errors="replace")


def warnings_in(said: str) -> list[str]:
    """The warnings of pb4u in what it said."""
    mark = "pb4u: warning: "
    return [line.removeprefix(mark) for line in said.splitlines() if line.startswith(mark)]


def last_sentence(said: str) -> str:
    """The sentence that pb4u ended with; of another program its last line."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    own = [line.removeprefix("pb4u: ") for line in lines if line.startswith("pb4u: ")]
    ends = [line for line in own if not line.startswith("warning: ")]
    return ends[-1] if ends else lines[-1] if lines else ""
