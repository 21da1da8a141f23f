"""What claims are computed from: the machine, its poses, the least squares and the posteriors' summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.least_squares import LeastSquaresFit
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import InputError
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.published import read_published
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import Machine, build_machine
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import Array

REFERENCE = "six_pus"
DEFORMATION_ORDER = ("none", "linear", "matrix")
TITLES = {"six_pus": "6-PUS", "jacobian": "Jacobian-based", "beam": "beam theory-based", "stiffness": "stiffness"}
POINTS = ("a_x", "a_y", "b_x", "b_y")
FREE = {"none": {*POINTS, "l", "u_x"}, "linear": {*POINTS, "l", "kappa"}, "matrix": {*POINTS, "l", "kappa"}}
"""What the report identifies with each deformation."""
HOLDS = "holds"
FAILS = "does not hold"
UNTESTABLE = "not testable"
NEVER_MEASURED = "never measured"  # what the origin of a simulated survey says


@dataclass(frozen=True, eq=False)
class ClaimEvidence:
    """A study as claims see it.

    Attributes
    ----------
    mechanism : Mechanism
    nominal : NominalDeformation
    poses, all_poses : MeasuredPoses
        The calibration poses, and these with the verification poses.
    target_noise, actuator_noise : float
        Standard deviations, mm.
    origin : str
        Where the data come from.
    free : mapping of variant to tuple of str
        What each variant frees.
    fits : mapping of variant to LeastSquaresFit
    variants : mapping of variant to dict
        The posteriors' summary, as in ``summary.json``.
    published : mapping of variant to mapping of symbol to ndarray, shape (N,)
        Published offsets from nominal.
    """

    mechanism: Mechanism
    nominal: NominalDeformation
    poses: MeasuredPoses
    all_poses: MeasuredPoses
    target_noise: float
    actuator_noise: float
    origin: str
    free: Mapping[str, tuple[str, ...]]
    fits: Mapping[str, LeastSquaresFit]
    variants: Mapping[str, Mapping[str, Any]]
    published: Mapping[str, Mapping[str, Array]]

    @classmethod
    def from_study(cls, inputs: StudyInputs, summary: Mapping[str, Any], fits: Mapping[str, LeastSquaresFit]) -> Self:
        """Return the evidence of a study whose posteriors are summarised and whose least squares is done.

        The report has one free set for each model and deformation: variants with names of their own are none of its.
        """
        config = inputs.config
        variants = [v for v in config.variants if not v.has_own_name]
        others = {v.name for v in config.variants if v.has_own_name}
        return cls(
            mechanism=inputs.mechanism,
            nominal=NominalDeformation(config.deformation.kappa, lambda: inputs.matrix),
            poses=inputs.poses(verification=False),
            all_poses=inputs.measured.poses,
            target_noise=inputs.target_noise,
            actuator_noise=1e-3 * config.measured.actuator_noise_um,
            origin=name_origin(config.origin.model_dump()),
            free={v.name: inputs.free(v) for v in variants},
            fits={name: fit for name, fit in fits.items() if name not in others},
            variants={name: fit for name, fit in summary["variants"].items() if name not in others},
            published={
                v.name: _by_symbol(read_published(inputs.folder / v.published, inputs.mechanism.n_legs))
                for v in variants
                if v.published is not None
            },
        )

    @property
    def simulated(self) -> bool:
        """Whether the data are a twin's."""
        return NEVER_MEASURED in self.origin

    def machine(self, model: str, deformation: str = "none") -> Machine | None:
        """Return the mechanism seen through a model and a deformation; None where it lacks what they need."""
        try:
            kind = DEFORMATIONS[deformation].from_nominal(self.nominal)
            machine = build_machine(MODELS[model], self.mechanism, kind)
            _ = machine.layout
        except InputError:
            return None
        return machine

    def identified(self, machine: Machine) -> Array:
        """Return the parameters (D,) that least squares found for a machine; nominal where it is no variant."""
        fit = self.fits.get(name_of(machine))
        return machine.layout.nominal if fit is None else fit.theta

    def likelihood(self, machine: Machine) -> PoseLikelihood:
        """Return the density of the calibration poses without model error."""
        return PoseLikelihood(machine, self.poses, self.actuator_noise)

    def repeats(self, *variants: str) -> bool:
        """Return whether the study identifies what the report does in these variants."""
        return all(v in self.fits and set(self.free[v]) == FREE[v.split("/")[1]] for v in variants)

    def offsets(self, variant: str) -> dict[str, Array]:
        """Return what least squares found, by symbol: offsets from nominal, shape (N,)."""
        machine = self.machine(*variant.split("/"))
        assert machine is not None
        offset = self.fits[variant].theta - machine.layout.nominal
        return {symbol: machine.layout.take(offset, symbol) for symbol in self.free[variant]}

    def deformations(self, *models: str) -> list[str]:
        """Return the deformations with which the study has all these models."""
        return [d for d in DEFORMATION_ORDER if all(f"{model}/{d}" in self.variants for model in models)]

    def best_machine(self) -> Machine:
        """Return the 6-PUS with the study's best deformation by least squares, or none."""
        fitted = [d for d in DEFORMATION_ORDER if f"{REFERENCE}/{d}" in self.fits]
        best = min(fitted, key=lambda d: self.fits[f"{REFERENCE}/{d}"].objective, default="none")
        machine = self.machine(REFERENCE, best)
        assert machine is not None
        return machine


def name_of(machine: Machine) -> str:
    """Return the name of a machine's variant."""
    return f"{machine.model.name}/{machine.deformation.name}"


def _by_symbol(values: Mapping[tuple[str, int], float]) -> dict[str, Array]:
    symbols = dict.fromkeys(symbol for symbol, _ in values)
    return {s: np.array([value for (symbol, _), value in values.items() if symbol == s]) for s in symbols}


@dataclass(frozen=True)
class Claim:
    """One statement and what the study's own numbers say of it.

    Attributes
    ----------
    claim : str
        A short name.
    section : str
        Where RR-8096 says it, or "own" for a finding of this project.
    statement, expected, found : str
        The statement in own words, the number it gives and the number that came out, with units.
    value : float
        The number behind ``found``; NaN where there is none.
    unit : str
    verdict : str
        ``holds``, ``does not hold`` or ``not testable``.
    why : str
        How it was tested, and what the verdict depends on.
    """

    claim: str
    section: str
    statement: str
    expected: str
    found: str
    value: float
    unit: str
    verdict: str
    why: str


type ClaimRows = Iterator[Claim]


def judge(holds: object) -> str:
    """Return the verdict of a test."""
    return HOLDS if holds else FAILS


def untestable(claim: str, section: str, statement: str, expected: str, why: str) -> Claim:
    """Return a claim that the data cannot judge."""
    return Claim(claim, section, statement, expected, "", float("nan"), "", UNTESTABLE, why)
