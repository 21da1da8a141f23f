"""Indices against singular values, updates and bounds against sets judged again, gradients against differences."""

from __future__ import annotations

import numpy as np
import pose_problems
import pytest
import telescope_machines as machines
from scipy.spatial.transform import Rotation

from bayescal.pose_selection import (
    SelectionProblem,
    compute_observability,
    even_candidates,
    identification_rows,
    random_candidates,
)
from bayescal.pose_selection.criteria import CRITERIA, O1
from bayescal.pose_selection.criteria.spectral import FINE, ROUGH
from bayescal.pose_selection.methods import PoseObjective
from bayescal.pose_selection.observability import angle_rates

NINE = np.arange(9)


def formulas(rows: np.ndarray, n_poses: int) -> dict[str, float]:
    """Return the indices as Yu prints them, from the eigenvalues of JᵀJ in extended precision where they are sums."""
    sigma = np.linalg.svd(rows)[1].astype(np.longdouble)
    n = len(sigma)
    return {
        "O1": float(np.prod(sigma ** (np.longdouble(1) / n)) / np.sqrt(np.longdouble(n_poses))),
        "O2": float(sigma[-1] / sigma[0]),
        "O3": float(sigma[-1]),
        "O4": float(sigma[-1] ** 2 / sigma[0]),
        "O5": float(1 / np.sum(1 / sigma)),
    }


def test_every_criterion_is_named_with_its_source():
    assert set(CRITERIA) == set(pose_problems.CRITERIA)
    for name, criterion in CRITERIA.items():
        assert criterion.name == name
        assert any(character.isdigit() for character in criterion.source)


