"""Which parameters to free, and the ridges by name: what RR-8096 found by hand has to come out without a hint."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.identifiability.directions import find_directions, find_sparse_basis
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.reading_rows import see
from bayescal.identifiability.ridges import describe_ridges
from bayescal.identifiability.selection import select_parameters
from bayescal.identifiability.structure import find_structural_rank
from bayescal.limits import IDENTIFIABLE_CONTRACTION
from bayescal.machines.kinematics import compute_home_legs
from bayescal.numerics.units import Units

POINTS = {"a_x", "a_y", "b_x", "b_y", "l"}


def _see(knowledge, plan, frames=()):
    """Return white rows of a plan, in units of the tolerances, and the posterior that they are of."""
    posterior = problems.read_plan(knowledge, plan, frames)
    return see(posterior, np.zeros(posterior.n_geometry)), posterior


def _analyse(knowledge, plan):
    rows, _ = _see(knowledge, plan)
    information = information_of_rows(rows, np.ones(rows.shape[-1]))
    wide = problems.read_plan(knowledge, problems.build_wide_plan(knowledge.machine))
    null = find_structural_rank(wide, np.random.default_rng(0)).null_space
    selection = select_parameters(information, problems.list_symbols(knowledge))
    return information, null, selection, find_directions(information, null, selection.fixed)


def _by_pivot(knowledge, directions):
    """Return the ridges' moves for a unit of their pivot, by the pivot's name."""
    found = {}
    for d in directions:
        if d.pivot is not None:
            natural = d.vector * knowledge.sd
            move = natural / natural[d.pivot]
            found[knowledge.names[d.pivot]] = {
                knowledge.names[k]: move[k] for k in np.argsort(-np.abs(d.vector)) if d.vector[k]
            }
    return found


@pytest.mark.parametrize("model", ["six_pus", "jacobian", "beam", "stiffness"])
@pytest.mark.parametrize(("deformation", "last"), [("none", "u_x"), ("linear", "kappa"), ("matrix", "kappa")])
def test_what_to_free_is_what_the_report_freed(model, deformation, last):
    knowledge, plan = problems.build_telescope_problem(deformation, model)
    _, _, selection, _ = _analyse(knowledge, plan)
    assert {problems.list_symbols(knowledge)[k] for k in selection.free} == POINTS | {last}
    assert len(selection.free) == 36


def test_a_frame_of_a_wide_tolerance_follows_what_it_hides():
    """A link and the place of what a tool touches go together; the place's tolerance is ten thousand of the link's."""
    rows = np.array([[1.0, -1e4, 0.0], [1.0, -1e4, 1.0]]) * 5.0  # by the link, the place and a zero, in tolerances
    information = information_of_rows(rows, np.ones(3))
    weak = [one for one in find_directions(information, np.empty((3, 0)), ()) if one.kind == "practical"]
    assert len(weak) == 1
    assert weak[0].vector[1] / weak[0].vector[0] == pytest.approx(1e-4)
    assert np.abs(rows @ weak[0].vector).max() < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_what_to_free_does_not_depend_on_the_order_of_the_legs(seed):
    knowledge, plan = problems.build_telescope_problem("linear")
    information, _, selection, _ = _analyse(knowledge, plan)
    legs = np.random.default_rng(seed).permutation(6)
    order = np.concatenate([6 * block + legs for block in range(len(knowledge.names) // 6)])
    shuffled = select_parameters(Information(information.root[:, order]), problems.list_symbols(knowledge))
    assert {problems.list_symbols(knowledge)[k] for k in shuffled.free} == {
        problems.list_symbols(knowledge)[k] for k in selection.free
    }


def test_selected_parameters_are_identifiable_together_and_no_symbol_more():
    knowledge, plan = problems.build_telescope_problem("none")
    information, _, selection, _ = _analyse(knowledge, plan)

    def least(free):
        part = information.matrix[np.ix_(free, free)]
        return 1.0 - np.diagonal(np.linalg.inv(part + np.eye(len(free)))).max()

    free = list(selection.free)
    assert least(free) >= IDENTIFIABLE_CONTRACTION
    for symbol in {problems.list_symbols(knowledge)[k] for k in selection.fixed}:
        assert (
            least(free + [k for k, s in enumerate(problems.list_symbols(knowledge)) if s == symbol])
            < IDENTIFIABLE_CONTRACTION
        )
    assert least(free + list(selection.extra)) >= IDENTIFIABLE_CONTRACTION


def test_a_tolerance_decides_between_two_that_stand_for_each_other():
    """One measured sum: the parameter with the larger tolerance is freed, whatever the order."""
    for sd, expected in (((1.0, 3.0), (1,)), ((3.0, 1.0), (0,))):
        information = information_of_rows(np.array([[50.0, 50.0]]), np.array(sd))
        assert select_parameters(information, ("p", "q")).free == expected


def test_there_are_as_many_directions_as_parameters_and_they_span_the_space():
    for deformation in ("none", "linear"):
        knowledge, plan = problems.build_telescope_problem(deformation)
        _, null, _, directions = _analyse(knowledge, plan)
        assert len(directions) == len(knowledge.names)
        assert sum(d.kind == "structural" for d in directions) == null.shape[1]
        vectors = np.stack([d.vector for d in directions if d.kind != "informed"], axis=1)
        assert np.linalg.matrix_rank(vectors, tol=1e-3) == vectors.shape[1]
        for d in directions:
            assert (d.contraction >= IDENTIFIABLE_CONTRACTION) == (d.kind == "informed")


def test_lengths_along_a_leg():
    """RR-8096 eq. (36): of a_z, b_z and l only λ a_z - λ b_z + l is seen, λ the cosine of the leg at home."""
    knowledge, plan = problems.build_telescope_problem("none")
    _, _, _, directions = _analyse(knowledge, plan)
    ridges = _by_pivot(knowledge, directions)
    vectors = compute_home_legs(knowledge.machine)
    lengths = np.linalg.norm(vectors, axis=1)
    for leg in range(6):
        axis = vectors[leg] / lengths[leg]
        for symbol, sign in (("a_z", -1.0), ("b_z", 1.0)):
            move = ridges[f"{symbol}[{leg + 1}]"]
            # the ridge keeps z·δa - z·δb + δl: as it runs it takes a and b sideways, too
            seen = move[f"l[{leg + 1}]"]
            for k, name in enumerate("xyz"):
                seen += axis[k] * (move.get(f"a_{name}[{leg + 1}]", 0.0) - move.get(f"b_{name}[{leg + 1}]", 0.0))
            assert abs(seen) < 5e-3
            assert set(move) <= {f"{s}[{leg + 1}]" for s in ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")}
            assert move[f"l[{leg + 1}]"] == pytest.approx(sign / axis[2], rel=0.02)


def test_initial_position_against_the_attachment():
    knowledge, plan = problems.build_telescope_problem("none")
    ridges = _by_pivot(knowledge, _analyse(knowledge, plan)[3])
    for leg in range(1, 7):
        assert ridges[f"rho0[{leg}]"] == pytest.approx({f"rho0[{leg}]": 1.0, f"a_z[{leg}]": -1.0}, abs=1e-6)


@pytest.mark.parametrize("model", ["six_pus", "jacobian"])
def test_gain_against_direction(model):
    """RR-8096 eqs. (38) to (40): κ = const + u_z + (z_x / z_z) u_x, and with y; a_x keeps the joint's place."""
    knowledge, plan = problems.build_telescope_problem("linear", model)
    ridges = _by_pivot(knowledge, _analyse(knowledge, plan)[3])
    vectors = compute_home_legs(knowledge.machine)
    for leg in range(1, 7):
        for k, axis in enumerate("xy"):
            move = ridges[f"u_{axis}[{leg}]"]
            slope = vectors[leg - 1, k] / vectors[leg - 1, 2]
            assert move[f"kappa[{leg}]"] == pytest.approx(slope, abs=0.02)
            assert move[f"a_{axis}[{leg}]"] == pytest.approx(-machines.INITIAL_POSITION, rel=0.1)


