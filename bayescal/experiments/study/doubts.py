"""What may be wrong with a study's data: a slip, or a zero that wide tolerances would swallow in silence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import Likelihood
from bayescal.experiments.shared.measured_slips import Suspect, find_leg_slip, weigh_poses
from bayescal.experiments.shared.outlook import join_outlooks, tell_outlook
from bayescal.experiments.shared.slips import FoundSlip, LegData
from bayescal.experiments.shared.study_schema import VariantConfig
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import InstrumentMeasurement
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_plain, format_significant

FAR = 0.03
"""Shift in units of the machine's size beyond which no drawing is that wrong."""
ALIKE = 3.0
"""Shift in units of what the poses scatter about it, below which it is not one for all."""
FEWEST = 3
ENOUGH = 0.5  # share of the poses at which the machine as drawn has to stand somewhere


def list_outlooks(inputs: StudyInputs) -> list[str]:
    """Return in a line each what the calibration poses can determine, to first order about each nominal machine."""
    found = {}
    for variant in inputs.config.variants:
        posterior = inputs.posterior(variant, with_model_error=False)
        likelihood, known = posterior.likelihood, posterior.sampling.coordinates
        errors, slope = likelihood.error_jacobian(known.start)
        tau = np.full(likelihood.n_model_errors, inputs.config.leg_error.scales(inputs.actuator_noise)[0])
        rows = likelihood.whiten(tau)(slope[..., known.free]) * known.scale
        names, counted = posterior.names[: posterior.n_geometry], np.count_nonzero(errors)
        of = f"{counted} equations of legs at {len(errors)} poses for {len(names)} unknowns"
        found[variant.name] = tell_outlook(of, np.nan_to_num(rows), names)
    return [*join_outlooks(found), *filter(None, [inputs.unused])]


def find_study_slip(inputs: StudyInputs) -> FoundSlip | None:
    """Return what explains the data many times better than they are; None where some variant's machine fits them."""
    stated = _state_error(inputs)
    suspects = (_suspect(inputs, _without_measured_matrix(inputs, one), stated) for one in inputs.config.variants)
    return find_leg_slip(suspects, inputs.mechanism.initial_actuator_positions)


def _suspect(inputs: StudyInputs, variant: VariantConfig, stated: float) -> Suspect:
    """Return a variant's density of all poses, calibration and verification in the order of the table."""
    machine, measured = inputs.machine(variant), inputs.measured
    noise = inputs.actuator_noise
    likelihood_of = weigh_poses(machine, measured.poses, noise)
    if isinstance(measured, InstrumentMeasurement) and not measured.has_poses:
        instrument = measured.instrument

        def likelihood_of(data: LegData, chosen: np.ndarray) -> Likelihood:
            return InstrumentLikelihood(machine, replace(instrument.select(chosen), actuators=data.actuators), noise)

    # those of targets have no form of their own
    stated_poses = measured.poses if isinstance(measured, InstrumentMeasurement) and measured.has_poses else None
    known = inputs.posterior(variant, with_model_error=False).sampling.coordinates
    return Suspect(
        likelihood_of, known.start, known.free, known.scale, LegData(measured.actuators, stated_poses), stated
    )


def _without_measured_matrix(inputs: StudyInputs, variant: VariantConfig) -> VariantConfig:
    """Return a variant without a K from targets, which is measured against the actuators, and so slips with them."""
    if variant.deformation != "matrix" or not inputs.matrix_from_targets:
        return variant
    rigid = variant.model_copy(update={"deformation": "none"})
    known = {block.symbol for block in inputs.machine(rigid).layout.blocks}
    return rigid.model_copy(update={"free": [symbol for symbol in inputs.free(variant) if symbol in known]})


def _state_error(inputs: StudyInputs) -> float:
    """Return what a leg may err by as stated: model error, actuators, the measured position, mm."""
    config = inputs.config
    variance = np.diagonal(inputs.measured.poses.covariance, axis1=1, axis2=2)[:, :3]
    position = float(np.nanmean(variance)) if np.isfinite(variance).any() else 0.0
    others = np.array([config.leg_error.scales(inputs.actuator_noise)[0], inputs.actuator_noise])
    return float(np.sqrt(position + np.sum(others**2)))


def doubt_zero(inputs: StudyInputs) -> list[str]:
    """Return in a line that all poses are shifted alike against the machine as drawn; nothing where they are not.

    Only poses measured whole in a known frame are looked at: an unknown one is found by the calibration.
    """
    if not inputs.measured.has_poses:
        return []
    poses, machine = inputs.measured.poses, inputs.machine(inputs.config.variants[0])
    shift = find_shift(machine, poses.position, poses.actuators)
    if shift is None:
        return []
    mean, scatter = shift
    distance, size = float(np.linalg.norm(mean)), measure_size(machine.mechanism)
    if distance < FAR * size or distance < ALIKE * scatter:
        return []
    each = ", ".join(format_plain(one, 3) for one in mean)
    return [
        f"the measured poses lie {format_significant(distance)} mm ({each}) from where the machine as drawn stands at "
        f"the same actuator positions, alike to {format_significant(scatter)} mm: perhaps the instrument has another "
        "zero than the base frame, the reflector another place than the platform's origin, or home_position is "
        "another; wide tolerances would take it for geometry"
    ]


def find_shift(machine: Machine, position: Array, actuators: Array) -> tuple[Array, float] | None:
    """Return by how much positions (P, 3) are shifted against the nominal machine's, and their rms scatter about it.

    Returns
    -------
    (ndarray of shape (3,), float) or None
        mm, base frame; None with fewer than three poses, or where the nominal machine reaches fewer than half of them.
    """
    found = solve_forward_kinematics(machine, machine.layout.nominal, actuators, check=False)
    off = (position - found.position)[found.converged]
    if len(off) < max(FEWEST, ENOUGH * len(position)) or not np.isfinite(off).all():
        return None
    mean = off.mean(axis=0)
    return mean, float(np.sqrt(np.mean(np.sum((off - mean) ** 2, axis=1))))


def measure_size(mechanism: Mechanism) -> float:
    """Return the rms distance of the joints at home from their middle, mm."""
    apart = [one - one.mean(axis=0) for one in (mechanism.home_joints, mechanism.platform_points)]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(apart) ** 2, axis=1))))
