"""Beam elements against the closed forms of strength of materials, and the chain in two independent forms."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines
from beam_matrices import compute_beam_stiffness, condense_chain, shift_nodes

from bayescal.machines.mechanism import BeamSection, section_of_rod
from bayescal.machines.models.equilibrium import SYMBOLS, compute_chain_stiffness, differentiate_chain
from bayescal.numerics.geometry import skew_matrix

E, G, DIAMETER, LENGTH = 200e3, 77e3, 1.5, 37.0
SECTION = section_of_rod(DIAMETER, E, G)
FORCE, MOMENT = 3.0, 50.0  # N and N mm
X_AXIS = np.array([1.0, 0.0, 0.0])


@pytest.fixture(params=range(8))
def chain(request):
    """Return random sections of flexure and leg, the distance of the centres and l_b: slim and stout, soft and hard."""
    rng = np.random.default_rng(request.param)
    flexure, leg = (BeamSection(*(10.0 ** rng.uniform(2, 5, 3))) for _ in range(2))
    l_b = 10.0 ** rng.uniform(-1, 2)
    return flexure, leg, l_b * (1.0 + 10.0 ** rng.uniform(-1, 1.7)), l_b


def chain_elements(flexure, leg, length, l_b):
    """Return the three elements between the nodes a', c', d' and b'."""
    flexures = compute_beam_stiffness(flexure, l_b)
    return flexures, compute_beam_stiffness(leg, length - l_b), flexures


def chain_between_centres(flexure, leg, length, l_b):
    """Return the condensed chain (12, 12) seen at the flexures' centres, half a flexure inside its end nodes."""
    return shift_nodes(
        condense_chain(chain_elements(flexure, leg, length, l_b)), 0.5 * l_b * X_AXIS, -0.5 * l_b * X_AXIS
    )


def chain_values(flexure, leg, length, l_b):
    """Return the chain's parameters in the order of `SYMBOLS`."""
    return [np.array(v) for v in (flexure.k1, flexure.k2, flexure.k3, leg.k1, leg.k2, leg.k3, length, l_b)]


def assert_relative(found, expected, tolerance):
    """Compare matrices of loads (N, N mm) per displacement (mm, rad), whose entries differ by powers of a length."""
    scale = np.sqrt(np.abs(np.outer(np.diag(expected), np.diag(expected))))
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)


def solve_cantilever(stiffness, load):
    """Return the displacement (6,) of the second node under a load (6,), the first node held."""
    return np.linalg.solve(stiffness[6:, 6:], load)


# --- one beam --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("load", "expected"),
    [
        ({0: FORCE}, {0: FORCE * LENGTH / SECTION.k2}),
        ({1: FORCE}, {1: FORCE * LENGTH**3 / (3 * SECTION.k1), 5: FORCE * LENGTH**2 / (2 * SECTION.k1)}),
        ({2: FORCE}, {2: FORCE * LENGTH**3 / (3 * SECTION.k1), 4: -FORCE * LENGTH**2 / (2 * SECTION.k1)}),
        ({3: MOMENT}, {3: MOMENT * LENGTH / SECTION.k3}),
        ({4: MOMENT}, {2: -MOMENT * LENGTH**2 / (2 * SECTION.k1), 4: MOMENT * LENGTH / SECTION.k1}),
        ({5: MOMENT}, {1: MOMENT * LENGTH**2 / (2 * SECTION.k1), 5: MOMENT * LENGTH / SECTION.k1}),
    ],
    ids=["pull", "force along y", "force along z", "torque", "moment about y", "moment about z"],
)
def test_cantilever(load, expected):
    """Tip deflection and slope of a beam held at one end."""

    def vector(entries):
        return np.array([entries.get(k, 0.0) for k in range(6)])

    found = solve_cantilever(compute_beam_stiffness(SECTION, LENGTH), vector(load))
    np.testing.assert_allclose(found, vector(expected), rtol=1e-12, atol=1e-13 * np.abs(found).max())


