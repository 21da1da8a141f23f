"""The shipped study with every parameter free: no mode of flexures twice as long as stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.density.calibration.independent_rows import FollowedBound
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import explore
from bayescal.inference.mode import find_mode

RIDGES = Path(__file__).parents[3] / "experiments" / "telescope" / "ridges.toml"


@pytest.mark.runs
@pytest.mark.parametrize("name", ["stiffness/none", "stiffness/linear"])
def test_ridges_of_stiffness_have_a_fast_form_and_a_proposal(name):
    """Closures are forces, whose scale goes with the stiffness: only readings followed to the pose do without it."""
    inputs = StudyInputs.load(load_experiment(RIDGES), RIDGES.parent, only=[name])
    posterior = inputs.variants[name].posterior().with_pose_guesses()
    assert isinstance(posterior.likelihood.lone.bound, FollowedBound)
    found = explore(posterior, np.random.SeedSequence(1), max_pilots=0)
    assert found.efficiency > 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stiffness/none", "stiffness/linear"])
def test_climbs_from_long_flexures_lead_back(name):
    inputs = StudyInputs.load(load_experiment(RIDGES), RIDGES.parent)
    posterior = drop_model_error(inputs.variants[name].posterior()).with_pose_guesses()
    found = explore(posterior, np.random.SeedSequence(1), max_pilots=0, from_prior=True)
    best = found.modes[0]
    assert best.converged
    assert len(found.modes) == 1
    long = best.y.copy()
    long[[symbol.startswith("l_b") for symbol in posterior.names]] += 10.0
    assert find_mode(posterior, long).log_density == pytest.approx(best.log_density, abs=0.01)
