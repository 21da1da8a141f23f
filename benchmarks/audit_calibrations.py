"""Time of 200 simulated calibrations fitted at once, against SciPy's least squares one after the other.

    python benchmarks/audit_calibrations.py [--machines 200] [--loops 8]

The telescope with linear deformation at the 40 configurations of table 3, the report's 36 free parameters, machines
drawn from the priors. Both sides find the most probable machine from the same measured poses with the same noise. SciPy
gets forward kinematics of all poses at once and either the exact derivatives or its own differences; it fits a few of
the machines. Estimates are compared, in posterior standard deviations, before times are. One core; the ratio is of the
times per machine in one run.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import time

from telescope_problem import TELESCOPE, write_results

import numpy as np
from scipy.optimize import least_squares

from bayescal.identifiability.calibration import simulate_measurements
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.fits import Fitter, Fits, Measurements
from bayescal.identifiability.sensitivity import compute_measured_poses, compute_sensitivity, root_of
from bayescal.machines.read import load_mechanism
from bayescal.machines.deformations.linear import LinearDeformation
from bayescal.numerics.geometry import Array, compute_pose_error
from bayescal.machines.kinematics import Machine
from bayescal.machines.models import SixPus
from bayescal.machines.sensors import PoseSensor
from bayescal.files.csv_tables import read_matrix

KAPPA = 0.011
FREE = ("a_x", "a_y", "b_x", "b_y", "l", "kappa")
PRIOR_SD = {"kappa": 0.01}  # everything else: 2 mm
AGREEMENT = 0.02  # posterior standard deviations
SEED = 1


def build_fitter() -> Fitter:
    """Return the telescope with its tolerances and plan."""
    mechanism = load_mechanism(TELESCOPE / "mechanism.toml")
    machine = Machine(mechanism, SixPus(), LinearDeformation(KAPPA))
    names = [name for block in machine.layout.blocks if block.symbol in FREE for name in block.names]
    priors = {name: PRIOR_SD.get(name.partition("[")[0], 2.0) for name in names}
    shares = read_matrix(TELESCOPE / "calibration_configurations.csv", mechanism.n_legs)
    actuators = mechanism.initial_actuator_positions + mechanism.actuator_range * shares
    return Fitter(Knowledge(machine, priors), Plan(actuators, (PoseSensor(2e-3, 1.7e-5),), 1e-3))


def fit_alone(fitter: Fitter, measured: Measurements, exact: bool) -> Array:
    """Return the moves (n,) that SciPy finds for one machine."""
    knowledge, plan = fitter.knowledge, fitter.plan
    root = root_of(np.linalg.solve(np.eye(6) + fitter.seen @ fitter.expected.pose_noise(plan), fitter.seen))
    identity = np.eye(len(knowledge.sd))

    def residual(moves: Array) -> Array:
        predicted = compute_measured_poses(knowledge, fitter.theta(moves[None])[0], plan.actuators)
        error = compute_pose_error(measured.position[0], measured.rotation[0], *predicted)
        return np.concatenate([np.einsum("pij,pj->pi", root, error).ravel(), moves])

    def jacobian(moves: Array) -> Array:
        slope = compute_sensitivity(knowledge, plan.actuators, fitter.theta(moves[None])[0]).slope
        return np.concatenate([-(root @ slope).reshape(-1, len(moves)) * knowledge.sd, identity])

    start = np.zeros(len(knowledge.sd))
    return least_squares(residual, start, jacobian if exact else "2-point", method="lm", x_scale="jac").x


def compare(fits: Fits, found: list[Array]) -> float:
    """Return the largest distance of SciPy's estimates from the batch's, in posterior standard deviations."""
    off = np.stack(found) - fits.moves[: len(found)]
    precision = fits.information[: len(found)] + np.eye(off.shape[1])
    return float(np.sqrt(np.einsum("bi,bij,bj->b", off, precision, off).max()))


def run(n_machines: int, n_loops: int) -> dict[str, object]:
    """Fit, compare, print and return the figures."""
    fitter, rng = build_fitter(), np.random.default_rng(SEED)
    moves = rng.standard_normal((n_machines, len(fitter.knowledge.sd)))
    measured, good = simulate_measurements(fitter, moves, rng)
    measured = measured.take(np.flatnonzero(good))
    fitter.fit(measured.take(np.arange(2)))
    began = time.perf_counter()
    fits = fitter.fit(measured)
    batch = time.perf_counter() - began
    figures: dict[str, object] = {
        "n_machines": len(fits.moves),
        "n_converged": int(fits.converged.sum()),
        "mean_iterations": float(fits.n_iterations.mean()),
        "batch_seconds": batch,
    }
    for name, exact in (("exact", True), ("differences", False)):
        began = time.perf_counter()
        found = [fit_alone(fitter, measured.take(np.array([k])), exact) for k in range(n_loops)]
        each = (time.perf_counter() - began) / n_loops
        apart = compare(fits, found)
        if not apart < AGREEMENT:
            raise SystemExit(f"{name}: estimates {apart:.2g} posterior sd apart, expected < {AGREEMENT:g}")
        figures |= {
            f"scipy_{name}_seconds_each": each,
            f"scipy_{name}_over_batch": each * len(fits.moves) / batch,
            f"scipy_{name}_apart": apart,
        }
    for key, value in figures.items():
        print(f"{key:34}{value:.3g}" if isinstance(value, float) else f"{key:34}{value}")
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--loops", type=int, default=8)
    arguments = parser.parse_args()
    results = run(arguments.machines, arguments.loops)
    print(f"wrote {write_results('audit_calibrations', results, ('numpy', 'scipy')).name}")
