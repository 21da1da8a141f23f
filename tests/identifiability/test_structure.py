"""Structural rank: planted gauge freedoms and duplicates are found, all of them and nothing else."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines
from scipy.linalg import subspace_angles
from shares import run_rest

from bayescal.identifiability.structure import find_structural_rank, find_structure
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import skew_matrix

N_MACHINES = 100
JOINTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l")
STRUTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")


def _plant(rng, machine, symbols):
    """Return a problem with gauges chosen at random, and its null vectors in natural units as columns."""
    layout, mechanism = machine.layout, machine.mechanism
    planted, frames, vectors = list(symbols), [], []
    if "rho0" in layout.index and rng.random() < 0.5:
        planted.append("rho0")
        for leg in range(mechanism.n_legs):  # c = a + rho0 u stays
            move = {f"a_{axis}[{leg + 1}]": -mechanism.directions[leg, k] for k, axis in enumerate("xyz")}
            vectors.append({f"rho0[{leg + 1}]": 1.0, **move})
    for frame, prefix, points in (
        ("frame", "a", mechanism.base_points),
        ("target", "b", mechanism.platform_points),
    ):
        if rng.random() < 0.5:
            continue
        frames += [frame, f"{frame}_r"]
        for k, axis in enumerate("xyz"):
            joints = {f"{prefix}_{axis}[{i + 1}]": 1.0 for i in range(len(points))}
            vectors += [{f"i_{frame}[{axis}]": 1.0} | joints]
            vectors += [{f"i_{frame}_r[{axis}]": 1.0} | _turn(prefix, points, np.eye(3)[k], mechanism)]
    return problems.build_knowledge(machine, tuple(planted)), tuple(frames), vectors


def _turn(prefix, points, axis, mechanism):
    """Return how joints, and the actuators' directions with them, turn with a frame that turns."""
    moved = points @ skew_matrix(axis).T
    loads = {f"{prefix}_{name}[{i + 1}]": moved[i, k] for i in range(len(points)) for k, name in enumerate("xyz")}
    if prefix == "a" and mechanism.drive == "base":
        turned = mechanism.directions @ skew_matrix(axis).T
        loads |= {f"u_{name}[{i + 1}]": turned[i, k] for i in range(len(points)) for k, name in enumerate("xy")}
    return loads


def _scaled(vectors, posterior):
    names = posterior.sampling.names
    columns = np.zeros((len(names), len(vectors)))
    for k, vector in enumerate(vectors):
        for name, value in vector.items():
            place = names.index(name)
            columns[place, k] = value / posterior.prior_sd[place]
    return columns


def _find(knowledge, plan, rng, frames=()):
    return find_structural_rank(problems.read_plan(knowledge, plan, frames), rng)


@pytest.mark.parametrize("seed", run_rest(range(N_MACHINES), 12, 30))
def test_planted_gauges_are_found_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    model, symbols = (("six_pus", JOINTS), ("six_ups", STRUTS))[seed % 2]
    machine = machines.build_machine("none", machines.build_random_mechanism(6 + seed % 3, seed), model)
    knowledge, frames, vectors = _plant(rng, machine, symbols)
    posterior = problems.read_plan(knowledge, problems.build_wide_plan(machine, seed), frames)
    found = find_structural_rank(posterior, rng)
    assert found.is_clear
    assert found.rank == posterior.n_geometry - len(vectors)
    if vectors:
        angles = subspace_angles(found.null_space, _scaled(vectors, posterior))
        assert np.degrees(angles.max()) < 1e-3


@pytest.mark.parametrize("seed", range(N_MACHINES))
def test_planted_duplicates_are_found_and_nothing_else(seed):
    """Columns that repeat others, alone or mixed, in the Jacobian of a random machine, each copy rounded again."""
    rng = np.random.default_rng([seed, 7])
    machine = machines.build_machine("none", machines.build_random_mechanism(6, seed), "six_pus")
    knowledge = problems.build_knowledge(machine, JOINTS)
    plan = problems.build_plan(machine, half=20.0, seed=seed)
    rows = problems.compute_rows(knowledge, plan)
    n_extra = int(rng.integers(0, 6))
    mix = rng.normal(size=(rows.shape[1], n_extra)) * (rng.random((rows.shape[1], n_extra)) < 0.1)
    mix[rng.integers(0, rows.shape[1], n_extra), np.arange(n_extra)] = 1.0
    scale = 10.0 ** rng.uniform(-3, 3, rows.shape[1] + n_extra)
    scale /= scale.max()
    eps = np.finfo(float).eps

    def jacobian():
        extended = np.concatenate([rows, rows @ mix], axis=1)
        return extended * (1.0 + eps * rng.uniform(-1, 1, extended.shape)) * scale

    found = find_structure(jacobian(), [jacobian() for _ in range(3)])
    assert found.is_clear
    assert found.rank == rows.shape[1]


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.parametrize("deformation", ["none", "linear", "matrix"])
def test_rank_of_every_model(model, deformation):
    """Per leg: the 6-PUS and its kin cannot tell rho0 from a; the Jacobian model knows six numbers of a leg."""
    machine = machines.build_machine(deformation, model=model)
    knowledge = problems.build_knowledge(machine)
    found = _find(knowledge, problems.build_wide_plan(machine), np.random.default_rng(0))
    n, per_leg = len(knowledge.names), {"six_pus": 1, "beam": 1, "six_ups": 0}
    assert found.is_clear
    if model in per_leg:
        assert n - found.rank == 6 * per_leg[model]
    elif model == "jacobian":
        assert found.rank == 36


def test_rank_does_not_depend_on_the_numbers_drawn():
    knowledge, plan = problems.build_telescope_problem("linear")
    ranks = {_find(knowledge, plan, np.random.default_rng(seed)).rank for seed in range(5)}
    assert ranks == {60}


def test_a_gap_that_is_none_is_said_to_be_none():
    """Singular values that fade into the rounding one after the other."""
    rng = np.random.default_rng(1)
    left, right = (np.linalg.qr(rng.normal(size=(40, 12)))[0] for _ in range(2))
    fading = (left * 10.0 ** -np.arange(0, 12 * 0.5, 0.5)) @ right[:12].T
    twins = [fading + 1e-5 * rng.normal(size=fading.shape) for _ in range(3)]
    assert not find_structure(fading, twins).is_clear


def test_sensors_that_see_only_a_part_leave_more_unseen():
    """Positions of the platform's origin alone: turning the platform joints about it changes none of them."""
    machine = machines.build_machine("none", machines.build_random_mechanism(6, 3), "six_ups")
    knowledge = problems.build_knowledge(machine, STRUTS)
    whole, part = (
        problems.build_wide_plan(machine),
        problems.build_wide_plan(machine, sensors=(problems.PoseSensor(0.01, None),)),
    )
    rng = np.random.default_rng(2)
    assert _find(knowledge, whole, rng).rank == 42
    assert _find(knowledge, part, rng).rank == 39
