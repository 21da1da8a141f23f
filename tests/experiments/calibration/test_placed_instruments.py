"""[instruments] in calibrations of any machine: built-in kinds, a user-defined class, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import calibrations
import numpy as np
import own_arm
import pandas as pd
import pytest
import studies

from bayescal.density.calibration.measurements import Comparison
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import POSE

MECHANISM = studies.EXPERIMENTS / "audit" / "m2_hexapod_mechanism.toml"
OWN = '''
"""A laser that looks along an axis of its own at a mirror on the tool."""

import numpy as np

from bayescal import Channel, Instrument, ParameterBlock, Section


class LaserConfig(Section):
    towards: list[float]


class Laser(Instrument):
    """How far the tool has gone along an axis."""

    Config = LaserConfig

    def __init__(self, config):
        super().__init__(config)
        self.axis = np.array(config.towards)
        self.parameters = [ParameterBlock("zero", (0.0,), per_leg=False)]
        self.channels = [Channel("", "mm")]

    def see(self, parameters, position, rotation):
        return ((position * self.axis).sum(axis=-1) - parameters["zero"])[..., None]
'''
INSTRUMENTS = """
[instruments.station]
kind = "point"
frame_mm = [900.0, -500.0, 100.0]
frame_deg = [0.0, 0.0, 120.0]

[instruments.bar]
kind = "distance"
anchor_mm = [300.0, 200.0, 0.0]

[instruments.laser]
kind = "laser.py:Laser"
towards = [0.0, 0.6, 0.8]
"""
SENSORS = """
[sensors]
encoder = { noise_arcsec = 20.0 }
station = { noise_um = 30.0 }
bar = { noise_um = 5.0 }
laser = { noise_um = 2.0 }

[parameters]
a = { prior = "normal", sd = 1.0 }
o = { prior = "normal", sd = 0.5 }
station_frame = { prior = "normal", sd = 2.0 }
station_frame_r = { prior = "normal", sd = 0.5 }
bar_zero = { prior = "normal", sd = 1.0 }
laser_zero = { prior = "normal", sd = 2.0 }
"""
ARM = f"""
kind = "study"
name = "arm"
title = "An arm and instruments beside it"
seed = 3
machine = "machine.toml"

[provenance]
status = "simulated"
text = "drawn within its tolerances"

[[data]]
file = "data/readings.csv"
{INSTRUMENTS}{SENSORS}
[model_error]
terms = []

[[variants]]
name = "all"
title = "All instruments"

[[variants]]
name = "near"
title = "Without the station"
sensors = ["encoder", "bar", "laser"]
free = ["a", "o", "bar_zero", "laser_zero"]

[validation]
draws = 100

[next]
candidates = 0

[sampler]
walkers = 48
burn_in = 10
steps = 40

[evidence]
draws = 4000
max_draws = 4000
"""
SIMULATION = f"""
kind = "simulation"
name = "arm_data"
title = "Readings of an arm"
seed = 4
provenance = {{ status = "simulated", text = "drawn within its tolerances" }}
machine = "machine.toml"
n_poses = 20
n_verification_poses = 3
{INSTRUMENTS}{SENSORS}"""


def write_arm(folder):
    """Write an arm with three instruments, of one kind each, one of them of a class of its own."""
    folder.mkdir(exist_ok=True)
    (folder / "own_arm.py").write_text(Path(own_arm.__file__).read_text())
    (folder / "machine.toml").write_text(own_arm.MACHINE)
    (folder / "laser.py").write_text(OWN)
    (folder / "simulate.toml").write_text(SIMULATION)
    (folder / "study.toml").write_text(ARM)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Return the config of the arm's calibration, its readings simulated before the same instruments."""
    path = write_arm(tmp_path_factory.mktemp("arm"))
    studies.write_texts(path.parent / "data", studies.simulate(path.parent / "simulate.toml").files)
    return path


@pytest.fixture
def copied(arm, tmp_path):
    return Path(shutil.copytree(arm.parent, tmp_path / "arm")) / "study.toml"


