"""Posteriors as files: ArviZ opens each and judges it, without a warning and without being told where anything is."""

from __future__ import annotations

import arviz as az
import numpy as np
import pytest
import studies
from saved_trees import check_tree, scale_power

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.shared.posterior_files import choose_draws, write_packed
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.readings import fit_variant
from bayescal.numerics.geometry import matrix_from_rotation_vector

VARIANT = "six_pus/matrix"
INFLUENTIAL = pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto")  # 12 parameters of 13 poses
POSE = ["x", "y", "z", "rx", "ry", "rz"]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> StudyInputs:
    """Return a tiny study whose ensembles are long enough to be judged."""
    folder = tmp_path_factory.mktemp("tiny")
    studies.write_tiny_study(folder)
    config = load_experiment(folder / "study.toml")
    sampler = config.sampler.model_copy(update={"walkers": 32, "burn_in": 10, "steps": 20})
    return StudyInputs.load(config.model_copy(update={"sampler": sampler}), folder)


@pytest.fixture(scope="module")
def fit(inputs):
    return fit_variant(inputs, VARIANT)


@pytest.fixture(scope="module")
def tree(fit, tmp_path_factory):
    """Return the tree as it is read from its file."""
    path = tmp_path_factory.mktemp("posterior") / "six_pus-matrix.nc"
    write_packed(fit.evaluated[TREE], path)
    return check_tree(path, k_is_good=False)


def test_arviz_scales_the_power_as_the_study_does(tree, fit):
    table = scale_power(tree)
    assert list(table.index) == [*(f"{symbol}[{leg}]" for symbol in ("l", "kappa") for leg in range(1, 7)), "tau"]
    np.testing.assert_allclose(table[["prior", "likelihood"]].to_numpy(float), fit.power_scaling, atol=1e-6)


@INFLUENTIAL
def test_leaving_poses_out_agrees_with_arviz(tree, fit):
    found, loo = fit.left_out, az.loo(tree, pointwise=True)
    # by weights alone, as ArviZ does it: poses that weigh too much are refitted here; the file has some of the draws
    assert float(loo.elpd) == pytest.approx(found.weighted.sum(), abs=0.5)
    np.testing.assert_allclose(loo.elpd_i, found.weighted, atol=0.3)


def test_the_draws_are_those_that_the_fit_summarises(tree, fit):
    assert tree.attrs["variant"] == VARIANT
    assert tree["posterior/l"].dims == ("chain", "draw", "leg")
    assert tree["posterior/l"].sizes["chain"] == 4
    for k, leg in enumerate(range(1, 7)):
        stored = tree["posterior/l"].sel(leg=leg)
        assert abs(float(stored.mean()) - fit.mean[k]) < 0.05 * fit.sd[k]  # the file has some of the draws
        assert float(stored.std()) == pytest.approx(fit.sd[k], rel=0.05)


def test_groups_fit_together(tree, inputs):
    sizes = {tree[name].sizes["draw"] for name in ("posterior", "log_prior", "log_likelihood", "posterior_predictive")}
    assert len(sizes) == 1
    assert set(tree["prior"].data_vars) == set(tree["posterior"].data_vars) == set(tree["log_prior"].data_vars)
    assert tree["log_likelihood"].sizes["row"] == int((~inputs.verification).sum())
    assert tree["posterior/l"].attrs["units"] == "mm"
    assert tree["observed_data/unit"].to_numpy().tolist() == ["mm"] * 9 + ["rad"] * 3


def test_prior_draws_and_densities_are_those_of_the_tolerances(tree):
    prior, length = tree["prior"], tree["posterior/l"]
    assert float(prior["l"].std()) == pytest.approx(2.0, rel=0.1)
    assert float(prior["l"].mean()) == pytest.approx(500.0, abs=0.2)
    assert float((prior["tau"] ** 2).mean() ** 0.5) == pytest.approx(0.01, rel=0.15)
    expected = -0.5 * ((length - 500.0) / 2.0) ** 2 - np.log(2.0 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(tree["log_prior/l"], expected, rtol=1e-12)


def test_replicates_scatter_about_the_measured_poses(tree, inputs):
    """As far as the noise says: had they another reference than the measured, they would lie whole mm away."""
    poses, used, position = inputs.measured[0].poses, ~inputs.verification, {"channel": POSE[:3]}
    measured = tree["observed_data/readings"]
    np.testing.assert_array_equal(measured.sel(position), poses.position[used])
    turned = matrix_from_rotation_vector(measured.sel(channel=POSE[3:]).to_numpy())
    np.testing.assert_allclose(turned, poses.rotation[used], atol=1e-12)
    away = tree["posterior_predictive/readings"].sel(position) - measured.sel(position)
    assert float(np.abs(away).max()) < 0.1
    assert 0.002 < float(away.std(("chain", "draw")).mean()) < 0.02


def test_as_many_draws_are_chosen_of_each_chain():
    chosen = choose_draws(3, 100, 50)
    assert chosen.shape == (3, 16)
    assert all(((chain * 100 <= own) & (own < (chain + 1) * 100)).all() for chain, own in enumerate(chosen))
    assert (choose_draws(2, 10, 50) == np.arange(20).reshape(2, 10)).all()
