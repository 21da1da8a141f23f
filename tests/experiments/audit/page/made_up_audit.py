"""Tiny audits with made-up numbers: three symbols on two legs and a parameter of the machine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.results import tabulate_help
from bayescal.experiments.audit.rows import (
    AuditParameterRow,
    AuditRequirementRow,
    AuditScenarioRow,
    AuditVariantRow,
    FreeingStepRow,
)
from bayescal.experiments.runner.results import Results, write_results

NAMES = ("a_z[1]", "a_z[2]", "l[1]", "l[2]", "rho0[1]", "rho0[2]", "k1_d")
CONTRACTION = {"a_z": 0.9, "l": 0.4, "rho0": 0.02, "k1_d": 0.0}
VERDICTS = {"a_z": "identifiable", "l": "weak", "rho0": "not", "k1_d": "not"}
RIDGES = (("structural", "k1_d"), ("structural", "rho0[1]"), ("structural", "rho0[2]"), ("practical", "l[1]"))
CHANGES = {"twice the poses": (30.0, False), "better camera": (45.0, False), "longer strokes": (60.0, True)}
OPTIONAL = ("sweeps", "sweep_requirements", "profiles", "profile_paths", "ridge_draws", "ridge_curves")


def describe_audit() -> dict[str, Any]:
    """Return a made-up summary in which everything is well."""
    return {
        "name": "made_up",
        "best": "all",
        "variants": {"all": describe_variant()},
        "title": "Made up for a test",
        "machine": "made-up machine",
        "model": "six_pus",
        "deformation": "none",
        "units": {"length": "mm", "angle": "deg"},
        "plan": {"n_poses": 40, "sensors": ["camera"], "poses": "random ones of the workspace"},
        "n_parameters": len(NAMES),
        "structural_rank": 4,
        "structural_gap": 1e9,
        "structural_rank_is_clear": True,
        "n_structural": 3,
        "n_practical": 1,
        "n_informed": 3,
        "total_nats": 20.0,
        "parameters": {name: describe_parameter(name) for name in NAMES},
        "directions": [
            *(describe_ridge(kind, pivot) for kind, pivot in RIDGES),
            *({"kind": "informed", "contraction": 0.9} for _ in range(3)),
        ],
        "reduced_set": {"free": ["a_z[1]", "a_z[2]", "l[1]", "l[2]"], "coverage_90": 0.18, "rms_z": 86.0},
        "also_identifiable": ["rho0[2]"],
        "selection": [
            {"symbol": "a_z", "nats": 3.0, "contraction": 0.95, "is_included": True},
            {"symbol": "l", "nats": 2.0, "contraction": 0.8, "is_included": True},
            {"symbol": "rho0", "nats": 0.1, "contraction": 0.2, "is_included": False},
        ],
        "requirements": {"x": describe_requirement(0.004, 1.0), "rx": describe_requirement(0.001, 0.999)},
        "scenarios": [
            *(describe_change(name, nats, beyond) for name, (nats, beyond) in CHANGES.items()),
            describe_change("out of reach", 1.0, True)
            | {"is_feasible": False, "total_nats": None, "n_identifiable": None, "ridges": {"l[1]": None}}
            | {"requirements": {}},
        ],
    }


def describe_variant() -> dict[str, Any]:
    numbers = {"n_equations": 240, "n_parameters": len(NAMES), "n_poses": 40, "n_identifiable": 2}
    return {
        "title": "all",
        "data_set": "camera",
        "error_ratio": 0.1,
        "sd_over_limit": 0.04,
        "probability": 0.998,
        **numbers,
    }


def describe_parameter(name: str) -> dict[str, Any]:
    symbol = name.partition("[")[0]
    contraction = CONTRACTION[symbol]
    free = symbol in ("a_z", "l")
    return {
        "unit": "N mm2" if symbol == "k1_d" else "mm",
        "nominal": 100.0,
        "prior_sd": 2.0,
        "posterior_sd": 2.0 * (1.0 - contraction) ** 0.5,
        "contraction": contraction,
        "nats": 0.5,
        "verdict": VERDICTS[symbol],
        "reduced_set": free,
        "reduced_claimed_sd": 0.02 if free else np.nan,
        "reduced_true_error": 1.3 if free else np.nan,
        "reduced_coverage_90": 0.02 if free else np.nan,
        "reason": "Its tolerance shrinks to 5 %."
        if symbol == "a_z"
        else "The planned measurements hardly tell it from l[1].",
    }


def describe_ridge(kind: str, pivot: str) -> dict[str, Any]:
    leg = pivot.partition("[")[2].rstrip("]")
    start = f"Leg {leg}: changing" if leg else "Changing"
    return {
        "kind": kind,
        "contraction": 0.05 if kind == "practical" else 0.0,
        "sentence": f"{start} {pivot.partition('[')[0]} by +1 mm changes nothing.",
        "pivot": pivot,
        "changes_workspace_position": 2e-5,
        "changes_workspace_rotation": 2e-6,
        "effect_on_pose": "harmless",
        "sd_over_limit": 0.004,
        "limit": "x",
    }


def describe_requirement(predicted_sd: float, probability: float) -> dict[str, Any]:
    return {
        "unit": "mm",
        "limit": 0.1,
        "prior_sd": 3.0,
        "predicted_sd": predicted_sd,
        "parameter_sd": 0.8 * predicted_sd,
        "prior_probability": 0.02,
        "probability": probability,
        "reduced_sd": 1.1 * predicted_sd,
        "reduced_probability": 0.98 * probability,
        **{"rms_sd": 0.9 * predicted_sd, "max_sd": predicted_sd, "p_all_poses": probability, "max_sd_pose": "x = 0 mm"},
    }


def describe_change(name: str, nats: float, beyond: bool) -> dict[str, Any]:
    return {
        "name": name,
        "n_poses": 40,
        "is_feasible": True,
        "is_beyond_range": beyond,
        "total_nats": nats,
        "n_identifiable": 4,
        "ridges": {"l[1]": nats / 100.0},
        "requirements": {"x": 0.004 * 20.0 / nats, "rx": 0.001},
    }


def add_checks(summary: dict[str, Any]) -> None:
    """Add draws of a posterior, plots of ridges and simulated calibrations, all made up."""
    values = {name: {"mean": 100.0, "sd": 1.0, "contraction": 0.5} for name in NAMES}
    summary["posterior"] = {
        "origin": "simulated at the expected machine",
        "n_draws": 4000,
        "converged": True,
        "principal_angle_deg": 2.5,
        "parameters": values,
        "requirements": {"x": {"probability": 0.99}},
    }
    one = {"claimed_sd": 0.101, "predicted_sd": 0.1, "simulated_sd": 0.102, "ratio": 1.02, "ratio_se": 0.03}
    one |= {"unit": "mm", "coverage_90": 0.89}
    kept = {"claimed_probability": 0.999, "kept": 200, "n": 200, "expected_low": 198, "expected_high": 200}
    summary["simulated_calibrations"] = {
        **{"n": 200, "n_converged": 200, "coverage_90": 0.893, "rms_z": 1.01},
        "symbols": {"a_z": one, "l": dict(one)},
        "requirements": {"x": kept | {"agrees": True}},
    }
    for k in (1, 2, 3):
        plot = {"x": "rho0[1]", "y": "a_z[1]", "x_unit": "mm", "y_unit": "mm", "formula": "a_z + rho0 = const. (eq. 5)"}
        summary["directions"][k] |= {"plot": plot, "posterior_contraction": 0.01}


def tabulate_rows(summary: dict[str, Any]) -> dict[str, pd.DataFrame]:
    """Return the tables of what a summary says of variants, parameters, requirements, and the reduced set."""
    rows = {
        row.table: row.collect(
            row(**(values | ({} if key == "variant" else {"variant": "all"}) | {key: name}))
            for name, values in summary[f"{key}s"].items()
        )
        for key, row in (
            ("variant", AuditVariantRow),
            ("parameter", AuditParameterRow),
            ("requirement", AuditRequirementRow),
        )
    }
    scenarios = [
        AuditScenarioRow(scenario=one["name"], ridge=name, contraction=np.nan if value is None else value)
        for one in summary["scenarios"]
        for name, value in one["ridges"].items()
    ]
    rows |= {"scenarios": AuditScenarioRow.collect(scenarios)} | tabulate_help(summary)
    return rows | {"selection": FreeingStepRow.collect(FreeingStepRow(**one) for one in summary["selection"])}


def make_tables(checks: bool) -> dict[str, pd.DataFrame]:
    """Return made-up tables; profiles, draws and curves only where the checks are wanted."""
    tables = {
        "spectrum": pd.DataFrame(
            {
                "number": range(1, 8),
                "wide_workspace": [1e3, 5e2, 2e2, 5e1, 1e-12, 0.0, 0.0],
                "planned": [1e2, 5e1, 2e1, 0.5, 0.2, 0.0, 0.0],
                "noise_floor": 1e-11,
                "is_in_rank": [True] * 4 + [False] * 3,
            }
        ),
        "sweeps": pd.DataFrame(
            [
                {"sweep": sweep, "value": value, "is_beyond_range": value > 1, "symbol": symbol}
                | {"contraction_min": contraction, "contraction_max": contraction}
                for sweep, values in (
                    ("noise", (0.1, 1.0, 10.0)),
                    ("poses", (6.0, 40.0)),
                    ("workspace", (0.5, 1.0, 2.0)),
                )
                for value in values
                for symbol, contraction in CONTRACTION.items()
            ]
        ),
        "sweep_requirements": pd.DataFrame(
            [
                {"sweep": sweep, "value": value, "requirement": name, "unit": "mm", "predicted_sd": 0.004, "limit": 0.1}
                for sweep in ("noise", "poses", "workspace")
                for value in (0.5, 2.0)
                for name in ("x", "rx")
            ]
        ),
    }
    return {**tables, **(_make_checks() if checks else {})}


def _make_checks() -> dict[str, pd.DataFrame]:
    value = np.linspace(90.0, 110.0, 21)
    offset = value - 100.0
    closed, flat = offset**2, 1e-3 * offset**2
    profiles = [
        pd.DataFrame({"parameter": name, "unit": "mm", "value": value, "deviance_data": data}).assign(
            deviance_total=data + closed / 4
        )
        for name, data in (("a_z[1]", closed), ("rho0[1]", flat))
    ]
    path = {"parameter": "rho0[1]", "value": value, "other": "a_z[1]", "other_unit": "mm", "other_value": 200.0 - value}
    rng = np.random.default_rng(1)
    draws, curves = [], []
    for direction in (2, 3, 4):
        x = rng.normal(100.0, 2.0, 300)
        cloud = {"direction": direction, "source": "posterior", "x": x, "y": 200.0 - x + rng.normal(0, 0.1, 300)}
        prior = {"direction": direction, "source": "prior", "x": x, "y": rng.normal(100.0, 2.0, 300)}
        draws += [pd.DataFrame(cloud), pd.DataFrame(prior)]
        for source in ("tangent", "profile"):
            curves.append(pd.DataFrame({"direction": direction, "source": source, "x": value, "y": 200.0 - value}))
    return {
        "profiles": pd.concat(profiles),
        "profile_paths": pd.DataFrame(path),
        "ridge_draws": pd.concat(draws),
        "ridge_curves": pd.concat(curves),
    }


def make_audit_results(change: Callable[[dict[str, Any]], None] | None = None, checks: bool = False) -> Results:
    """Return a made-up audit's results."""
    summary = describe_audit()
    if checks:
        add_checks(summary)
    if change is not None:
        change(summary)
    provenance = {"kind": "audit", "name": "made_up", "seed": 1, "config_sha256": "0" * 64, "config": {}}
    return Results(summary, make_tables(checks) | tabulate_rows(summary), provenance=provenance)


def write_audit_results(
    folder: Path, change: Callable[[dict[str, Any]], None] | None = None, checks: bool = False, name: str = "audit"
) -> Path:
    """Write a made-up audit's directory and return it."""
    out = folder / name
    out.mkdir()
    write_results(make_audit_results(change, checks), out, tables_in="tables", digits=0)
    return out