def test_simulated_readings_are_the_calibrations(arm):
    """The columns of all instruments, and their true parameters beside the machine's."""
    table = pd.read_csv(arm.parent / "data" / "readings.csv", comment="#")
    assert {"encoder_1_rad", "station_x_mm", "station_z_mm", "bar_mm", "laser_mm"} <= set(table.columns)
    true = pd.read_csv(arm.parent / "data" / "true_parameters.csv", comment="#").set_index("parameter")["value"]
    assert true["station_frame[x]"] != 900.0
    assert true["bar_anchor[x]"] == 300.0  # without a prior it is known
    variants = read_inputs(load(arm)[1], arm.parent).variants
    assert variants["all"].model.names[-2:] == ("bar", "laser")
    assert set(variants["all"].priors) - set(variants["near"].priors) == {
        f"station_frame{r}[{k}]" for r in ("", "_r") for k in "xyz"
    }
    assert not variants["all"].model.pick(np.array([0])).channels[0].external
    assert variants["all"].internal.tolist() == [True] * 3 + [False] * 5


@pytest.fixture(scope="module")
def results(arm, tmp_path_factory):
    """Return results that have left the experiment behind, run once to the end, with a column that nobody takes."""
    from bayescal.experiments.runner.run import run_experiment

    folder = tmp_path_factory.mktemp("results")
    path = Path(shutil.copytree(arm.parent, folder / "arm")) / "study.toml"
    lines = [one for one in (arm.parent / "data" / "readings.csv").read_text().splitlines() if one[0] != "#"]
    ends = [",tracker_x_mm", *[",600.0"] * (len(lines) - 1)]
    (path.parent / "data" / "readings.csv").write_text("".join(f"{a}{b}\n" for a, b in zip(lines, ends, strict=True)))
    run_experiment(load(path)[1], path.parent, folder / "out")
    shutil.rmtree(path.parent)
    return folder / "out"


@pytest.mark.runs
def test_the_truth_lies_where_the_posterior_says(arm, results):
    found = pd.read_csv(results / "tables" / "parameters.csv")
    true = pd.read_csv(arm.parent / "data" / "true_parameters.csv", comment="#").set_index("parameter")["value"]
    every = found[found["variant"] == "all"].set_index("parameter")
    z = (every["mean"] - true[every.index]) / every["sd"]
    assert (z.abs() < 4.0).all()
    assert (every["sd"] < 0.5 * every["prior_sd"]).sum() > 8
    provenance = json.loads((results / "provenance.json").read_text())
    assert {"laser.py", "own_arm.py"} <= set(provenance["files"])
    line = "Not used: tracker_x_mm of data/readings.csv;"
    assert line in (results / "report.html").read_text()


@pytest.mark.runs
@pytest.mark.parametrize("variant", ["all", "near"])
def test_the_machine_alone_is_predicted_and_commanded(variant, results, tmp_path, call):
    """Instruments are no part of the calibrated machine, whose results keep their code for reverifications alone."""
    (tmp_path / "commands.csv").write_text(
        "pose,encoder_1_rad,encoder_2_rad,encoder_3_rad\nA,0.1,0.5,-1.1\nB,-0.4,0.7,-1.3\n"
    )
    asked = ("--variant", variant, "--trust-code")
    code, _, err = call("predict", results, tmp_path / "commands.csv", *asked, "--out", tmp_path / "poses.csv")
    assert code == 0, err
    pd.read_csv(tmp_path / "poses.csv", comment="#").filter(regex="^(pose|tool_[xyz]_mm)$").to_csv(
        tmp_path / "places.csv", index=False
    )
    code, _, err = call("compensate", results, tmp_path / "places.csv", *asked, "--out", tmp_path / "again.csv")
    assert code == 0, err
    told, found = (
        pd.read_csv(tmp_path / name, comment="#").set_index("pose") for name in ("commands.csv", "again.csv")
    )
    np.testing.assert_allclose(found[told.columns], told, rtol=0, atol=1e-6)


