"""Every sampler draws the same posterior, and finds the same evidence where it finds one; what no config may name."""

from __future__ import annotations

import importlib.util
import re

import numpy as np
import pytest
import studies
import telescope_machines as machines

from bayescal.config.classes import ClassName
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.priors import NormalPrior
from bayescal.experiments.shared.estimate import estimate_posterior
from bayescal.inference import SAMPLERS
from bayescal.inference.samplers import EvidenceCheck
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.limits import ESS_BULK_WANTED

EFFORT = EvidenceConfig(draws=4000, max_draws=20_000)
LITTLE = {"smc": {"runs": 4, "chains": 128}, "nautilus": {"live_points": 300, "networks": 0, "effective_draws": 1000}}


@pytest.fixture(scope="module")
def posterior():
    """Return a telescope whose lengths are unknown: six coordinates, nearly normal."""
    machine = machines.build_machine("none")
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    found = machines.simulate_poses(machine, theta, machines.table_3_actuators()[:8], np.full(6, 5e-3), rng)
    nominal = dict(zip(machine.layout.names, machine.layout.nominal, strict=True))
    priors = {name: NormalPrior(value, 0.02) for name, value in nominal.items() if name.startswith("l")}
    return machines.measure(machine, found, priors, ErrorModel(())).with_pose_guesses()


@pytest.fixture(scope="module")
def usual(posterior):
    """Return what the default finds."""
    return estimate_posterior(posterior, 1, "lengths", SamplerConfig(), EFFORT)


def test_steps_go_on_until_means_are_as_sure_as_is_wanted(posterior):
    few = SamplerConfig(walkers=14)
    assert few.ensembles * few.walkers * few.plan(is_easy=True)[1] < ESS_BULK_WANTED
    found = estimate_posterior(posterior, 3, "lengths", few, EFFORT)
    assert found.diagnostics.ess_bulk.min() >= ESS_BULK_WANTED
    stated = estimate_posterior(posterior, 3, "lengths", few.model_copy(update={"steps": 15}), EFFORT)
    assert stated.diagnostics.ess_bulk.min() < ESS_BULK_WANTED


@pytest.mark.runs
@pytest.mark.parametrize("name", sorted(SAMPLERS))
def test_every_sampler_draws_the_same_posterior(name, posterior, usual):
    if importlib.util.find_spec(name) is None and name == "nautilus":
        pytest.skip("nautilus is not installed")
    backend = ClassName(name, "SAMPLERS", LITTLE.get(name, {}))
    found = estimate_posterior(posterior, 2, "lengths", SamplerConfig.model_construct(backend=backend), EFFORT)
    assert np.abs(found.mean - usual.mean).max() < 0.1 * usual.sd.min()
    np.testing.assert_allclose(found.sd, usual.sd, rtol=0.06)
    assert found.diagnostics.rhat.max() < 1.02
    assert found.log_evidence == pytest.approx(usual.log_evidence, abs=0.03)
    assert (found.check is None) == (name == "emcee")
    if found.check is not None:
        assert found.check.mixed
        assert found.check.log_evidence == pytest.approx(
            usual.log_evidence, abs=max(0.05, 4 * found.check.standard_error)
        )


def test_runs_that_are_apart_do_not_agree():
    agreed = EvidenceCheck.of_runs([-10.0, -10.1, -9.9, -10.0], [0.1] * 4)
    assert agreed.mixed
    assert agreed.log_evidence == pytest.approx(-10.0, abs=0.02)
    assert 0.04 < agreed.standard_error < 0.06
    assert not EvidenceCheck.of_runs([-10.0, -13.0, -10.0, -10.0], [0.05] * 4).mixed


REFUSED = {
    ("sampler", 'backend = "nuts"'): r"sampler\.backend: found 'nuts', .*expected one of emcee, nautilus, smc",
    ("evidence", 'cross_check = "emcee"'): r"evidence\.cross_check: found 'emcee',",
    (
        "sampler",
        'backend = { class = "smc", runs = 3 }',
    ): r"sampler\.backend\.runs: found 3, expected greater than or equal to 4",
}


@pytest.mark.parametrize("section", REFUSED)
def test_what_is_no_sampler_is_refused(section, tmp_path, call):
    path, (table, line) = studies.write_tiny_study(tmp_path), section
    studies.edit(path, f"[{table}]\n", f"[{table}]\n{line}\n")
    code, _, err = call("validate", path)
    assert code == 2
    assert re.search(REFUSED[section], err), err
