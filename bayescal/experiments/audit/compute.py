"""Computing an audit: all its levels, the long ones in tasks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.audit import Audit, run_audit
from bayescal.experiments.audit.inputs import AuditDesign, AuditInputs, prepare
from bayescal.experiments.audit.posterior import LeftOut, audit_posterior
from bayescal.experiments.audit.results import summarise, tabulate
from bayescal.experiments.audit.ridge_curves import plot_ridges, tabulate_plots
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.identifiability.calibration import (
    Comparison,
    compare_with_prediction,
    expected_covariance,
    simulate_calibrations,
)
from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.information import Information
from bayescal.identifiability.profile import Profile, compute_profiles
from bayescal.numerics.geometry import Array

PROFILES = 4  # where the design names none


def compute_audit(design: AuditDesign, run: Run) -> Results:
    """Return everything an audit says."""
    with np.errstate(all="ignore"):
        inputs = prepare(design, run)
        audit = run_audit(inputs, run)
        level = audit_posterior(inputs, audit, run)
        plots = plot_ridges(inputs, audit, level)
        profiles = _profile(audit, run)
        simulated = _simulate(audit, run)
        averaged = _average(audit, run)
    summary = summarise(audit)
    if isinstance(level, LeftOut):
        summary["posterior_left_out"] = level.reason
    else:
        summary["posterior"] = level.summary()
    for direction, said in zip(audit.analysis.directions, summary["directions"], strict=True):
        said["posterior_contraction"] = level.contraction_along(direction.vector)
    for k, plot in plots.items():
        summary["directions"][k] |= plot.summary()
    if averaged is not None:
        for said, share in zip(summary["parameters"].values(), averaged, strict=True):
            said["posterior_sd_over_draws"] = float(share) * said["prior_sd"]
    for name, calibrations in simulated.items():
        summary[name] = _summarise_calibrations(audit, name, calibrations)
    tables = tabulate(summary, audit) | tabulate_plots(plots) | _tabulate_profiles(audit, profiles)
    return Results(summary, tables)


# --- profiles ----------------------------------------------------------------------------------------------------


def choose_profiles(audit: Audit) -> list[str]:
    """Return the design's profiles; where it names none, a known parameter and some that ridges are named after."""
    if audit.inputs.config.profiles:
        return list(audit.inputs.config.profiles)
    names, chosen = audit.inputs.knowledge.names, dict[str, str]()
    for name, verdict in zip(names, audit.analysis.verdicts, strict=True):
        if verdict == "identifiable":
            chosen[name.partition("[")[0]] = name
            break
    for ridge in audit.ridges:
        if ridge.direction.pivot is not None and len(chosen) < PROFILES:
            name = names[ridge.direction.pivot]
            chosen.setdefault(name.partition("[")[0], name)
    return list(chosen.values())


def _profile(audit: Audit, run: Run) -> list[Profile]:
    """Return the profiles, all of them as one batch: side by side they share each iteration."""
    return run.once("profiles", _compute_profiles, (audit.inputs, choose_profiles(audit)), (Profile,))


def _compute_profiles(task: tuple[AuditInputs, list[str]]) -> list[Profile]:
    inputs, names = task
    return compute_profiles(inputs.knowledge, inputs.plan, names)


def _tabulate_profiles(audit: Audit, profiles: list[Profile]) -> dict[str, pd.DataFrame]:
    units, knowledge = audit.inputs.units, audit.inputs.knowledge
    named = {name: units.name(unit) for name, unit in zip(knowledge.names, knowledge.units, strict=True)}
    factors = np.array([units.factor(unit) for unit in knowledge.units])
    rows, paths = [], []
    for profile in profiles:
        place = knowledge.names.index(profile.name)
        moved = np.ptp(profile.path / knowledge.sd, axis=0)
        followers = [int(k) for k in np.argsort(-moved) if k != place and moved[k] > 0.01][:PROFILES]
        for k, value in enumerate(profile.values / factors[place]):
            deviances = {"deviance_data": profile.data_deviance[k], "deviance_total": profile.deviance[k]}
            rows.append({"parameter": profile.name, "unit": named[profile.name], "value": value, **deviances})
            for other in followers:
                name, at = knowledge.names[other], profile.path[k, other] / factors[other]
                paths.append(
                    {
                        "parameter": profile.name,
                        "value": value,
                        "other": name,
                        "other_unit": named[name],
                        "other_value": at,
                    }
                )
    tables = {"profiles": pd.DataFrame(rows), "profile_paths": pd.DataFrame(paths)}
    return {name: table for name, table in tables.items() if len(table)}


