"""What may be wrong with a study's data: a slip, or a zero that wide tolerances would swallow in silence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayescal.data.instruments.readings import PointReadings
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.experiments.shared.leg_readings import read_legs, read_points
from bayescal.experiments.shared.outlook import join_outlooks, tell_outlook
from bayescal.experiments.shared.slip_rows import Readings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import FoundSlip
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
        tau = np.full(likelihood.n_model_errors, inputs.config.leg_error.scales(inputs.actuator_noise)[0])
        names, counted, roots = posterior.names[: posterior.n_geometry], 0, list[Array]()
        for _, part in likelihood.parts():  # of many poses not all rows are needed at once
            errors, slope = part.error_jacobian(known.start)
            rows = np.nan_to_num(part.whiten(tau)(slope[..., known.free]) * known.scale)
            roots.append(np.linalg.qr(rows.reshape(-1, len(names)), mode="r"))
            counted += int(np.count_nonzero(errors))
        of = f"{counted} equations of legs at {likelihood.n_poses} poses for {len(names)} unknowns"
        found[variant.name] = tell_outlook(of, np.concatenate(roots), names)
    return [*join_outlooks(found), *filter(None, [inputs.unused])]


def find_study_slip(inputs: StudyInputs) -> FoundSlip | None:
    """Return what explains the data many times better than they are; None where some variant's machine fits them.

    What happened to the calibration poses alone is no slip of all poses.
    """
    every = [_read(inputs, _without_measured_matrix(inputs, one)) for one in inputs.config.variants]
    found, held = find_slip(every), inputs.verification
    if found is None and held.any():
        found = find_slip(one.pick(np.flatnonzero(~held)) for one in every)
    return found


def _read(inputs: StudyInputs, variant: VariantConfig) -> Readings:
    """Return all poses, calibration and verification in the order of the table, under a variant.

    Points stand for the poses that they determine, where they determine all. What frames that are free do to poses is
    taken to first order.
    """
    machine, measured = inputs.machine(variant), inputs.measured
    (known, fixed), layout = inputs.priors(variant), machine.layout.names
    noise = inputs.actuator_noise
    scale = inputs.config.leg_error.scales(noise)[0]
    if isinstance(measured, InstrumentMeasurement):
        instrument = measured.instrument
        if isinstance(instrument, PointReadings) and not instrument.is_whole():
            return read_points(machine, instrument, noise, known, fixed, scale)
    priors = {name: one for name, one in known.items() if name in layout}
    frames = {name: one.sd for name, one in known.items() if name not in layout}
    shared = _see_frames(machine, measured, frames) if isinstance(measured, InstrumentMeasurement) and frames else None
    return read_legs(machine, measured.poses, noise, priors, fixed, scale, shared)


def _see_frames(machine: Machine, measured: InstrumentMeasurement, sd: Mapping[str, float]) -> Array:
    """Return what frames (M) with standard deviations do to what an instrument says of the poses, (P, N + 6, M)."""
    likelihood = InstrumentLikelihood(machine, measured.instrument, 0.0)
    slope = likelihood.error_jacobian(likelihood.layout.nominal)[1][
        ..., [likelihood.layout.names.index(one) for one in sd]
    ]
    rows = measured.instrument.rows
    seen = rows.to_pose @ slope[:, : rows.to_pose.shape[-1]]
    legs = np.zeros((len(seen), measured.actuators.shape[1], len(sd)))
    return np.concatenate([legs, -seen * np.array(list(sd.values()))], axis=1)


def _without_measured_matrix(inputs: StudyInputs, variant: VariantConfig) -> VariantConfig:
    """Return a variant without a K from targets, which is measured against the actuators, and so slips with them."""
    if variant.deformation != "matrix" or not inputs.matrix_from_targets:
        return variant
    rigid = variant.model_copy(update={"deformation": "none"})
    known = {block.symbol for block in inputs.machine(rigid).layout.blocks}
    return rigid.model_copy(update={"free": [symbol for symbol in inputs.free(variant) if symbol in known]})


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
