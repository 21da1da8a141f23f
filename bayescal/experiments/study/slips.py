"""What may have happened to a study's data, where no variant's machine comes near them within its tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.likelihood import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.shared.pose_slips import list_rereads
from bayescal.experiments.shared.slips import BETTER, FoundSlip, LikelihoodOf, find_slip, weigh
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import InstrumentMeasurement
from bayescal.experiments.study.schema import VariantConfig
from bayescal.machines.coordinates import Coordinates
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE


class _Suspect:
    """A variant's density of all poses, calibration and verification in the order of the table."""

    def __init__(self, inputs: StudyInputs, variant: VariantConfig) -> None:
        self.inputs, self.machine = inputs, inputs.machine(variant)
        self.coordinates: Coordinates = inputs.posterior(variant, with_model_error=False).coordinates
        self.noise = inputs.config.data.actuator_noise_um * MICROMETRE
        self.actuators = inputs.measured.actuators
        self.weight = weigh(self.likelihood, self.coordinates, self.actuators, np.arange(len(self.actuators)))

    def likelihood(self, actuators: Array, chosen: np.ndarray) -> Likelihood:
        """Return the density of some poses as if they had been taken at other actuator positions."""
        measured = self.inputs.measured
        if isinstance(measured, InstrumentMeasurement) and not measured.has_poses:
            instrument: Any = replace(measured.instrument.select(chosen), actuators=actuators)
            return InstrumentLikelihood(self.machine, instrument, self.noise)
        return self.of_poses(measured.poses, actuators, chosen)

    def of_poses(self, poses: MeasuredPoses, actuators: Array, chosen: np.ndarray) -> Likelihood:
        """Return the density of some of these poses as if they had been taken at other actuator positions."""
        return PoseLikelihood(self.machine, replace(poses.select(chosen), actuators=actuators), self.noise)

    def rereads(self) -> Iterator[tuple[str, LikelihoodOf]]:
        """Yield what may have happened to poses that an instrument handed out, and the density without it."""
        measured = self.inputs.measured
        if isinstance(measured, InstrumentMeasurement) and measured.has_poses:
            for text, poses in list_rereads(measured.poses):
                yield text, partial(self.of_poses, poses)


def find_study_slip(inputs: StudyInputs) -> FoundSlip | None:
    """Return what explains the data many times better than they stand; None where some variant's machine fits them."""
    stated = _state_error(inputs)
    suspects = []
    for variant in inputs.config.variants:
        suspects.append(_Suspect(inputs, _without_measured_matrix(inputs, variant)))
        if suspects[-1].weight.error < BETTER * stated:
            return None
    best = max(suspects, key=lambda one: one.weight.log_density)
    start = inputs.mechanism.initial_actuator_positions
    return find_slip(best.likelihood, best.coordinates, best.actuators, start, stated, best.rereads())


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
