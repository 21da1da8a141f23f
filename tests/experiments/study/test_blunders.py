"""A study in which poses may be outliers: the spoiled one is named, a clean one has none, what cannot be is refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment, write_report

pytestmark = pytest.mark.runs

OFF = 0.3  # mm
RIGID = '[[variants]]\nmodel = "six_pus"\ndeformation = "none"\nfree = ["l"]\n\n'


def write_study(folder):
    """Write a tiny study of the variant that is right alone."""
    path = studies.write_tiny_study(folder)
    studies.edit(path, RIGID, "")
    return path


def allow_outliers(path, share="0.02"):
    path.write_text(path.read_text().replace("[[variants]]\n", f"[[variants]]\noutlier_fraction = {share}\n"))
    return path


def spoil(path, pose):
    """Move all targets on the platform of one pose along x."""
    file = path.parent / "data" / "targets.csv"
    lines = file.read_text().splitlines()
    head = [line for line in lines if line.startswith("#")]
    table = pd.read_csv(file, comment="#", dtype={"pose": str})
    moved = (table["pose"] == pose) & (table["body"] == "platform")
    assert moved.any()
    table.loc[moved, "x_mm"] += OFF
    file.write_text("\n".join(head) + "\n" + table.to_csv(index=False))


def first_pose(path):
    return pd.read_csv(path.parent / "data" / "actuators.csv", comment="#", dtype=str)["pose"][4]


@pytest.mark.parametrize("spoiled", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_blunders_are_named_on_the_page(tmp_path, spoiled, no_pictures, search_little):
    path = allow_outliers(write_study(tmp_path))
    pose = first_pose(path)
    if spoiled:
        spoil(path, pose)
    finished = run_experiment(load_experiment(path), tmp_path, tmp_path / "out")
    table = finished.results.table("poses")
    best = table[table["variant"] == finished.summary["rankings"][0][0]]
    assert len(best) == studies.N_CALIBRATION
    named = list(best[best["is_outlier"]]["pose"].astype(str))
    assert named == ([pose] if spoiled else [])
    actions = [one.action for one in finished.page.verdict if one.lead == "Outliers"]
    assert any(pose in action for action in actions) == spoiled
    fit = finished.summary["variants"]["six_pus/matrix"]
    assert studies.read_posterior(tmp_path / "out", "six_pus/matrix")["epsilon"]["verdict"] == "noise"
    assert fit["misfit_chi2"] < 2.0 * fit["misfit_dof"]
    assert ("Contradicted poses" in write_report(tmp_path / "out").read_text()) == spoiled


def test_variants_with_and_without_stand_side_by_side(tmp_path, no_pictures, search_little):
    path = write_study(tmp_path)
    own = '[[variants]]\nmodel = "six_pus"\ndeformation = "matrix"\nfree = ["l", "kappa"]\n'
    studies.edit(path, own, f'{own}\n{own}name = "wary"\noutlier_fraction = 0.02\n')
    for spoiled in (False, True):
        if spoiled:
            spoil(path, first_pose(path))
        finished = run_experiment(load_experiment(path), tmp_path, tmp_path / f"out{spoiled}")
        table, (first, *_) = finished.results.table("poses"), finished.summary["rankings"][0]
        assert first == ("wary" if spoiled else "six_pus/matrix")
        assert table[table["variant"] == "wary"]["is_outlier"].any() == spoiled


def test_a_study_without_them_says_nothing(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    plain = load_experiment(path).model_dump(mode="json")
    assert not any("outlier_fraction" in one for one in plain["variants"])
    assert all(one.outlier_fraction == 0.02 for one in load_experiment(allow_outliers(path)).variants)


@pytest.mark.parametrize("share", ["0.0", "0.5", "-1", '"few"'])
def test_impossible_shares_are_refused(tmp_path, share):
    path = allow_outliers(studies.write_tiny_study(tmp_path), share)
    with pytest.raises(InputError, match=r"variants.0.outlier_fraction"):
        load_experiment(path)


def test_poses_measured_in_part_may_be_outliers_too(tmp_path):
    folder = studies.EXPERIMENTS / "camera_hexapod"
    path = studies.copy_small(folder / "study.toml", tmp_path / "camera")
    allow_outliers(path)
    inputs = studies.load_study(path)
    posterior = next(iter(inputs.variants.values())).posterior().with_pose_guesses()
    y = posterior.least_squares_start()[None]
    square = np.sum(posterior.likelihood.residuals(*posterior.at(y)) ** 2, axis=-1)
    trust = posterior.errors.tails(posterior.zeta(y)).trust(square, posterior.likelihood.n_spare)[0]
    assert posterior.names[-1] == "epsilon"
    assert np.argmin(trust) == np.argmax(square)
    assert trust.max() < 1.0
