"""Updating a posterior: the same as beginning again, whichever mode it starts from."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import studies

from bayescal.inference import updating
from bayescal.inference.mode import find_modes
from bayescal.inference.updating import maximise, update

N_DRAWS = 1000


@pytest.fixture(scope="module")
def posteriors(tmp_path_factory):
    """Return the posteriors of the first eight poses of a tiny study, and of all of them."""
    inputs = studies.load_study(studies.write_tiny_study(tmp_path_factory.mktemp("updating")))
    variant = inputs.variants["six_pus/matrix"]
    used = ~variant.verification
    first = used & (np.cumsum(used) <= 8)
    return variant.posterior(first).with_pose_guesses(), variant.posterior(used).with_pose_guesses()


def test_the_mode_is_that_of_a_search_from_the_beginning(posteriors):
    before, whole = posteriors
    start = maximise(before, before.least_squares_start()).y
    found, searched = maximise(whole, start), find_modes(whole)[0]
    assert found.converged
    assert found.log_density == pytest.approx(searched.log_density, abs=1e-3)
    sd = np.sqrt(np.diag(searched.covariance))
    assert np.abs((found.y - searched.y) / sd).max() < 0.02


@pytest.mark.slow
def test_an_update_is_what_exploring_anew_finds(posteriors, monkeypatch):
    before, whole = posteriors
    updated = update(whole, maximise(before, before.least_squares_start()).y, N_DRAWS, 3)
    assert updated.way == "updated"
    monkeypatch.setattr(updating, "PARETO_K_LIMIT", -np.inf)  # nothing is good enough: all ways are gone
    monkeypatch.setattr(updating, "sample_posterior", fail)
    with pytest.raises(ArithmeticError, match="ensembles"):
        update(whole, None, N_DRAWS, 3)
    monkeypatch.undo()
    again = updating._begin_anew(whole, N_DRAWS, 4)
    assert again.way in ("explored", "sampled")
    spread = again.draws.std(axis=0)
    # each mean errs by spread / sqrt(effective draws); a few hundred of these count
    assert np.abs((updated.draws.mean(axis=0) - again.draws.mean(axis=0)) / spread).max() < 0.25
    assert updated.draws.std(axis=0) / spread == pytest.approx(1.0, abs=0.25)


def fail(*_arguments):
    raise ArithmeticError("ensembles")


def test_the_same_seed_gives_the_same_draws(posteriors):
    _, whole = posteriors
    start = maximise(whole, whole.least_squares_start()).y
    assert np.array_equal(update(whole, start, 200, 5).draws, update(whole, start, 200, 5).draws)


def test_of_two_solutions_one_machine_is_kept(pytestconfig, tmp_path):
    folder = shutil.copytree(pytestconfig.rootpath / "tests/cases/two_modes", tmp_path / "two_modes")
    (variant,) = studies.load_study(folder / "study.toml").variants.values()
    found = updating._begin_anew(variant.posterior().with_pose_guesses(), 400, 1)
    assert found.draws.shape[0] == 400
    posterior = variant.posterior().with_pose_guesses()
    place = posterior.names.index("b")
    side = np.sign(posterior.natural(found.draws)[:, place])
    assert abs(side.sum()) == 400
    assert np.sign(posterior.natural(found.y[None])[0, place]) == side[0]
