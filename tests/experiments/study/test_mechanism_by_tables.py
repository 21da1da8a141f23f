"""A mechanism's file calibrated by tables of readings: variants' models and deformations make its channels."""

import shutil

import numpy as np
import pytest
import studies
import telescope_machines

import bayescal
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.files.csv_tables import format_table
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import Legs

N_POSES = 14
STUDY = """kind = "study"
name = "legs"
title = "Legs by readings"
seed = 3
machine = "mechanism.toml"
provenance = { status = "simulated", text = "for the tests" }

[[data]]
file = "readings.csv"
commanded_channels = ["rho"]

[sensors]
rho = { noise_um = 1.0 }
x = { noise_um = 5.0 }
y = { noise_um = 5.0 }
z = { noise_um = 5.0 }
rx = { noise_arcsec = 2.0 }
ry = { noise_arcsec = 2.0 }
rz = { noise_arcsec = 2.0 }

[deformation]
kappa = 0.01

[parameters]
l = { prior = "normal", sd = 0.5 }
kappa = { prior = "normal", sd = 0.01 }

[model_error]
rho = { scale = 0.002 }

[error_terms.wave]
channels = ["rho"]
kernel = "linear"
scale_um = 5.0

[[variants]]
model = "six_pus"

[[variants]]
model = "six_pus"
deformation = "linear"

[[variants]]
name = "all errors"
model = "six_pus"
outlier_fraction = 0.05

[validation]
folds = 2
draws = 100

[sampler]
ensembles = 4
walkers = 16
burn_in = 2
steps = 6

[evidence]
draws = 1000
max_draws = 1000
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the telescope, readings of its actuators and poses, and a study."""
    folder = tmp_path_factory.mktemp("legs")
    shutil.copy(studies.TELESCOPE / "mechanism.toml", folder)
    legs = Legs(telescope_machines.build_machine("none", load_mechanism(folder / "mechanism.toml")))
    rng = np.random.default_rng(4)
    home = np.array([one.home for one in legs.coordinates])
    poses = home + rng.uniform(-1.0, 1.0, (N_POSES, 6)) * [1.0, 1.0, 1.0, 0.002, 0.002, 0.002]
    read = legs.read(legs.layout.nominal, poses, {})
    noise = [1e-3] * 6 + [5e-3] * 3 + [1e-5] * 3
    values = read[:, :12] + noise * rng.standard_normal((N_POSES, 12))
    columns = [f"{one.stem}_{one.unit}" for one in legs.channels[:12]]
    rows = [(f"P{k}", *(repr(float(x)) for x in row)) for k, row in enumerate(values)]
    (folder / "readings.csv").write_text(format_table([], ["pose", *columns], rows))
    (folder / "study.toml").write_text(STUDY)
    return folder


def test_variants_are_named_after_what_they_are_seen_by(folder):
    experiment, config = load(folder / "study.toml")
    inputs = experiment.read(config, folder)
    assert list(inputs.variants) == ["six_pus/none", "six_pus/linear", "all errors"]
    assert "kappa" in {name.partition("[")[0] for name in inputs.variants["six_pus/linear"].priors}
    assert "kappa" not in {name.partition("[")[0] for name in inputs.variants["six_pus/none"].priors}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('model = "six_pus"\n\n', "", "model: missing"),
        ('deformation = "linear"', 'deformation = "matrix"', "deformation.matrix: found 'targets'"),
    ],
)
def test_what_means_nothing_here_is_refused(folder, tmp_path, refuse, old, new, message):
    for name in ("mechanism.toml", "readings.csv"):
        shutil.copy(folder / name, tmp_path)
    (tmp_path / "study.toml").write_text(STUDY.replace(old, new, 1))
    refuse(message, tmp_path / "out", "run", tmp_path / "study.toml", "--quiet")


@pytest.mark.runs
def test_errors_of_the_pose_outliers_and_folds_go_together_and_the_machine_is_kept(folder, tmp_path, call):
    call("run", folder / "study.toml", "--out", tmp_path / "out", "--quiet")
    results = bayescal.load_results(tmp_path / "out")
    row = results.tables["variants"].set_index("variant").loc["all errors"]
    assert np.isfinite([row["log_evidence"], row["elpd"]]).all()
    parameters = results.tables["parameters"]
    mine = set(parameters[parameters["variant"] == "all errors"]["parameter"])
    assert {"model_error(rho)", "epsilon"} < mine
    found = load_calibrated(tmp_path / "out", "six_pus/linear", allow_unconverged=True)
    assert "kappa" in found.model.layout.symbols
    assert found.draws is not None