@pytest.mark.runs
def test_an_audit_chooses_among_instruments(arm, tmp_path, call):
    text = ARM.partition("[validation]")[0].replace('kind = "study"', 'kind = "audit"')
    text = text.replace("[model_error]\nterms = []\n\n", "")
    before, _, after = text.partition("[provenance]")
    audit = before + after[after.index("\n[instruments") :] + "\n[poses]\ncount = 12\n[next]\ncandidates = 10\n"
    path = arm.parent / "audit.toml"
    path.write_text(
        audit + '\n[sensor_selection]\nrequired_sensors = ["encoder"]\ncandidates = [["station"], "bar", "laser"]\n'
    )
    code, _, err = call("run", path, "--out", tmp_path / "out", "--workers", 1, "--quiet")
    assert code == 0, err
    sets = pd.read_csv(tmp_path / "out" / "tables" / "sensor_sets.csv")
    assert len(sets) == 8


# --- legs ----------------------------------------------------------------------------------------------------------


LEGS = """
kind = "study"
name = "legs"
title = "Legs and a pose"
seed = 1
machine = "machine.toml"

[provenance]
status = "simulated"
text = "made up"

[[data]]
file = "readings.csv"
commanded_channels = ["rho"]

{instruments}

[sensors]
rho = {{ noise_um = 1.0 }}
{sensors}

[parameters]
a_x = {{ prior = "normal", sd = 0.1 }}
b_z = {{ prior = "normal", sd = 0.1 }}
l = {{ prior = "normal", sd = 0.5 }}

[noise_factor_log_sd]
rho = 0.5

[model_error]
terms = []

[[variants]]
name = "all"
title = "All"
"""
TRACKER = """[instruments.tracker]
kind = "pose"
frame_mm = [0.0, 0.0, 0.0]
frame_deg = [0.0, 0.0, 0.0]
"""
SEEN = {**{name: f"tracker[{name}]" for name in "xyz"}, **{f"r{name}": f"tracker_r[{name}]" for name in "xyz"}}


def write_legs(folder, rng, instruments="", names=None):
    """Write a calibration of legs whose pose is seen by their own channels, or by an instrument's of other names."""
    folder.mkdir()
    (folder / "machine.toml").write_text(
        'kind = "legs"\nname = "m2"\nmechanism = "mechanism.toml"\nmodel = "six_ups"\n'
    )
    (folder / "mechanism.toml").write_text(MECHANISM.read_text())
    model = read_reading_model(folder / "machine.toml")
    n, reach = 12, np.array([4.0] * 3 + [0.004] * 3)  # within the actuators' range
    theta = model.layout.nominal.copy()
    theta[model.layout.index["l"]] += 0.3 * rng.standard_normal(6)
    pose = model.home_pose + reach * rng.uniform(-1.0, 1.0, (n, 6))
    chosen = model.select(["rho", *POSE])
    noise = np.array([1e-3] * 6 + [5e-3] * 3 + [1e-5] * 3)
    values = model.read(theta, pose)[:, chosen] + noise * rng.standard_normal((n, 12))
    stem = (lambda name: name) if names is None else lambda name: names[name].replace("[", "_").rstrip("]")
    columns = [f"rho_{k}_mm" for k in range(1, 7)]
    columns += [f"{stem(name)}_{'mm' if k < 3 else 'rad'}" for k, name in enumerate(POSE)]
    root = rng.standard_normal((6, 6))
    covariance = np.array([5.0] * 3 + [10.0] * 3)[:, None] * (np.eye(6) + 0.05 * (root + root.T))
    covariance = covariance * np.array([5.0] * 3 + [10.0] * 3)  # µm and µrad
    pairs = [(i, j) for i in range(6) for j in range(i, 6)]
    columns += [f"cov_{stem(POSE[i])}_{stem(POSE[j])}" for i, j in pairs]
    lines = [",".join(["pose", *columns])]
    for k, row in enumerate(values):
        numbers = [*row, *(covariance[one] for one in pairs)]
        lines.append(",".join([f"P{k}", *(repr(float(x)) for x in numbers)]))
    (folder / "readings.csv").write_text("\n".join(lines) + "\n")
    noise = "\n".join(
        f'"{(names or {}).get(name, name)}" = {{ noise_{u} = 1.0 }}'
        for name, u in zip(POSE, 3 * ["mm"] + 3 * ["rad"], strict=True)
    )
    (folder / "study.toml").write_text(LEGS.format(instruments=instruments, sensors=noise))
    return folder / "study.toml", covariance


