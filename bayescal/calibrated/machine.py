"""A calibrated machine: where its parameters are, how well they are known, and by what its commands err besides.

Any machine is one of readings (`machines.readings`), legs too. Those on legs have their geometry as the nominal one of
a mechanism of their own where drawings hold it (see `settle_machine`), so that whatever takes a mechanism takes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayescal.calibrated.functions import KnownFunctions
from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import InputError
from bayescal.files.plain_text import name_file
from bayescal.machines.deformations import (
    DEFORMATIONS,
    Deformation,
    FreeMatrixDeformation,
    MatrixDeformation,
    NoDeformation,
)
from bayescal.machines.kinematics import Machine, build_machine
from bayescal.machines.mechanism import BeamSection, Flexures
from bayescal.machines.models import MODELS
from bayescal.machines.models.legs import actuator_directions, chart_of
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings import Channel, Legs, ReadingModel
from bayescal.machines.readings.base import NO_CONDITIONS, Given
from bayescal.machines.readings.legs import GAIN, divide_closure
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector

KAPPA, TRAVEL = "kappa", "rho0"
LEAST_SPREAD = 1e-13  # of a parameter's size, below which draws of it differ by rounding alone
NOISE, MODEL, MATRIX = "actuator noise", "model error", "deformation matrix"


def find_export_obstacle(machine: Machine) -> str:
    """Return why no drawings hold a machine's kinematics, in words; empty where they do.

    Of a machine with more legs than six the home pose that flexures and the Jacobian-based model refer to is a
    compromise, weighed at the nominal machine (see `models.home`): with other drawings it is another one.
    """
    if type(machine.model) not in MODELS.values() or type(machine.deformation) not in DEFORMATIONS.values():
        return "a user-defined model or deformation, expected built-in ones"
    if machine.deformation.name == FreeMatrixDeformation.name:
        return "deformation 'free_matrix', expected 'matrix' or another"
    if machine.mechanism.n_legs != DEGREES_OF_FREEDOM and not machine.model.has_perfect_joints:
        return (
            f"model {machine.model.name!r} of {machine.mechanism.n_legs} legs, expected "
            f"{DEGREES_OF_FREEDOM} legs or perfect joints"
        )
    return ""


def settle_legs(legs: Legs, theta: Array) -> Legs:
    """Return the machine whose nominal parameters are those of another, θ (D,), wherever they stand in its layout.

    Three things are elsewhere than in the parameters. Actuators' readings go on counting from the initial positions: an
    offset of ρ^0 moves the attachment, a + (ρ^0 - ρ^0_nominal) u, and nothing else. Directions are unit vectors, stated
    by the components that suit them. κ of each leg is the diagonal of a deformation matrix: no other file holds one per
    leg.
    """
    machine = legs.machine
    layout, mechanism = machine.layout, machine.mechanism
    attachments, directions = _place_actuators(machine, theta)
    moved = replace(
        mechanism,
        base_points=attachments,
        platform_points=layout.take_vector(theta, "b"),
        directions=mechanism.directions if directions is None else directions,
        leg_lengths=layout.take(theta, "l"),
        flexures=_settle_flexures(layout, theta, mechanism.flexures),
        actuator_gains=legs.layout.take(theta, GAIN) if legs.has_gains else None,
    )
    deformation: Deformation = NoDeformation()
    if KAPPA in layout.index:
        kappa = layout.take(theta, KAPPA)
        rest = machine.deformation.coupling(len(kappa))
        deformation = MatrixDeformation(np.where(np.eye(len(kappa), dtype=bool), np.diag(kappa), rest))
    return Legs(build_machine(type(machine.model), moved, deformation))


def _place_actuators(machine: Machine, theta: Array) -> tuple[Array, Array | None]:
    """Return attachments and directions (..., N, 3) with the initial positions nominal; struts have no directions."""
    layout = machine.layout
    attachments = layout.take_vector(theta, "a")
    if TRAVEL not in layout.index:
        return attachments, None
    directions = actuator_directions(layout, theta)
    offset = layout.take(theta, TRAVEL) - machine.mechanism.initial_actuator_positions
    return attachments + offset[..., None] * directions, directions


def _settle_flexures(layout: ParameterLayout, theta: Array, flexures: Flexures | None) -> Flexures | None:
    if flexures is None:
        return None
    known = layout.index
    return Flexures(
        layout.take(theta, "l_b") if "l_b" in known else flexures.lengths,
        layout.take(theta, "beta") if "beta" in known else flexures.beta,
        _settle_section(layout, theta, "d", flexures.section),
        _settle_section(layout, theta, "l", flexures.leg_section),
    )


def _settle_section(
    layout: ParameterLayout, theta: Array, part: str, section: BeamSection | None
) -> BeamSection | None:
    if f"k1_{part}" not in layout.index:
        return section
    return BeamSection(*(float(layout.take(theta, f"{k}_{part}")[0]) for k in ("k1", "k2", "k3")))


def express_parameters(legs: Legs, settled: Legs, theta: Array) -> Array:
    """Return parameter vectors (..., D) of a machine as those of a settled one, shape (..., D')."""
    old, new = legs.layout, settled.layout
    result = np.broadcast_to(new.nominal, (*theta.shape[:-1], new.size)).copy()
    for symbol in set(old.symbols) & set(new.symbols):
        result[..., new.index[symbol]] = old.take(theta, symbol)
    attachments, directions = _place_actuators(legs.machine, theta)
    for k, axis in enumerate("xyz"):
        result[..., new.index[f"a_{axis}"]] = attachments[..., k]
    if directions is not None:
        local = chart_of(new).to_local(directions)
        for k, symbol in enumerate(new.direction_symbols):
            result[..., new.index[symbol]] = local[..., k]
        result[..., new.index[TRAVEL]] = settled.machine.mechanism.initial_actuator_positions
    return result


@dataclass(frozen=True)
class Source:
    """Where a calibrated machine comes from."""

    # names of the experiment and of its variant
    experiment: str
    variant: str
    data: str  # what its data are, in words
    problems: tuple[
        str, ...
    ] = ()  # what speaks against its convergence; none of what is exported without --allow-unconverged
    solution: str = ""  # which of several solutions: ``mode 1 of 2, probability 0.6``; empty of a single one

    @property
    def stem(self) -> str:
        """Name of a directory for the machine."""
        number = f"-mode{self.solution.split()[1]}" if self.solution else ""
        return f"{name_file(self.experiment)}-{name_file(self.variant)}{number}"

    def describe(self) -> list[str]:
        """Return lines for the head of a file."""
        which = f", {self.solution}" if self.solution else ""
        first = f"Calibrated machine: experiment {self.experiment}, variant {self.variant}{which}"
        lines = [first, f"Data: {self.data}"]
        if self.problems:
            lines.append(f"NOT CONVERGED, written with --allow-unconverged: {'; '.join(self.problems)}")
        return lines


@dataclass(frozen=True, eq=False)
class CommandErrors:
    """By what the C commanded channels err besides the geometry, in their units: h(θ, v) = s + δ at commands s."""

    noise: Array  # (C, C): covariance of the channels' readings, independent from one visit of a pose to the next
    model_variance: Array  # (C,): posterior mean of τ², the same at each visit

    def covariance(self, pose: Array, commands: Array) -> Array:
        """Return the covariance of δ at poses (P, q) and commands (P, C), shape (P, C, C)."""
        del pose
        return np.broadcast_to(self.noise + np.diag(self.model_variance), (*commands.shape, commands.shape[-1]))

    def split(self) -> dict[str, CommandErrors]:
        """Return the same by source, those that there are; noise always."""
        parts = {NOISE: replace(self, model_variance=np.zeros_like(self.model_variance))}
        if self.model_variance.any():
            parts[MODEL] = self.without_noise()
        return parts

    def without_noise(self) -> CommandErrors:
        """Return what stays the same when a pose is visited again."""
        return replace(self, noise=np.zeros_like(self.noise))


@dataclass(frozen=True, eq=False)
class LegErrors(CommandErrors):
    """Errors of the closures of legs, mm, as a pose's density has them (see `density.pose_likelihood`).

    τ_i and what K's rest leaves of Δb_z are errors of a leg's own closure, e_i = A_ii ε_i with A = ∂F/∂ρ; the
    deflection does not pass them on: δ = A⁻¹ diag(A_ii) ε.
    """

    legs: Legs
    theta: Array  # (D,), in the legs' layout
    # (N, N, N): covariance of each row of a measured deformation matrix K, whose diagonal is a parameter and counts
    # as known
    matrix_covariance: Array | None = None

    def covariance(self, pose: Array, commands: Array) -> Array:
        """Return σ_ρ² 1 + A⁻¹ diag(A_ii² (τ_i² + v_i)) A⁻ᵀ, where v_i is the variance of Δb_z that K's rest leaves.

        Of actuators with gains γ it is that of what they read: errors of travel are over γ; σ_ρ and τ are of readings.
        """
        machine, standing = self.legs.machine, self.legs.place_actuators(self.theta, commands)
        with np.errstate(all="ignore"):  # poses that were not found
            rotation = matrix_from_rotation_vector(np.nan_to_num(pose[..., 3:]))
            closure = machine.model.prepare(machine.layout, self.theta[: machine.layout.size])
            slopes = closure(pose[..., :3], rotation, machine.basis(standing), False).actuators
        own = slopes * np.eye(slopes.shape[-1])
        passed = divide_closure(slopes, own)
        variance = np.broadcast_to(self.model_variance, commands.shape)
        gain = self.legs.layout.take(self.theta, GAIN) if self.legs.has_gains else None
        if gain is not None:
            passed = passed * gain / gain[:, None]
        if self.matrix_covariance is not None:
            displacement = standing - machine.mechanism.initial_actuator_positions
            others = displacement[..., None, :] * (1.0 - np.eye(displacement.shape[-1]))
            rest = np.einsum("...ij,ijk,...ik->...i", others, self.matrix_covariance, others)
            variance = variance + (rest if gain is None else rest / gain**2)
        return np.asarray(self.noise + (passed * variance[..., None, :]) @ np.swapaxes(passed, -1, -2))

    def split(self) -> dict[str, CommandErrors]:
        """Return the same by source, the measured matrix among them."""
        parts: dict[str, CommandErrors] = {
            name: replace(one, matrix_covariance=None)  # type: ignore[call-arg]  # a class of the same fields
            for name, one in super().split().items()
        }
        if self.matrix_covariance is not None:
            nothing = {"noise": np.zeros_like(self.noise), "model_variance": np.zeros_like(self.model_variance)}
            parts[MATRIX] = replace(self, **nothing)  # type: ignore[arg-type]  # arrays
        return parts


@dataclass(frozen=True, eq=False)
class CalibratedMachine:
    """A machine by its posterior.

    Attributes
    ----------
    model : ReadingModel
        What it reads; a machine on legs as `Legs`.
    theta : ndarray, shape (D,)
        Posterior mean in the model's layout; its nominal vector where drawings hold the kinematics.
    free : ndarray of int, shape (n,)
        Which of its entries are uncertain.
    covariance : ndarray, shape (n, n), or None
        Of those; None where the results hold no draws.
    draws : ndarray, shape (S, n), or None
        Of the posterior.
    errors : Errors
        Of the commanded channels.
    source : Source
    measured : ndarray, shape (P, C), or None
        Commands of the poses that calibrated it, in the channels' units; None where they are not known.
    given : mapping of str to ndarray, shape (P,)
        What was known of the same poses besides.
    workspace : ndarray, shape (2, q), or None
        Smallest and largest value of each coordinate where accuracy counts; None where commands have a range.
    machine_file : str
        Name of the file that the machine is read from among ``files``; none of a machine on legs.
    files : mapping of str to bytes
        That file and the code of a class of its own, by their names.
    noise : ndarray, shape (K,), or None
        Of each channel as the calibration found it; NaN where that is not known. None where nothing is.
    functions : KnownFunctions or None
        What is known of errors that are functions of the pose, together with the uncertain parameters.
    units : mapping of str to str
        Units that channels have in the data's tables, by name, where these are not their own; tables are written so.
    aligned : bool
        Whether its accuracy is what remains of errors once base and tool are aligned.
    drawn : ReadingModel or None
        The machine whose nominal parameters are as drawn; None where the calibrated ones have replaced them.

    Examples
    --------
    >>> isinstance(study.best.machine, bc.CalibratedMachine), study.best.machine.names[:2]
    (True, ('x[1]', 'x[2]'))
    """

    model: ReadingModel
    theta: Array
    free: np.ndarray
    covariance: Array | None
    draws: Array | None
    errors: CommandErrors
    source: Source
    measured: Array | None = None
    given: Mapping[str, Array] = field(default_factory=dict)
    workspace: Array | None = None
    machine_file: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    noise: Array | None = None
    functions: KnownFunctions | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    aligned: bool = True
    drawn: ReadingModel | None = None

    def __repr__(self) -> str:
        known = 0 if self.covariance is None else len(self.free)
        counted = f"{known} uncertain parameters of {self.theta.size}"
        return f"machine {self.name!r} calibrated by variant {self.source.variant!r}: {counted}"

    @property
    def name(self) -> str:
        """Name of the machine."""
        return str(getattr(self.model, "name", self.source.experiment))

    @property
    def legs(self) -> Machine:
        """The machine on legs; InputError where it is none."""
        if self.model.legs is None:
            raise InputError(f"machine {self.name!r}: found no legs, expected a mechanism")
        return self.model.legs.machine

    @cached_property
    def commanded(self) -> np.ndarray:
        """Where the commanded channels stand among all, shape (C,)."""
        return self.model.select(self.model.commanded)

    @cached_property
    def command_channels(self) -> tuple[Channel, ...]:
        """The commanded channels."""
        return tuple(self.model.channels[k] for k in self.commanded)

    @cached_property
    def sd(self) -> Array:
        """Standard deviation of each parameter by the posterior, (D,); zero of those that are known, or if none is."""
        sd = np.zeros(len(self.theta))
        if self.covariance is not None:
            sd[self.free] = np.sqrt(np.diagonal(self.covariance))
        return sd

    @cached_property
    def weights(self) -> Array:
        """One over the standard deviation of each command's errors, shape (C,); alike where there are none."""
        variance = np.diagonal(self.errors.noise) + self.errors.model_variance
        return 1.0 / np.sqrt(variance) if (variance > 0.0).all() else np.ones(len(variance))

    @cached_property
    def comparison(self) -> Comparison:
        """How two tools differ."""
        return Comparison(self.model.tool_channels)

    @cached_property
    def lengths(self) -> np.ndarray:
        """Which of the tool's numbers are lengths, their places."""
        return np.flatnonzero([one.unit == "mm" for one in self.model.tool_channels])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the uncertain parameters."""
        return tuple(self.model.layout.names[k] for k in self.free)

    @cached_property
    def usual_units(self) -> Mapping[str, str]:
        """Units of tables by inner ones: that of all channels of a kind, where they have the same one."""
        found = dict[str, set[str]]()
        for one in self.model.channels:
            found.setdefault(one.unit, set()).add(self.units.get(one.name, one.unit))
        return {unit: next(iter(shown)) for unit, shown in found.items() if len(shown) == 1}

    def typical(self, n: int) -> dict[str, Array]:
        """Return what a pose has to know besides, n times the median of the poses that calibrated it.

        InputError where that is not known.
        """
        for name in self.model.given:
            if name not in self.given:
                raise InputError(f"machine {self.name!r}: found no {name}, expected it at each pose")
        return {name: np.full(n, np.median(self.given[name])) for name in self.model.given}

    def thin(self, n: int) -> Array:
        """Return full parameter vectors of at most n draws, shape (n, D), evenly from all."""
        assert self.draws is not None
        chosen = np.linspace(0, len(self.draws) - 1, min(n, len(self.draws))).astype(int)
        theta = np.broadcast_to(self.theta, (len(chosen), len(self.theta))).copy()
        theta[:, self.free] = self.draws[chosen]
        return theta


def build_calibrated(
    model: ReadingModel,
    theta: Array,
    draws: Array | None,
    errors: CommandErrors,
    source: Source,
    measured: Array | None = None,
    given: Given = NO_CONDITIONS,
    workspace: Array | None = None,
    machine_file: str = "",
    files: Mapping[str, bytes] | None = None,
) -> CalibratedMachine:
    """Return a calibrated machine by its posterior's mean θ (D,) and draws (S, D), or None; see `CalibratedMachine`.

    One with errors of its legs' closures is settled where drawings hold its kinematics; these errors are then its own.
    """
    drawn = model
    if (alone := model.legs) is not None and isinstance(errors, LegErrors):
        drawn = legs = Legs(alone.machine, has_gains=alone.has_gains)
        if not find_export_obstacle(legs.machine):
            settled = settle_legs(legs, theta)
            draws = None if draws is None else express_parameters(legs, settled, draws)
            legs, theta = settled, settled.layout.nominal
        model, errors = legs, replace(errors, legs=legs, theta=theta)
    free, covariance, kept = np.empty(0, dtype=int), None, None
    if draws is not None:
        free = np.flatnonzero(np.ptp(draws, axis=0) > LEAST_SPREAD * (1.0 + np.abs(theta)))
        covariance = np.cov(draws[:, free], rowvar=False).reshape(len(free), len(free))
        kept = draws[:, free]
    place = (measured, dict(given), workspace, machine_file, files or {})
    return CalibratedMachine(model, theta, free, covariance, kept, errors, source, *place, drawn=drawn)
