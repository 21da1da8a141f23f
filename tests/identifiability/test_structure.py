"""Structural rank: planted gauge freedoms and duplicates are found, all of them and nothing else."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines
from scipy.linalg import subspace_angles

from bayescal.identifiability.structure import find_structural_rank, find_structure
from bayescal.machines.frames import frame_symbols
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import skew_matrix

N_MACHINES = 100
JOINTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l")
STRUTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")
BASE_SHIFT, BASE_TURN = frame_symbols("base")
TOOL_SHIFT, TOOL_TURN = frame_symbols("tool")


def _plant(rng, knowledge_of, machine, symbols):
    """Return a problem with gauges chosen at random, and its null vectors in natural units as columns."""
    layout, mechanism = machine.layout, machine.mechanism
    planted, frames, vectors = list(symbols), [], []
    if "rho0" in layout.index and rng.random() < 0.5:
        planted.append("rho0")
        for leg in range(mechanism.n_legs):  # c = a + rho0 u stays
            move = {f"a_{axis}[{leg + 1}]": -mechanism.directions[leg, k] for k, axis in enumerate("xyz")}
            vectors.append({f"rho0[{leg + 1}]": 1.0, **move})
    for frame, prefix, points in (("base", "a", mechanism.base_points), ("tool", "b", mechanism.platform_points)):
        if rng.random() < 0.5:
            continue
        shift, turn = frame_symbols(frame)
        frames += [*shift, *turn]
        sign = -1.0 if frame == "base" else 1.0
        for k, axis in enumerate("xyz"):
            vectors.append({shift[k]: 1.0} | {f"{prefix}_{axis}[{i + 1}]": sign for i in range(len(points))})
        for k in range(3):
            vectors.append({turn[k]: 1.0} | _turn(prefix, points, np.eye(3)[k], sign, mechanism))
    return knowledge_of(machine, tuple(planted), tuple(frames)), vectors


def _turn(prefix, points, axis, sign, mechanism):
    """Return how joints, and the actuators' directions with them, turn against a frame that turns."""
    moved = sign * points @ skew_matrix(axis).T
    loads = {f"{prefix}_{name}[{i + 1}]": moved[i, k] for i in range(len(points)) for k, name in enumerate("xyz")}
    if prefix == "a" and mechanism.drive == "base":
        turned = sign * mechanism.directions @ skew_matrix(axis).T
        loads |= {f"u_{name}[{i + 1}]": turned[i, k] for i in range(len(points)) for k, name in enumerate("xy")}
    return loads


def _scaled(vectors, knowledge):
    columns = np.zeros((len(knowledge.names), len(vectors)))
    for k, vector in enumerate(vectors):
        for name, value in vector.items():
            place = knowledge.names.index(name)
            columns[place, k] = value / knowledge.sd[place]
    return columns


@pytest.mark.parametrize("seed", range(N_MACHINES))
def test_planted_gauges_are_found_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    model, symbols = (("six_pus", JOINTS), ("six_ups", STRUTS))[seed % 2]
    machine = machines.build_machine("none", machines.build_random_mechanism(6 + seed % 3, seed), model)
    knowledge, vectors = _plant(rng, problems.build_knowledge, machine, symbols)
    plan = problems.build_plan(machine, seed=seed)
    found = find_structural_rank(knowledge, plan, rng)
    assert found.is_clear
    assert found.rank == len(knowledge.names) - len(vectors)
    if vectors:
        angles = subspace_angles(found.null_space, _scaled(vectors, knowledge))
        assert np.degrees(angles.max()) < 1e-3


@pytest.mark.parametrize("seed", range(N_MACHINES))
def test_planted_duplicates_are_found_and_nothing_else(seed):
    """Columns that repeat others, alone or mixed, in the Jacobian of a random machine, each copy rounded anew."""
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
    found = find_structural_rank(knowledge, problems.build_plan(machine), np.random.default_rng(0))
    n, per_leg = len(knowledge.names), {"six_pus": 1, "beam": 1, "six_ups": 0}
    assert found.is_clear
    if model in per_leg:
        assert n - found.rank == 6 * per_leg[model]
    elif model == "jacobian":
        assert found.rank == 36


def test_rank_does_not_depend_on_the_numbers_drawn():
    knowledge, plan = problems.build_telescope_problem("linear")
    ranks = {find_structural_rank(knowledge, plan, np.random.default_rng(seed)).rank for seed in range(5)}
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
    whole = problems.build_plan(machine)
    part = problems.build_plan(machine, sensors=(problems.PoseSensor(0.01, None),))
    rng = np.random.default_rng(2)
    assert find_structural_rank(knowledge, whole, rng).rank == 42
    assert find_structural_rank(knowledge, part, rng).rank == 39
