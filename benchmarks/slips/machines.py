"""Machines whose data get slips: hexapods, shipped ones and those of `bayescal init`, a delta, an arm, a cable robot.

Every one is written to a folder with simulated data, as a user has them, and read as a study is checked; shipped ones
are there.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import compute_experiment
from bayescal.experiments.selftest.inputs import TestedVariant, read_selftest
from bayescal.experiments.selftest.kind import configure_selftest
from bayescal.projects.start import start_project

HERE = Path(__file__).parent
HEXAPODS = {f"hexapod by {one}": one for one in ("poses", "points", "targets")}
HEAD = """name = "{name}"
title = "{name}"
seed = 1
machine = "machine.toml"

[provenance]
status = "simulated"
text = "one machine drawn within its tolerances, never measured"
"""
ARM = (
    'kind = "arm.py:Arm"\nname = "arm"\ntitle = "An arm"\n',
    """
[sensors]
encoder = { noise_arcsec = 5.0 }
tracker_x = { noise_um = 15.0, noise_group = "tracker" }
tracker_y = { noise_um = 15.0, noise_group = "tracker" }
tracker_z = { noise_um = 15.0, noise_group = "tracker" }

[parameters]
a = { prior = "normal", sd = 0.3 }
h = { prior = "normal", sd = 0.3 }
o = { prior = "normal", sd = 0.1 }
""",
)
CABLES = (
    (HERE.parents[1] / "experiments" / "hangprinter" / "machine.toml").read_text(),
    """
[sensors]
motor = { noise_deg = 0.5 }
x = { noise_mm = 0.1, noise_group = "camera" }
y = { noise_mm = 0.1, noise_group = "camera" }
z = { noise_mm = 0.1, noise_group = "camera" }

[parameters]
A_x = { prior = "normal", sd = 5.0 }
A_y = { prior = "normal", sd = 5.0 }
A_z = { prior = "normal", sd = 5.0 }
R = { prior = "normal", sd = 0.3 }
""",
)
OWN = {"serial arm": ARM, "cable robot": CABLES}
SHIPPED = {"m2 hexapod": "m2_hexapod", "hexaglide": "hexaglide"}
MACHINES = (*HEXAPODS, *SHIPPED, "linear delta", *OWN)
N_POSES = 30


def write_project(machine: str, folder: Path) -> Path:
    """Write a machine's project; return its study's config."""
    if machine in SHIPPED:
        return HERE.parents[1] / "experiments" / SHIPPED[machine] / "study.toml"
    if machine in HEXAPODS:
        start_project(folder, "hexapod", HEXAPODS[machine])
    elif machine == "linear delta":
        start_project(folder, "own", None)
    else:
        _write_own(folder, *OWN[machine])
    return folder / "study.toml"


def _write_own(folder: Path, machine: str, known: str) -> None:
    (folder / "data").mkdir(parents=True)
    shutil.copy(HERE / "arm.py", folder)
    (folder / "machine.toml").write_text(machine)
    head = HEAD.format(name="own")
    (folder / "simulate.toml").write_text(f'kind = "simulation"\nn_poses = {N_POSES}\n{head}{known}')
    variant = '\n[[data]]\nfile = "data/readings.csv"\n\n[[variants]]\nname = "all"\ntitle = "Everything free"\n'
    (folder / "study.toml").write_text(f'kind = "study"\n{head}{known}{variant}')
    made = compute_experiment(load(folder / "simulate.toml")[1], folder)
    (folder / "data" / "readings.csv").write_text(str(made.files["readings.csv"]))


def read_subject(path: Path) -> TestedVariant:
    """Return a study's first variant as a check sees it."""
    name = load(path)[1].variants[0].name
    return read_selftest(configure_selftest(path, [name], None, None), path.parent).subjects[name]
