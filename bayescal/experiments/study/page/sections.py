"""The report's tables on variants: ranking, errors, evidence, sensitivity, diagnostics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.study.page.checks import is_too_narrow, measure_gain, measure_gap
from bayescal.experiments.study.page.results import Results
from bayescal.experiments.study.page.variants import (
    find_variants,
    group_variants,
    label_model,
    label_variant,
    list_deformations,
    list_models,
    name_variants,
    read_evidence,
    split_variant,
)
from bayescal.experiments.study.page.verdict import read_verification_elpd
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_TAIL_LIMIT, PARETO_K_LIMIT, RHAT_LIMIT
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    MILLIDEGREES,
    NOTHING,
    count_decimals,
    format_estimate,
    format_fixed,
    format_pair,
    format_percent,
    format_significant,
    format_span,
    join_words,
)

VARIANT = Column("Variant", kind="name")
USES = ("calibration", "verification")


def tabulate_ranking(results: Results, setting: str) -> Table:
    """Return the ranking of one setting of the model error, the largest evidence first."""
    names = sorted(results.ranking, key=lambda name: -results.fit(name, setting)["log_evidence"])
    best = results.fit(names[0], setting)["log_evidence"]
    uses = USES if results.n_verification else USES[:1]
    columns = [
        Column("Rank"),
        VARIANT,
        Column("Free"),
        Column("Log-evidence", "nat"),
        Column("Difference", "nat"),
        Column("LOO", "nat", "elpd"),
        Column("verification", "nat", "elpd"),
        *(Column(use, "µm", "Position error, mean / max") for use in uses),
        *(Column(use, "mdeg", "Orientation error, mean / max") for use in uses),
        Column("rms", "mm", "From nominal"),
        Column("rms", "prior sd", "From nominal"),
        Column("Checks", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for rank, name in enumerate(names, start=1):
        fit = results.fit(name, setting)
        rows.append(
            [
                str(rank),
                label_variant(name),
                str(fit["n_parameters"]),
                format_evidence(fit["log_evidence"], fit["log_evidence_se"]),
                format_fixed(fit["log_evidence"] - best, 1),
                _format_loo(fit),
                format_fixed(read_verification_elpd(fit), 1),
                *(_format_errors(fit[use], "position_error_mm", MICROMETRES) for use in uses),
                *(_format_errors(fit[use], "orientation_error_deg", MILLIDEGREES) for use in uses),
                format_significant(fit["distance_from_nominal"]["rms_mm"]),
                format_significant(fit["distance_from_nominal"]["rms_prior_sd"]),
                Cell("passed") if fit["converged"] else Cell("FAILED", "bad"),
            ]
        )
    title = {"free": "with model error τ", "zero": "without model error (τ = 0)"}[setting]
    notes = []
    if any(results.fit(name, setting)["elpd_loo_n_bad_k"] for name in names):
        notes.append(
            Statement(
                f"(n) n poses with Pareto k above {PARETO_K_LIMIT}: there elpd LOO is not to be trusted.", "warning"
            )
        )
    if setting == "free":
        notes += _state_names(results)
    return make_table(f"Ranking {title}.", columns, rows, notes)


def _state_names(results: Results) -> list[Statement]:
    """Say how models are called in config and results, where the report writes them otherwise."""
    other = [f"{label_model(model)} is {model}" for model in list_models(results) if label_model(model) != model]
    if not other:
        return []
    example = next(name for name in results.ranking if label_variant(name) != name)
    return [Statement(f"In config and results {join_words(other)}: {label_variant(example)} is {example}.")]


def tabulate_effects(results: Results) -> Table | None:
    """Return the log-evidence by model and deformation, and what either is worth with the other kept; None for one."""
    models, deformations = list_models(results), list_deformations(results)
    if len(models) < 2 or len(deformations) < 2:
        return None
    letters = {
        name: chr(ord("A") + k) if k < 26 else str(k)
        for k, group in enumerate(group_variants(results, results.ranking))
        for name in group
    }
    best = split_variant(results.ranking[0])[1]
    columns = [
        Column("Model", kind="text"),
        *(Column(d, "nat", "Below the best variant") for d in deformations),
        *(Column(f"{best} − {d}", "nat", "What the deformation adds") for d in deformations if d != best),
        *(Column(d, "nat", f"Against {label_model(models[0])}, same deformation") for d in deformations),
    ]
    top = read_evidence(results, results.ranking[0])
    rows = []
    for model in models:
        own = {d: name for d in deformations for name in find_variants(results, model, d)}
        value = {d: read_evidence(results, name) for d, name in own.items()}
        other = {d: read_evidence(results, n) for d in deformations for n in find_variants(results, models[0], d)}
        row = [label_model(model)]
        row += [f"{format_fixed(value[d] - top, 1)} {letters[own[d]]}" if d in own else NOTHING for d in deformations]
        row += [_format_difference(value, best, value, d) for d in deformations if d != best]
        row += [_format_difference(value, d, other, d) if model != models[0] else NOTHING for d in deformations]
        rows.append(row)
    note = (
        "Variants of one letter are not told apart: within 1 nat, or within twice the error of the estimates, of the "
        "best of their letter."
    )
    return make_table("Log-evidence by model and deformation, with model error.", columns, rows, [Statement(note)])


def _format_difference(value: dict[str, float], one: str, reference: dict[str, float], other: str) -> str:
    there = one in value and other in reference
    return format_fixed(value[one] - reference[other], 1, sign=True) if there else NOTHING


def format_evidence(value: float, se: float) -> str:
    """Return a log-evidence with its standard error, two to three decimals."""
    return format_estimate(value, se, min(3, max(2, count_decimals(se, 1))))


def _format_loo(fit: dict[str, Any]) -> Cell:
    text = format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1)
    bad = int(fit["elpd_loo_n_bad_k"])
    return Cell(f"{text} ({bad})", "warning") if bad else Cell(text)


def _format_errors(errors: dict[str, Any] | None, key: str, factor: float) -> str:
    return NOTHING if errors is None else format_pair(factor * errors[key]["mean"], factor * errors[key]["max"], 2)


def tabulate_coverage(results: Results) -> Table:
    """Return how often intervals and bounds hold the measurements, for every posterior."""
    uses = USES if results.n_verification else USES[:1]
    kinds = ("90 % intervals, all components", "95 % bound, position", "95 % bound, orientation")
    columns = [VARIANT, Column("Model error", kind="text"), *(Column(use, "%", kind) for kind in kinds for use in uses)]
    rows = []
    for name, setting, fit in results.fits():
        chosen = results.predictions["variant"].eq(name) & results.predictions["model_error"].eq(setting)
        frame = results.predictions[chosen]
        cells: list[str | Cell] = [label_variant(name), "free" if setting == "free" else "τ = 0"]
        for use in uses:
            share, n = fit[use]["interval_90_coverage"], results.summary["n_poses"][use]
            cells.append(Cell(format_percent(share).rstrip(" %"), "warning" if is_too_narrow(share, n) else "plain"))
        for kind, unit in (("position", "mm"), ("orientation", "deg")):
            for use in uses:
                poses = frame[frame["use"] == use]
                inside = poses[f"{kind}_error_{unit}"] <= poses[f"{kind}_bound_95_{unit}"]
                cells.append(format_percent(float(inside.mean())).rstrip(" %") if len(poses) else NOTHING)
        rows.append(cells)
    note = "Marked where the coverage lies two standard errors or more below 90 %, a pose counted as one trial."
    caption = "Share of the measurements inside their predictive intervals and bounds; nominal 90 % and 95 %."
    return make_table(caption, columns, rows, [Statement(note)])


def tabulate_evidence(results: Results) -> Table:
    """Return both estimators of the log-evidence side by side."""
    columns = [
        VARIANT,
        Column("Model error", kind="text"),
        Column("importance", "nat", "Log-evidence by"),
        Column("bridge", "nat", "Log-evidence by"),
        Column("Difference", f"nat, limit {AGREEMENT}"),
        Column("draws", "", "Importance sampling"),
        Column("efficiency", "%", "Importance sampling"),
        Column("Pareto k", f"limit {PARETO_K_LIMIT}", "Importance sampling"),
        Column("Reported", kind="text"),
    ]
    rows = []
    for name, setting, fit in results.fits():
        methods, errors, quality = fit["log_evidence_methods"], fit["log_evidence_method_se"], fit["importance"]
        rows.append(
            [
                label_variant(name),
                "free" if setting == "free" else "τ = 0",
                format_evidence(methods["importance"], errors["importance"]),
                format_evidence(methods["bridge"], errors["bridge"]),
                Cell(f"{measure_gap(fit):.3f}", "plain" if fit["log_evidence_agrees"] else "bad"),
                f"{int(quality['n_draws']):,}",
                format_fixed(100 * quality["efficiency"], 0),
                _limited(quality["pareto_k"], quality["pareto_k"] <= PARETO_K_LIMIT, 2),
                fit["log_evidence_primary"],
            ]
        )
    return make_table("The log-evidence of every posterior by two independent estimators.", columns, rows)


def _limited(value: float, fine: bool, decimals: int) -> Cell:
    return Cell(format_fixed(value, decimals), "plain" if fine else "bad")


def tabulate_sensitivity(results: Results) -> Table:
    """Return the log-evidence and rank of every variant at every tolerance."""
    wide = results.sensitivity_grid
    ranks = wide.rank(axis=1, ascending=False, method="min")
    columns = [VARIANT, *(Column(f"{t:g} mm", "nat (rank)", "Tolerance of the lengths, prior sd") for t in wide.index)]
    doubtful = results.sensitivity.pivot(index="tolerance_mm", columns="variant", values="pareto_k") > PARETO_K_LIMIT
    rows: list[list[str | Cell]] = []
    for name in results.ranking:
        texts = [f"{format_fixed(x, 1)} ({rank:.0f})" for x, rank in zip(wide[name], ranks[name], strict=True)]
        marks = doubtful.sort_index()[name]
        rows.append(
            [
                label_variant(name),
                *(Cell(t, "warning" if bad else "plain") for t, bad in zip(texts, marks, strict=True)),
            ]
        )
    note = Statement(f"Marked where Pareto k exceeds {PARETO_K_LIMIT}.", "warning")
    notes = [note] if doubtful.to_numpy().any() else []
    return make_table("Log-evidence with model error for other tolerances of the lengths.", columns, rows, notes)


def tabulate_diagnostics(results: Results) -> Table:
    """Return convergence of every posterior."""
    columns = [
        VARIANT,
        Column("Model error", kind="text"),
        Column("R-hat", f"limit {RHAT_LIMIT}"),
        Column("bulk", f"limit {ESS_BULK_LIMIT:.0f}", "Smallest ESS"),
        Column("tail", f"limit {ESS_TAIL_LIMIT:.0f}", "Smallest ESS"),
        Column("Acceptance", "%"),
        Column("Largest LOO", "Pareto k"),
        Column("Time", "s"),
        Column("Status", kind="text"),
    ]
    rows = []
    for name, setting, fit in results.fits():
        problems = "; ".join(str(p) for p in fit["problems"]) or "not converged"
        k = fit["elpd_loo_pareto_k_max"]
        rows.append(
            [
                label_variant(name),
                "free" if setting == "free" else "τ = 0",
                _limited(fit["rhat_max"], fit["rhat_max"] < RHAT_LIMIT, 4),
                _limited(fit["ess_bulk_min"], fit["ess_bulk_min"] > ESS_BULK_LIMIT, 0),
                _limited(fit["ess_tail_min"], fit["ess_tail_min"] > ESS_TAIL_LIMIT, 0),
                format_fixed(100 * fit["acceptance"], 0),
                Cell(format_fixed(k, 2), "plain" if k <= PARETO_K_LIMIT else "warning"),
                format_fixed(fit["wall_seconds"], 1),
                Cell("converged") if fit["converged"] else Cell(problems, "bad"),
            ]
        )
    caption = "Convergence of every posterior; R-hat is rank-normalised, a chain is one ensemble of walkers."
    return make_table(caption, columns, rows)


def tabulate_model_error(results: Results) -> tuple[Table | None, list[Statement]]:
    """Return τ of each leg with its 90 % interval and what it adds to the evidence, and a sentence per group."""
    frame = results.parameters
    rows_free = frame[(frame["model_error"] == "free") & (frame["symbol"] == "tau")]
    if rows_free.empty:
        return None, []
    legs = sorted(set(rows_free["leg"]))
    columns = [VARIANT, *(Column(f"leg {leg}" if leg else "all legs", "µm", "τ, mean [5 %, 95 %]") for leg in legs)]
    columns.append(Column("Worth of τ", "nat"))
    rows = []
    for name in results.ranking:
        values = MICROMETRES * rows_free[rows_free["variant"] == name].set_index("leg")[["mean", "q05", "q95"]]
        cells = [_format_interval(values, leg) if leg in values.index else NOTHING for leg in legs]
        rows.append([label_variant(name), *cells, format_fixed(measure_gain(results, name), 1, sign=True)])
    note = "Worth of τ: log-evidence with model error less that without; negative where the model suffices."
    groups = group_variants(results, results.ranking)
    return (
        make_table("Model error of each leg.", columns, rows, [Statement(note)]),
        [_state_group(results, rows_free, group) for group in groups],
    )


def _format_interval(values: pd.DataFrame, leg: int) -> str:
    """Return ``mean [low, high]`` with the decimals that the narrowest interval of the table asks for."""
    places = min(3, count_decimals(float((values["q95"] - values["q05"]).min())))
    row = values.loc[[leg], ["mean", "q05", "q95"]].to_numpy(dtype=float)[0]
    mean, low, high = (format_fixed(x, places) for x in row)
    return f"{mean} [{low}, {high}]"


def _state_group(results: Results, rows: pd.DataFrame, names: list[str]) -> Statement:
    """Say how large τ is in variants that are alike, and whether the measurements call for it."""
    values = MICROMETRES * rows[rows["variant"].isin(names)]["mean"]
    span = " to ".join(dict.fromkeys(format_significant(float(x), 2) for x in (values.min(), values.max())))
    gains = [measure_gain(results, name) for name in names]
    call = "call for it" if min(gains) > 0 else "do not call for it" if max(gains) <= 0 else "call for it in some"
    level = "higher" if min(gains) > 0 else "lower" if max(gains) <= 0 else "higher or lower"
    worth = format_span([abs(x) for x in gains])
    return Statement(
        f"{name_variants(names)}: τ is {span} µm; the measurements {call} (log-evidence {worth} nat {level} than with "
        "τ = 0)."
    )


def read_prior_scale(results: Results) -> float | None:
    """Return the scale of the model error's prior, µm, if the provenance states it."""
    config = results.provenance.get("config")
    section = config.get("model_error") if isinstance(config, dict) else None
    scale = section.get("scale_um") if isinstance(section, dict) else None
    return float(scale) if isinstance(scale, int | float) and math.isfinite(scale) else None


