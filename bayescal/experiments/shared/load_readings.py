"""Reading a machine that is known by its sensors from a TOML file."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import check_section, read_toml
from bayescal.machines.readings.schema import SlidingPlatformConfig


def load_sliding_platform(path: Path) -> SlidingPlatformConfig:
    """Return the checked config of a planar platform on sliding legs.

    Raises
    ------
    InputError
        Where the file is none.
    """
    content, text = read_toml(path)
    return check_section(SlidingPlatformConfig, content, path, text)