def test_second_component_of_a_direction():
    """Without κ an actuator's direction may turn about the leg: z·u stays."""
    knowledge, plan = problems.build_telescope_problem("none", "jacobian")
    ridges = _by_pivot(knowledge, _analyse(knowledge, plan)[3])
    vectors = compute_home_legs(knowledge.machine)
    for leg in range(1, 7):
        move = next(m for p, m in ridges.items() if p in (f"u_x[{leg}]", f"u_y[{leg}]"))
        along = sum(vectors[leg - 1, k] * move[f"u_{axis}[{leg}]"] for k, axis in enumerate("xy"))
        assert abs(along) < 0.02 * np.linalg.norm(vectors[leg - 1, :2]) * max(
            abs(v) for v in move.values() if abs(v) < 9
        )


def test_initial_position_of_the_jacobian_model():
    """RR-8096 section 7.1.2: a joint moved along its leg, with ρ^0 and l, leaves the Jacobian model as it is."""
    knowledge, plan = problems.build_telescope_problem("none", "jacobian")
    _, null, _, directions = _analyse(knowledge, plan)
    assert null.shape[1] == 24
    symbols = problems.list_symbols(knowledge)
    structural = [{symbols[k] for k in np.flatnonzero(d.vector)} for d in directions if d.kind == "structural"]
    assert sum("rho0" in one for one in structural) >= 6


