"""The user's cache folder."""

from __future__ import annotations

from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """The user's cache folder for this package: XDG_CACHE_HOME, or the platform's own folder."""
    return platformdirs.user_cache_path("pb4u", appauthor=False)
