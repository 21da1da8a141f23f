"""Computing an audit: all its levels, the long ones in tasks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.experiments.audit.accuracy import compute_accuracy
from bayescal.experiments.audit.audit import AuditOutcome, complete, judge
from bayescal.experiments.audit.design import AuditDesign, draw_plan
from bayescal.experiments.audit.draws import audit_posterior, plot_ridges, tabulate_plots
from bayescal.experiments.audit.measured import Draws
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.results import (
    describe_variant,
    summarise,
    summarise_row,
    tabulate,
    tabulate_errors,
    tabulate_help,
    tabulate_variants,
)
from bayescal.experiments.audit.rows import AXES, ProfilePathRow, ProfileRow
from bayescal.experiments.audit.sensor_sets import FoundSets, search_sensors, tabulate_sets
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.identifiability.calibration import compare_kept, compare_with_prediction
from bayescal.identifiability.profile import Profile, compute_profile
from bayescal.identifiability.requirements import DRAWS
from bayescal.numerics.geometry import Array

PROFILES = 4  # where the design names none


def compute_audit(inputs: AuditDesign, run: Run) -> Results:
    """Return everything an audit says: of all variants how they compare, of the best one all the rest."""
    config, asked = inputs.config, inputs.sensors
    with np.errstate(all="ignore"):
        plans, draws = inputs.plans, None
        if inputs.measured is not None:
            measured, draws = draw_plan(inputs, run)
            plans = {config.variants[0].name: measured}
        tables = compute_accuracy(plans, run)
        if asked is not None:
            tables |= tabulate_sets(asked, run.once("sets of sensors", search_sensors, asked, (FoundSets,)))
        judged = {name: judge(one) for name, one in plans.items()}
        best = choose_best(judged)
        audit = complete(judged[best], run)
        # simulated calibrations see whether first order holds: of machines without errors that bind the poses together
        bare = (
            judge(audit.inputs.without_systematic_errors())
            if config.n_simulated_calibrations and audit.inputs.sizes
            else audit
        )
        simulated = run.map("simulated calibrations", _simulate_case, bare.inputs, _list_cases(bare))
        averaged = None
        if config.n_prior_draws:
            averaged = run.once("expected over machines", _average_machines, audit.inputs)
        summary = summarise(audit)
        tables |= tabulate_variants(judged) | tabulate(summary, audit) | tabulate_errors(judged[best])
        tables |= tabulate_machine(audit.inputs) | _draw_ridges(audit, draws, summary, run)
        tables |= tabulate_help(summary)
    if inputs.measured is not None:
        summary["plan"]["n_verification_poses"] = inputs.measured.found.n_held_back
    summary["best"] = best
    summary["variants"] = {name: summarise_row(describe_variant(one), "variant") for name, one in judged.items()}
    summary["candidates"] = None if config.selection is None else config.selection.candidates
    summary["pose_selection"] = None if config.selection is None else config.selection.method
    summary["sensor_selection"] = None
    if asked is not None:
        candidates = [one.name for one in asked.choices]
        summary["sensor_selection"] = {"candidates": candidates, "required_sensors": asked.section.required_sensors}
    summary["aligned"] = all(one.variant.aligned for one in plans.values())
    if averaged is not None:
        for said, share in zip(summary["parameters"].values(), averaged, strict=True):
            said["posterior_sd_over_draws"] = float(share) * said["prior_sd"]
    return Results(summary | simulated, tables)


def choose_best(audits: Mapping[str, AuditOutcome]) -> str:
    """Return the variant that most probably keeps what is required, else that which leaves least error."""

    def order(name: str) -> tuple[float, float]:
        one = audits[name]
        if one.outlooks:
            worst = max(x.predicted_sd / x.requirement.limit for x in one.outlooks)
            return -one.together, worst if np.isfinite(worst) else np.inf
        left = one.measure_left()
        return 0.0, left if np.isfinite(left) else np.inf

    return min(audits, key=order)


def tabulate_machine(inputs: DesignVariant) -> dict[str, pd.DataFrame]:
    """Return where the joints of a machine on legs stand at the planned poses; nothing of other machines."""
    variant, model = inputs.variant, inputs.variant.whole
    if model.legs is None:
        return {}
    read = model.read(model.layout.nominal, variant.start, variant.data.given)
    actuators = read[:, model.select(model.commanded)]
    return {"joints": tabulate_joints(model.legs.machine.mechanism, actuators, variant.data.poses)}


def _draw_ridges(audit: AuditOutcome, draws: Draws | None, summary: Summary, run: Run) -> dict[str, pd.DataFrame]:
    """Return profiles and what draws of the posterior show of the ridges; a summary is told of the draws."""
    inputs = audit.inputs
    level = audit_posterior(inputs, draws, audit)
    names = {name: name for name in choose_profiles(inputs, audit)}
    profiles = list(
        run.map("profiles", _compute_profile, inputs.without_systematic_errors(), names, (Profile,)).values()
    )
    plots = plot_ridges(inputs, audit, level, profiles)
    if isinstance(level, str):
        summary["no_posterior_reason"] = level
    else:
        summary["posterior"] = level.summary()
    for direction, said in zip(audit.analysis.directions, summary["directions"], strict=True):
        along = None if isinstance(level, str) else level.contraction_along(direction.vector)
        said["posterior_contraction"] = along
    for k, plot in plots.items():
        summary["directions"][k]["plot"] = {name: getattr(plot, name) for name in AXES}
    return tabulate_plots(plots) | _tabulate_profiles(inputs, profiles)


# --- profiles ----------------------------------------------------------------------------------------------------


def choose_profiles(inputs: DesignVariant, audit: AuditOutcome) -> list[str]:
    """Return the config's profiles; where it names none, a known parameter and some that ridges are named after."""
    if inputs.config.profiles:
        return [name for name in inputs.config.profiles if name in inputs.names]
    names, chosen = inputs.names, dict[str, str]()
    for name, verdict in zip(names, audit.analysis.verdicts, strict=True):
        if verdict == "identifiable":
            chosen[name.partition("[")[0]] = name
            break
    for ridge in audit.ridges:
        if ridge.direction.pivot is not None and len(chosen) < PROFILES:
            name = names[ridge.direction.pivot]
            chosen.setdefault(name.partition("[")[0], name)
    return list(chosen.values())


