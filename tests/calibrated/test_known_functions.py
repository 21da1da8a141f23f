"""Machines whose carriages err by each other's travel: what a calibration knows of it is taken along in all uses."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import calibrated_readings as made_up
import numpy as np
import pytest

from bayescal.calibrated.accuracy import compute_budget
from bayescal.calibrated.drawn_machines import draw_poses
from bayescal.calibrated.exported import FUNCTIONS, _read_functions, list_posterior_files
from bayescal.calibrated.functions import KnownFunctions
from bayescal.calibrated.in_use import MachineInUse
from bayescal.calibrated.machine import CalibratedMachine, CommandErrors, build_calibrated
from bayescal.calibrated.predict import compensate_poses, predict_poses
from bayescal.calibrated.verify.statistics import (
    choose_suspects,
    compute_knowledge,
    judge_reverification,
    weigh_left_over,
)
from bayescal.density.calibration import terms
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import OwnChannelRows, build_model_error
from bayescal.density.pose_kernels import OWN_COLUMNS
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.knowledge import learn_posterior
from bayescal.identifiability.reading_rows import differentiate_poses
from bayescal.inference.mode import find_mode

NOISE = {"s": 1e-3, "cam_x": 2e-3, "cam_y": 2e-3, "height": 2e-3}
SORTS = ("random", "linear", "positioning", "smooth", "drift")
COUPLING = 0.1 * np.array([[0.3, 1.0, -0.6], [-0.8, 0.2, 0.7], [0.9, -0.5, 0.4]])  # mm over a range of travel
N_POSES, N_AGAIN, N_DRAWS = 40, 12, 400


class Erring:
    """A delta of the tolerances whose carriages err by a coupling, its calibration, and sessions of it."""

    def __init__(self, seed: int) -> None:
        self.planned, self.rng = replace(made_up.build_planned("delta"), noise=NOISE), np.random.default_rng(seed)
        layout = self.planned.model.layout
        symbols = [name.partition("[")[0] for name in layout.names]
        sd = np.array([self.planned.tolerances.get(one, 0.0) for one in symbols])
        self.theta = layout.nominal + sd * self.rng.standard_normal(layout.size)
        middle = 0.5 * (self.planned.low + self.planned.high)
        self.home = self.planned.model.read(layout.nominal, middle[None])[0]
        pose = self.draw(N_POSES)
        data = self.read(self.theta, pose)
        corners = self.planned.model.read(layout.nominal, self.draw(200))
        self.reach = np.where(np.arange(6) < 3, np.abs(corners - self.home).max(axis=0), 0.0)
        used = np.ones(N_POSES, dtype=bool)
        model = self.planned.model
        positions = RowPositions.find(model.channels, data, model.read(self.theta, pose), self.home)
        self.own = OwnChannelRows.find(model, data, pose, used, positions, self.reach)
        found = build_model_error(self.own, 6, SORTS, (0.01, 0.02), {}, each=False)
        priors = {
            name: NormalPrior(float(value), float(width))
            for name, value, width in zip(layout.names, layout.nominal, sd, strict=True)
        }
        likelihood = CalibrationLikelihood(self.planned.model, data, 1.0, pose)
        self.random = Posterior(likelihood, priors, terms.ErrorModel(found[:1])).with_pose_guesses()
        self.posterior = Posterior(likelihood, priors, terms.ErrorModel(found)).with_pose_guesses()

    def draw(self, n: int) -> np.ndarray:
        return self.rng.uniform(self.planned.low, self.planned.high, (n, 3))

    def err(self, values: np.ndarray) -> np.ndarray:
        """Return the carriages' errors, mm, at what they read."""
        return ((values[:, :3] - self.home[:3]) / 80.0) @ COUPLING

    def read(self, theta: np.ndarray, pose: np.ndarray) -> Measurements:
        values = self.planned.model.read(theta, pose)
        values[:, :3] += self.err(values)
        values += self.planned.sd * self.rng.standard_normal(values.shape)
        names = tuple(f"R{k}" for k in range(len(pose)))
        return Measurements(names, values, np.tile(self.planned.sd, (len(pose), 1)))

    def calibrate(self) -> CalibratedMachine:
        """Return the calibrated machine and what is known of its errors, given their most probable sizes."""
        mode, m = find_mode(self.posterior, self.posterior.least_squares_start()), self.posterior.n_geometry
        (mean,), (covariance,) = self.posterior.linear_geometry(mode.y).given(mode.y[None, m:])
        y = np.tile(mode.y, (N_DRAWS, 1))
        y[:, :m] = self.rng.multivariate_normal(mean, covariance, N_DRAWS)
        self.draws = y
        return replace(self.build(y, 0.0), functions=KnownFunctions.find(self.posterior, y))

    def calibrate_by_random_errors(self) -> CalibratedMachine:
        """Return the machine as τ alone has it."""
        mode = find_mode(self.random, self.random.least_squares_start())
        y = self.rng.multivariate_normal(mode.y, mode.covariance, N_DRAWS)
        return self.build(y, float(self.random.natural(mode.y[None])[0, -1]))

    def build(self, y: np.ndarray, tau: float) -> CalibratedMachine:
        draws = self.posterior.theta(y)
        errors = CommandErrors(np.diag(self.planned.sd[:3] ** 2), np.full(3, tau**2))
        bounds = np.stack([self.planned.low, self.planned.high])
        return build_calibrated(self.planned.model, draws.mean(axis=0), draws, errors, made_up.SOURCE, workspace=bounds)

    def judge(self, calibrated: CalibratedMachine, shift: float = 0.0, carriage: int = 0):
        """Return what two sessions at other poses say after a shift of a carriage's zero."""
        theta = self.theta.copy()
        theta[self.planned.model.layout.index["s0"][carriage]] += shift
        sessions = [self.read(theta, self.draw(N_AGAIN)) for _ in range(2)]
        return judge_reverification(calibrated, choose_suspects(calibrated, ["s0"]), sessions, 0.01, 2)


