"""How a garment of a dictionary of the released code is named: FILE.pkl:NAME, or FILE.pkl:NAME@CENTRE.

Apart from what reads the file, since descriptions of scenes need the name and nothing that is heavy to import.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple


class DictionaryEntry(NamedTuple):
    """A garment of a dictionary as the user names it.

    Args:
        path: the file.
        name: of the garment in the file; None if the file has only one.
        centre: vertex that its coarse levels start from; None is the first that the file has levels for.
    """

    path: Path
    name: str | None
    centre: int | None

    @classmethod
    def parse(cls, text: str | Path) -> DictionaryEntry | None:
        """Entry that FILE.pkl, FILE.pkl:NAME or FILE.pkl:NAME@CENTRE names; None for any other text.

        Args:
            text: value of --garment.
        """
        match = re.fullmatch(r"(?P<file>.+\.pkl)(?::(?P<name>[^@:]*)(?:@(?P<centre>\d+))?)?", str(text), re.IGNORECASE)
        if match is None:
            return None
        centre = match["centre"]
        return cls(Path(match["file"]), match["name"] or None, None if centre is None else int(centre))

    @property
    def title(self) -> str:
        """Name of the garment."""
        return self.name or self.path.stem
