"""What may have happened to a study's data, where no variant's machine comes near them within its tolerances."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.likelihood import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.shared.pose_slips import list_rereads
from bayescal.experiments.shared.slips import FoundSlip, LikelihoodOf, Suspect, find_slip
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import InstrumentMeasurement
from bayescal.experiments.study.schema import VariantConfig
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE


def find_study_slip(inputs: StudyInputs) -> FoundSlip | None:
    """Return what explains the data many times better than they stand; None where some variant's machine fits them."""
    suspects = (_suspect(inputs, _without_measured_matrix(inputs, variant)) for variant in inputs.config.variants)
    return find_slip(suspects, inputs.mechanism.initial_actuator_positions, _state_error(inputs))


def _suspect(inputs: StudyInputs, variant: VariantConfig) -> Suspect:
    """Return a variant's density of all poses, calibration and verification in the order of the table."""
    machine, measured = inputs.machine(variant), inputs.measured
    noise = inputs.config.data.actuator_noise_um * MICROMETRE

    def likelihood_of(actuators: Array, chosen: np.ndarray) -> Likelihood:
        if isinstance(measured, InstrumentMeasurement) and not measured.has_poses:
            instrument: Any = replace(measured.instrument.select(chosen), actuators=actuators)
            return InstrumentLikelihood(machine, instrument, noise)
        return of_poses(measured.poses, actuators, chosen)

    def of_poses(poses: MeasuredPoses, actuators: Array, chosen: np.ndarray) -> Likelihood:
        return PoseLikelihood(machine, replace(poses.select(chosen), actuators=actuators), noise)

    rereads: tuple[tuple[str, LikelihoodOf], ...] = ()
    if isinstance(measured, InstrumentMeasurement) and measured.has_poses:  # those of targets have no form of their own
        rereads = tuple((text, partial(of_poses, poses)) for text, poses in list_rereads(measured.poses))
    coordinates = inputs.posterior(variant, with_model_error=False).sampling.coordinates
    return Suspect(likelihood_of, coordinates, measured.actuators, rereads)


def _without_measured_matrix(inputs: StudyInputs, variant: VariantConfig) -> VariantConfig:
    """Return a variant without a K from targets, which is measured against the actuators, and so slips with them."""
    if variant.deformation != "matrix" or not inputs.matrix_from_targets:
        return variant
    rigid = variant.model_copy(update={"deformation": "none"})
    known = {block.symbol for block in inputs.machine(rigid).layout.blocks}
    return rigid.model_copy(update={"free": [symbol for symbol in variant.free if symbol in known]})


def _state_error(inputs: StudyInputs) -> float:
    """Return what a leg may err by as stated: model error, actuators, the measured position, mm."""
    config = inputs.config
    variance = np.diagonal(inputs.measured.poses.covariance, axis1=1, axis2=2)[:, :3]
    position = float(np.nanmean(variance)) if np.isfinite(variance).any() else 0.0
    others = MICROMETRE * np.array([config.model_error.scale_um, config.data.actuator_noise_um])
    return float(np.sqrt(position + np.sum(others**2)))
