"""Faults that show only when a study's files meet: found before any long computation, named by file and place."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import studies
from refusals import line_of

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import engine
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.study import compute


@pytest.fixture
def folder(tmp_path) -> Path:
    """Return a folder with a tiny study and its data."""
    studies.write_tiny_study(tmp_path)
    return tmp_path


def change_targets(folder: Path, change: Callable[[list[str]], list[str] | None]) -> None:
    path = folder / "data" / "targets.csv"
    lines = path.read_text().splitlines()
    rows = [change(line.split(",")) for line in lines[3:]]
    path.write_text("\n".join([*lines[:3], *(",".join(row) for row in rows if row is not None)]) + "\n")


def fail(folder: Path, file: str) -> str:
    """Return the one-line message with which loading fails; it names the file at fault."""
    message = line_of(studies.load_study, folder / "study.toml")
    assert re.sub(r"^variant '[^']+': ", "", message).startswith(str(folder / file))
    assert "expected" in message
    return message


def leave_only_the_variant_none(folder: Path) -> None:
    """Let no variant need K."""
    text = (folder / "study.toml").read_text()
    at = text.index('[[variants]]\nmodel = "six_pus"\ndeformation = "matrix"')
    text = text[:at] + text[text.index("[sampler]") :]
    (folder / "study.toml").write_text(text.replace('kappa = { prior = "normal", sd = 0.01 }\n', ""))


def test_pad_that_was_not_seen_names_pose_and_leg(folder):
    change_targets(folder, lambda row: None if row[0] == "C03" and row[2].startswith("L2") else row)
    assert re.search(r"pose 'C03': .*leg 2: ", fail(folder, "data/targets.csv"))
    leave_only_the_variant_none(folder)
    assert studies.load_study(folder / "study.toml").pads.pads is None  # nobody asks for it


def test_poses_too_few_for_the_matrix(folder):
    path = folder / "data" / "actuators.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:8], *(x for x in lines[8:] if x.startswith("V"))]) + "\n")
    kept = {line.split(",")[0] for line in path.read_text().splitlines()}
    change_targets(folder, lambda row: row if row[0] in kept else None)
    assert "5 poses of rank 5" in fail(folder, "data/targets.csv")
    leave_only_the_variant_none(folder)
    assert studies.load_study(folder / "study.toml").pads.pads is None


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("study.toml", "target_noise_um = 3.0", "target_noise_um = 1e-300", "data.0.target_noise_um: found 1e-300"),
        ("study.toml", "noise_um = 1.0", "noise_um = 1e200", "sensors.rho.noise_um: found 1e+200"),
        ("study.toml", "sd = 2.0", "sd = 1e300", "parameters.l.sd: found 1e+300"),
        (
            "study.toml",
            "prior_width_factors = [1.0]",
            "prior_width_factors = [1e-300]",
            "sensitivity.prior_width_factors.0: found 1e-300",
        ),
        ("study.toml", "offset = 0.0", "offset = 1e300", "parameters.b_z.offset: found 1e+300"),
        ("study.toml", 'free = ["l"]', 'free = ["l", "l"]', "free: found 'l' twice, expected it once"),
        ("study.toml", "draws = 1000", "draws = 5000", "max_draws 1000, expected at least draws 5000"),
        ("mechanism.toml", "[0.0, 0.0, 1.0]", "[0.0, 0.0, 1e300]", "legs.direction.2: found 1e+300"),
        ("mechanism.toml", "radius_mm = 130.0", "radius_mm = 9.0\npoints_mm = [[1, 2, 3]]", "platform: expected"),
        ("mechanism.toml", "azimuth_deg = [265.0", "points_mm = [[1, 2, 3]]\n#", "platform: expected radius_mm"),
    ],
)
def test_slips_in_numbers(folder, name, old, new, expected):
    studies.edit(folder / name, old, new)
    assert expected in fail(folder, name)


# --- models of flexures ----------------------------------------------------------------------------------------------

FIRST_VARIANT = 'model = "six_pus"\ndeformation = "none"\nfree = ["l"]'
FIXED = 'b_z = { prior = "fixed", offset = 0.0 }\n'


def choose(folder: Path, model: str, parameter: str = "", free: str = '["l"]') -> None:
    """Let the study's first variant take another model, with one more line of [parameters] and what it frees."""
    studies.edit(folder / "study.toml", FIRST_VARIANT, f'model = "{model}"\ndeformation = "none"\nfree = {free}')
    studies.edit(folder / "study.toml", FIXED, f"{FIXED}{parameter}\n")


def fail_variant(folder: Path, name: str) -> str:
    """Return the one-line message with which loading fails; it names the variant at fault."""
    message = line_of(studies.load_study, folder / "study.toml")
    assert message.startswith(f"variant {name!r}: ")
    assert "expected" in message
    return message


