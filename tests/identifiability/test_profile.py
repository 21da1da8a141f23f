"""Profiles: parabolas where all is linear, flat along ridges, and paths that are the report's curves."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.errors import InputError
from bayescal.identifiability.information import information_of_rows
from bayescal.identifiability.profile import compute_profile
from bayescal.identifiability.reading_rows import see
from bayescal.machines.kinematics import compute_leg_lines

NOTHING = np.empty(0)


def test_profile_of_a_linear_machine_is_the_parabola_of_the_audit():
    """Its curvature is the posterior precision without that of the parameter's own prior."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.scale_tolerances(
        problems.build_knowledge(knowledge.machine, machines.FREE_SYMBOLS["linear"]), 1e-2
    )
    posterior = problems.read_plan(knowledge, plan)
    information = information_of_rows(see(posterior, np.zeros(posterior.n_geometry)), np.ones(posterior.n_geometry))
    for name in ("l[1]", "a_x[3]", "kappa[2]"):
        profile = compute_profile(posterior, name, NOTHING, n_side=3)
        place = knowledge.names.index(name)
        move = (profile.values - knowledge.theta[knowledge.free][place]) / knowledge.sd[place]
        expected = move**2 * (1.0 / information.covariance[place, place] - 1.0)
        assert move == pytest.approx(np.linspace(-3, 3, 7), abs=1e-9)
        assert profile.deviance == pytest.approx(expected, rel=0.02, abs=1e-9)
        assert np.all(profile.data_deviance <= profile.deviance + 1e-9)


def test_profile_along_a_gauge_is_flat():
    """A later home position of an actuator along z is a lower base joint: only the prior of a_z minds."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.build_knowledge(knowledge.machine, ("a_z", "rho0"))
    profile = compute_profile(problems.read_plan(knowledge, plan), "rho0[4]", NOTHING, n_side=4)
    move = profile.values - 10.0
    path = profile.path[:, knowledge.names.index("a_z[4]")]
    assert np.abs(profile.data_deviance).max() < 1e-4
    assert path - path[4] == pytest.approx(-move, abs=1e-3)
    assert profile.deviance == pytest.approx((move / problems.LENGTH_SD) ** 2, rel=1e-3, abs=1e-6)


def test_path_of_kappa_against_the_direction_is_the_reports():
    """RR-8096 eqs. (38) to (40): κ = const + u_z + z_x / z_z u_x + z_y / z_z u_y, z the leg at home."""
    knowledge, plan = problems.build_telescope_problem("linear")
    slope_x, slope_y, _ = compute_leg_lines(knowledge.machine)[0]
    profile = compute_profile(problems.read_plan(knowledge, plan), "u_x[1]", NOTHING, n_side=6)
    kappa, u_x, u_y = (profile.path[:, knowledge.names.index(f"{symbol}[1]")] for symbol in ("kappa", "u_x", "u_y"))
    gain = np.sqrt(1.0 - u_x**2 - u_y**2) + slope_x * u_x + slope_y * u_y
    assert np.isfinite(profile.deviance).all()
    assert np.ptp(kappa) > 0.05
    assert kappa - kappa[6] == pytest.approx(gain - gain[6], abs=3e-4)
    straight = np.polyval(np.polyfit(u_x[5:8], kappa[5:8], 1), u_x)
    assert np.abs(kappa - straight).max() > 0.01  # it bends


def test_what_deviates_alike_is_held_alike():
    """Two lengths that are one unknown: its profile is the parabola of the sum of what both tell."""
    knowledge, plan = problems.build_telescope_problem("none")
    knowledge = problems.scale_tolerances(problems.build_knowledge(knowledge.machine, ("l",)), 1e-2)
    posterior = problems.read_plan(knowledge, plan)
    pair = ("l[1]", "l[2]")
    joined = {"l[1,2]": posterior.priors["l[1]"]} | {n: p for n, p in posterior.priors.items() if n not in pair}
    both = type(posterior)(posterior.likelihood, joined, posterior.errors, {}, {"l[1,2]": pair})
    rows = see(posterior, np.zeros(6)).reshape(-1, 6)
    others = rows[:, 2:]
    seen = rows[:, :2].sum(axis=1)
    left = seen @ np.linalg.solve(np.eye(len(rows)) + others @ others.T, seen)
    profile = compute_profile(both, "l[1,2]", NOTHING, n_side=2)
    assert profile.deviance == pytest.approx(left * np.array([9.0, 2.25, 0.0, 2.25, 9.0]), rel=0.02, abs=1e-9)


def test_values_without_a_machine_have_no_deviance():
    """A direction longer than one: the profile ends where the machine does."""
    knowledge, plan = problems.build_telescope_problem("none")
    knowledge = problems.build_knowledge(knowledge.machine, ("u_x",))
    priors = dict(knowledge.priors)
    priors["u_x[1]"] = replace(priors["u_x[1]"], scale=0.5)
    posterior = problems.read_plan(replace(knowledge, priors=priors), plan)
    profile = compute_profile(posterior, "u_x[1]", NOTHING, n_side=3)
    assert np.isfinite(profile.deviance).tolist() == [False, False, True, True, True, False, False]


def test_profile_of_a_fixed_parameter_is_an_error():
    knowledge, plan = problems.build_telescope_problem("none")
    with pytest.raises(InputError, match=r"profile of 'kappa\[1\]':"):
        compute_profile(problems.read_plan(knowledge, plan), "kappa[1]", NOTHING)
