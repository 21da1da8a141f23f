"""The shipped study with every parameter free: no mode of flexures twice as long as stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.study.inputs import load_inputs
from bayescal.inference.exploration import explore
from bayescal.inference.mode import find_mode

pytestmark = pytest.mark.slow

RIDGES = Path(__file__).parents[3] / "experiments" / "telescope" / "ridges.toml"


@pytest.mark.parametrize("name", ["stiffness/none", "stiffness/linear"])
def test_climbs_from_long_flexures_lead_back(name):
    """The density of the hot path is larger there by a hundred nats, that of solved pose errors smaller by as much."""
    inputs = load_inputs(load_experiment(RIDGES), RIDGES.parent)
    posterior = inputs.posterior(inputs.variant(name), with_model_error=False)
    found = explore(posterior, np.random.SeedSequence(1), max_pilots=0, anew=True)
    finer, best = found.straight.posterior, found.modes[0]
    assert finer.likelihood.is_solved
    assert best.converged
    assert len(found.modes) == 1
    long = best.y.copy()
    long[[symbol.startswith("l_b") for symbol in posterior.names]] += 10.0
    astray = posterior.polish(long)
    assert posterior.log_density(astray[None])[0] > best.log_density + 100.0
    assert finer.log_density(astray[None])[0] < best.log_density - 100.0
    for start in (long, astray):
        assert find_mode(finer, start).log_density == pytest.approx(best.log_density, abs=0.01)
