"""Calibrability against the Schur complement of the whole Jacobian; what units and noise do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sika_problems import make_problem

from sika2008.sensors import compute_calibrability

DEGREE = np.pi / 180


def schur_condition(sensors, free, pose, length, angle, scale):
    """Condition of the information on the parameters, poses eliminated from the normal equations instead."""
    unit = np.where(np.array([sensors.model.channels[k].unit for k in sensors.chosen]) == "mm", length, angle)
    found = sensors.model.linearise(free.centre, pose)
    h = found.by_pose[:, sensors.chosen] / unit[:, None]
    a = found.by_parameters[:, sensors.chosen][..., free.places] / unit[:, None] * scale
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    information = np.zeros((a.shape[-1],) * 2)
    for one, by in zip(h, a, strict=True):
        information += by.T @ by - by.T @ one @ np.linalg.solve(one.T @ one, one.T @ by)
    values = np.linalg.eigvalsh(information)
    return values[-1] / values[0]


@pytest.mark.parametrize("n_sensors", [4, 8, 12])
def test_agrees_with_the_schur_complement(n_sensors):
    sensors, free, pose = make_problem(n_sensors, 60)
    found = compute_calibrability(sensors, free, pose)
    mm = np.array(sensors.model.layout.units)[free.places] == "mm"
    wanted = {
        "metres_radians": (1e3, 1.0, np.where(mm, 1e3, 1.0)),
        "millimetres_degrees": (1.0, DEGREE, np.where(mm, 1.0, DEGREE)),
    }
    for unit, arguments in wanted.items():
        # the eigenvalues of a squared matrix lose digits as C grows
        value = schur_condition(sensors, free, pose, *arguments)
        assert getattr(found, unit) == pytest.approx(value, rel=1e-14 * value + 1e-6)
    scaled = schur_condition(sensors, free, pose, 1e-3, sensors.noise[-1], free.scale)
    assert found.scaled == pytest.approx(scaled, rel=1e-5)


def test_documented_machine_has_the_published_order():
    for n_sensors, published in ((4, 3e8), (8, 3e4), (12, 4e4)):
        sensors, free, pose = make_problem(n_sensors, 100)
        found = compute_calibrability(sensors, free, pose).metres_radians
        assert published / 3.2 < found < published * 3.2


def test_more_noise_of_all_sensors_changes_nothing():
    """C says nothing of how well parameters are known."""
    sensors, free, pose = make_problem(8, 30)
    worse = type(sensors)(sensors.model, sensors.chosen, 10.0 * sensors.noise)
    one, two = (compute_calibrability(s, free, pose) for s in (sensors, worse))
    assert two.scaled == pytest.approx(one.scaled, rel=1e-9)
    assert two.metres_radians == one.metres_radians
    uneven = type(sensors)(sensors.model, sensors.chosen, sensors.noise * np.where(sensors.chosen < 4, 10.0, 1.0))
    assert compute_calibrability(uneven, free, pose).scaled != pytest.approx(one.scaled, rel=0.1)


def test_units_of_the_tolerances_change_only_the_scaled_one():
    sensors, free, pose = make_problem(8, 30)
    other = replace(free, scale=free.scale * np.where(np.arange(len(free.scale)) == 3, 20.0, 1.0))
    one, two = (compute_calibrability(sensors, f, pose) for f in (free, other))
    assert two.millimetres_radians == one.millimetres_radians
    assert two.scaled != pytest.approx(one.scaled, rel=0.01)


def test_what_no_sensor_sees_makes_it_infinite():
    sensors, free, pose = make_problem(8, 30)
    tool = sensors.model.layout.names.index("xi_V")
    unseen = replace(free, places=np.append(free.places, tool), scale=np.append(free.scale, 0.3))
    assert compute_calibrability(sensors, unseen, pose).scaled == np.inf
    few = compute_calibrability(sensors, free, pose[:3])  # 15 rows for 22 parameters
    assert few.metres_radians == np.inf