# --- simulated calibrations --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated calibrations beside what was predicted of them: how many, how many converged, how many were redrawn."""

    n: int
    n_converged: int
    n_redrawn: int
    comparison: Comparison


type Case = tuple[Knowledge, Information, int]
"""What is known, what is predicted, and the stream of random numbers."""


def _list_cases(audit: Audit) -> dict[str, Case]:
    """Return simulated calibrations with everything free, and with what is recommended free and the rest nominal."""
    inputs, knowledge = audit.inputs, audit.inputs.knowledge
    if inputs.config.simulated_calibrations == 0:
        return {}
    free = np.array(audit.analysis.selection.free, dtype=int)
    cases = {"simulated_calibrations": np.arange(len(knowledge.names))}
    if 0 < len(free) < len(knowledge.names):
        cases["simulated_calibrations_recommended"] = free
    found = {}
    for k, (name, chosen) in enumerate(cases.items()):
        part = replace(knowledge, priors={knowledge.names[i]: knowledge.priors[knowledge.names[i]] for i in chosen})
        found[name] = part, Information(audit.analysis.information.root[:, chosen]), 5 + k
    return found


def _simulate(audit: Audit, run: Run) -> dict[str, Simulated]:
    return run.map("simulated calibrations", _simulate_case, audit.inputs, _list_cases(audit), (Simulated,))


def _simulate_case(inputs: AuditInputs, case: Case) -> Simulated:
    knowledge, information, stream = case
    n, rng = inputs.config.simulated_calibrations, np.random.default_rng([inputs.config.seed, stream])
    simulated = simulate_calibrations(knowledge, inputs.plan, n, rng)
    comparison = compare_with_prediction(simulated, information.covariance)
    return Simulated(n, int(simulated.converged.sum()), simulated.n_redrawn, comparison)


def _average(audit: Audit, run: Run) -> Array | None:
    """Return posterior sds in tolerances as root mean squares over machines of the tolerances, shape (n,)."""
    if audit.inputs.config.expected_over_draws == 0:
        return None
    return run.once("expected over machines", _average_machines, audit.inputs)


def _average_machines(inputs: AuditInputs) -> Array:
    n, rng = inputs.config.expected_over_draws, np.random.default_rng([inputs.config.seed, 7])
    return np.sqrt(np.diagonal(expected_covariance(inputs.knowledge, inputs.plan, n, rng)))


def _summarise_calibrations(audit: Audit, name: str, simulated: Simulated) -> dict[str, Any]:
    knowledge, units = _list_cases(audit)[name][0], audit.inputs.units
    found = simulated.comparison
    symbols = np.array(knowledge.symbols)
    ratios = found.by_symbol()
    result: dict[str, Any] = {}
    for symbol in dict.fromkeys(knowledge.symbols):
        part = np.flatnonzero(symbols == symbol)
        unit = knowledge.units[part[0]]
        scale = knowledge.sd[part] / units.factor(unit)
        result[symbol] = {
            "unit": units.name(unit),
            "predicted_sd": float(np.sqrt(np.mean((found.predicted[part] * scale) ** 2))),
            "simulated_sd": float(np.sqrt(np.mean((found.found[part] * scale) ** 2))),
            "ratio": ratios[symbol],
            "ratio_se": float(np.sqrt(np.mean(found.ratio_error[part] ** 2) / len(part))),
        }
    return {
        "n": simulated.n,
        "n_converged": simulated.n_converged,
        "n_redrawn": simulated.n_redrawn,
        "chi_square": found.chi_square,
        "chi_square_se": found.chi_square_error,
        "symbols": result,
    }
