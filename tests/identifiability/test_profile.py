"""Profiles: parabolas where all is linear, flat along ridges, and paths that are the report's curves."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.errors import InputError
from bayescal.identifiability.information import information_of_rows
from bayescal.identifiability.profile import compute_profiles
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.kinematics import compute_leg_lines


def test_profile_of_a_linear_machine_is_the_parabola_of_the_audit():
    """Its curvature is the posterior precision without that of the parameter's own prior."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.scale_tolerances(
        problems.build_knowledge(knowledge.machine, machines.FREE_SYMBOLS["linear"]), 1e-2
    )
    information = information_of_rows(compute_sensitivity(knowledge, plan.actuators).rows(plan), knowledge.sd)
    names = ["l[1]", "a_x[3]", "kappa[2]"]
    for profile in compute_profiles(knowledge, plan, names, n_side=3):
        place = knowledge.names.index(profile.name)
        move = (profile.values - knowledge.centre[knowledge.free][place]) / knowledge.sd[place]
        expected = move**2 * (1.0 / information.covariance[place, place] - 1.0)
        assert profile.converged.all()
        assert move == pytest.approx(np.linspace(-3, 3, 7), abs=1e-9)
        assert profile.deviance == pytest.approx(expected, rel=0.02, abs=1e-9)
        assert np.all(profile.data_deviance <= profile.deviance + 1e-9)


def test_profile_along_a_gauge_is_flat():
    """A later home position of an actuator along z is a lower base joint: only the prior of a_z minds."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.build_knowledge(knowledge.machine, ("a_z", "rho0"))
    (profile,) = compute_profiles(knowledge, plan, ["rho0[4]"], n_side=4)
    move = profile.values - 10.0
    path = profile.path[:, knowledge.names.index("a_z[4]")]
    assert np.abs(profile.data_deviance).max() < 1e-4
    assert path - path[4] == pytest.approx(-move, abs=1e-3)
    assert profile.deviance == pytest.approx((move / problems.LENGTH_SD) ** 2, rel=1e-3, abs=1e-6)


def test_path_of_kappa_against_the_direction_is_the_reports():
    """RR-8096 eqs. (38) to (40): κ = const + u_z + z_x / z_z u_x + z_y / z_z u_y, z the leg at home."""
    knowledge, plan = problems.build_telescope_problem("linear")
    slope_x, slope_y, _ = compute_leg_lines(knowledge.machine)[0]
    (profile,) = compute_profiles(knowledge, plan, ["u_x[1]"], n_side=6)
    kappa, u_x, u_y = (profile.path[:, knowledge.names.index(f"{symbol}[1]")] for symbol in ("kappa", "u_x", "u_y"))
    gain = np.sqrt(1.0 - u_x**2 - u_y**2) + slope_x * u_x + slope_y * u_y
    assert profile.converged.all()
    assert np.ptp(kappa) > 0.05
    assert kappa - kappa[6] == pytest.approx(gain - gain[6], abs=3e-4)
    straight = np.polyval(np.polyfit(u_x[5:8], kappa[5:8], 1), u_x)
    assert np.abs(kappa - straight).max() > 0.01  # it bends


def test_profile_of_noisy_poses_is_best_somewhere_else():
    """Small tolerances, so that the parameter's own prior would be seen had it not been left out."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.scale_tolerances(
        problems.build_knowledge(knowledge.machine, machines.FREE_SYMBOLS["linear"]), 0.1
    )
    exact, noisy = (
        compute_profiles(knowledge, plan, ["kappa[2]"], rng, n_side=10)[0] for rng in (None, np.random.default_rng(0))
    )
    assert np.argmin(exact.deviance) == 10
    assert exact.deviance[10] == pytest.approx(0.0, abs=1e-6)
    assert np.all(noisy.deviance > -1e-4)
    curve = np.polynomial.Polynomial.fit(noisy.values, noisy.deviance, 4)
    best = curve.deriv().roots()
    best = float(best[np.argmin(np.abs(best - exact.values[10]))].real)
    assert curve(best) == pytest.approx(0.0, abs=1e-3)
    assert abs(best - exact.values[10]) > 0.2 * knowledge.priors["kappa[2]"]


def test_profile_of_a_fixed_parameter_is_an_error():
    knowledge, plan = problems.build_telescope_problem("none")
    with pytest.raises(InputError, match=r"profile of 'kappa\[1\]': not free here"):
        compute_profiles(knowledge, plan, ["kappa[1]"])
