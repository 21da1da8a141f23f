"""Machines and their images: a mirrored or turned machine stands in the mirrored or turned pose, for every model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.mechanism import ExternalLoad
from bayescal.numerics.geometry import compute_pose_error

HANGING = ExternalLoad(weight=(0.0, 0.0, -98.0), centre_of_mass=(0.0, 0.0, 40.0))  # on the axis of symmetry


@dataclass(frozen=True)
class Symmetry:
    """An orthogonal map of the base frame, and which leg's image each leg is."""

    matrix: np.ndarray
    source: np.ndarray

    def image(self, layout, theta):
        """Return the parameters of the machine's image."""
        result = theta.copy()
        for index in layout.index.values():
            if len(index) == len(self.source):
                result[index] = theta[index][self.source]
        for prefix in ("a", "b"):
            point = layout.take_vector(theta, prefix)[self.source] @ self.matrix.T
            for k, axis in enumerate("xyz"):
                result[layout.index[f"{prefix}_{axis}"]] = point[:, k]
        if "u_x" not in layout.index:
            return result
        u = (
            np.stack([layout.take(theta, "u_x"), layout.take(theta, "u_y")], axis=1)[self.source]
            @ self.matrix[:2, :2].T
        )
        result[layout.index["u_x"]], result[layout.index["u_y"]] = u.T
        return result


SYMMETRIES = {
    "mirror": Symmetry(np.diag([-1.0, 1.0, 1.0]), np.array([1, 0, 5, 4, 3, 2])),
    "third of a turn": Symmetry(
        np.array([[-0.5, -np.sqrt(0.75), 0.0], [np.sqrt(0.75), -0.5, 0.0], [0.0, 0.0, 1.0]]),
        np.array([4, 5, 0, 1, 2, 3]),
    ),
}


@pytest.fixture(params=SYMMETRIES.values(), ids=SYMMETRIES.keys())
def symmetry(request):
    """Return a symmetry of the telescope."""
    return request.param


@pytest.fixture(params=["none", "linear"])
def machine(request, model):
    """Return the telescope with a weight; K itself is not symmetric."""
    return machines.build_machine(request.param, machines.build_telescope(load=HANGING), model)


@pytest.fixture(params=machines.model_names())
def model(request):
    """Return the name of a model."""
    return request.param


def assert_image(symmetry, machine, theta, rho, other_theta):
    """Assert that the image of the machine stands in the images of its poses."""
    pose = solve_forward_kinematics(machine, theta, rho)
    image = solve_forward_kinematics(machine, other_theta, rho[:, symmetry.source])
    turned = symmetry.matrix @ pose.rotation @ symmetry.matrix.T
    error = compute_pose_error(image.position, image.rotation, pose.position @ symmetry.matrix.T, turned)
    assert np.abs(error[:, :3]).max() < 1e-9
    assert np.abs(error[:, 3:]).max() < 1e-11
    assert np.linalg.norm(image.position - pose.position, axis=1).max() > 0.1  # the poses are not symmetric themselves


def test_the_telescope_is_symmetric(symmetry, machine):
    layout = machine.layout
    np.testing.assert_allclose(symmetry.image(layout, layout.nominal), layout.nominal, atol=1e-12)


def test_image_of_any_machine_stands_in_images(symmetry, machine, rng):
    """Every parameter off nominal."""
    layout = machine.layout
    theta = layout.nominal + 0.5 * machines.spread_of(layout) * rng.standard_normal(layout.size)
    other = symmetry.image(layout, theta)
    assert np.abs(other - theta).max() > 0.1
    assert_image(symmetry, machine, theta, machines.table_3_actuators(), other)


def test_symmetric_configuration_keeps_the_platform_level(model, symmetry):
    """All actuators alike: the platform goes up, and neither aside nor round; struts lean, and lift it further."""
    machine = machines.build_machine("none", machines.build_telescope(load=HANGING), model)
    pose = solve_forward_kinematics(machine, machine.layout.nominal, np.full(6, machines.INITIAL_POSITION + 1.0))
    turned = symmetry.matrix @ pose.rotation @ symmetry.matrix.T
    np.testing.assert_allclose(turned, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(pose.position[:2], 0.0, atol=1e-10)
    base = solve_forward_kinematics(machine, machine.layout.nominal, np.full(6, machines.INITIAL_POSITION))
    aside = np.linalg.norm((machine.mechanism.home_joints - machine.mechanism.platform_points)[0, :2])
    longer = np.sqrt(501.0**2 - aside**2) - np.sqrt(500.0**2 - aside**2)
    rise = longer if machine.mechanism.drive == "strut" else 1.0
    assert pose.position[2] - base.position[2] == pytest.approx(rise, abs=1e-9)


def test_a_load_aside_breaks_the_symmetry():
    """Negative control."""
    load = replace(HANGING, centre_of_mass=(30.0, 0.0, 0.0))
    machine = machines.build_machine("none", machines.build_telescope(load=load), "stiffness")
    theta = machine.layout.nominal
    with pytest.raises(AssertionError):
        assert_image(SYMMETRIES["mirror"], machine, theta, machines.table_3_actuators(), theta)
