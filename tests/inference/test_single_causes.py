"""Single causes of a model error: their evidence against that of whole calibrations, and which is named."""

from __future__ import annotations

from dataclasses import replace

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.runner.load import load
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.causes import NONE, weigh_causes
from bayescal.inference.mode import find_modes

SILENT = "\n[model_error]\nterms = []\n"
SLOPES = np.array([4e-4, -6e-4, 5e-4])  # a lead error of each carriage


def write(folder, error=None):
    """Write a delta's study that is silent on its model error; carriages read what they do, and an error (P, 3), mm."""
    path = calibrations.write_delta(folder)
    calibrations.change(path, SILENT, "")
    if error is not None:
        file = path.parent / "data" / "readings.csv"
        table = pd.read_csv(file, comment="#")
        columns = ["s_1_mm", "s_2_mm", "s_3_mm"]
        table[columns] += error(table[columns].to_numpy())
        table.to_csv(file, index=False)
    return path


def weigh(path, seed=1):
    study = StudyInputs.load(load(path)[1], path.parent)
    posterior = study.variants["all"].posterior().with_pose_guesses()
    found = weigh_causes(posterior, find_modes(posterior)[0].y, np.random.default_rng(seed))
    return {name: one.log_odds for name, one in found.items()}, posterior


def test_the_cause_is_far_better_than_any_other_alone(tmp_path):
    found, _ = weigh(write(tmp_path, lambda s: SLOPES * 3.0 * (s - s.mean(axis=0))))
    lead, own = found.pop("lead"), found.pop("positioning")
    assert lead > own > -1.0  # functions of the own position that are no lead error have to be small
    assert lead - max(found.values()) > 3.0
    assert found[NONE] < found["linear"]


def find_places(folder, s):
    """Return where the nominal delta's carriages (P, 3) hold its tool, from the middle of all, in half ranges."""
    path = folder / "own_machine" / "study.toml"
    model = StudyInputs.load(load(path)[1], path.parent).variants["all"].whole
    pose, found = model.locate(model.layout.nominal, s)
    assert found.all()
    return (pose - pose.mean(axis=0)) / (0.5 * np.ptp(pose, axis=0))


def bend(place):
    """Return what a load on the frame does: the same in all carriages, of the place linear and quadratic, mm."""
    return np.repeat((place @ [0.1, -0.08, 0.05] + place**2 @ [0.2, 0.25, -0.2])[:, None], 3, axis=1)


def twist(place):
    """Return squares and products of the place, each carriage with its own coefficients, mm."""
    x, y, z = place.T
    return 0.25 * np.stack([x**2 - x * y, y * z - z**2, x * z + y**2], axis=1)


@pytest.mark.parametrize(("error", "cause"), [(bend, "gravity"), (twist, "joints")])
def test_causes_that_are_smooth_are_told_apart(tmp_path, error, cause):
    found, _ = weigh(write(tmp_path, lambda s: error(find_places(tmp_path, s))))
    assert max(found, key=found.get) == cause
    assert found[cause] - found["smooth"] > 3.0


def test_a_direction_weighs_what_its_columns_in_the_rows_do(tmp_path):
    """Density of the sizes against one normal density of all rows, whose covariance has the columns in it."""
    _, posterior = weigh(write(tmp_path, lambda s: bend(find_places(tmp_path, s))))
    y = find_modes(posterior)[0].y
    m, linear, extended = posterior.n_geometry, posterior.linear_geometry(y), posterior.linear_geometry(y, "gravity")
    zeta, size = y[m:], 0.03
    n = len(extended.pull) - m
    precision = extended.precision.copy()
    precision[m:, m:] += np.eye(n) / size**2
    told = replace(extended, precision=precision).log_mass(zeta[None])[0] - n * np.log(size)
    both = extended.rows.square(zeta[None])[0][0]
    j, u, e = np.split(np.linalg.cholesky(both + 1e-9 * np.eye(len(both))).T, [m, m + n], axis=1)

    def weigh_rows(covariance):
        wide = covariance + j @ np.linalg.solve(linear.precision, j.T)
        deviation = e[:, 0] + j @ np.linalg.solve(linear.precision, linear.pull)
        return -0.5 * (np.linalg.slogdet(wide)[1] + deviation @ np.linalg.solve(wide, deviation))

    without, within = (weigh_rows(np.eye(len(u)) + one * u @ u.T) for one in (0.0, size**2))
    assert told - linear.log_mass(zeta[None])[0] == pytest.approx(within - without, abs=1e-4)


def test_without_errors_none_is_best(tmp_path):
    found, _ = weigh(write(tmp_path))
    assert max(found, key=found.get) == NONE


def test_draws_hardly_matter(tmp_path):
    path = write(tmp_path)
    one, other = weigh(path)[0], weigh(path, seed=2)[0]
    assert list(one) == [NONE, "linear", "positioning", "smooth", "drift", "lead", "joints", "gravity"]
    np.testing.assert_allclose([*one.values()], [*other.values()], atol=0.5)


def test_nothing_is_said_without_functions(tmp_path):
    path = calibrations.change(calibrations.write_delta(tmp_path), "terms = []", 'terms = ["random"]')
    assert weigh(path)[0] == {}


@pytest.mark.runs
def test_evidence_is_that_of_whole_calibrations(tmp_path, call):
    """Sampling of the joint posterior and importance sampling of it know nothing of the closed form."""
    path = write(tmp_path, lambda s: SLOPES * (s - s.mean(axis=0))).with_name("causes.toml")
    others = {"positioning": ["positioning"], "linear": ["linear"], NONE: []}
    chosen = {"all": "", **{name: f"model_error = {['random', *one]}\n" for name, one in others.items()}}
    variants = [f'[[variants]]\nname = "{name}"\ntitle = "{name}"\n{keys}' for name, keys in chosen.items()]
    path.write_text("\n".join(['extends = "study.toml"\nname = "causes"\n', *variants]).replace("'", '"'))
    assert call("run", path, "--out", tmp_path / "out", "--workers", "1")[0] in (0, 3)
    tables = tmp_path / "out" / "tables"
    evidence = pd.read_csv(tables / "variants.csv").set_index("variant")["log_evidence"]
    alone = pd.read_csv(tables / "model_error_alone.csv").set_index(["variant", "term"])["log_bayes_factor"]
    for name in others:
        assert alone["all", name] == pytest.approx(evidence[name] - evidence["all"], abs=0.4), name