def test_section_of_a_rod():
    """k1 = E π d⁴ / 64, k2 = E π d² / 4, k3 = G π d⁴ / 32, by integration over the disc."""
    radius = (np.arange(20_000) + 0.5) / 20_000 * DIAMETER / 2
    ring = 2 * np.pi * radius * DIAMETER / 2 / 20_000
    assert SECTION.k2 == pytest.approx(E * ring.sum(), rel=1e-8)
    assert SECTION.k3 == pytest.approx(G * (ring * radius**2).sum(), rel=1e-8)
    assert SECTION.k1 == pytest.approx(E * (ring * radius**2).sum() / 2, rel=1e-8)  # y² is half of r² on average


def rigid_displacements(length):
    """Return the displacements (12, 6) of both ends when a beam along x moves as a rigid body about its first end."""
    first, second = np.eye(6), np.eye(6)
    second[:3, 3:] = -skew_matrix(length * X_AXIS)
    return np.concatenate([first, second])


def stiffnesses(chain):
    """Return the stiffness matrices of an element, of the chain and of the chain between its centres, with lengths."""
    flexure, _, length, l_b = chain
    return {
        "element": (compute_beam_stiffness(flexure, length), length),
        "chain": (condense_chain(chain_elements(*chain)), length + l_b),
        "between centres": (chain_between_centres(*chain), length),
    }


@pytest.mark.parametrize("kind", ["element", "chain", "between centres"])
def test_matrix_is_symmetric_and_positive(chain, kind):
    stiffness, _ = stiffnesses(chain)[kind]
    assert_relative(stiffness.T, stiffness, 1e-10)
    unit = np.sqrt(np.diag(stiffness))
    values = np.linalg.eigvalsh(stiffness / np.outer(unit, unit))
    assert values[0] > -1e-10
    assert np.all(values[6:] > 1e-10)  # held at one end it resists


@pytest.mark.parametrize("kind", ["element", "chain", "between centres"])
def test_rigid_displacements_cause_no_load(chain, kind):
    stiffness, length = stiffnesses(chain)[kind]
    rigid = rigid_displacements(length)
    size = np.abs(stiffness) @ np.abs(rigid)
    assert np.all(np.abs(stiffness @ rigid) <= 1e-10 * size)
    bent = rigid.copy()
    bent[7, 1] += 1.0  # the second end alone
    assert np.abs(stiffness @ bent)[:, 1].max() > 1e-3 * size[:, 1].max()


@pytest.mark.parametrize("kind", ["element", "chain", "between centres"])
def test_loads_of_both_ends_balance(chain, kind, rng):
    """Forces sum to zero, moments about any point too."""
    stiffness, length = stiffnesses(chain)[kind]
    loads = stiffness @ rng.standard_normal(12)
    (force, moment), (other_force, other_moment) = (np.split(part, 2) for part in np.split(loads, 2))
    np.testing.assert_allclose(force, -other_force, rtol=0, atol=1e-9 * np.abs(force).max())
    point = rng.uniform(-300, 300, 3)
    levers = np.cross(-point, force) + np.cross(length * X_AXIS - point, other_force)
    total = moment + other_moment + levers
    size = np.abs(moment).max() + np.abs(other_moment).max() + 300.0 * np.abs(force).max()
    assert np.abs(total).max() < 1e-9 * size


# --- chains ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_beams", [2, 3, 5])
def test_equal_beams_in_a_row_are_one_long_beam(n_beams, rng):
    lengths = rng.uniform(5, 30, n_beams)
    found = condense_chain([compute_beam_stiffness(SECTION, length) for length in lengths])
    assert_relative(found, compute_beam_stiffness(SECTION, lengths.sum()), 1e-11)


