"""The folder of an evaluation: a folder of jobs whose results come with one frame each, for pictures.

* jobs/KEY.npz: one frame of the rollout
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pb4u import __version__
from pb4u.errors import InputError
from pb4u.jobs.job_folder import JOBS, MANIFEST, JobFolder
from pb4u.paper.rollout import PROTOCOL_VERSION, Rollout, RolloutJob


class ResultFolder(JobFolder):
    """The files of one evaluation; while open, it is this process's alone.

    Args:
        path: the folder, made where it is not there.
        protocol: name of the protocol that is run in it.

    Raises:
        InputError: it holds something else, another protocol or a run of another version, or is in use.
    """

    def __init__(self, path: Path, protocol: str) -> None:
        self._protocol = protocol
        super().__init__(path, "an evaluation")

    def require_same(self, manifest: dict[str, Any]) -> None:
        version, made_by, held = manifest["protocol_version"], manifest["pb4u"], manifest["protocol"]
        if version != PROTOCOL_VERSION or made_by != __version__:
            raise InputError(
                f"{self.path} holds a run by pb4u {made_by} with protocols of version {version}, and this is pb4u "
                f"{__version__} with version {PROTOCOL_VERSION}; results of two do not belong in one table: give "
                "another --out."
            )
        if held != self._protocol:
            raise InputError(
                f"{self.path} holds a run of the protocol {held}, not {self._protocol}; give another --out."
            )

    def write_manifest(self, request: dict[str, Any], jobs: tuple[RolloutJob, ...]) -> None:
        """Record what the run consists of.

        Args:
            request: what was asked for, as JSON.
            jobs: every rollout of it.
        """
        manifest = {
            "protocol_version": PROTOCOL_VERSION,
            "pb4u": __version__,
            "protocol": self._protocol,
            "request": request,
            "jobs": [{"key": job.key, **asdict(job)} for job in jobs],
        }
        self.write(MANIFEST, (json.dumps(manifest, indent=1, default=str) + "\n").encode())

    def parts(self, job: RolloutJob, made: Rollout) -> tuple[dict[str, Any], dict[str, bytes]]:
        return made.result, {} if made.still is None else {f"{JOBS}/{job.key}.npz": made.still}

    def still(self, job: RolloutJob) -> Path:
        """Path of the frame kept for pictures; the file may be absent."""
        return self.path / JOBS / f"{job.key}.npz"
