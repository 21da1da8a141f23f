"""Modes: stationary, with the curvature of the density there, and every mirror image of a direction."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.errors import NumericalError
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.mode import _characterise, find_mode, find_modes, revisit_modes
from bayescal.inference.peaks import GaussianMode, proposal_from_peaks
from bayescal.machines.kinematics import solve_forward_kinematics

SIX = ("a_x", "a_y", "b_x", "b_y", "l")
VARIANTS = [("none", 0.01), ("none", None), ("linear", None), ("matrix", None)]
"""Where errors are not known whatever the geometry is: there a mode is that of both."""


def build(deformation, poses, *errors, **options):
    """Return a posterior of the telescope about the machine that explains the poses."""
    return machines.build_posterior(deformation, poses, machines.let_err(*errors, **options)).with_pose_guesses()


@pytest.fixture(params=VARIANTS, ids=lambda v: f"{v[0]}, {'free' if v[1] else 'no'} model error")
def posterior(request, twin):
    """Return the posterior of a variant of the telescope."""
    return build(request.param[0], twin, request.param[1])


def test_mode_is_a_maximum(posterior, rng):
    mode = find_mode(posterior, np.zeros(posterior.n_parameters))
    assert mode.converged
    assert mode.log_density == pytest.approx(posterior.log_density(mode.y[None])[0], abs=1e-9)
    directions = rng.standard_normal((50, len(mode.y))) @ np.linalg.cholesky(mode.covariance).T
    directions /= np.sqrt(len(mode.y))
    for side in (0.3, -0.3):
        around = posterior.log_density(mode.y + side * directions)
        drop = mode.log_density - around
        # a step of 0.3 sd costs 0.045 where the density is normal; the funnel of the model errors is not
        assert drop.min() > 0
        np.testing.assert_allclose(drop.mean(), 0.045, rtol=0.15)


def test_covariance_is_the_inverse_curvature(posterior, rng):
    """Second differences of the log-density along whitened directions are minus one, first differences vanish."""
    mode = find_mode(posterior, np.zeros(posterior.n_parameters))
    white = np.linalg.cholesky(mode.covariance).T
    directions = np.concatenate([white, rng.standard_normal((100, len(white))) @ white / np.sqrt(len(white))])
    size = np.concatenate(
        [np.ones(len(white)), np.sum(np.linalg.solve(white.T, directions[len(white) :].T) ** 2, axis=0)]
    )
    step = 0.02
    ahead, behind = (posterior.log_density(mode.y + side * directions) for side in (step, -step))
    np.testing.assert_allclose((ahead + behind - 2 * mode.log_density) / step**2 / size, -1.0, atol=0.03)
    # the gradient leaves out second-order terms of the pose errors, so that it vanishes a little off the maximum
    assert np.abs((ahead - behind) / (2 * step)).max() < 0.1


@pytest.mark.parametrize("deformation", ["linear", "matrix"])
def test_where_errors_are_known_whatever_the_geometry_is_they_are_best_by_themselves(deformation, twin, rng):
    """And the geometry is the best one at them."""
    posterior = build(deformation, twin)
    mode, m = find_mode(posterior, np.zeros(posterior.n_parameters)), posterior.n_geometry
    log_mass = posterior.linear_geometry(mode.y).log_mass
    steps = 0.1 * np.concatenate([np.eye(6), -np.eye(6)])
    assert (log_mass(mode.y[None, m:]) > log_mass(mode.y[m:] + steps)).all()
    assert np.abs(posterior.gradient(mode.y)[0][m:]).max() > 0.1  # both together are larger elsewhere
    directions = rng.standard_normal((50, m)) @ np.linalg.cholesky(mode.covariance[:m, :m]).T / np.sqrt(m)
    for side in (0.3, -0.3):
        around = np.concatenate([mode.y[:m] + side * directions, np.tile(mode.y[m:], (50, 1))], axis=1)
        assert (mode.log_density - posterior.log_density(around)).min() > 0.0


def test_exact_data_return_the_truth():
    """Without noise in the data, the mode predicts their poses and lies within the prior's pull of the truth."""
    machine = machines.build_machine("matrix")
    truth = machines.telescope_truth(machine)
    poses = machines.place_poses(machine, truth, machines.table_3_actuators(), np.zeros((40, 6)))
    posterior = build("matrix", poses, None)
    mode = find_mode(posterior, np.zeros(posterior.n_parameters))
    found, nominal = (
        solve_forward_kinematics(machine, theta, poses.actuators).position - poses.position
        for theta in (posterior.theta(mode.y[None])[0], machine.layout.nominal)
    )
    assert np.abs(found).max() < 0.5e-3
    assert np.abs(nominal).max() > 0.1
    sd = np.sqrt(np.diag(mode.covariance))
    assert np.abs((posterior.sampling.y_from_theta(truth) - mode.y) / sd).max() < 1.0


