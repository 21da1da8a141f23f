"""How often `bayescal recheck` is wrong: false alarms, shifts of a leg found, the leg named, on twins of a hexapod.

Every twin is a machine of the tolerances of experiments/m2_hexapod, calibrated by the 40 poses of that study, all
simulated with real kinematics. A plan is made for it, and its sessions are simulated twice: as it was calibrated, and
with one leg longer by the shift. `python benchmarks/recheck.py --twins 400`; add `--first N` to do them in parts.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.calibrated.machine import CalibratedMachine, LegErrors, Source
from bayescal.calibrated.recheck.plan import Demand, expect_pose, list_candidates, place_poses, plan_recheck
from bayescal.calibrated.recheck.statistics import choose_suspects, judge_recheck
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.measurements import Measurements
from bayescal.experiments.check.inputs import Subject
from bayescal.experiments.frame.load import load
from bayescal.experiments.shared.measured import MeasuredVariant, see_legs
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

STUDY = Path(__file__).parents[1] / "experiments" / "m2_hexapod" / "study.toml"
VARIANT = "six_ups/none"
SHARE = 0.9


def calibrate(measured: MeasuredVariant, poses: MeasuredPoses) -> CalibratedMachine:
    """Return the machine as a calibration by poses leaves it, by Laplace's approximation; the twins have no τ."""
    posterior = measured.with_poses(poses).posterior
    y = posterior.polish(posterior.approach())
    change = posterior.sampling.jacobian(posterior.theta(y[None])[0])[posterior.sampling.free]
    data, prior = posterior.information(y)
    covariance = change @ np.linalg.inv(data + prior) @ change.T
    machine = measured.machine
    theta, free = posterior.theta(y[None])[0], posterior.sampling.free
    n_legs = machine.mechanism.n_legs
    noise = measured.actuator_noise**2 * np.eye(n_legs)
    errors = LegErrors(noise, np.zeros(n_legs), machine, theta)
    source = Source("twin", VARIANT, "simulated")
    return CalibratedMachine(Legs(machine), theta, free, covariance, None, errors, source)


def measure(
    measured: MeasuredVariant, theta: Array, actuators: Array, covariance: Array, rng: np.random.Generator
) -> Measurements:
    """Return poses of a true machine θ (D,) as an instrument of a covariance (6, 6) sees them."""
    actual = actuators + rng.normal(0.0, measured.actuator_noise, actuators.shape)
    found = solve_forward_kinematics(measured.machine, theta, actual)
    noise = rng.multivariate_normal(np.zeros(6), covariance, len(actuators), method="cholesky")
    rotation = matrix_from_rotation_vector(noise[:, 3:]) @ found.rotation
    names = tuple(f"R{k + 1}" for k in range(len(actuators)))
    spread = np.broadcast_to(covariance, (len(actuators), 6, 6))
    values = np.concatenate([found.position + noise[:, :3], rotation_vector_from_matrix(rotation)], axis=1)
    return place_poses(names, actuators, values, spread)


def try_twin(measured: MeasuredVariant, demand: Demand, seed: int) -> dict[str, object]:
    """Return what rechecks say of one twin."""
    rng = np.random.default_rng([2026, seed])
    readings, posterior = see_legs(measured), measured.posterior
    truth, values = Subject(readings).draw_truth(rng)
    poses = measured.retake(measured.poses.names, values).poses
    calibrated, covariance = calibrate(measured, poses), measured.poses.covariance.mean(axis=0)
    suspects, planned = choose_suspects(calibrated, ()), expect_pose(calibrated, covariance)
    plan = plan_recheck(calibrated, suspects, *list_candidates(calibrated, SHARE), planned, demand)
    theta, leg = posterior.theta(truth[None])[0], int(rng.integers(6))
    length = measured.machine.layout.index["l"][leg]
    row: dict[str, object] = {"twin": seed, "poses": len(plan.chosen), "leg": leg + 1, "promised": plan.power[leg]}
    for name, shift in (("holds", 0.0), ("moved", demand.shift[leg] * (1.0 if rng.random() < 0.5 else -1.0))):
        theta_now = theta.copy()
        theta_now[length] += shift
        sessions = [measure(measured, theta_now, plan.commands, covariance, rng) for _ in range(demand.sessions)]
        found = judge_recheck(calibrated, suspects, sessions, demand.false_alarm, demand.sessions)
        row |= {f"{name}_found": not found.holds, f"{name}_leg": found.worst + 1, f"{name}_odd": found.is_odd}
        row[f"{name}_first"] = bool(np.abs(found.statistic[0]).max() > found.threshold)
        row[f"{name}_z"] = (found.shift[leg] - shift) / found.sd[leg]
    return row


def main() -> None:
    """Print shares with their standard errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--shift-um", type=float, default=20.0)
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    experiment, study = load(STUDY)
    measured = experiment.measure(study, STUDY, [VARIANT], False)[VARIANT].legs
    demand = Demand(np.full(6, 1e-3 * given.shift_um), sessions=given.sessions)
    table = pd.DataFrame([try_twin(measured, demand, given.first + k) for k in range(given.twins)])
    if given.out is not None:
        table.to_csv(given.out, index=False)
    report(table)


def report(table: pd.DataFrame) -> None:
    """Print what the twins of a table tell."""
    right = table["moved_leg"] == table["leg"]
    shares = {
        "false alarms": table["holds_found"],
        "found": table["moved_found"],
        "found at the first session": table["moved_first"],
        "leg named rightly where found": right[table["moved_found"]],
        "something else suspected, none there": table["holds_odd"],
    }
    print(f"{len(table)} twins, {table['poses'].min()} to {table['poses'].max()} poses a session")
    print(f"promised: found in {100 * table['promised'].mean():.1f} %")
    for name, share in shares.items():
        p = float(share.mean())
        print(f"{name}: {100 * p:.1f} ± {100 * np.sqrt(max(p * (1 - p), 1 / len(share)) / len(share)):.1f} %")
    print(f"rms of errors over stated sd: {np.sqrt(np.mean(table['moved_z'] ** 2)):.3f}")


if __name__ == "__main__":
    main()
