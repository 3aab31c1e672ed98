"""Folders of the user in which something is kept between runs."""

import os
import sys
from pathlib import Path


def cache_folder() -> Path:
    """The folder of what can be made or fetched again: `~/.cache/tustinnet` on Linux."""
    return _folder("XDG_CACHE_HOME", ".cache", "Library/Caches")


def config_folder() -> Path:
    """The folder of what the user has decided: `~/.config/tustinnet` on Linux."""
    return _folder("XDG_CONFIG_HOME", ".config", "Library/Application Support")


def _folder(variable: str, linux: str, mac: str) -> Path:
    """A folder of this package where the system keeps such folders."""
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 (`Path.home` raises where there is none)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData/Local") / "tustinnet"
    if sys.platform == "darwin":
        return home / mac / "tustinnet"
    return Path(os.environ.get(variable) or home / linux) / "tustinnet"