def test_laplace_is_close_to_the_evidence_of_a_normal_posterior(twin):
    posterior = build("matrix", twin, None)
    modes = find_modes(posterior)
    assert len(modes) == 1
    peak = GaussianMode(modes[0].y, np.linalg.cholesky(modes[0].covariance), modes[0].log_density)
    proposal = proposal_from_peaks([peak], 50.0)
    evidence = estimate_by_importance(posterior.log_density, proposal, np.random.default_rng(1), 4000)
    assert evidence.standard_error < 0.02
    assert modes[0].log_evidence == pytest.approx(evidence.log_evidence, abs=0.05)


@pytest.fixture(scope="module")
def mirrored():
    """Return a posterior of a machine whose directions lie beside the middle of their two solutions."""
    machine = machines.build_machine("none")
    layout = machine.layout
    slope = machines.build_posterior(
        "none",
        machines.place_poses(machine, layout.nominal, machines.table_3_actuators(), np.zeros((40, 6))),
        machines.let_err(None),
    ).sampling.coordinates.legs[:, 0]
    theta = layout.nominal.copy()
    theta[layout.index["u_x"]] = np.sin(np.arctan(slope)) + 0.03 * np.array([1, -1, 1, -1, 1, -1])
    rng = np.random.default_rng(5)
    poses = machines.simulate_poses(machine, theta, machines.table_3_actuators(), np.zeros(6), rng)
    return build("none", poses, None)


def test_mirror_images_of_a_direction_are_found(mirrored):
    """With κ fixed the actuator gain u_z + s u_x has two solutions; seen from one of them, the other is found."""
    posterior, layout = mirrored, mirrored.likelihood.layout
    slope = posterior.sampling.coordinates.legs[:, 0]
    modes = find_modes(posterior)
    assert len(modes) > 1
    densities = [mode.log_density for mode in modes]
    assert densities[0] == max(densities)
    best = posterior.theta(modes[0].y[None])[0]
    for other in modes[1:]:
        assert other.converged
        change = layout.take(posterior.theta(other.y[None])[0] - best, "u_x")
        *small, large = np.sort(np.abs(change))  # one leg's direction is another, the rest stays about where it was
        assert large > 0.03
        assert max(small) < 0.25 * large
        leg = int(np.argmax(np.abs(change)))
        angle = 2 * np.arctan(slope[leg]) - np.arcsin(layout.take(best, "u_x")[leg])
        mirrored = np.sin(angle) - layout.take(best, "u_x")[leg]
        assert change[leg] == pytest.approx(mirrored, abs=0.25 * abs(mirrored))


def test_no_mode_comes_twice_and_none_without_weight(mirrored):
    modes = find_modes(mirrored)
    for k, mode in enumerate(modes):
        assert mode.log_evidence > modes[0].log_evidence - 12.0
        sd = np.sqrt(np.diag(mode.covariance))
        for other in modes[:k]:
            assert np.max(np.abs(mode.y - other.y) / sd) > 1


def test_start_without_a_machine_is_refused(twin):
    posterior = build("none", twin, None)
    start = np.zeros(posterior.n_parameters)
    start[posterior.names.index("u_x[2]")] = 40.0
    assert posterior.log_density(start[None])[0] == -np.inf
    with pytest.raises(NumericalError, match="not finite"):
        find_mode(posterior, start)


def test_mirrors_of_two_legs_at_once_are_found():
    """Each of two legs alone has two solutions; all four are modes, and the masses of both jumps about multiply."""
    machine = machines.build_machine("none")
    layout, rng = machine.layout, np.random.default_rng(2)
    poses = machines.simulate_poses(machine, layout.nominal, machines.table_3_actuators()[:12], np.zeros(6), rng)
    priors = {f"{s}[{leg}]": NormalPrior(layout.nominal[layout.index[s][leg - 1]], 2.0) for s in SIX for leg in (1, 2)}
    priors |= {f"u_y[{leg}]": UniformPrior(-0.3, 0.3) for leg in (1, 2)}
    posterior = machines.measure(machine, poses, priors).with_pose_guesses()
    modes = find_modes(posterior)
    assert len(modes) == 4
    best, *others = (layout.take(posterior.theta(mode.y[None])[0], "u_y")[:2] for mode in modes)
    moved = {tuple(np.abs(other - best) > 0.05) for other in others}
    assert moved == {(True, False), (False, True), (True, True)}
    first, *lesser = (mode.log_evidence for mode in modes)
    assert min(lesser) - first == pytest.approx(sum(sorted(lesser)[1:]) - 2 * first, abs=0.7)


