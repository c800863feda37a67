"""Pack the Blender add-on: `python tools/pack_blender_addon.py [FOLDER]` writes pb4u-VERSION.zip, and says its name.

The same sources give the same bytes. Blender takes the file as it is: Edit > Preferences > Get Extensions > Install
from Disk.
"""

from __future__ import annotations

import argparse
import re
import sys
import zipfile
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "integrations" / "blender"
LICENCE = Path(__file__).resolve().parents[1] / "LICENSE"
# A zip holds local times from 1980 on; the first of them, on every machine, keeps the bytes the same.
NO_TIME = (1980, 1, 1, 0, 0, 0)


def pack(folder: Path) -> Path:
    """Write the add-on into a folder; the path of the file."""
    manifest = (SOURCE / "blender_manifest.toml").read_text(encoding="utf-8")
    (version,) = re.findall(r'^version = "(.+)"$', manifest, re.MULTILINE)
    files = {path.name: path for path in (*SOURCE.glob("*.py"), SOURCE / "blender_manifest.toml", LICENCE)}
    target = folder / f"pb4u-{version}.zip"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, path in sorted(files.items()):
            entry = zipfile.ZipInfo(name, NO_TIME)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            # Line ends as in the repository, whatever the checkout made of them.
            archive.writestr(entry, path.read_bytes().replace(b"\r\n", b"\n"))
    return target


def main() -> None:
    """Pack into the folder that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path())
    folder = parser.parse_args().folder
    if not folder.is_dir():
        sys.exit(f"There is no folder {folder}; make it first.")
    print(pack(folder))


if __name__ == "__main__":
    main()
