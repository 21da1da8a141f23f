"""The standing contract of the two eliminations: legs' exact density is that of the general route, commanded actuators.

Nothing is free between them: constants agree too, so that evidences of the two routes may be compared. What is left is
the second order about the best pose, where model errors move poses far: up to 0.015 nats of all poses together, where
they are 60 µm on the telescope; 1e-4 otherwise. Errors that all poses have in common, such as that of a measured K, are
no part of either elimination: here K is known.
"""

from dataclasses import replace
from functools import cache

import frozen_densities as frozen
import numpy as np
import pytest
from eliminated_legs import eliminate_legs, evaluate_legs

from bayescal.density.exact import ExactDensity
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.frame.load import load
from bayescal.experiments.study.inputs import load_inputs
from bayescal.numerics.units import MICROMETRE

CLOSE = 0.02
DRAWS, FEW_DRAWS = 20, 5
MACHINES = [
    *(
        ("experiments/telescope/study.toml", f"{model}/{deformation}")
        for model in ("six_pus", "beam", "stiffness", "jacobian")
        for deformation in ("none", "linear", "matrix")
    ),
    *(("experiments/m2_hexapod/study.toml", f"six_ups/{deformation}") for deformation in ("none", "linear", "matrix")),
    *(("experiments/hexaglide/study.toml", f"six_pus/{deformation}") for deformation in ("none", "linear")),
]
FEW = [MACHINES[k] for k in (0, 4, 8, 11, 12, 16)]


@cache
def read(path):
    """Return the inputs of a study."""
    return load_inputs(load(frozen.ROOT / path)[1], (frozen.ROOT / path).parent)


def draw(path, name, n_draws):
    """Return a machine, its poses and actuator noise, and draws of the posterior: θ (B, D), τ (B, N)."""
    inputs = read(path)
    variant = inputs.variant(name)
    posterior, mode = inputs.posterior(variant, True), frozen.read_frozen()[f"{path}: {name}"]["mode"]
    factor = np.linalg.cholesky(-posterior.gradient(mode)[1])
    z = np.random.default_rng(28).standard_normal((len(mode), n_draws))
    y = np.concatenate([mode[None], mode + np.linalg.solve(factor.T, z).T])
    noise = inputs.config.measured.actuator_noise_um * MICROMETRE
    tau = posterior.errors.tau(posterior.zeta(y))
    return inputs.machine(variant), inputs.poses(verification=False), noise, posterior.theta(y), tau


def compare(machine, poses, noise, theta, tau):
    """Return the general density minus the exact one, (B,)."""
    exact = ExactDensity(PoseLikelihood(machine, poses, noise), noise)
    general = evaluate_legs(eliminate_legs(machine, poses, noise, theta[0]), theta, tau)
    return general.sum(axis=1) - exact(theta, tau)


@pytest.mark.parametrize(("path", "name"), FEW)
def test_the_general_density_is_that_of_legs(path, name):
    assert np.abs(compare(*draw(path, name, FEW_DRAWS))).max() < CLOSE


@pytest.mark.slow
@pytest.mark.parametrize(("path", "name"), MACHINES)
def test_the_general_density_is_that_of_legs_for_all_machines(path, name):
    difference = compare(*draw(path, name, DRAWS))
    assert np.abs(difference).max() < CLOSE
    if "telescope" not in path or "jacobian/none" in name or "jacobian/linear" in name:
        assert np.abs(difference).max() < 1e-3


def test_the_measure_of_the_pose_matters():
    """Without commanded actuators the two differ by what varies from machine to machine."""
    machine, poses, noise, theta, tau = draw("experiments/telescope/study.toml", "six_pus/linear", FEW_DRAWS)
    exact = ExactDensity(PoseLikelihood(machine, poses, noise), noise)
    general = eliminate_legs(machine, poses, noise, theta[0])
    flat = replace(general, data=replace(general.data, commanded=None))
    difference = evaluate_legs(flat, theta, tau).sum(axis=1) - exact(theta, tau)
    assert np.ptp(difference) > 5 * CLOSE
