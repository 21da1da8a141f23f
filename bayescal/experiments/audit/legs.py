"""A mechanism on legs whose platform instruments see, planned or measured, as an audit takes it.

A machine that has been measured is known better than its drawings, and the ridges of its posterior bend. Derivatives
are therefore taken at the posterior mean: there the tangent of a bent ridge is, to second order, the chord through the
draws, while at the nominal machine it is turned away by the bend times the distance. Without draws the most probable
machine stands in for it. Tolerances stay those of the priors.

What moves a pose besides the geometry is, beside the actuators' noise, the posterior mean of the model error's τ² and
the variance v_n that the measured part of a deformation matrix K leaves, both averaged over legs and poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayescal.config.classes import label_class
from bayescal.data.actuators import read_moves
from bayescal.density.functions import find_floors, find_sizes
from bayescal.density.legs import LegPosterior
from bayescal.density.priors import INDEPENDENT
from bayescal.density.schema import ALONE
from bayescal.density.sorts import FEWEST_POSES, rescale
from bayescal.errors import InputError
from bayescal.experiments.audit.planned import FreeParameters, Planned, read_requirements
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, WhatIfConfig
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.design import (
    REQUIRED,
    build_sensor,
    choose_sensors,
    find_actuators,
    plan_sensors,
    read_machine,
    read_tolerances,
    read_workspace,
)
from bayescal.experiments.shared.measured import MeasuredVariant, VariantChoice, measure_legs
from bayescal.experiments.shared.readings.schema import ChannelConfig
from bayescal.experiments.shared.schema import FramesConfig, ModelConfig, WorkspaceConfig
from bayescal.identifiability.calibration import (
    SimulatedCalibrations,
    count_kept,
    expected_covariance,
    simulate_calibrations,
)
from bayescal.identifiability.design import (
    Knowledge,
    Plan,
    PoseVolume,
    SystematicErrors,
    draw_displacements,
    find_workspace_actuators,
    predict_poses,
)
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.draws import Draws, draw_posterior
from bayescal.identifiability.information import Information
from bayescal.identifiability.profile import check_profiles
from bayescal.identifiability.requirements import Forecast, Requirement, find_limits
from bayescal.identifiability.ridges import Ridge, describe_ridges
from bayescal.identifiability.sensitivity import (
    compute_sensitivity,
    inform,
    list_rows,
    place_actuators,
    share_functions,
    show_functions_elsewhere,
)
from bayescal.identifiability.structure import Structure, find_structural_rank
from bayescal.inference.mode import find_modes
from bayescal.inference.schema import DrawsConfig
from bayescal.machines.frames import FRAME_BLOCKS, FRAMES, frame_symbols
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.parameters import AXES
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.units import Units
from bayescal.pose_selection import (
    ActuatorBox,
    Selection,
    SelectionProblem,
    WorkspaceBox,
    factorial_candidates,
    random_candidates,
    select,
)
from bayescal.pose_selection.criteria import IOptimality
from bayescal.pose_selection.domain import candidates_at

SLACK = 1e-9
POSE_UNITS = ("mm",) * 3 + ("rad",) * 3
DRAWS_WITH_DATA = 100_000
"""So many that chance turns the ridges' directions by less than what is said of them; a few seconds."""
SEED, SEED_OF_POSES = 4, 21
N_CANDIDATES, N_CORNERS = 3**6, 2**6  # of legs that are six
FAR = 2.0
"""How many half ranges of its readings a lever is long, from which on it is worth saying."""
SHARE = 0.05
"""Of a ridge, from which on a parameter takes part in it."""
PLACES = tuple(f"a_{axis}" for axis in AXES)


@dataclass(frozen=True, eq=False)
class Measured:
    """A machine that has been measured.

    Attributes
    ----------
    origin : str
        In words.
    posterior : LegPosterior
    draws : Draws or None
        None where the design wants no draws.
    n_held_back : int
        How many measured poses are left out, since they are kept for verification.
    """

    origin: str
    posterior: LegPosterior
    draws: Draws | None
    n_held_back: int = 0