def read(path):
    return read_inputs(load(path)[1], path.parent)


def test_a_tracked_pose_in_the_base_frame_is_legs_own(tmp_path):
    """The posterior by an instrument whose frame is known equals that by legs' own channels of the pose."""
    own, _ = write_legs(tmp_path / "own", np.random.default_rng(5))
    other, _ = write_legs(tmp_path / "other", np.random.default_rng(5), TRACKER, SEEN)
    one, two = (read(path).variants["all"].posterior().with_pose_guesses() for path in (own, other))
    assert one.n_parameters == two.n_parameters
    y = one.least_squares_start() + 0.05 * np.random.default_rng(6).standard_normal((6, one.n_parameters))
    np.testing.assert_allclose(two.natural(y), one.natural(y), rtol=1e-12)
    one, two = (replace(it, likelihood=it.likelihood.whole) for it in (one, two))
    np.testing.assert_allclose(two.pointwise(y), one.pointwise(y), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(two.log_density(y), one.log_density(y), rtol=1e-9)


def test_a_free_frame_leaves_less_to_know(tmp_path):
    """A tracker that may stand anywhere: its frame is free, and moves what the machine's own channels cannot tell."""
    path, _ = write_legs(tmp_path / "free", np.random.default_rng(5), TRACKER, SEEN)
    calibrations.change(path, "[parameters]", '[parameters]\ntracker_frame = { prior = "normal", sd = 5.0 }')
    posterior = read(path).variants["all"].posterior().with_pose_guesses()
    assert {"tracker_frame[x]", "tracker_frame[z]"} <= set(posterior.sampling.names)
    gradient, hessian = posterior.gradient(posterior.least_squares_start())
    assert np.isfinite(gradient).all()
    assert (np.linalg.eigvalsh(-hessian) > 0.0).all()


def test_covariances_are_taken_as_deviations_and_correlations(tmp_path):
    path, covariance = write_legs(tmp_path / "own", np.random.default_rng(5))
    data = read(path).variants["all"].data
    sd, correlation = data.sd[0, 6:], data.correlation[0, 6:, 6:]
    units = np.array([1e-3] * 3 + [1e-6] * 3)
    np.testing.assert_allclose(correlation * np.outer(sd, sd), covariance * np.outer(units, units), rtol=1e-12)
    np.testing.assert_array_equal(data.correlation[0, :6], np.eye(12)[:6])


@pytest.mark.runs
def test_what_poses_from_targets_writes_is_taken(tmp_path, call):
    """Its table as it stands, with the actuators in another one."""
    path, _ = write_legs(tmp_path / "own", np.random.default_rng(5))
    code, _, err = call(
        "poses-from-targets", studies.EXPERIMENTS / "telescope" / "study.toml", "--out", tmp_path / "p.csv"
    )
    assert code == 0, err
    table = pd.read_csv(tmp_path / "p.csv", comment="#")
    rho = pd.read_csv(path.parent / "readings.csv").filter(regex="^(pose|rho)")
    written = table.iloc[: len(rho)].assign(pose=rho["pose"])
    for k, axis in enumerate(POSE):  # poses of another machine; what counts here are the columns
        column = f"{axis}_{'mm' if k < 3 else 'deg'}"
        written[column] = pd.read_csv(path.parent / "readings.csv").iloc[:, 7 + k] * (1.0 if k < 3 else 180.0 / np.pi)
    written.to_csv(path.parent / "poses.csv", index=False)
    rho.to_csv(path.parent / "readings.csv", index=False)
    calibrations.change(path, "[[data]]", '[[data]]\nfile = "poses.csv"\n\n[[data]]')
    data = read(path).variants["all"].data
    expected = table.loc[0, "cov_x_rx"] * 1e-9
    assert data.correlation[0, 6, 9] * data.sd[0, 6] * data.sd[0, 9] == pytest.approx(expected, rel=1e-9)


def test_turned_readings_are_compared_as_rotations(tmp_path):
    path, _ = write_legs(tmp_path / "own", np.random.default_rng(5), TRACKER, SEEN)
    model = read(path).variants["all"].model
    assert Comparison(model.channels).rotations == [slice(9, 12)]


# --- what is said and what is refused ------------------------------------------------------------------------------


def leave_out_laser(path):
    calibrations.change(path, "laser = { noise_um = 2.0 }\n", "")
    calibrations.change(path, 'sensors = ["encoder", "bar", "laser"]', 'sensors = ["encoder", "bar"]')


def test_columns_that_nobody_takes_are_said(copied, call):
    leave_out_laser(copied)
    code, out, err = call("validate", copied)
    assert code == 0, err
    line = "Not used: laser_mm of data/readings.csv; expected them in [sensors], or in data.ignore"
    assert out.splitlines().count(line) == 1
    calibrations.change(copied, 'file = "data/readings.csv"', 'file = "data/readings.csv"\nignore = ["laser_mm"]')
    assert "Not used" not in call("validate", copied)[1]


def test_columns_that_one_variant_leaves_out_are_used(arm, call):
    code, out, _ = call("validate", arm)
    assert code == 0
    assert "Not used" not in out


REFUSED = {
    "another frame": (
        "frame_deg = [0.0, 0.0, 120.0]\n",
        "frame_deg = [0.0, 0.0, 20.0]",
        "instruments.station: readings lie",
    ),
    "unknown kind": ('kind = "point"', 'kind = "points"', "instruments.station.kind"),
    "unknown key": ("anchor_mm", "anker_mm", "anker_mm"),
    "unknown class": ("laser.py:Laser", "laser.py:Maser", "Maser"),
    "class that is none": ("laser.py:Laser", "own_arm.py:Arm", "expected a subclass of Instrument"),
    "rotation that is not there": (
        'kind = "point"',
        'kind = "pose"',
        "instruments.station: machine 'arm': expected a rotation vector",
    ),
    "target on a tool without rotation": (
        'kind = "distance"',
        'kind = "distance"\ntarget_mm = [0.0, 0.0, 10.0]',
        "instruments.bar: machine 'arm': expected a rotation vector",
    ),
    "channel of no instrument": (
        "bar = { noise_um",
        "rod = { noise_um",
        "sensor 'rod':",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_are_one_line_and_write_nothing(case, copied, tmp_path, refuse):
    old, new, message = REFUSED[case]
    calibrations.change(copied, old, new)
    refuse(re.escape(message), tmp_path / "out", "run", copied, "--quiet")


@pytest.mark.parametrize(
    ("column", "change", "message"),
    [
        ("x_sd_mm", None, "found columns 'cov_x_x' and 'x_sd_mm', expected one of them"),
        ("corr_x_y", None, "found columns 'cov_x_y' and 'corr_x_y', expected one of them"),
        (None, "cov_x_x", "cov_x_y: found no variance"),
        ("cov_y_x", None, "found column 'cov_y_x', expected pose, use, "),
    ],
)
def test_noise_is_stated_once(column, change, message, tmp_path, refuse):
    path, _ = write_legs(tmp_path / "own", np.random.default_rng(5))
    table = pd.read_csv(path.parent / "readings.csv")
    if column is not None:
        table[column] = 0.1
    if change is not None:
        table = table.drop(columns=[change])
    table.to_csv(path.parent / "readings.csv", index=False)
    refuse(message, tmp_path / "out", "run", path, "--quiet")


def test_a_machine_without_a_tool_takes_no_instrument(copied, tmp_path, refuse):
    source = copied.parent / "own_arm.py"
    text = source.read_text().replace(".tool(", ".place(").replace("def tool(", "def place(")
    start = text.index("    tool_channels = (")
    source.write_text(text[:start] + text[text.index("\n", start) + 1 :])
    said = "instruments.station: machine 'arm': expected tool_channels"
    refuse(said, tmp_path / "out", "run", copied, "--quiet")


def test_code_beside_a_config_is_not_run_where_that_is_refused(copied, call):
    code, out, err = call("validate", copied, "--no-custom-code")
    assert (code, out) == (2, "")
    assert re.search(r"instruments\.laser\.kind: found 'laser\.py:Laser'.* --no-custom-code", err)