@pytest.fixture(scope="module")
def erring():
    return Erring(3)


@pytest.fixture(scope="module")
def calibrated(erring):
    return erring.calibrate()


def test_the_error_is_known_where_the_machine_goes(erring, calibrated):
    """Geometry takes up a part of it: what is left over of both together is within its own uncertainty."""
    known, model = calibrated.functions, erring.planned.model
    session = erring.read(erring.theta, erring.draw(60))
    acted, _ = known.show(model, session, session.values)
    assert np.sqrt(np.mean((acted[:, :3] @ known.mean) ** 2)) > 0.5 * np.sqrt(np.mean(erring.err(session.values) ** 2))
    suspects = choose_suspects(calibrated, ["s0"])
    knowledge = compute_knowledge(calibrated, suspects, session)
    square = knowledge.left_over(knowledge.total()) / knowledge.n_rows
    assert 0.6 < square < 1.4


def test_healthy_machines_pass_and_a_shift_is_found_and_named(erring, calibrated):
    """Without what is known of the error none passes; as random errors it hides shifts that are found now."""
    found = [erring.judge(calibrated) for _ in range(20)]
    assert sum(not one.holds or one.is_odd for one in found) <= 1
    blind = [erring.judge(replace(calibrated, functions=None)) for _ in range(10)]
    assert all(not one.holds or one.is_odd for one in blind)
    assert (3.0 * found[0].sd < erring.judge(erring.calibrate_by_random_errors()).sd).all()
    for carriage in range(3):
        moved = erring.judge(calibrated, 6.0 * float(found[0].sd[carriage]), carriage)
        assert not moved.holds
        assert moved.worst == carriage
        assert moved.shift[carriage] == pytest.approx(6.0 * found[0].sd[carriage], abs=4.0 * found[0].sd[carriage])