def test_condensed_nodes_carry_no_load(chain, rng):
    """The nodes in between stand where no load is needed; then the outer loads are those of the condensed matrix."""
    elements = chain_elements(*chain)
    full = np.zeros((24, 24))
    for k, element in enumerate(elements):
        full[6 * k : 6 * k + 12, 6 * k : 6 * k + 12] += element
    outer, inner = np.r_[0:6, 18:24], np.arange(6, 18)
    displacement = np.zeros(24)
    displacement[outer] = rng.standard_normal(12)
    displacement[inner] = np.linalg.solve(full[np.ix_(inner, inner)], -full[np.ix_(inner, outer)] @ displacement[outer])
    loads = full @ displacement
    size = np.abs(full).max() * np.abs(displacement).max()
    assert np.abs(loads[inner]).max() < 1e-10 * size
    np.testing.assert_allclose(condense_chain(elements) @ displacement[outer], loads[outer], atol=1e-10 * size)


def test_shifting_there_and_back(chain):
    stiffness, offset = condense_chain(chain_elements(*chain)), np.array([1.0, -2.0, 3.0])
    again = shift_nodes(shift_nodes(stiffness, offset, 2 * offset), -offset, -2 * offset)
    assert_relative(again, stiffness, 1e-9)


def test_closed_form_is_the_condensed_matrix(chain):
    """`compute_chain_stiffness` says of the flexures' centres what eqs. (24) to (27) say, moved there."""
    found, length = compute_chain_stiffness(*chain_values(*chain)), chain[2]
    bending = found.near + found.far
    slim = bending / length
    near = np.diag([found.axial, 2 * slim / length, 2 * slim / length, found.torsional, found.near, found.near])
    near[1, 5] = near[5, 1] = slim
    near[2, 4] = near[4, 2] = -slim
    far_end = np.diag(np.diag(near))
    far_end[1, 5] = far_end[5, 1] = -slim
    far_end[2, 4] = far_end[4, 2] = slim
    between = -np.diag([found.axial, 2 * slim / length, 2 * slim / length, found.torsional, -found.far, -found.far])
    between[1, 5], between[5, 1] = slim, -slim
    between[2, 4], between[4, 2] = -slim, slim
    expected = np.block([[near, between], [between.T, far_end]])
    assert_relative(chain_between_centres(*chain), expected, 1e-8)


def test_without_flexures_the_leg_is_a_beam():
    """l_b to zero leaves the leg alone: 4 k1 / l and 2 k1 / l, k2 / l and k3 / l."""
    found = compute_chain_stiffness(*chain_values(SECTION, SECTION, LENGTH, 1e-9))
    expected = [SECTION.k2, SECTION.k3, 4 * SECTION.k1, 2 * SECTION.k1]
    np.testing.assert_allclose(
        [found.axial, found.torsional, found.near, found.far], np.array(expected) / LENGTH, rtol=1e-8
    )


def test_soft_flexures_bend_alone():
    """On a rigid leg: moments k1 / l_b about the own centre, and little about the other one: a spring at each end."""
    flexure, leg, l_b, length = SECTION, BeamSection(1e15, 1e15, 1e15), 10.0, 5000.0
    found = compute_chain_stiffness(*chain_values(flexure, leg, length, l_b))
    assert found.near == pytest.approx(flexure.k1 / l_b, rel=1e-6)
    assert abs(found.far) < 1e-4 * found.near
    assert found.axial == pytest.approx(flexure.k2 / (2 * l_b), rel=1e-6)
    assert found.torsional == pytest.approx(flexure.k3 / (2 * l_b), rel=1e-6)


def test_derivatives_of_the_chain(chain):
    values = np.array(chain_values(*chain))
    found = differentiate_chain([np.array(v) for v in values])

    def quantities(x):
        return np.stack(list(vars(compute_chain_stiffness(*x.T)).values()), axis=-1)

    # l only just above l_b would make a step in either a large one in the leg between
    steps = 3e-3 * np.where(np.arange(8) < 6, values, values[6] - values[7])
    steps[7] = min(steps[7], 3e-3 * values[7])
    expected = machines.stencil_derivative(quantities, values, steps)
    assert found.shape == (len(SYMBOLS), 4)
    computed = found.T
    size = np.abs(quantities(values[None])[0])[:, None] / values  # an elasticity of one
    np.testing.assert_allclose(computed / size, expected / size, rtol=1e-7, atol=1e-9)
