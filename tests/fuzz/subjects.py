"""What is mutated: a config of every kind, short, with the files that belong to it."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import calibrations
import lookup_tables
import session_studies
import sweeps
from fuzz.hostile import dump_toml
from tiny_experiments import copy_tiny

from bayescal.config.load import list_extended
from bayescal.experiments.runner.load import load

QUICK = {
    "audit/m2_hexapod.toml": False,
    "audit/m2_hexapod_tracker.toml": False,
    "audit/telescope_six_pus_matrix.toml": False,
    "audit/telescope_stiffness_linear.toml": False,
    "camera_hexapod/simulate.toml": True,
    "camera_hexapod/study.toml": False,
    "yu2023/figure10.toml": True,
    "yu2023/table1.toml": True,
    "yu2023/table4.toml": False,
    "yu2023/table8.toml": True,
    "m2_hexapod/short.toml": False,
    "own_machine/audit.toml": False,
    "own_machine/simulate.toml": True,
    "own_machine/study.toml": True,
    "rr8096/figure5.toml": True,
    "pose_selection/hexapod_i_optimal.toml": True,
    "pose_selection/rr8096_figure14.toml": False,
    "rail/study.toml": True,
    "rail/table.toml": True,
    "sessions/sessions.toml": True,
    "sika2008/calibrations.toml": True,
    "sliding_star/m2_hexapod_sensors.toml": False,
    "sliding_star/sensors.toml": False,
    "sliding_star/short.toml": True,
    "sliding_star/simulate.toml": True,
    "sweep/sweep.toml": True,
    "telescope/selftest.toml": False,
    "telescope/next_pose.toml": True,
    "telescope/short.toml": False,
    "telescope/simulate.toml": True,
}
"""Those that are read within half a second, all kinds among them, and whether they are computed in two."""
DISTURBED = {
    "audit": "audit/telescope_six_pus_matrix.toml",
    "selftest": "telescope/selftest.toml",
    "next_pose": "telescope/next_pose.toml",
    "selection": "pose_selection/hexapod_i_optimal.toml",
    "sessions": "sessions/sessions.toml",
    "simulation": "own_machine/simulate.toml",
    "study": "own_machine/study.toml",
    "sweep": "sweep/sweep.toml",
    "table": "rail/table.toml",
    "a kind in a file": "yu2023/figure10.toml",
}
"""A short run of every kind and use."""
POSES = ("C01", "C02", "C03", "C04", "C05", "C06", "C07", "C08", "C09", "C10", "C11", "C12", "V01", "V02")
NEWEST: dict[str, Callable[[Path], Path]] = {
    "rail": lookup_tables.write_rail,
    "sessions": session_studies.write_sessions,
    "sweep": sweeps.write_apart,
}
"""Folders of their own, and what writes them."""
SHORT: dict[str, dict[str, Any]] = {
    "telescope": {"sensitivity": {"prior_width_factors": [1.0]}},
    "m2_hexapod": {"sensitivity": {"prior_width_factors": [1.0]}},
    "sliding_star": {"next": {"candidates": 20}},
}
CHECK = (
    'kind = "selftest"\nname = "selftest"\ntitle = "A self-test"\nseed = 1\nstudy = "short.toml"\n'
    'variants = ["six_pus/none"]\n'
)
NEXT = """name = "next_pose"
title = "The next pose"
seed = 1
study = "short.toml"
variants = ["six_pus/none"]
draws = 200
workspace = { position_mm = [0.3, 0.3, 0.3], rotation_deg = [0.1, 0.1, 0.1], poses = 12 }
requirements = { z = 0.02 }
candidates = { count = 64, range_mm = 1.2 }
"""


@dataclass(frozen=True)
class Subject:
    """A config, its kind, and all files that make it up, itself first."""

    config: Path
    kind: str
    files: tuple[Path, ...]

    @property
    def machine(self) -> Path:
        """The machine's file, the first of those that are configs."""
        return next(path for path in self.files[1:] if path.suffix == ".toml")


def write_subjects(folder: Path) -> list[Path]:
    """Write all experiments to a folder, each with little to do and few data; return their configs."""
    root = copy_tiny(folder)
    calibrations.write_delta(root)
    for name in ("audit.toml", "simulate.toml"):
        shutil.copy(calibrations.OWN_MACHINE / name, root / "own_machine" / name)
    for name, sections in SHORT.items():
        study = tomllib.loads((root / name / "study.toml").read_text(encoding="utf-8"))
        study |= sections | {"variants": study["variants"][:1]}
        study.get("parameters", {}).pop("kappa", None)  # the first variants have no deformation
        (root / name / "short.toml").write_text(dump_toml(study), encoding="utf-8")
    for name, write in NEWEST.items():
        (root / name).mkdir()
        write(root / name)
    (root / "telescope" / "selftest.toml").write_text(CHECK, encoding="utf-8")
    (root / "telescope" / "next_pose.toml").write_text(NEXT, encoding="utf-8")
    for name in ("targets.csv", "actuators.csv"):
        _keep_poses(root / "telescope" / "data" / name)
    experiment = re.compile(r"(?m)^(kind|study) = ")
    return [path for path in sorted(root.glob("*/*.toml")) if experiment.search(path.read_text(encoding="utf-8"))]


def _keep_poses(path: Path) -> None:
    rows = path.read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if row.startswith(("#", "pose", *POSES))]
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")


def read_subject(config: Path) -> Subject:
    """Return a config with its files."""
    experiment, loaded = load(config)
    folder = config.parent
    names = sorted({*experiment.files(loaded, folder), *list_extended(config.name, folder)})
    return Subject(config, loaded.kind, (config, *(folder / name for name in names if not name.endswith(".py"))))