def _compute_profile(bare: DesignVariant, name: str) -> Profile:
    return compute_profile(bare.posterior, name, bare.expected[len(bare.names) :])


def _tabulate_profiles(inputs: DesignVariant, profiles: list[Profile]) -> dict[str, pd.DataFrame]:
    units, known = inputs.units, inputs.parameters
    named = {name: units.name(unit) for name, unit in zip(known.names, known.units, strict=True)}
    factors = np.array([units.factor(unit) for unit in known.units])
    rows, paths = list[ProfileRow](), list[ProfilePathRow]()
    for profile in profiles:
        place, there = known.names.index(profile.name), np.isfinite(profile.deviance)
        moved = np.ptp(profile.path[there] / known.sd, axis=0)
        followers = [int(k) for k in np.argsort(-moved) if k != place and moved[k] > 0.01][:PROFILES]
        for k in np.flatnonzero(there):
            point = ProfileRow(
                parameter=profile.name,
                unit=named[profile.name],
                value=profile.values[k] / factors[place],
                deviance_data=profile.data_deviance[k],
                deviance_total=profile.deviance[k],
            )
            rows.append(point)
            paths += [
                ProfilePathRow(
                    parameter=profile.name,
                    value=point.value,
                    other=known.names[other],
                    other_unit=named[known.names[other]],
                    other_value=profile.path[k, other] / factors[other],
                )
                for other in followers
            ]
    tables = {"profiles": ProfileRow.collect(rows), "profile_paths": ProfilePathRow.collect(paths)}
    return {name: table for name, table in tables.items() if len(table)}


