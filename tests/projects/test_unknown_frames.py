"""The line that a project's study has for an instrument in a frame of its own: posteriors are found, and right."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.experiments.runner.load import load
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import explore
from bayescal.projects.start import start_project

OFFERED = "# frames.base = { position = 2.0, rotation = 0.1 }"
NATS = 0.05


@pytest.fixture(scope="module", params=["points", "poses"])
def folder(request, tmp_path_factory):
    """Return a project in which the base's frame is looked for."""
    folder = tmp_path_factory.mktemp("project") / request.param
    start_project(folder, "hexapod", request.param)
    text = (folder / "study.toml").read_text()
    assert OFFERED in text
    (folder / "study.toml").write_text(text.replace(OFFERED, OFFERED.removeprefix("# ")))
    return folder


@pytest.mark.parametrize("terms", ["", '[model_error]\nterms = ["random"]\n'], ids=["default", "random"])
def test_the_density_leaves_nothing_out_and_a_proposal_is_found(folder, terms):
    path = folder / f"study{len(terms)}.toml"
    path.write_text((folder / "study.toml").read_text() + terms)
    (variant,) = StudyInputs.load(load(path)[1], folder).variants.values()
    posterior = variant.posterior().with_pose_guesses()
    found = explore(posterior, np.random.default_rng(1).bit_generator.seed_seq, from_prior=True)
    assert found.efficiency > 0.5
    y = found.straight.y_from_x(found.proposal.draw(30, np.random.default_rng(2)))
    at = posterior.at(y)
    whole = posterior.likelihood.whole.density(*at)
    difference = posterior.likelihood.density(*at) - whole
    assert np.std(difference) < NATS
    assert np.std(whole) > 1.0