OUTSIDE = [
    ("beam", "beta", "fixed", "0.35", "found 0.6, expected above 0 and below"),
    ("beam", "beta[4]", "fixed", "[0, 0, 0, -0.25, 0, 0]", "found 0, expected above 0 and below 0.5"),
    ("beam", "l_b", "fixed", "-11", "found -1 mm, expected above 0"),
    ("stiffness", "k1_d", "fixed", "-1e6", "found -990183 N mm2, expected above"),
    ("six_pus", "u_x", "fixed", "1.5", "found 1.5, expected above -1 and below"),
    ("beam", "beta", "uniform", "0.3", "found a prior from -0.05 to 0.55, expected it within 0 to 0.5"),
    ("beam", "beta[3]", "uniform", "[0.1, 0.1, 0.3, 0.1, 0.1, 0.1]", "found a prior from -0.05 to 0.55"),
    ("beam", "l_b", "uniform", "11.0", "found a prior from -1 to 21, expected it within 0 to inf"),
    ("stiffness", "k1_d", "uniform", "1e6", "found a prior from -990183 to 1.00982e+06, expected it within 0 to inf"),
    ("six_pus", "u_x", "uniform", "1.5", "found a prior from -1.5 to 1.5, expected it within -1 to 1"),
]
"""Models, parameters, the kind of their prior, its offset or half width, and what is said of it."""


@pytest.mark.parametrize(("model", "name", "prior", "size", "expected"), OUTSIDE)
def test_values_and_priors_outside_the_bounds(folder, model, name, prior, size, expected):
    symbol, key = name.partition("[")[0], {"fixed": "offset", "uniform": "half_width"}[prior]
    free = f'["{symbol}"]' if prior == "uniform" else '["l"]'
    choose(folder, model, f"{symbol} = {{ prior = '{prior}', {key} = {size} }}", free)
    first = name if "[" in name or model == "stiffness" else f"{name}[1]"
    assert f"parameter {first}: {expected}" in fail_variant(folder, f"{model}/none")


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("six_pus", "u_x = { prior = 'fixed', offset = 0.8 }\nu_y = { prior = 'fixed', offset = 0.8 }"),
        ("jacobian", "a_x = { prior = 'fixed', offset = [0, 0, 600.0, 0, 0, 0] }"),
        ("beam", "a_x = { prior = 'fixed', offset = [0, 0, 600.0, 0, 0, 0] }"),
        ("stiffness", "a_x = { prior = 'fixed', offset = [0, 0, 600.0, 0, 0, 0] }"),
    ],
    ids=["direction off the sphere", "no home pose", "no home pose of a beam", "no home pose of the stiffness model"],
)
def test_a_start_that_is_no_machine(folder, model, parameters):
    """Every value lies between its bounds, and yet there is no such machine."""
    choose(folder, model, parameters)
    assert "prior centres" in fail_variant(folder, f"{model}/none")


@pytest.mark.parametrize("model", ["beam", "stiffness", "stiffness_fixed"])
@pytest.mark.parametrize("section", ["flexures", "stiffness"])
def test_models_of_flexures_need_them(folder, model, section):
    path = folder / "mechanism.toml"
    path.write_text(path.read_text()[: path.read_text().index(f"[{section}]")])
    choose(folder, model)
    if section == "stiffness" and model == "beam":
        assert studies.load_study(folder / "study.toml").pads.mechanism.flexures.section is None
    else:
        assert f"no [{section}]" in fail(folder, "mechanism.toml")


def test_a_model_of_another_drive_is_refused(folder):
    choose(folder, "six_ups")
    assert "model 'six_ups':" in fail(folder, "mechanism.toml")


def test_one_stiffness_for_all_legs(folder):
    choose(folder, "stiffness", "k1_d = { prior = 'uniform', half_width = [1, 2, 3, 4, 5, 6] }", '["k1_d"]')
    assert "parameters.k1_d: found 6" in fail_variant(folder, "stiffness/none")


@pytest.mark.parametrize("model", ["jacobian", "beam", "stiffness", "stiffness_fixed"])
def test_every_model_loads(folder, model):
    choose(folder, model)
    inputs = studies.load_study(folder / "study.toml")
    assert inputs.variants[f"{model}/none"].whole.machine.model.name == model


@pytest.mark.parametrize("error", [ValueError("array must not contain infs"), OverflowError(34, "too large")])
def test_a_failure_of_scipy_is_numerical(folder, monkeypatch, error):
    def fail_always(inputs, task):
        raise error

    monkeypatch.setattr(compute, "fit_variant", fail_always)
    with pytest.raises(NumericalError, match="six_pus/none"):
        run_experiment(load_experiment(folder / "study.toml"), folder, folder / "out")


@pytest.mark.runs
def test_left_handed_targets_are_a_numerical_failure_or_a_misfit(folder):
    change_targets(folder, lambda row: [*row[:5], str(-float(row[5]))])
    try:
        result = run_experiment(load_experiment(folder / "study.toml"), folder, folder / "out")
    except (InputError, NumericalError):
        return
    assert not result.converged


def kill_worker(parent, *_):
    """Stand for the kernel that ends a process for want of memory."""
    import os

    assert os.getpid() != parent
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.runs
def test_a_killed_worker_is_a_numerical_failure(folder, monkeypatch):
    monkeypatch.setattr(engine, "_call_in_worker", kill_worker)
    with pytest.raises(NumericalError, match="worker was"):
        run_experiment(load_experiment(folder / "study.toml"), folder, folder / "out", workers=2)