def test_jacobian_is_the_closures():
    """J_1⁻¹ J_2 (Yu, Wu and Wang 2023 eq. 23), of the closure and not of what actuators read."""
    domain = pose_problems.yu_domain()
    candidates = random_candidates(domain, 30, np.random.default_rng(1))
    placed, design = candidates.placed, domain.design
    here = design.machine.linearise(design.theta, placed.position, placed.rotation, placed.actuators)
    expected = -np.linalg.solve(here.pose, here.parameters)
    scale = np.abs(expected).max(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(candidates.seen.slope / scale, expected / scale, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_indices_against_singular_values(seed):
    problem = pose_problems.build_problem("O1", 40, 12, seed)
    sets = np.stack([problem.draw_set(np.random.default_rng(k)) for k in range(5)])
    found = compute_observability(problem.blocks[sets])
    for place, members in enumerate(sets):
        expected = formulas(problem.blocks[members].reshape(-1, 42), 12)
        assert {name: values[place] for name, values in found.items()} == pytest.approx(expected, rel=1e-12)


def test_too_few_rows_are_worth_nothing():
    found = compute_observability(pose_problems.build_problem("O1").blocks[:6])
    assert {name: float(value) for name, value in found.items()} == dict.fromkeys(pose_problems.INDICES, 0.0)


def test_bayesian_criteria_against_the_posterior_covariance():
    design = pose_problems.yu_design()
    for name in "DAI":
        problem = pose_problems.build_problem(name)
        seen = problem.candidates.seen
        slope = seen.slope[NINE].reshape(-1, 42)
        noise = np.tile(np.concatenate([np.full(3, 1e-3), np.full(3, np.radians(1e-4))]), 9)
        own = (seen.located.located @ np.swapaxes(seen.located.located, -1, -2))[NINE]
        covariance = np.diag(noise**2)
        for k in NINE:
            covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own[k]
        prior = np.diag(design.sd**-2)
        posterior = np.linalg.inv(prior + slope.T @ np.linalg.solve(covariance, slope))
        if name == "D":
            expected = -0.5 * (np.linalg.slogdet(posterior)[1] + np.linalg.slogdet(prior)[1])
        elif name == "A":
            expected = -np.mean(np.diagonal(posterior) / design.sd**2)
        else:
            workspace = problem.criterion.workspace / design.sd
            variance = np.einsum("wki,ij,wkj->wk", workspace, posterior, workspace)
            expected = -np.mean(np.sum(variance / pose_problems.LIMITS**2, axis=1))
        assert problem.value_of(problem.blocks[NINE]) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("name", pose_problems.CRITERIA)
def test_updates_equal_sets_judged_anew(name, measured):
    fields = {}
    if measured:
        actuators = pose_problems.build_problem("O1", seed=5).candidates.placed.actuators
        fields = {"measured": actuators[:4]}
    problem = pose_problems.build_problem(name, **fields)
    scorer = problem.scorer()
    scorer.start(range(9))
    rng = np.random.default_rng(2)
    for step in range(30):  # beyond a refresh
        added = int(rng.choice(np.setdiff1d(np.arange(60), scorer.members)))
        scorer.add(added)
        scorer.drop(int(rng.choice(scorer.members)))
        members = list(scorer.members)
        assert scorer.value() == pytest.approx(problem.value_of(problem.blocks[members]), rel=1e-10)
        if step % 7 and step != 29:
            continue
        expected = [problem.value_of(problem.blocks[[*members, k]]) for k in range(60)]
        np.testing.assert_allclose(scorer.values_added(), expected, rtol=1e-10)
        expected = [problem.value_of(problem.blocks[[m for m in members if m != k]]) for k in members]
        np.testing.assert_allclose(scorer.values_dropped(), expected, rtol=1e-10)


def test_updates_of_a_set_too_small():
    problem = pose_problems.build_problem("O1")
    scorer = problem.scorer()
    scorer.start(range(6))
    expected = [problem.value_of(problem.blocks[[*range(6), k]]) for k in range(60)]
    np.testing.assert_allclose(scorer.values_added()[6:], expected[6:], rtol=1e-9)
    assert scorer.value() == 0.0
    assert not scorer.values_dropped().any()


@pytest.mark.parametrize("name", ["O2", "O3", "O4", "O5"])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_find_what_judging_all_finds(name, seed):
    problem = pose_problems.build_problem(name, 300, 12, seed)
    scorer = problem.scorer()
    scorer.start(problem.draw_set(np.random.default_rng(seed)).tolist())
    outside = np.ones(300, dtype=bool)
    outside[scorer.members] = False
    every = np.where(outside, scorer.values_added(), -np.inf)
    best, value = scorer.best_added(outside)
    assert (best, value) == (int(np.argmax(every)), float(every.max()))
    assert scorer.n_evaluations < outside.sum() / 2
    every = scorer.values_dropped()
    assert scorer.best_dropped() == (scorer.members[int(np.argmax(every))], float(every.max()))


@pytest.mark.parametrize("name", pose_problems.CRITERIA)
@pytest.mark.parametrize("domain", ["yu", "telescope"])
def test_gradient_by_the_poses(name, domain):
    box = pose_problems.yu_domain() if domain == "yu" else pose_problems.telescope_domain()
    problem = pose_problems.build_problem(name, 30, 9, domain=box)
    objective = PoseObjective(problem)
    shares = np.random.default_rng(3).uniform(-0.9, 0.9, (9, 6))
    value, gradient = objective.value_and_gradient(shares)
    assert value == pytest.approx(
        problem.value_of(problem.criterion.rows(box.design.see(box.place(shares)))), rel=1e-12
    )

    ways = np.linalg.qr(np.random.default_rng(4).normal(size=(54, 12)))[0].T.reshape(12, 9, 6)  # each moves all poses

    def moved(steps):
        return np.array([objective.value(shares + np.tensordot(step, ways, 1)) for step in steps])

    expected = machines.stencil_derivative(moved, np.zeros(12), np.full(12, 1e-3))
    assert np.abs(np.tensordot(ways, gradient, 2) - expected).max() < 1e-6 * np.abs(expected).max()


def test_implicit_rows_are_the_closures():
    domain = pose_problems.telescope_domain()
    problem = SelectionProblem(random_candidates(domain, 30, np.random.default_rng(0)), O1(form="closure"), 10)
    legs = np.array([int(name[-2]) for name in domain.design.names])
    for leg in range(6):  # each leg's row knows its own parameters only
        assert not problem.blocks[:, leg, legs != leg + 1].any()
    seen, placed = problem.candidates.seen, problem.candidates.placed
    by_pose = domain.design.machine.linearise(
        domain.design.theta, placed.position, placed.rotation, placed.actuators
    ).pose
    np.testing.assert_allclose(by_pose @ seen.slope, -problem.blocks, atol=1e-9)


def test_angles_in_place_of_the_rotation_vector():
    """Rates of the angles of R = R_z R_y R_x against differences of the angles that SciPy finds."""
    rotation = Rotation.random(20, rng=np.random.default_rng(1))
    found = angle_rates(rotation.as_matrix())
    step = 1e-6
    for axis in range(3):
        turned = [
            (Rotation.from_rotvec(sign * step * np.eye(3)[axis]) * rotation).as_euler("ZYX")[:, ::-1]
            for sign in (1.0, -1.0)
        ]
        difference = (turned[0] - turned[1] + np.pi) % (2.0 * np.pi) - np.pi
        np.testing.assert_allclose(found[..., axis], difference / (2.0 * step), rtol=1e-6, atol=1e-6)
    seen = pose_problems.build_problem("O1").candidates.seen
    rows = identification_rows(seen, "angles")
    np.testing.assert_array_equal(rows[:, :3], seen.slope[:, :3])
    np.testing.assert_allclose(rows[:, 3:], angle_rates(seen.placed.rotation) @ seen.slope[:, 3:], rtol=1e-12)


def test_o3_by_rotation_vectors_is_bound_below_the_published_one():
    """Turning all platform points about the platform's axis turns every pose alike: no choice of poses tells more."""
    design = pose_problems.yu_design()
    points = design.machine.mechanism.platform_points
    bound = 1.0 / np.sqrt(np.sum(points[:, :2] ** 2))
    blocks = even_candidates(pose_problems.yu_domain(), 200).seen.slope
    turn = np.zeros(42)
    for k, (x, y, _) in enumerate(points):
        turn[design.names.index(f"b_x[{k + 1}]")], turn[design.names.index(f"b_y[{k + 1}]")] = -y, x
    np.testing.assert_allclose(np.linalg.norm(blocks @ turn, axis=1), 1.0, rtol=1e-9)
    assert float(compute_observability(blocks)["O3"]) <= np.sqrt(200) * bound
    for n, published in {20: 1.395e-3, 30: 1.709e-3, 40: 1.973e-3}.items():
        assert published > 1.027 * np.sqrt(n) * bound


@pytest.mark.parametrize("low", [1, ROUGH, FINE])
@pytest.mark.parametrize("name", ["O2", "O3", "O4", "O5"])
def test_bounds_are_bounds(name, low):
    problem = pose_problems.build_problem(name, 200, 12)
    scorer = problem.scorer()
    scorer.start(range(12))
    decomposed = scorer._decompose()
    every = np.arange(200)
    assert np.all(scorer._bounds(*decomposed, every, 1.0, low) >= scorer.values_added())
    dropped = scorer._bounds(*decomposed, np.array(scorer.members), -1.0, low)
    assert np.all(dropped >= scorer.values_dropped())
