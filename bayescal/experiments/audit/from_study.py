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

from bayescal.config.load import load_experiment
from bayescal.config.schema import StudyConfig, VariantConfig
from bayescal.density.posterior import Posterior
from bayescal.errors import InputError
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.study.inputs import StudyInputs, load_inputs
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.draws import Draws, draw_posterior
from bayescal.inference.mode import find_modes
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
    posterior : Posterior
    draws : Draws or None
        None where the design wants no draws.
    """

    origin: str
    knowledge: Knowledge
    plan: Plan
    posterior: Posterior
    draws: Draws | None


def read_measured(config: AuditConfig, folder: Path) -> Measured:
    """Return what a design's study says of its machine.

    Raises
    ------
    InputError
        Where there is no such study, or it has no variant of the design's model, deformation and free parameters, or
        another mechanism.
    """
    assert config.data is not None
    where = folder / config.data.study
    study = load_experiment(where)
    if not isinstance(study, StudyConfig):
        raise InputError(f"{where}: kind: found {study.kind!r}, expected 'study', since an audit's data are a study's")
    variant = _find_variant(config, study, where)
    _check_mechanism(config, folder, study, where)
    inputs = load_inputs(study, where.parent)
    posterior = inputs.posterior(variant, config.data.with_model_error)
    wanted = DRAWS_WITH_DATA if config.posterior.draws is None else config.posterior.draws
    draws = None
    if wanted:
        draws = draw_posterior(posterior, config.posterior, wanted, np.random.SeedSequence([config.seed, SEED]))
        values, variance = draws.mean, draws.model_error_variance
    else:
        values, variance = _find_mode(posterior)
    origin = f"{study.data.origin}: study {study.name}, variant {variant.name}"
    knowledge = _knowledge(inputs, variant, posterior, values)
    return Measured(origin, knowledge, _plan(inputs, variant, variance), posterior, draws)


def _find_variant(config: AuditConfig, study: StudyConfig, where: Path) -> VariantConfig:
    wanted = f"{config.variant.model}/{config.variant.deformation}"
    by_name = {variant.name: variant for variant in study.variants}
    if wanted not in by_name:
        raise InputError(f"{where}: variants: found no {wanted}, expected one of {', '.join(by_name)}")
    variant, free = by_name[wanted], config.variant.free
    if free is not None and set(free) != set(variant.free):
        raise InputError(
            f"variant.free: found {', '.join(free)}, expected none or those of the study's {wanted}: "
            f"{', '.join(variant.free)}"
        )
    return variant


def _check_mechanism(config: AuditConfig, folder: Path, study: StudyConfig, where: Path) -> None:
    if config.mechanism is None:
        return
    found, expected = folder / config.mechanism, where.parent / study.mechanism
    if found.resolve() != expected.resolve():
        raise InputError(f"mechanism: found {found} beside [data], expected none or the study's {expected}")


def _find_mode(posterior: Posterior) -> tuple[Array, float]:
    """Return the most probable parameters (m,), and the mean of τ² there, mm²."""
    natural = posterior.natural(find_modes(posterior)[0].y[None])[0]
    values, tau = natural[: posterior.n_geometry], natural[posterior.n_geometry :]
    return values, float(np.mean(tau**2)) if tau.size else 0.0


def _knowledge(inputs: StudyInputs, variant: VariantConfig, posterior: Posterior, values: Array) -> Knowledge:
    priors, fixed = inputs.priors(variant)
    names = posterior.names[: posterior.n_geometry]
    centre = dict(zip(names, values.tolist(), strict=True))
    return Knowledge(inputs.machine(variant), {name: priors[name].sd for name in names}, {**fixed, **centre})


def _plan(inputs: StudyInputs, variant: VariantConfig, model_error_variance: float) -> Plan:
    poses = inputs.poses(verification=False)
    left = inputs.matrix_variance(variant, verification=False)
    variance = model_error_variance + (0.0 if left is None else float(left.mean()))
    noise = 1e-3 * inputs.config.data.actuator_noise_um
    information = np.linalg.inv(poses.covariance)
    return Plan(poses.actuators, (), noise, float(np.sqrt(variance)), pose_information=information)
