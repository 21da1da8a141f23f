"""What claims are computed from: the machine, its poses, the least squares and the posteriors' summary."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final, Literal, Self

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.errors import InputError
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.shared.readings.pads import SeenPads
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import ClaimRow
from bayescal.files.csv_tables import read_matrix
from bayescal.inference.mode import find_mode
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import Machine, build_machine, solve_forward_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE
from rr8096.identified import FREE, list_free, read_tables
from rr8096.least_squares import LeastSquaresFit

REFERENCE = "six_pus"
DEFORMATION_ORDER = ("none", "linear", "matrix")
TITLES = {"six_pus": "6-PUS", "jacobian": "Jacobian-based", "beam": "beam theory-based", "stiffness": "stiffness"}
PER_MILLE = 1e-3  # unit of K in a file
HOLDS: Final = "holds"
FAILS: Final = "does not hold"
UNTESTABLE: Final = "not testable"
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
    weigh_alone : callable
        Returns the log-evidence of a variant, by its name, without its model error.
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
    weigh_alone: Callable[[str], float]

    @classmethod
    def from_study(cls, inputs: StudyInputs, summary: Mapping[str, Any], fits: Mapping[str, LeastSquaresFit]) -> Self:
        """Return the evidence of a study whose posteriors are summarised and whose least squares is done.

        The report has one free set for each model and deformation: variants with names of their own are none of its.
        """
        config, seen = inputs.config, inputs.pads
        assert seen is not None
        assert seen.measured.targets is not None
        own = {name: one for name, one in inputs.variants.items() if not one.config.has_own_name}
        return cls(
            mechanism=seen.mechanism,
            nominal=NominalDeformation(config.deformation.kappa, partial(_find_matrix, inputs, seen)),
            poses=seen.measured.poses.select(~seen.measured.verification),
            all_poses=seen.measured.poses,
            target_noise=seen.measured.targets.noise,
            actuator_noise=float(np.max(config.sensors["rho"].noise_um or 0.0)) * MICROMETRE,
            origin=name_origin(config.provenance.model_dump()),
            free={name: list_free(one) for name, one in own.items()},
            fits={name: fit for name, fit in fits.items() if name in own},
            variants={name: one for name, one in summary["variants"].items() if name in own},
            published={name: _by_symbol(values) for name, values in read_tables(inputs).items()},
            weigh_alone=cache(partial(_weigh_alone, inputs)),
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

    def hold(self, machine: Machine, theta: Array) -> MeasuredPoses:
        """Return the calibration poses as a machine of these parameters holds them by the same actuator positions."""
        found = solve_forward_kinematics(machine, theta, self.poses.actuators)
        return replace(self.poses, position=found.position, rotation=found.rotation)

    def linearise(self, machine: Machine, theta: Array, carrier: Array | None = None) -> tuple[Array, Array]:
        """Return how the calibration poses' errors, seen by the legs, follow the parameters, and their covariance.

        With A = ∂f/∂pose and e the error of a measured pose, which follows a parameter by A⁻¹ ∂f/∂θ, they are A⁰ e, mm.
        A⁰, and what the noise does, are by default those of the nominal machine: a model that leaves something out
        identifies parameters that stand for it, and noise reaches the legs by the machine as it is, which is nearer to
        nominal.

        Parameters
        ----------
        machine : Machine
        theta : ndarray, shape (D,)
            Where it is linearised, at the poses that it holds itself.
        carrier : ndarray, shape (D,), optional
            The machine of A⁰, instead of the nominal one.

        Returns
        -------
        slope : ndarray, shape (P, N, D)
        covariance : ndarray, shape (P, N, N)
            By the stated noise of poses and actuators, without model error.
        """
        carrier = machine.layout.nominal if carrier is None else carrier
        held = [(one, self.hold(machine, one)) for one in (theta, carrier)]
        here, there = (machine.linearise(one, poses.position, poses.rotation, poses.actuators) for one, poses in held)
        gain = np.linalg.pinv(there.pose)
        moved = np.linalg.solve(gain @ here.pose, gain) @ here.parameters
        slope = here.parameters + (there.pose - here.pose) @ moved
        covariance = there.pose @ self.poses.covariance @ np.swapaxes(there.pose, -1, -2)
        covariance += self.actuator_noise**2 * there.actuators @ np.swapaxes(there.actuators, -1, -2)
        return slope, covariance

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


def _find_matrix(inputs: StudyInputs, seen: SeenPads) -> Array:
    """Return K in mm per mm, from the targets on the pads or from a file."""
    if seen.from_targets:
        return seen.find_matrix()
    return PER_MILLE * read_matrix(inputs.folder / inputs.config.deformation.matrix, seen.mechanism.n_legs)


def _weigh_alone(inputs: StudyInputs, variant: str) -> float:
    """Return the log-evidence of a variant without its model error, by Laplace's approximation.

    At the mode near least squares: others have a thousandth of its mass.
    """
    posterior = drop_model_error(inputs.variants[variant].posterior()).with_pose_guesses()
    return find_mode(posterior, posterior.least_squares_start()).log_evidence


def _by_symbol(values: Mapping[tuple[str, int], float]) -> dict[str, Array]:
    symbols = dict.fromkeys(symbol for symbol, _ in values)
    return {s: np.array([value for (symbol, _), value in values.items() if symbol == s]) for s in symbols}


type ClaimRows = Iterator[ClaimRow]


def judge(holds: object) -> Literal["holds", "does not hold"]:
    """Return the verdict of a test."""
    return HOLDS if holds else FAILS


def untestable(claim: str, section: str, statement: str, expected: str, reason: str) -> ClaimRow:
    """Return a claim that the data cannot judge."""
    return ClaimRow(
        claim=claim,
        section=section,
        statement=statement,
        expected=expected,
        found="",
        value=float("nan"),
        unit="",
        verdict=UNTESTABLE,
        reason=reason,
    )