def test_frames_move_with_the_joints():
    """A frame's displacement and all joints of its body, and nothing else."""
    machine = machines.build_machine("none", model="six_ups")
    rows, posterior = _see(problems.build_knowledge(machine), problems.build_plan(machine), problems.FRAMES)
    information, names = information_of_rows(rows, np.ones(rows.shape[-1])), posterior.sampling.names
    wide = problems.read_plan(problems.build_knowledge(machine), problems.build_wide_plan(machine), problems.FRAMES)
    null = find_structural_rank(wide, np.random.default_rng(0)).null_space
    symbols = tuple(name.partition("[")[0] for name in names)
    fixed = select_parameters(information, symbols, {f"i_{one}" for one in problems.FRAMES}).fixed
    shifts = {}
    structural = [d for d in find_directions(information, null, fixed) if d.kind == "structural"]
    for d in structural:
        moved = {names[k] for k in np.flatnonzero(d.vector)}
        for frame, body in (("i_frame", "a"), ("i_target", "b")):
            for axis in "xyz":
                if moved == {f"{frame}[{axis}]", *(f"{body}_{axis}[{leg}]" for leg in range(1, 7))}:
                    shifts[frame, axis] = d
    assert len(shifts) == 6
    assert len(structural) == 12


@pytest.mark.parametrize("seed", range(20))
def test_sparse_basis_gives_back_planted_groups(seed):
    """Disjoint groups of parameters, mixed at random, are taken apart again."""
    rng = np.random.default_rng(seed)
    n, sizes = 60, rng.integers(2, 6, 8)
    places = np.split(rng.permutation(n)[: sizes.sum()], np.cumsum(sizes)[:-1])
    groups = np.zeros((n, 8))
    for k, place in enumerate(places):
        groups[place, k] = rng.uniform(0.3, 1.0, len(place)) * rng.choice([-1, 1], len(place))
    mixed = np.linalg.qr(groups @ rng.normal(size=(8, 8)))[0]
    basis, pivots = find_sparse_basis(mixed, ())
    assert len(set(pivots)) == 8
    assert {frozenset(np.flatnonzero(v)) for v in basis.T} == {frozenset(p.tolist()) for p in places}


# --- words -------------------------------------------------------------------------------------------------------


def test_sentences_say_what_the_readings_do():
    """The largest change of a reading, found again from the machine itself for a step so small that nothing bends."""
    knowledge, plan = problems.build_telescope_problem("linear")
    _, _, _, directions = _analyse(knowledge, plan)
    rows, posterior = _see(knowledge, plan)
    told = (knowledge.names, problems.list_units(knowledge), knowledge.sd, Units(), "leg")
    ridges = list(describe_ridges(directions, rows, *told))
    assert len(ridges) == sum(d.kind != "informed" for d in directions)
    likelihood, small = posterior.likelihood, 1e-3
    for _, move, sentence in ridges[::5]:
        y = small * move / knowledge.sd
        error = likelihood.explain(*posterior.at(y[None]))[1].error[0]
        found = float(np.abs(error).max()) / small
        said = float(sentence.removesuffix(" of its noise.").rpartition(" ")[2])
        assert found == pytest.approx(said, rel=0.06, abs=1e-3)
    first = next(sentence for d, _, sentence in ridges if knowledge.names[d.pivot] == "a_z[3]")
    assert first.startswith("Leg 3: changing a_z by +1 mm with l by \u22121.03 mm")
