"""Where the poses of many rows are looked for: from the middle where a sample of rows shows that it suffices."""

from __future__ import annotations

import calibrations
import numpy as np
import pytest
import studies

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.readings import workspace
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.shared.readings.workspace import Workspace

N_ROWS = 320


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Return the config of a study of many rows, with the folder of its files."""
    folder = calibrations.copy_delta(tmp_path_factory.mktemp("many"))
    path = folder / "simulate.toml"
    for name, text in studies.simulate(path, n_poses=N_ROWS, n_verification_poses=0).files.items():
        (folder / "data" / name).write_text(text)
    return load_experiment(folder / "study.toml"), folder


def find_square(study) -> np.ndarray:
    """Return what the poses leave of the readings of the first variant, r² (P,)."""
    variant = next(iter(read_inputs(*study).variants.values()))
    posterior = variant.posterior(np.ones(variant.data.n_poses, dtype=bool))
    white = posterior.likelihood.whiten(
        *posterior.likelihood.noise(posterior.errors, posterior.zeta(np.zeros((1, posterior.n_parameters))))
    )
    error, _, _ = posterior.likelihood.linearise(posterior.sampling.start[None], variant.start[None], white)
    return np.sum(error[0] ** 2, axis=-1)


@pytest.fixture(scope="module")
def from_all(study):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(workspace, "TRIED", N_ROWS)
        return find_square(study)


@pytest.fixture
def looked(monkeypatch) -> list[tuple[int, int]]:
    """Return how many starts and rows each search has, as they come."""
    sizes, search = [], workspace.search_poses

    def count(likelihood, theta, white, start):
        sizes.append(start.shape[:2])
        return search(likelihood, theta, white, start)

    monkeypatch.setattr(workspace, "search_poses", count)
    return sizes


def test_the_middle_leads_to_what_all_starts_lead_to(study, from_all, looked):
    found = find_square(study)
    assert looked[:2] == [(27, workspace.TRIED), (1, N_ROWS)]
    assert all(rows < N_ROWS for starts, rows in looked[2:] if starts > 1 and rows != workspace.TRIED)
    np.testing.assert_allclose(found, from_all, rtol=1e-2, atol=1e-2)


def test_a_middle_that_leads_nowhere_is_not_relied_on(study, from_all, looked, monkeypatch):
    starts = Workspace.starts

    def far(self, seed):
        found = starts(self, seed)
        return np.concatenate([self.middle[None] + 50.0 * self.half, found])

    def stay(posterior, theta, home):
        return np.tile(home, (1, posterior.likelihood.data.n_poses, 1))

    monkeypatch.setattr(Workspace, "starts", far)
    monkeypatch.setattr(workspace, "_locate_rows", stay)  # a machine whose commands do not say where it stands
    found = find_square(study)
    assert (28, N_ROWS) in looked
    np.testing.assert_allclose(found, from_all, rtol=1e-2, atol=1e-2)
