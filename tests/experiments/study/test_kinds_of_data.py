"""Tables of [[data]] of every kind, alone and together, for machines on legs and for others."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import own_arm
import pandas as pd
import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.inference.mode import find_modes
from bayescal.machines.read import read_reading_model
from bayescal.numerics.geometry import matrix_from_rotation_vector

ARM = """
kind = "study"
name = "arm"
title = "An arm that a tracker sees"
seed = 3
machine = "machine.toml"

[provenance]
status = "simulated"
text = "for the tests"

{data}
[sensors]
encoder = {{ noise_arcsec = 20.0 }}
{sensors}

[parameters]
a = {{ prior = "normal", sd = 1.0 }}
o = {{ prior = "normal", sd = 0.1 }}
{parameters}

[model_error]
terms = []

[[variants]]
name = "all"
"""
POSES = """[[data]]
kind = "poses"
file = "poses.csv"
position_um = 30.0
frames.base = { position = 5.0, rotation = 0.5 }
"""
POINT = """[instruments.seen]
kind = "point"
frame_mm = [0.0, 0.0, 0.0]
frame_deg = [0.0, 0.0, 0.0]

[[data]]
file = "readings.csv"
commanded_channels = ["encoder"]
"""
FRAME = 'seen_frame = { prior = "normal", sd = 5.0 }\nseen_frame_r = { prior = "normal", sd = 0.5 }'


def weigh(path: Path) -> tuple[float, dict[str, float]]:
    """Return the log-evidence of a study's first variant by Laplace at its mode, and the mode by parameter."""
    inputs = read_inputs(load(path)[1], path.parent)
    posterior = next(iter(inputs.variants.values())).posterior().with_pose_guesses()
    mode = find_modes(posterior)[0]
    natural = posterior.natural(mode.y[None])[0]
    return mode.log_evidence, dict(zip(posterior.names, natural, strict=True))


@pytest.fixture
def arm(tmp_path):
    """Return a folder with an arm's encoders and where a tracker saw its tool, in a frame a little off the base's."""
    rng = np.random.default_rng(5)
    (tmp_path / "own_arm.py").write_text(Path(own_arm.__file__).read_text())
    (tmp_path / "machine.toml").write_text(own_arm.MACHINE)
    model = read_reading_model(tmp_path / "machine.toml")
    pose = np.array([0.0, 0.6, -1.2]) + [0.8, 0.3, 0.3] * rng.uniform(-1.0, 1.0, (14, 3))
    theta = model.layout.nominal + np.array([0.6, -0.4, 0.0, 1e-3, -5e-4, 8e-4])
    read = model.read(theta, pose)
    turned = matrix_from_rotation_vector(np.array([2e-3, -1e-3, 3e-3]))
    seen = read[:, 3:] @ turned.T + [1.0, -2.0, 0.5] + 0.03 * rng.standard_normal((14, 3))
    encoders = read[:, :3] + np.radians(20.0 / 3600.0) * rng.standard_normal((14, 3))
    table = pd.DataFrame({"pose": [f"P{k}" for k in range(14)], "use": "calibration"})
    table[[f"encoder_{k}_deg" for k in (1, 2, 3)]] = np.degrees(encoders)
    table.join(pd.DataFrame(seen, columns=["x_mm", "y_mm", "z_mm"])).to_csv(tmp_path / "poses.csv", index=False)
    named = pd.DataFrame(seen, columns=["seen_x_mm", "seen_y_mm", "seen_z_mm"])
    table.join(named).to_csv(tmp_path / "readings.csv", index=False)
    return tmp_path


def write_arm(folder: Path, data: str, sensors: str = "", parameters: str = "") -> Path:
    (folder / "study.toml").write_text(ARM.format(data=data, sensors=sensors, parameters=parameters))
    return folder / "study.toml"


