"""Readings far from where a direction turns are found by the derivatives alone, and no others."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pytest

from bayescal.identifiability.directions import Direction
from bayescal.identifiability.scale_ambiguity import find_levers


def _tie(posterior, *names):
    """Return a ridge of some parameters in equal shares."""
    vector = np.zeros(posterior.n_geometry)
    vector[[posterior.sampling.names.index(name) for name in names]] = len(names) ** -0.5
    return Direction("practical", vector, 0.0, 0.0, int(np.flatnonzero(vector)[0]))


@pytest.fixture(scope="module")
def telescope():
    """Return readings of actuators between 8.7 and 11.3 mm, whose rails turn about zero."""
    return problems.read_plan(*problems.build_telescope_problem("linear"))


def test_a_place_that_a_direction_turns_is_found(telescope):
    y = np.zeros(telescope.n_geometry)
    found = list(find_levers(telescope, y, [_tie(telescope, "u_x[2]", "a_x[2]"), _tie(telescope, "u_y[5]", "a_y[5]")]))
    assert [one.channel for one in found] == ["rho[2]", "rho[5]"]
    assert [one.reading for one in found] == pytest.approx([10.0, 10.0], abs=0.2)
    assert [one.moved for one in found] == pytest.approx([0.5, 0.5], rel=0.05)  # of a tolerance of 0.05


def test_other_ties_are_none(telescope):
    """A gain and a length, a direction and another leg's place, and a direction alone."""
    ridges = [_tie(telescope, "kappa[1]", "l[1]"), _tie(telescope, "u_x[1]", "a_x[3]"), _tie(telescope, "u_x[4]")]
    assert not list(find_levers(telescope, np.zeros(telescope.n_geometry), ridges))


def test_readings_that_reach_to_zero_have_no_lever():
    knowledge, _ = problems.build_telescope_problem("linear")
    posterior = problems.read_plan(knowledge, problems.build_plan(knowledge.machine, half=6.5))
    assert not list(find_levers(posterior, np.zeros(posterior.n_geometry), [_tie(posterior, "u_x[2]", "a_x[2]")]))