# --- simulated calibrations --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """What is identified in simulated calibrations, and what is predicted of it."""

    fitted: np.ndarray  # (m,): the others, off by their tolerances too, are taken for nominal
    covariance: Array  # (m, m): of the errors to expect, in tolerances
    probability: dict[str, float]  # by requirement: to keep it


STREAM = 5  # of random numbers; the same machines with the same noise for every case


def _list_cases(audit: AuditOutcome) -> dict[str, Case]:
    """Return simulated calibrations with everything free, and with the reduced set free and the rest held at nominal.

    In both all parameters are off by their tolerances.
    """
    information, outlooks = audit.analysis.information, audit.outlooks
    if audit.inputs.config.n_simulated_calibrations == 0:
        return {}
    every = np.arange(len(audit.inputs.names))
    claimed = {one.requirement.name: one.probability for one in outlooks}
    cases = {"simulated_calibrations": Case(every, information.covariance, claimed)}
    reduced = audit.analysis.reduced
    if reduced is not None:
        errors = information.errors_of_reduced(audit.analysis.selection.free)
        chances = {one.requirement.name: one.reduced_probability for one in outlooks}
        part = errors[np.ix_(reduced.free, reduced.free)]
        cases["simulated_calibrations_reduced"] = Case(reduced.free, part, chances)
    return cases


def _simulate_case(inputs: DesignVariant, case: Case) -> Summary:
    """Return what simulated calibrations reach beside what is predicted of them, in the config's units."""
    n, rng, units = (
        inputs.config.n_simulated_calibrations,
        np.random.default_rng([inputs.config.seed, STREAM]),
        inputs.units,
    )
    simulated, kept = inputs.simulate(n, rng, case.fitted.tolist())
    found, converged = compare_with_prediction(simulated, case.covariance), int(simulated.converged.sum())
    fitted, ratios, symbols = np.array(inputs.symbols)[case.fitted], found.by_symbol(), dict[str, object]()
    for symbol, ratio in ratios.items():
        part = np.flatnonzero(fitted == symbol)
        places = case.fitted[part]
        unit = inputs.parameters.units[places[0]]
        scale = inputs.sd[places] / units.factor(unit)
        deviations = {"claimed_sd": found.claimed, "predicted_sd": found.predicted, "simulated_sd": found.found}
        symbols[symbol] = {
            "unit": units.name(unit),
            **{name: float(np.sqrt(np.mean((value[part] * scale) ** 2))) for name, value in deviations.items()},
            "ratio": ratio,
            "ratio_se": float(np.sqrt(np.mean(found.ratio_error[part] ** 2) / len(part))),
            "coverage_90": float(found.covered[part].mean()),
            "rms_z": float(np.sqrt(np.mean(found.z[part] ** 2))),
        }
    requirements: Summary = {}
    for required, number in zip(inputs.requirements, kept, strict=True):
        claimed = case.probability[required.name]
        one = compare_kept(int(number), converged, claimed, DRAWS)
        requirements[required.name] = {
            "claimed_probability": claimed,
            "kept": one.kept,
            "n": one.n,
            "expected_low": one.low,
            "expected_high": one.high,
            "agrees": one.agrees,
        }
    return {
        "n": n,
        "n_converged": converged,
        "n_redrawn": simulated.n_redrawn,
        "chi_square": found.chi_square,
        "chi_square_se": found.chi_square_error,
        "coverage_90": float(found.covered.mean()),
        "rms_z": float(np.sqrt(np.mean(found.z**2))),
        "symbols": symbols,
        "requirements": requirements,
    }


def _average_machines(inputs: DesignVariant) -> Array:
    """Return posterior sds in tolerances as root mean squares over machines of the tolerances, shape (n,)."""
    n, rng = inputs.config.n_prior_draws, np.random.default_rng([inputs.config.seed, 7])
    return np.sqrt(np.diagonal(inputs.average(n, rng)))