def tabulate_deformation(results: Results) -> tuple[list[Table], list[Statement]]:
    """Return κ and K from the targets on the platform, and how well each describes the measured deflections."""
    if results.deformation is None or results.ring is None:
        return [], []
    frame = results.deformation
    kappa = frame[frame["quantity"] == "kappa"].set_index("leg")
    matrix = frame[frame["quantity"] == "K"]
    legs = [int(leg) for leg in kappa.index]
    tables = [
        make_table(
            "Coefficient κ of each leg in the linear description Δb_z = κ Δρ (RR-8096 eq. 1), mean ± sd.",
            [Column("", kind="symbol"), *(Column(f"leg {leg}", "10⁻³") for leg in legs)],
            [["kappa", *map(format_estimate, kappa["mean_1e-3"], kappa["sd_1e-3"])]],
        )
    ]
    if len(matrix):
        mean, sd = (matrix.pivot(index="leg", columns="actuator", values=v) for v in ("mean_1e-3", "sd_1e-3"))
        tables.append(
            make_table(
                "Matrix K in Δb_z = K Δρ (RR-8096 eqs. 2 to 4), mean ± sd; row: joint that moves, column: actuator.",
                [Column("Joint", kind="text"), *(Column(f"actuator {j}", "10⁻³") for j in mean.columns)],
                [[f"leg {i}", *map(format_estimate, mean.loc[i], sd.loc[i])] for i in mean.index],
            )
        )
    return tables, _state_residuals(results, kappa["mean_1e-3"].to_numpy(), mean.to_numpy() if len(matrix) else None)


def _state_residuals(results: Results, kappa: np.ndarray, matrix: np.ndarray | None) -> list[Statement]:
    assert results.ring is not None
    statements = []
    for use, rows in results.ring.groupby("use", sort=True):
        travel = rows.pivot(index="pose", columns="leg", values="actuator_displacement_mm").to_numpy()
        measured = rows.pivot(index="pose", columns="leg", values="deflection_um").to_numpy()
        left = {"linear": measured - kappa * travel}
        if matrix is not None:
            left["matrix"] = measured - travel @ matrix.T
        described = "; ".join(
            f"the {name} description leaves {format_significant(float(np.mean(np.abs(r))), 2)} µm mean and "
            f"{format_significant(float(np.max(np.abs(r))), 2)} µm at most"
            for name, r in left.items()
        )
        noise = format_significant(float(rows["deflection_sd_um"].mean()), 2)
        reach = format_significant(float(np.max(np.abs(measured))), 2)
        statements.append(
            Statement(
                f"On the {use} poses the joints move by up to {reach} µm out of the rigid platform; {described}, at a "
                f"measuring uncertainty of {noise} µm (sd)."
            )
        )
    return statements