def test_poses_of_any_machine_are_what_an_instrument_beside_it_sees(arm):
    """Their frames are each other's inverses: what is known of them differs by 3 mrad of their displacements."""
    evidence, mode = weigh(write_arm(arm, POSES))
    other, same = weigh(write_arm(arm, POINT, "seen = { noise_um = 30.0 }", FRAME))
    assert evidence == pytest.approx(other, abs=0.01)
    own = [name for name in mode if name[0] in "ao"]
    np.testing.assert_allclose([mode[one] for one in own], [same[one] for one in own], rtol=1e-6, atol=1e-9)
    assert {f"base_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")} < set(mode)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("frames.base", "frames.tool"), r"data\.frames\.tool: found it for a machine without a tool rotation"),
        (("pose,use", "pose,rx_deg,use"), r"poses\.csv: found rotations for a machine"),
        (("[sensors]", POSES + "\n[sensors]"), "data: found two tables with frames named ''"),
        (("[sensors]", '[[data]]\nfile = "readings.csv"\nignore = ["seen_x_mm", "seen_y_mm", "seen_z_mm"]\n[sensors]'),
         r"found a second reading of encoder\[1\]"),
    ],
)  # fmt: skip
def test_what_an_arm_cannot_be_compared_with_is_refused(arm, change, message):
    config, table = write_arm(arm, POSES), arm / "poses.csv"
    if change[0] in config.read_text():
        studies.edit(config, *change)
    else:
        rows = table.read_text().replace(*change).splitlines()
        text = [rows[0], *(re.sub("^(P[0-9]+),", r"\1,0.5,", row) for row in rows[1:])]
        table.write_text("\n".join(text) + "\n")
        studies.edit(config, "position_um", "orientation_arcsec = 5.0\nposition_um")
    with pytest.raises(InputError, match=message):
        read_inputs(load(config)[1], arm)


READER = """
import pandas as pd

from bayescal import Section, TableReader


class LoggerConfig(Section):
    decimal: str


class Logger(TableReader):
    Config = LoggerConfig

    def read(self, path):
        return pd.read_csv(path, sep=";", decimal=self.config.decimal)
"""


def test_a_reader_of_ones_own_reads_a_logger(arm):
    expected = weigh(write_arm(arm, POINT, "seen = { noise_um = 30.0 }", FRAME))
    pd.read_csv(arm / "readings.csv").to_csv(arm / "log.txt", sep=";", decimal=",", index=False)
    (arm / "logger.py").write_text(READER)
    own = POINT.replace('file = "readings.csv"', 'kind = "logger.py:Logger"\nfile = "log.txt"\ndecimal = ","')
    path = write_arm(arm, own, "seen = { noise_um = 30.0 }", FRAME)
    experiment, config = load(path)
    assert {"log.txt", "logger.py"} <= set(experiment.files(config, arm))
    assert weigh(path)[0] == pytest.approx(expected[0], abs=1e-9)
    studies.edit(path, "decimal =", "decimals =")
    with pytest.raises(InputError, match=r"data\.0\.decimals: unknown.*'decimal'"):
        load(path)


@pytest.fixture(scope="module")
def fed(tmp_path_factory):
    """Return the config of a tiny study by the poses that its targets tell."""
    config = studies.write_tiny_study(tmp_path_factory.mktemp("fed"))
    studies.edit(config, 'deformation = "matrix"', 'deformation = "linear"')
    (config.parent / "data" / "poses.csv").write_text(studies.feed_poses(config))
    config.write_text(config.read_text().replace(studies.BY_TARGETS, studies.BY_POSES))
    return config


def test_actuators_may_stand_in_a_table_of_readings(fed):
    expected = weigh(fed)
    readings = '\n[[data]]\nfile = "data/actuators.csv"\ncommanded_channels = ["rho"]\n'
    apart = fed.with_name("apart.toml")
    apart.write_text(fed.read_text().replace('actuators = "data/actuators.csv"\n', readings))
    evidence, mode = weigh(apart)
    assert evidence == pytest.approx(expected[0], abs=1e-9)
    assert mode == pytest.approx(expected[1], abs=1e-6)


def test_an_instrument_stands_beside_a_table_of_poses(fed):
    """A draw-wire that reads where the poses say: it adds a channel, and takes nothing away."""
    bar = '\n[instruments.bar]\nkind = "distance"\nanchor_mm = [500.0, 0.0, 0.0]\n'
    poses = read_inputs(load(fed)[1], fed.parent).measured[0].poses
    distance = np.linalg.norm(poses.position - [500.0, 0.0, 0.0], axis=1)
    table = pd.DataFrame({"pose": poses.names, "bar_mm": distance})
    table.to_csv(fed.parent / "bar.csv", index=False)
    config = fed.with_name("bar.toml")
    text = fed.read_text().replace("rho = {", "bar = { noise_um = 5.0 }\nrho = {")
    config.write_text(text.replace("[sensors]", f'[[data]]\nfile = "bar.csv"\n{bar}\n[sensors]'))
    variant = next(iter(read_inputs(load(config)[1], fed.parent).variants.values()))
    assert variant.model.names[-1] == "bar"
    assert np.isfinite(variant.data.values[:, -1]).all()
    assert np.isfinite(weigh(config)[0])
