"""Running an audit: all its levels, and its results put in place at the end, as a whole."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bayescal.config.load import dump_config
from bayescal.errors import InputError
from bayescal.experiments.audit.audit import Audit, run_audit
from bayescal.experiments.audit.changes import Planner
from bayescal.experiments.audit.inputs import read_inputs
from bayescal.experiments.audit.page.write import write_audit_report
from bayescal.experiments.audit.posterior import LeftOut, audit_posterior
from bayescal.experiments.audit.results import summarise, tabulate
from bayescal.experiments.audit.ridge_curves import plot_ridges, tabulate_plots
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.frame.store import Store
from bayescal.experiments.study.inputs import hash_identity
from bayescal.identifiability.calibration import (
    Comparison,
    SimulatedCalibrations,
    compare_with_prediction,
    expected_covariance,
    simulate_calibrations,
)
from bayescal.identifiability.information import Information
from bayescal.identifiability.profile import Profile, compute_profiles
from bayescal.numerics.geometry import Array

AUDIT_FILE = "audit.json"
PROFILES = 4  # where the design names none


@dataclass(frozen=True, eq=False)
class Results:
    """What an audit's directory holds.

    Attributes
    ----------
    summary : dict
        ``audit.json``.
    tables : dict of name to DataFrame
        ``tables/*.csv``.
    """

    summary: dict[str, Any]
    tables: dict[str, pd.DataFrame]


def compute_audit(config: AuditConfig, folder: Path, planner: Planner | None = None) -> Results:
    """Return everything an audit says.

    Parameters
    ----------
    config : AuditConfig
    folder : Path
        Where the design's file names start.
    planner : callable, optional
        Proposes a plan, such as `selection_study.for_audit.propose_i_optimal`, which is listed among the changes.
    """
    with threadpool_limits(1), np.errstate(all="ignore"):
        inputs = read_inputs(config, folder)
        audit = run_audit(inputs, planner)
        level = audit_posterior(inputs, audit)
        plots = plot_ridges(inputs, audit, level)
        profiles = compute_profiles(inputs.knowledge, inputs.plan, choose_profiles(audit))
        simulated = _simulate(audit)
        averaged = _average(audit)
    summary = summarise(audit)
    summary["config_sha256"] = hash_identity(dump_config(config))
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
        summary[name] = _summarise_calibrations(audit, *calibrations)
    tables = tabulate(summary, audit) | tabulate_plots(plots) | _tabulate_profiles(audit, profiles)
    return Results(summary, tables)


def write_audit(config: AuditConfig, folder: Path, out: Path, planner: Planner | None = None) -> dict[str, Any]:
    """Run an audit and write ``audit.json``, ``tables/*.csv`` and the report into ``out``, all of them or nothing.

    Raises
    ------
    InputError
        For a design at fault, or a directory that holds something else. Nothing is written then.
    """
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / AUDIT_FILE).is_file())):
        raise InputError(f"{out}: exists and holds no audit, expected a new directory or an audit's")
    results = compute_audit(config, folder, planner)
    store = Store(out)
    staged = store.stage()
    (staged / "tables").mkdir()
    for name, table in results.tables.items():
        table.to_csv(staged / "tables" / f"{name}.csv", index=False)
    (staged / AUDIT_FILE).write_text(json.dumps(results.summary, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_audit_report(staged)
    store.publish()
    return results.summary


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


def _simulate(audit: Audit) -> dict[str, tuple[SimulatedCalibrations, Comparison]]:
    """Return simulated calibrations with everything free, and with what is recommended free and the rest nominal."""
    inputs, found = audit.inputs, {}
    n, knowledge, plan = inputs.config.simulated_calibrations, inputs.knowledge, inputs.plan
    if n == 0:
        return {}
    free = np.array(audit.analysis.selection.free, dtype=int)
    cases = {"simulated_calibrations": np.arange(len(knowledge.names))}
    if 0 < len(free) < len(knowledge.names):
        cases["simulated_calibrations_recommended"] = free
    for k, (name, chosen) in enumerate(cases.items()):
        part = replace(knowledge, priors={knowledge.names[i]: knowledge.priors[knowledge.names[i]] for i in chosen})
        simulated = simulate_calibrations(part, plan, n, np.random.default_rng([inputs.config.seed, 5 + k]))
        predicted = Information(audit.analysis.information.root[:, chosen]).covariance
        found[name] = simulated, compare_with_prediction(simulated, predicted)
    return found


def _average(audit: Audit) -> Array | None:
    """Return posterior sds in tolerances as root mean squares over machines of the tolerances, shape (n,)."""
    inputs = audit.inputs
    n = inputs.config.expected_over_draws
    if n == 0:
        return None
    covariance = expected_covariance(inputs.knowledge, inputs.plan, n, np.random.default_rng([inputs.config.seed, 7]))
    return np.sqrt(np.diagonal(covariance))


def _summarise_calibrations(audit: Audit, simulated: SimulatedCalibrations, found: Comparison) -> dict[str, Any]:
    knowledge, units = simulated.knowledge, audit.inputs.units
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
        "n": len(simulated.converged),
        "n_converged": int(simulated.converged.sum()),
        "n_redrawn": simulated.n_redrawn,
        "chi_square": found.chi_square,
        "chi_square_se": found.chi_square_error,
        "symbols": result,
    }
