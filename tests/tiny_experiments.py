"""All shipped experiments with little to do: the same files, with few draws, poses, candidates and repeats."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

SHIPPED = Path(__file__).parents[1] / "experiments"

SMALL = {
    "study": {"walkers": "8", "burn_in": "5", "steps": "10", "draws": "1000", "max_draws": "1000"}
    | {"prior_width_factors": "[1.0]"},
    "pose_methods.py:PoseMethods": {"repeats": "2", "n_targets": "[6, 8]"},
    "kind.py:HexapodCalibrations": {
        **{"candidates": "150", "list_length": "5", "iterations": "3", "verification_poses": "7", "repeats": "4"},
        **{"selections": "2", "parameter_sets": "3", "noise_draws": "4"},
    },
    "selection": {"repeats": "2", "count": "150", "poses": "14", "machines": "4"},
    "published_poses.py:PublishedPoses": {
        **{"repeats": "1", "iterations": "2", "n_sets": "10", "list_length": "5", "count": "60"},
    },
    "boundary_poses.py:BoundaryPoses": {"repeats": "1", "max_iterations": "3", "count": "60"},
    "self_calibrations.py:SelfCalibrations": {
        **{"calibrations": "6", "verification_poses": "5", "n_poses": "20", "count": "3"},
        "angle_noise_arcsec": "[0.5, 2.0]",
    },
    "sessions": {"draws": "500", "separate_by_leg": "false"},
    "audit": {"n_simulated_calibrations": "4", "n_prior_draws": "3", "draws": "2000"}
    | {"count": "12", "max_exhaustive_sets": "0"},
}
"""By kind of experiment, what stands after the names of its keys instead of what is shipped."""

REPLACED: dict[str, tuple[tuple[str, str], ...]] = {
    "selection": ((r"(?m)^n_poses = \[(\d+).*$", r"n_poses = [\1]"),),
    "kind.py:HexapodCalibrations": ((r"(?m)^poses = \[.*$", "poses = [12, 24]"),),
}
"""What is replaced besides, as regular expressions."""

ADDED = {
    "audit": ("sweep", "noise = [1.0]\nposes = [10, 40]\nworkspace = [1.0]"),
    "kind.py:HexapodCalibrations": ("selection", "candidates = 150\nlist_length = 5\niterations = 3"),
}
"""Sections that are shorter than what holds without them."""


def copy_tiny(folder: Path, *names: str) -> Path:
    """Copy shipped experiments, all unless folders are named, each with little to do; return where they stand."""
    target = folder / "experiments"
    for name in names or (".",):
        shutil.copytree(SHIPPED / name, target / name)
    for path in target.glob("*/*.toml"):
        text = path.read_text(encoding="utf-8")
        kind = read_kind(path)
        for key, value in SMALL.get(kind, {}).items():
            text = key_line(key).sub(f"{key} = {value}", text)
        for old, new in REPLACED.get(kind, ()):
            text = re.sub(old, new, text)
        section, lines = ADDED.get(kind, ("", ""))
        if section and not {"extends", section} & set(tomllib.loads(text)):
            text += f"\n[{section}]\n{lines}\n"
        path.write_text(text, encoding="utf-8")
    return target


def key_line(key: str) -> re.Pattern[str]:
    """Return what matches lines of a config that give a key a value, no table."""
    return re.compile(rf"^{key} = (?!{{).*$", flags=re.MULTILINE)


def read_kind(path: Path) -> str:
    """Return the kind that a file states; that of what it extends where it states none."""
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    if "extends" in content:
        return read_kind(path.parent / content["extends"])
    return str(content.get("kind", ""))
