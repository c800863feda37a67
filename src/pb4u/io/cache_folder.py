"""The user's cache folder."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def cache_folder() -> Path:
    """The user's cache folder for this package: XDG_CACHE_HOME, or the platform's own place."""
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "pb4u"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "pb4u" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "pb4u"
    return Path.home() / ".cache" / "pb4u"
