"""A study's measurements as an audit takes them: its machine, tolerances, measured poses and posterior.

A machine that has been measured is known better than its drawings, and the ridges of its posterior bend. Derivatives
are therefore taken at the posterior mean: there the tangent of a bent ridge is, to second order, the chord through the
draws, while at the nominal machine it is turned away by the bend times the distance. Without draws the most probable
machine stands in for it. Tolerances stay those of the priors.

What moves a pose besides the geometry is, beside the actuators' noise, the posterior mean of the model error's τ² and
the variance v_n that the measured part of a deformation matrix K leaves, both averaged over legs and poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.config.classes import label_class
from bayescal.density.legs import LegPosterior, find_function_of_pose
from bayescal.errors import InputError
from bayescal.experiments.audit.schema import NOT_STRUCTURED, AuditConfig
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.measured import MeasuredVariant, VariantChoice, measure_legs
from bayescal.identifiability.design import FunctionOfPose, Knowledge, Plan
from bayescal.identifiability.draws import Draws, draw_posterior
from bayescal.inference.mode import find_modes
from bayescal.inference.schema import DrawsConfig
from bayescal.numerics.geometry import Array

DRAWS_WITH_DATA = 100_000
"""So many that chance turns the ridges' directions by less than what is said of them; a few seconds."""
SEED = 4


@dataclass(frozen=True, eq=False)
class Measured:
    """A machine that has been measured.

    Attributes
    ----------
    origin : str
        In words.
    knowledge : Knowledge
        Tolerances of the study's priors; the machine at which derivatives are taken.
    plan : Plan
        The calibration poses, with what is known of each.
    posterior : LegPosterior
    draws : Draws or None
        None where the design wants no draws.
    n_held_back : int
        How many measured poses are left out, since they are kept for verification.
    """

    origin: str
    knowledge: Knowledge
    plan: Plan
    posterior: LegPosterior
    draws: Draws | None
    n_held_back: int = 0


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
    if found.posterior.likelihood.structured is not None:
        refuse_independent(config)
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


def refuse_independent(config: AuditConfig) -> None:
    """Raise InputError for what a design wants that has no errors that are functions of the pose."""
    for field in NOT_STRUCTURED:
        if field in config.model_fields_set:
            raise InputError(
                f"{field}: found it beside errors that are functions of the pose, expected none, or deformation "
                "'free_matrix' in place of linear ones"
            )


def draw_measured(config: AuditConfig, found: MeasuredVariant, run: Run) -> Measured:
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
    information = np.linalg.inv(found.poses.covariance)
    function = _find_function(posterior, natural)
    plan = Plan(
        found.poses.actuators, (), found.actuator_noise, model_error, pose_information=information, function=function
    )
    return Measured(found.origin, knowledge, plan, found.posterior, draws, found.n_held_back)


def draw(task: tuple[LegPosterior, DrawsConfig, int, int]) -> Draws:
    """Return draws of a posterior: so many, by a design's effort and seed."""
    posterior, effort, wanted, seed = task
    return draw_posterior(posterior, effort, wanted, np.random.SeedSequence([seed, SEED]))


def _find_function(posterior: LegPosterior, natural: Array) -> FunctionOfPose | None:
    """Return what the legs err by as a function of the pose, of draws in natural units (S, n); None where nothing."""
    function = find_function_of_pose(posterior, natural)
    return FunctionOfPose(*function) if function is not None and function[1].any() else None