def test_what_is_kept_is_the_same_whatever_the_signs_of_the_columns(erring, calibrated):
    known, model = calibrated.functions, erring.planned.model
    arrays = {name: one[1] for name, one in known.list_arrays().items()}
    n, smooth = known.n_geometry, arrays["smooth"].shape[1]
    first = n + 9 + 3 * OWN_COLUMNS  # linear ones of three channels, own ones
    turned = np.ones(len(known.covariance))
    turned[first : first + 3 * smooth] = np.tile((-1.0) ** np.arange(smooth), 3)
    arrays |= {
        "smooth": arrays["smooth"] * (-1.0) ** np.arange(smooth),
        "mean": arrays["mean"] * turned[n:],
        "covariance": arrays["covariance"] * np.outer(turned, turned),
    }
    again = KnownFunctions.of_arrays(arrays, known.names, known.sorts)
    session = erring.read(erring.theta, erring.draw(5))
    for one, other in zip(
        known.show(model, session, session.values), again.show(model, session, session.values), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(again.mean, known.mean, atol=1e-9)
    np.testing.assert_allclose(again.covariance, known.covariance, atol=1e-9)


def test_drifts_join_the_rows_of_a_session(erring, calibrated):
    """The same as one normal density of all rows with their covariance."""
    knowledge = compute_knowledge(
        calibrated, choose_suspects(calibrated, ["s0"]), erring.read(erring.theta, erring.draw(4))
    )
    n, k = knowledge.rows.shape[:2]
    time, span = (np.arange(n) + 1.0) / n, np.mean(np.arange(N_POSES) / N_POSES + 0.02)
    walk = (np.minimum.outer(time, time) + 0.02) / span
    covariance = np.eye(n * k)
    for p in range(n):
        for q in range(n):
            covariance[p * k : (p + 1) * k, q * k : (q + 1) * k] += (
                knowledge.drifting[p] @ knowledge.drifting[q].T * walk[p, q]
            )
    rows = knowledge.rows.reshape(n * k, -1)
    np.testing.assert_allclose(knowledge.total(), rows.T @ np.linalg.solve(covariance, rows), rtol=1e-8)
    assert not np.allclose(knowledge.total(), knowledge.gram.sum(axis=0), rtol=1e-3)


def score(erring, calibrated, n=150):
    """Return errors of predicted tools over their uncertainties, (n, 3), and the errors, mm, of a machine as it is."""
    pose = erring.draw(n)
    commands = erring.read(erring.theta, pose).values[:, :3]
    found = predict_poses(calibrated, commands)
    apart = found.tool - pose
    return apart / np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)), apart


def test_poses_are_predicted_with_what_is_known_of_the_errors(erring, calibrated):
    """Geometry alone is off by what it took of them, beyond all that it says of itself."""
    (scores, apart), (blind, more) = score(erring, calibrated), score(erring, replace(calibrated, functions=None))
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 1.3
    assert np.mean(np.abs(scores) < 1.645) > 0.85
    assert np.sqrt(np.mean(blind**2)) > 2.0
    assert np.mean(apart**2) < 0.2 * np.mean(more**2)


def in_use(erring):
    return MachineInUse.find(erring.posterior, erring.draws)