@dataclass(frozen=True, eq=False)
class LegPlan(Planned):
    """A mechanism on legs whose platform instruments see, planned or measured.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
        Where the config's file names start.
    knowledge : Knowledge
    plan : Plan
    sensors : dict of name to Sensor
        All that the config lists, those that it does not use too.
    workspace : PoseVolume or None
    workspace_actuators : ndarray, shape (W, N)
        Actuator positions of the workspace's poses; those of the plan where there is no workspace.
    requirements : tuple of Requirement
    units : Units
    measured : Measured or None
        Where the config has data.
    """

    config: AuditConfig
    folder: Path
    knowledge: Knowledge
    plan: Plan
    sensors: dict[str, Sensor]
    workspace: PoseVolume | None
    workspace_actuators: Array
    requirements: tuple[Requirement, ...]
    units: Units
    measured: Measured | None = None

    @property
    def parameters(self) -> FreeParameters:
        """The free parameters."""
        known = self.knowledge
        return FreeParameters(known.names, known.units, known.sd, np.asarray(known.layout.nominal[known.free]))

    @property
    def frames(self) -> frozenset[str]:
        """Symbols of the frames of instrument and tool."""
        return frozenset(block.symbol for block in FRAME_BLOCKS)

    @property
    def n_poses(self) -> int:
        """Number of planned poses."""
        return self.plan.n_poses

    @property
    def is_beyond_range(self) -> bool:
        """Whether the actuators would have to reach further than they do."""
        mechanism = self.knowledge.machine.mechanism
        moved = np.abs(self.plan.actuators - mechanism.initial_actuator_positions)
        return bool(np.any(moved > mechanism.actuator_range * (1.0 + SLACK)))

    def inform(self) -> Information:
        """Return what the plan tells of the parameters."""
        return inform(self.knowledge, self.plan)

    def list_rows(self) -> tuple[Array, Array, np.ndarray]:
        """Return white rows, their columns of systematic errors, and of which term each is."""
        return list_rows(self.knowledge, self.plan)

    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no measurement with the plan's instruments sees."""
        return find_structural_rank(self.knowledge, self.plan, rng)

    def forecast(self) -> Forecast:
        """Return how the pose errs over the workspace."""
        sensitivity = compute_sensitivity(self.knowledge, self.workspace_actuators)
        slope, noise, functions = sensitivity.slope * self.sd, sensitivity.pose_noise(self.plan), None
        if self.plan.systematic is not None:
            functions, beside = show_functions_elsewhere(
                self.knowledge, self.plan, sensitivity, self.workspace_actuators
            )
            noise = noise + beside
        return Forecast(slope, noise, functions)

    @property
    def sizes(self) -> Mapping[str, float]:
        """Root mean squares of systematic errors along the legs, mm."""
        return {} if self.plan.systematic is None else self.plan.systematic.sizes

    @property
    def function_scale(self) -> float:
        """Scale of the prior of each of these sizes, mm."""
        return self.config.model_error.scales(self.plan.actuator_noise)[1]

    @property
    def floors(self) -> Mapping[str, float]:
        """What each term has at least, mm: as stated here, or in the study."""
        return super().floors if self.measured is None else find_floors(self.measured.posterior)

    def resize(self, sizes: Mapping[str, float]) -> LegPlan:
        """Return the same with systematic errors of other sizes, mm."""
        return replace(self, plan=replace(self.plan, systematic=_list_errors(sizes)))

    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions, computed with the machine itself."""
        return describe_ridges(self.knowledge, self.plan, self.workspace_actuators, directions, self.units)

    @property
    def tool_units(self) -> tuple[str, ...]:
        """Units of a pose."""
        return POSE_UNITS

    def name_workspace_pose(self, k: int) -> str:
        """Return the actuators' displacements at a pose of the workspace."""
        moved = self.workspace_actuators[k] - self.knowledge.machine.mechanism.initial_actuator_positions
        return f"displacements {', '.join(f'{one:.3g}' for one in moved)} mm"

    def describe_variant(self) -> dict[str, Any]:
        """Return what sees the platform."""
        names = [] if self.measured is not None else list_measuring(self.config)
        words = ", ".join(name.replace("_", " ") for name in names)
        n_legs = self.knowledge.machine.mechanism.n_legs
        return {
            "title": self.config.variants[0].label,
            "data": f"{words or 'measured poses'}, {self.n_poses} poses",
            "n_equations": self.n_poses * n_legs,
        }

    def summarise_plan(self) -> dict[str, Any]:
        """Return machine and plan for ``summary.json``."""
        config, plan, machine = self.config, self.plan, self.knowledge.machine
        mechanism = machine.mechanism
        moved = np.abs(plan.actuators - mechanism.initial_actuator_positions)
        found: dict[str, Any] = {
            "n_poses": plan.n_poses,
            "sensors": [] if config.data is not None else list_measuring(config),
            "actuator_noise_um": 1e3 * plan.actuator_noise,
            "model_error_um": 1e3 * plan.model_error,
            "largest_displacement_mm": float(moved.max()),
            "actuator_range_mm": mechanism.actuator_range,
        }
        found |= self.describe_errors()
        if self.measured is not None:
            found["n_held_back"] = self.measured.n_held_back
        if isinstance(config.workspace, WorkspaceConfig):
            found["workspace"] = config.workspace.model_dump(mode="json")
        return {
            "machine": mechanism.name,
            "model": label_class(config.variants[0].model or ""),
            "model_title": machine.model.title,
            "deformation": label_class(config.variants[0].deformation),
            "plan": found,
        }

    def summarise_ridges(self, ridges: Sequence[Ridge]) -> dict[str, Any]:
        """Return how far from zero the actuators read whose places and directions a ridge ties, mm; else nothing.

        A joint is at a + ρ u (RR-8096 eq. 30): a tolerance of u turns the rail about the point where the actuator reads
        zero. Readings of 731 mm with a tolerance of 0.5 mrad add 0.37 mm to the joint's, and of a and u the poses
        determine little more than the sum. With the zero in the middle of the readings each is a dimension of its own.
        """
        knowledge, actuators = self.knowledge, self.plan.actuators
        chart = knowledge.machine.layout.directions
        if chart is None or knowledge.machine.mechanism.drive != "base":
            return {}
        middle, half = actuators.mean(axis=0), 0.5 * np.ptp(actuators, axis=0)
        names, legs = np.array(knowledge.names), []
        strong = [set(names[one.direction.vector**2 >= SHARE].tolist()) for one in ridges]
        for leg in np.flatnonzero(np.abs(middle) > FAR * half).tolist():
            turns, moves = ({f"{one}[{leg + 1}]" for one in some} for some in (chart.symbols, PLACES))
            if any(turns & one and moves & one for one in strong):
                legs.append(leg)
        if not legs:
            return {}
        far = max(legs, key=lambda leg: abs(middle[leg]))
        sd = dict(zip(knowledge.names, knowledge.sd.tolist(), strict=True))
        turned = max(sd.get(f"{symbol}[{far + 1}]", 0.0) for symbol in chart.symbols)
        found = {"legs": [leg + 1 for leg in legs], "reading_mm": float(middle[far]), "direction_sd": turned}
        return {"far_readings": found}

    def list_changes(self) -> list[WhatIfConfig]:
        """Return poses at the ends of the range, over all of it, and each instrument that is listed and not used."""
        config, n, changes = self.config, self.n_poses, list[WhatIfConfig]()
        for plan, words in (("extremes", "at the ends of the range"), ("uniform", "spread evenly over the range")):
            if config.data is None and config.poses.plan != plan:
                poses = PosesConfig.model_validate({"plan": plan, "count": n})
                changes.append(WhatIfConfig(name=f"{n} poses {words}", poses=poses))
        if self.sizes:
            changes.append(WhatIfConfig(name="no error that is a function of the pose", model_error=False))
        measuring = list_measuring(config)
        for name in config.sensors:
            if name not in measuring:
                words = name.replace("_", " ")
                changes.append(WhatIfConfig(name=f"{words} instead", sensors=[name]))
                changes.append(WhatIfConfig(name=f"{words} too", sensors=[*measuring, name]))
        return changes

    def change(self, change: WhatIfConfig) -> LegPlan:
        """Return the same machine with a changed plan."""
        plan, mechanism = self.plan, self.knowledge.machine.mechanism
        count = max(1, round(change.poses_factor * plan.n_poses))
        config = change.poses or (None if self.measured is not None else self.config.poses)
        information = plan.pose_information
        if config is not None:
            same = change.poses is not None and change.poses_factor == 1.0
            number = None if same else count
            actuators = plan_actuators(
                self.config, self.folder, self.knowledge, self.workspace, config, change.workspace_factor, number
            )
        else:
            again = np.arange(count) % plan.n_poses
            start = mechanism.initial_actuator_positions
            actuators = start + change.workspace_factor * (plan.actuators[again] - start)
            information = None if information is None else information[again]
        sensors = plan.sensors
        if change.sensors is not None:
            sensors = choose_sensors(self.sensors, change.sensors, f"what_if {change.name!r}: sensors")
            information = None
        changed = replace(
            plan,
            actuators=actuators,
            sensors=sensors,
            pose_information=information,
            noise_factor=plan.noise_factor * change.noise_factor,
            actuator_noise=plan.actuator_noise * change.actuator_noise_factor,
        )
        sizes = self.sizes if change.model_error else {}
        places = (place_actuators(self.knowledge, one) for one in (plan.actuators, actuators))
        return replace(self, plan=changed).resize(rescale(sizes, *places))

    def propose(self) -> tuple[str, LegPlan]:
        """Return as many poses as planned, chosen I-optimally; sensors and noise stay."""
        plan = replace(self.plan, actuators=select_i_optimal(self).actuators)
        places = (place_actuators(self.knowledge, one.actuators) for one in (self.plan, plan))
        return f"{self.n_poses} poses chosen I-optimally", replace(self, plan=plan).resize(rescale(self.sizes, *places))

    def simulate(
        self, n: int, rng: np.random.Generator, fitted: Sequence[int]
    ) -> tuple[SimulatedCalibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement."""
        simulated = simulate_calibrations(self.knowledge, self.plan, n, rng, fitted)
        return simulated, count_kept(simulated, self.plan, self.workspace_actuators, list(self.requirements), rng)

    def average(self, n: int, rng: np.random.Generator) -> Array:
        """Return the posterior covariance averaged over n machines of the priors, in units of the tolerances."""
        return expected_covariance(self.knowledge, self.plan, n, rng)


def select_i_optimal(inputs: LegPlan, n: int | None = None, n_candidates: int | None = None) -> Selection:
    """Return I-optimal poses for an audit, found by exchange.

    They minimise the expected posterior variance of the predicted pose, averaged over the poses of the audit's
    workspace (those of its plan where it has none) and in units of its requirements (see `find_limits`). Systematic
    errors are found with the parameters, and the machine in use has them.

    Parameters
    ----------
    inputs : LegPlan
    n : int, optional
        How many poses; as many as planned by default.
    n_candidates : int, optional
        On a full factorial over the actuators' range, since far corners tell most: three levels each by default, and
        the ends alone where there are systematic errors, beside poses of the plan and of the workspace. Where legs are
        redundant random ones within the workspace.

    Raises
    ------
    InputError
        Where legs are redundant and there is no workspace, or poses are too few for the parameters.
    """
    knowledge = inputs.knowledge
    if n_candidates is None:
        n_candidates = N_CANDIDATES if inputs.plan.systematic is None else N_CORNERS
    rng = np.random.default_rng([inputs.config.seed, SEED_OF_POSES])
    workspace = compute_sensitivity(knowledge, inputs.workspace_actuators)
    limits = find_limits(inputs.requirements, workspace.slope * knowledge.sd)
    if knowledge.machine.mechanism.n_legs == DEGREES_OF_FREEDOM:
        domain = ActuatorBox(knowledge)
        candidates = factorial_candidates(domain, n_candidates)
        if inputs.plan.systematic is not None:  # far corners tell less of errors elsewhere
            inside = place_actuators(knowledge, np.concatenate([inputs.plan.actuators, inputs.workspace_actuators]))
            shares = np.concatenate([candidates.shares, inside.travel[np.abs(inside.travel).max(axis=1) <= 1.0]])
            candidates = candidates_at(domain, shares)
    else:
        if inputs.workspace is None:
            raise InputError("I-optimal poses: found redundant legs without [workspace], expected it")
        candidates = random_candidates(WorkspaceBox(knowledge, inputs.workspace.half), n_candidates, rng)
    plan, show = inputs.plan, None
    if plan.systematic is not None:
        pool = np.concatenate([plan.actuators, inputs.workspace_actuators, candidates.placed.actuators])
        show, plan = share_functions(knowledge, plan, pool)
    criterion = IOptimality(plan, workspace=workspace, sd=knowledge.sd, limits=limits, show=show)
    count = inputs.plan.n_poses if n is None else n
    problem = SelectionProblem(candidates, criterion, count)
    with threadpool_limits(1), np.errstate(all="ignore"):
        return select(problem, "exchange", rng)


# --- reading a plan --------------------------------------------------------------------------------------------------


def read_legs(config: AuditConfig, folder: Path) -> LegPlan:
    """Return a machine that has not been measured and how it is to be, read and checked.

    Raises
    ------
    InputError
        For anything at fault in the design or its files: unknown names, poses that the machine cannot take or the
        actuators cannot reach, sensors that are not there.
    """
    assert config.machine is not None
    assert config.noise is not None
    variant, units = config.variants[0], Units(config.units.length, config.units.angle)
    assert variant.model is not None
    model = ModelConfig(model=variant.model, deformation=variant.deformation)
    machine = read_machine(folder / config.machine, model, config.deformation, folder)
    priors, fixed = read_tolerances(machine, config.parameters, variant.free, units, Path(config.name))
    knowledge = Knowledge(machine, priors | _read_frames(config.frames, units), fixed)
    actuators = plan_actuators(config, folder, knowledge, read_volume(config), config.poses)
    mechanism, moved = machine.mechanism, np.abs(actuators - machine.mechanism.initial_actuator_positions)
    if np.any(moved > mechanism.actuator_range * (1.0 + SLACK)):
        pose, leg = np.unravel_index(int(np.argmax(moved)), moved.shape)
        raise InputError(
            f"poses: pose {pose + 1}, leg {leg + 1}: found a displacement of {moved[pose, leg]:g} mm, "
            f"expected at most the actuator range of {mechanism.actuator_range:g} mm"
        )
    plan = plan_sensors(
        actuators, _read_sensors(config, folder), list_measuring(config), config.noise, "variants.sensors"
    )
    there = config.model_error.terms if len(actuators) >= FEWEST_POSES and moved.any() else ALONE
    true = {name: size for name, size in config.model_error.sizes(there).items() if name != INDEPENDENT}
    tau = float(np.hypot(plan.model_error, config.model_error.tau))
    return _complete(config, folder, knowledge, replace(plan, model_error=tau), None).settle(true)


def _list_errors(sizes: Mapping[str, float]) -> SystematicErrors | None:
    """Return systematic errors of sizes in mm; None where all are zero."""
    there = {name: size for name, size in sizes.items() if size > 0.0}
    return SystematicErrors(there) if there else None


def _complete(
    config: AuditConfig, folder: Path, knowledge: Knowledge, plan: Plan, measured: Measured | None
) -> LegPlan:
    units, workspace = Units(config.units.length, config.units.angle), read_volume(config)
    check_profiles(knowledge, config.profiles)
    predict_poses(knowledge.machine, knowledge.machine_centre, plan.actuators)
    at = find_actuators(knowledge, workspace, config.seed, plan.actuators)
    requirements = read_requirements(
        config, {name: "rad" if name.startswith("rotation") else "mm" for name in REQUIRED}
    )
    sensors = _read_sensors(config, folder)
    return LegPlan(config, folder, knowledge, plan, sensors, workspace, at, requirements, units, measured)


def _read_sensors(config: AuditConfig, folder: Path) -> dict[str, Sensor]:
    return {
        name: build_sensor(name, sensor, folder)
        for name, sensor in config.sensors.items()
        if not isinstance(sensor, ChannelConfig)
    }


def list_measuring(config: AuditConfig) -> list[str]:
    """Return the instruments that see each planned pose."""
    chosen = config.variants[0].sensors
    return list(config.sensors) if chosen is None else chosen


def read_volume(config: AuditConfig) -> PoseVolume | None:
    """Return where accuracy counts; None where nothing is said."""
    return read_workspace(config.workspace if isinstance(config.workspace, WorkspaceConfig) else None)


def _read_frames(frames: FramesConfig, units: Units) -> dict[str, float]:
    """Return standard deviations of the frames that the calibration has to find, by parameter."""
    priors: dict[str, float] = {}
    for frame in FRAMES:
        section = getattr(frames, frame)
        if section is not None:
            moved, turned = frame_symbols(frame)
            priors |= dict.fromkeys(moved, section.position * units.factor("mm"))
            priors |= dict.fromkeys(turned, section.rotation * units.factor("rad"))
    return priors


# --- poses -------------------------------------------------------------------------------------------------------


def plan_actuators(
    config: AuditConfig,
    folder: Path,
    knowledge: Knowledge,
    workspace: PoseVolume | None,
    plan: PosesConfig,
    factor: float = 1.0,
    count: int | None = None,
) -> Array:
    """Return the actuator positions of a plan, shape (P, N), mm.

    Parameters
    ----------
    config, folder
        The design and where its files are.
    knowledge : Knowledge
    workspace : PoseVolume or None
    plan : PlanConfig
    factor : float
        On the displacements.
    count : int, optional
        Number of poses; a table's rows are taken round and round.
    """
    mechanism = knowledge.machine.mechanism
    start = mechanism.initial_actuator_positions
    rng = np.random.default_rng([config.seed, 1])
    if plan.file is not None:
        raise InputError("poses.file: found poses of a platform that instruments see, expected configurations")
    if plan.configurations is not None:
        moves = read_moves(folder / plan.configurations, plan.unit_mm, mechanism.n_legs)
        moves = moves if count is None else moves[np.arange(count) % len(moves)]
        return start + factor * moves
    n = plan.count if count is None else count
    assert n is not None
    if plan.plan != "workspace":
        half = mechanism.actuator_range if plan.range_mm is None else plan.range_mm
        drawn = start + factor * draw_displacements(plan.plan, n, mechanism.n_legs, half, rng)
        return close_legs(knowledge, drawn)
    if workspace is None:
        raise InputError("poses: found plan 'workspace' without [workspace], expected it")
    theta = knowledge.machine_centre
    found = find_workspace_actuators(knowledge.machine, theta, workspace, max(n, 12), config.seed)
    return start + factor * (rng.permutation(found)[:n] - start)


def close_legs(knowledge: Knowledge, actuators: Array) -> Array:
    """Return positions near the given ones (P, N) at which redundant legs close too; six legs always do.

    The poses are those of least squares; where there is none, or a leg cannot follow, the position stays as it was.
    """
    machine = knowledge.machine
    if machine.mechanism.n_legs == DEGREES_OF_FREEDOM:
        return actuators
    theta = knowledge.machine_centre
    found = solve_forward_kinematics(machine, theta, actuators, check=False)
    back = solve_inverse_kinematics(machine, theta, found.position, found.rotation, check=False)
    good = found.converged & back.converged
    return np.where(good[:, None], back.actuators, actuators)


# --- a study's measurements -------------------------------------------------------------------------------------------


def read_measured(config: AuditConfig, folder: Path) -> MeasuredVariant:
    """Return what a design's study says of its machine.

    Raises
    ------
    InputError
        Where there is no such study, or it has no variant of the design's model, deformation, name and free parameters,
        or several, or another mechanism.
    """
    assert config.data is not None
    where = folder / config.data.study
    experiment, study = load(where)
    variant = config.variants[0]
    assert variant.model is not None
    choice = VariantChoice(label_class(variant.model), label_class(variant.deformation), config.data.variant)
    found = measure_legs(experiment, study, where, choice, config.data.with_model_error)
    free = variant.free
    if free is not None and set(free) != set(found.free):
        raise InputError(
            f"variants.free: found {', '.join(free)}, expected none or those of the study's {found.name}: "
            f"{', '.join(found.free)}"
        )
    if config.machine is not None and (folder / config.machine).resolve() != found.mechanism.resolve():
        raise InputError(
            f"machine: found {folder / config.machine} beside [data], expected none or the study's {found.mechanism}"
        )
    return found


def draw_measured(config: AuditConfig, folder: Path, found: MeasuredVariant, run: Run) -> LegPlan:
    """Return what is known of a measured machine: by its posterior's draws, or its mode where none are wanted."""
    wanted = DRAWS_WITH_DATA if config.posterior.draws is None else config.posterior.draws
    draws, posterior = None, found.posterior
    if wanted:
        draws = run.once("posterior", draw, (posterior, config.posterior, wanted, config.seed), (Draws,))
        values, natural = draws.mean, draws.natural.reshape(-1, posterior.n_parameters)
    else:
        natural = posterior.natural(find_modes(posterior)[0].y[None])
        values = natural[0, : posterior.n_geometry]
    names = posterior.names[: posterior.n_geometry]
    centre = dict(zip(names, values.tolist(), strict=True))
    knowledge = Knowledge(found.machine, {name: found.priors[name].sd for name in names}, {**found.fixed, **centre})
    variance = posterior.errors.mean_square_tau(posterior.zeta(natural))
    model_error = float(np.sqrt(variance + found.left_variance))
    plan = Plan(
        found.poses.actuators,
        (),
        found.actuator_noise,
        model_error,
        pose_information=np.linalg.inv(found.poses.covariance),
        systematic=_list_errors(find_sizes(posterior, natural)),
    )
    measured = Measured(found.origin, found.posterior, draws, found.n_held_back)
    return _complete(config, folder, knowledge, plan, measured)


def draw(task: tuple[LegPosterior, DrawsConfig, int, int]) -> Draws:
    """Return draws of a posterior: so many, by a design's effort and seed."""
    posterior, effort, wanted, seed = task
    return draw_posterior(posterior, effort, wanted, np.random.SeedSequence([seed, SEED]))