def test_a_mirror_beyond_the_bounds_is_no_start(twin):
    """A jump that leads out of a uniform prior is left out; the mode is found all the same."""
    machine = machines.build_machine("none")
    priors = {"u_y[1]": UniformPrior(-0.05, 0.05), "l[1]": NormalPrior(500.0, 2.0)}
    posterior = machines.measure(machine, twin, priors, machines.let_err(shared=True)).with_pose_guesses()
    assert find_modes(posterior)[0].converged


def test_draws_of_the_prior_lead_to_modes_that_no_jump_knows(monkeypatch):
    """Two solutions of a direction, its jump forgotten and the start beside the lesser one."""
    machine = machines.build_machine("none")
    layout, rng = machine.layout, np.random.default_rng(2)
    poses = machines.simulate_poses(machine, layout.nominal, machines.table_3_actuators()[:12], np.zeros(6), rng)
    priors = {f"{s}[1]": NormalPrior(layout.nominal[layout.index[s][0]], 2.0) for s in SIX}
    priors |= {"u_y[1]": UniformPrior(-0.3, 0.3)}
    posterior = machines.measure(machine, poses, priors).with_pose_guesses()
    both = find_modes(posterior)
    assert len(both) == 2
    monkeypatch.setattr(Posterior, "mode_candidates", lambda self, y: [])
    monkeypatch.setattr(Posterior, "least_squares_start", lambda self: both[1].y)
    assert len(find_modes(posterior)) == 1
    found = find_modes(posterior, np.random.default_rng(1))
    assert [mode.log_density for mode in found] == pytest.approx([mode.log_density for mode in both], abs=1e-3)


def test_draws_of_the_prior_that_lead_back_change_nothing(twin):
    posterior = build("linear", twin, None)
    plain, again = find_modes(posterior), find_modes(posterior, np.random.default_rng(1))
    assert [mode.y.tolist() for mode in again] == [mode.y.tolist() for mode in plain]


def test_known_modes_are_kept_beside_those_that_starts_lead_to(mirrored, monkeypatch):
    modes = find_modes(mirrored)
    assert len(modes) > 1
    again = revisit_modes(mirrored, [modes[-1].y], modes[:-1])
    assert [mode.y.tolist() for mode in again[:1]] == [modes[0].y.tolist()]  # as it was, not climbed to again
    assert len(again) == len(modes)
    assert [m.log_evidence for m in again] == sorted((m.log_evidence for m in again), reverse=True)
    monkeypatch.setattr("bayescal.inference.mode._climb", lambda *_: pytest.fail("nothing is to be climbed to"))
    assert len(revisit_modes(mirrored, [], modes)) == len(modes)


def test_a_climb_to_where_there_is_no_slope_is_refused(twin, monkeypatch):
    posterior = build("none", twin, 0.01)
    n = posterior.n_parameters
    monkeypatch.setattr(Posterior, "newton", lambda self, y: (np.full(n, np.nan), np.eye(n)))
    with pytest.raises(NumericalError, match="zero gradient"):
        find_mode(posterior, np.zeros(n))


def test_a_curvature_that_is_no_maximums_is_found_by_differences(twin):
    """With heavy tails the approximate Hessian may have the wrong sign where the density has a maximum."""
    posterior = build("none", twin, 0.01)
    right = find_mode(posterior, np.zeros(posterior.n_parameters))

    class Wrong:
        def __getattr__(self, name):
            return getattr(posterior, name)

        def gradient(self, y):
            slope, curvature = posterior.gradient(y)
            values, axes = np.linalg.eigh(curvature)
            k = len(values) // 2
            return slope, (axes * np.where(np.arange(len(values)) == k, -0.2 * values[k], values)) @ axes.T

    found = revisit_modes(Wrong(), [right.y])[0]
    sd = np.sqrt(np.diag(right.covariance))
    np.testing.assert_allclose(found.covariance / np.outer(sd, sd), right.covariance / np.outer(sd, sd), atol=0.02)


def test_a_saddle_is_no_mode(twin):
    posterior = build("none", twin, 0.01)
    right = find_mode(posterior, np.zeros(posterior.n_parameters))

    class Saddle:
        def __getattr__(self, name):
            return getattr(posterior, name)

        def gradient(self, y):
            return np.zeros_like(y), np.eye(len(y))

        def log_density(self, y):
            return np.sum((y - right.y) ** 2, axis=-1)

    with pytest.raises(NumericalError, match="negative definite"):
        _characterise(Saddle(), right.y, 0.0)