def test_the_next_pose_counts_the_errors_that_accuracy_counts(erring, calibrated):
    """Draws over poses against the law of propagation: functions that were found are no noise."""
    model, pose, own = erring.planned.model, erring.draw(8), np.arange(6) < 3
    machine = replace(in_use(erring), known=calibrated.functions)
    draws = erring.draws[:: len(erring.draws) // 400]
    remaining = machine.remain(own, pose, {}, draws, 3, False)
    moved = remaining.by_functions @ machine.draw(draws, erring.rng)[:, erring.posterior.n_geometry :].T
    error = remaining.follow(erring.posterior.theta(draws)) + moved + remaining.noise
    found = predict_poses(calibrated, model.read(calibrated.theta, pose)[:, :3])
    np.testing.assert_allclose(error.std(axis=-1), found.sd, rtol=0.2)
    ignorant = replace(machine, known=None).remain(own, pose, {}, draws, 3, False)
    assert (ignorant.noise.std(axis=-1) > 1.5 * found.sd).mean() > 0.5


def test_a_page_states_the_accuracy_that_the_machine_predicts(erring, calibrated):
    """By other code: derivatives of white readings by coordinates of the posterior, not of commands by parameters."""
    model, posterior, pose = erring.planned.model, erring.posterior, erring.draw(8)
    half, own = 0.5 * (erring.planned.high - erring.planned.low), np.arange(6) < 3
    variant = SimpleNamespace(model=model, data=posterior.likelihood.data, internal=own)
    at = differentiate_poses(posterior, half, erring.draws.mean(axis=0), pose, {}).select_channels(own)
    forecast, both = learn_posterior(variant, replace(in_use(erring), known=calibrated.functions))(at)
    found = predict_poses(calibrated, model.read(calibrated.theta, pose)[:, :3])
    np.testing.assert_allclose(forecast.covariance(both), found.of_geometry, rtol=0.02, atol=1e-7)
    np.testing.assert_allclose(forecast.covariance(both) + forecast.noise, found.covariance, rtol=0.02, atol=1e-7)
    blind = forecast.covariance(both[: posterior.n_geometry, : posterior.n_geometry])
    assert not np.allclose(blind, found.of_geometry, rtol=0.2)


def test_draws_spread_as_predicted(erring, calibrated):
    pose = erring.draw(6)
    commands = erring.planned.model.read(erring.theta, pose)[:, :3]
    found, drawn = predict_poses(calibrated, commands), draw_poses(calibrated, commands, N_DRAWS, erring.rng)
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.abs((drawn.mean(axis=0) - found.tool) / sd).max() < 5.0 / np.sqrt(N_DRAWS)
    np.testing.assert_allclose(drawn.std(axis=0), sd, rtol=0.15)
    budget = compute_budget(calibrated, commands)
    np.testing.assert_allclose(budget.combined, found.covariance, atol=1e-15)
    alone = compute_budget(replace(calibrated, functions=None), commands)
    assert (budget.sd("geometry") > alone.sd("geometry")).any()  # what is known of the errors is known with it


def test_commands_correct_the_errors(erring, calibrated):
    pose = erring.draw(8)
    commands = compensate_poses(calibrated, pose).commands
    corrected = commands - compensate_poses(replace(calibrated, functions=None), pose).commands
    assert np.abs(corrected).max() > 0.01
    left = predict_poses(calibrated, commands).tool - pose
    assert np.abs(left).max() < 0.01 * np.abs(corrected).max()  # both are of first order in the errors


def test_an_exported_machine_knows_its_errors(erring, calibrated, tmp_path):
    calibrated = replace(calibrated, machine_file="delta.toml", files={})
    files = list_posterior_files(calibrated)
    path = tmp_path / FUNCTIONS
    path.write_bytes(files[FUNCTIONS])
    again = replace(calibrated, functions=_read_functions(path, calibrated.names))
    commands = erring.planned.model.read(erring.theta, erring.draw(5))[:, :3]
    one, other = predict_poses(calibrated, commands), predict_poses(again, commands)
    np.testing.assert_allclose(other.tool, one.tool, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-7, atol=1e-15)
    with pytest.raises(InputError, match=r"functions\.nc:"):
        _read_functions(path, calibrated.names[1:])
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match=FUNCTIONS + ": cannot"):
        _read_functions(path, calibrated.names)


def test_a_drift_of_a_size_that_is_hardly_known_is_seldom_odd(erring, calibrated):
    """Drifts are drawn by their sizes: as little is left over by chance as is said; by a mean size far too often."""
    sizes, rng = np.array([0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 1.3, 2.1]), np.random.default_rng(5)
    square = np.where(np.array(calibrated.functions.sorts) == "drift", 0.02**2, calibrated.functions.square)
    known = replace(calibrated, functions=replace(calibrated.functions, square=square, drifts=sizes))
    session = erring.read(erring.theta, erring.draw(N_AGAIN))
    knowledge = compute_knowledge(known, choose_suspects(known, ["s0"]), session)
    n, k = knowledge.rows.shape[:2]
    root = np.linalg.cholesky(known.functions.follow(n))
    unknown = knowledge.rows[..., : -1 - knowledge.n_shifts]
    chances = []
    for size in np.tile(sizes, 50):
        walk = root @ rng.standard_normal((n, knowledge.drifting.shape[-1]))
        error = unknown @ rng.standard_normal(unknown.shape[-1]) + rng.standard_normal((n, k))
        error += size * np.einsum("pkd,pd->pk", knowledge.drifting, walk)
        drawn = replace(knowledge, rows=np.concatenate([knowledge.rows[..., :-1], error[..., None]], axis=-1))
        by_mean = replace(drawn, functions=replace(known.functions, drifts=np.ones(1)))
        chances.append([weigh_left_over([one], False) for one in (drawn, by_mean)])
    said, by_mean = np.mean(np.array(chances) < 0.02, axis=0)
    assert said < 0.035  # 0.02 and two standard errors
    assert by_mean > 0.06
