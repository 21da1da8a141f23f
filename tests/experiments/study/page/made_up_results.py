"""Tiny results directories with made-up numbers: two or twelve variants, two legs, six poses."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from html_reader import leave_out_script

from bayescal.experiments.runner import results as frame
from bayescal.experiments.study.page.build import build_page
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.rows import ROWS
from bayescal.report.blocks import Page
from bayescal.report.page import render_page, show_provenance, write_page
from bayescal.report.pictures import Picture

TWO = {"pus/none": (100.0, 2.0), "pus/linear": (120.0, 1.0)}  # log-evidence and how far the parameters moved
TWELVE = {
    f"{model}/{deformation}": (level - below, shift)
    for model, below in (("six_pus", 0.1), ("jacobian", 150.0), ("beam", 0.4), ("stiffness", 0.0))
    for deformation, level, shift in (("none", 1200.0, 3.0), ("linear", 1210.0, 2.0), ("matrix", 1500.0, 1.0))
}
LETTERS = {"six_pus": "a", "jacobian": "b", "beam": "c", "stiffness": "d"}
TABLES = {"none": 5, "linear": 6, "matrix": 7}
TITLES = {"six_pus": "6-PUS", "six_ups": "6-UPS", "jacobian": "Jacobian"}
PUBLICATION = {
    "source": "Gough 1956",
    "citation": "V. E. Gough, Contribution to discussion of papers on research in automobile stability, 1956.",
    "figures": {
        **{"errors_all": "figures 15 to 17", "errors_none": "figure 15", "errors_linear": "figure 16"},
        **{"errors_matrix": "figure 17", "hardpoints": "figure 18", "deflections": "figure 7", "flexure": "figure 9"},
    },
    "notation": {"a": "section 2.2", "rho0": "eq. 9", "kappa": "eq. 1", "K": "eqs. 2 to 4"},
}
SYMBOLS = ("a_x", "a_y", "b_x", "b_y", "l", "kappa")
LEGS = (1, 2)
USES = {"calibration": 4, "verification": 2}
FACTORS = (0.5, 2.0)


def tabulate_parameters(variants: dict[str, tuple[float, float]]) -> pd.DataFrame:
    """Return posteriors; of a_x the prior decides, prior and data are in conflict over b_x of leg 2."""
    rows = []
    odd = {"a_x[1]": (0.2, 0.01), "a_x[2]": (0.3, 0.02), "b_x[2]": (0.1, 0.2)}
    for variant, (_, shift) in variants.items():
        for name, values in describe_parameters(shift).items():
            prior, likelihood = odd.get(name, (0.01, 0.1))
            own = {"variant": variant, "parameter": name, **values}
            rows.append({**own, "prior_sensitivity": prior, "likelihood_sensitivity": likelihood})
    return pd.DataFrame(rows)


def describe_parameters(shift: float) -> dict:
    parameters = {}
    for k, symbol in enumerate(SYMBOLS):
        for leg in LEGS:
            length = symbol != "kappa"
            nominal, sd = (100.0 * leg - 10 * k, 0.1) if length else (0.01, 0.001)
            mean = nominal + (shift * leg if length else 0.002)
            prior_sd, unit = (2.0, "mm") if length else (0.01, "1")
            parameters[f"{symbol}[{leg}]"] = describe(nominal, mean, sd, prior_sd, unit)
    tau = describe(0.0, 0.004, 0.001, 0.006, "mm") | {"verdict": "noise"}
    return parameters | {f"tau[{leg}]": tau for leg in LEGS}


def describe(nominal: float, mean: float, sd: float, prior_sd: float, unit: str) -> dict:
    interval = {"q05": mean - 1.6 * sd, "q95": mean + 1.6 * sd}
    known = {"contraction": 1.0 - (sd / prior_sd) ** 2, "verdict": "identifiable", "rhat": 1.0}
    return {"nominal": nominal, "unit": unit, "mean": mean, "sd": sd, **interval, "prior_sd": prior_sd, **known}


def describe_fit(title: str, log_evidence: float, shift: float, uses: dict[str, int]) -> dict:
    errors = {
        "position_error_mm": {"mean": 0.004 * shift, "max": 0.009 * shift},
        "orientation_error_deg": {"mean": 0.001, "max": 0.002},
        "interval_90_coverage": 0.9,
        "bound_95_coverage": 1.0,
    }
    evidence = {"log_evidence": log_evidence, "log_evidence_importance": log_evidence}
    return {
        "title": title,
        "data_set": "4 poses",
        **{"has_outliers": False, "n_poses": 4, "n_equations": 200, "n_parameters": 14},
        **evidence,
        "log_evidence_bridge": log_evidence + 0.02,
        **{f"{name}_se": 0.01 for name in (*evidence, "log_evidence_bridge")},
        "log_evidence_by": "importance",
        **{"efficiency": 0.4, "pareto_k": 0.3, "acceptance": 0.4, "wall_seconds": 10.0},
        **{"elpd": log_evidence / 5 if "verification" in uses else None, "elpd_loo": log_evidence + 50},
        **{"elpd_loo_se": 5.0, "elpd_loo_difference": 0.0, "elpd_loo_difference_se": 4.0, "stacking_weight": 0.5},
        **{"loo_pareto_k_max": 0.5, "n_loo_refitted": 0, "n_loo_bad_k": 0},
        **{"converged": True, "problems": "", "rhat_max": 1.001, "ess_bulk_min": 4000.0, "ess_tail_min": 3000.0},
        **{use: errors if use in uses else None for use in USES},
        **{"distance_from_nominal_mm": shift, "distance_from_nominal_prior_sd": shift / 2, "reduced_chi": 1.01},
        **{"misfit_chi2": 205.0, "misfit_dof": 200.0, "prior_chi2": 11.0, "prior_dof": 10.0},
    }


def describe_summary(uses: dict[str, int], variants_of: dict[str, tuple[float, float]]) -> dict:
    variants = {}
    for name, (log_evidence, shift) in variants_of.items():
        model, _, deformation = name.rpartition("/")
        title = f"{TITLES.get(model, model)}/{deformation}"
        variants[name] = describe_fit(title, log_evidence, shift, uses)
    return {
        "experiment": "tiny",
        "title": "A tiny study",
        "machine": "tiny.toml",
        "origin": {"status": "simulated", "text": "made up for a test", "source": "", "licence": ""},
        "units": {"length": "mm", "angle": "deg"},
        "converged": True,
        "models": {model: title for model, title in TITLES.items() if any(n.startswith(f"{model}/") for n in variants)},
        "n_poses": {"calibration": uses["calibration"], "verification": uses.get("verification", 0)},
        "pose_extraction": {"method": "robust", "chi2_per_dof": 1.02, "rejected_targets": []},
        "variants": variants,
        "rankings": [sorted(variants, key=lambda name: -variants_of[name][0])],
    }


def tabulate_poses(variants: dict[str, dict]) -> pd.DataFrame:
    """Return elpd by pose: of the k-th variant k nat to and fro, so that LOO of two differs by ± 2 nat times that."""
    rows, n = [], USES["calibration"]
    for number, (variant, fit) in enumerate(variants.items()):
        for k in range(n):
            left_out = {"elpd_loo": fit["elpd_loo"] / n + number * (-1) ** k, "pareto_k": 0.3, "loo_refitted": False}
            residual = {"n_dof": 6, "chi2": 5.0 + k, "robust_weight": 1.0, "is_outlier": False}
            rows.append({"variant": variant, "pose": f"C{k}", **left_out, **residual})
    return pd.DataFrame(rows)


def tabulate_accuracy(variants: dict[str, tuple[float, float]]) -> pd.DataFrame:
    """Return a tool of x alone, which before the calibration was a hundred times as uncertain."""
    return pd.DataFrame(
        {
            "variant": variant,
            "coordinate": "x",
            "unit": "mm",
            "prior_sd": 1.3,
            "posterior_sd": 0.013,
            "noise": 0.002,
            "max_sd": 0.021,
            "max_sd_pose": "x = 7 mm",
            "frame": "base",
            "unaligned_sd": 0.013,
            "max_unaligned_sd": 0.021,
        }
        for variant in variants
    )


def tabulate_model_error(variants: dict[str, tuple[float, float]]) -> pd.DataFrame:
    """Return random errors that the data show."""
    size = {"unit": "um", "median": 4.0, "q05": 3.0, "q95": 5.0}
    return pd.DataFrame({"variant": variant, "term": "random", **size} for variant in variants)


def tabulate_pose_errors(uses: dict[str, int], variants: dict[str, tuple[float, float]]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "variant": variant,
            "pose": f"{use[0].upper()}{k}",
            "use": use,
            "position_error_mm": 0.004 + 0.001 * k,
            "position_bound_95_mm": 0.0065,
            "orientation_error_deg": 0.001,
            "orientation_bound_95_deg": 0.002,
        }
        for variant in variants
        for use, n in uses.items()
        for k in range(n)
    )


def tabulate_least_squares(variants: dict[str, tuple[float, float]], published: bool) -> pd.DataFrame:
    """Least squares differ from the published values by 0.3 mm in leg 1 and 0.4 mm in leg 2, by 7 in kappa.

    Of two variants only the second has published values.
    """
    rows = []
    for variant in variants:
        known = published and (len(variants) > 2 or variant == "pus/linear")
        for symbol in SYMBOLS:
            for leg in LEGS:
                difference = 7.0 if symbol == "kappa" else {1: 0.3, 2: 0.4}[leg]
                rows.append(
                    {
                        "variant": variant,
                        "parameter": symbol,
                        "leg": leg,
                        "unit": "1" if symbol == "kappa" else "mm",
                        "nominal": 0.0,
                        "offset": 1.0 * leg,
                        "published_offset": 1.0 * leg - difference if known else np.nan,
                        "difference": difference if known else np.nan,
                        "leg_residual_rms_um": 1.5,
                        "converged": True,
                    }
                )
    return pd.DataFrame(rows)


def tabulate_sensitivity(summary: dict) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "variant": variant,
            "factor": factor,
            "log_evidence": fit["log_evidence"] - factor,
            "log_evidence_se": 0.01,
            "efficiency": 0.4,
            "pareto_k": 0.3,
        }
        for factor in FACTORS
        for variant, fit in summary["variants"].items()
    )


def tabulate_deflections() -> tuple[pd.DataFrame, pd.DataFrame]:
    matrix = np.array([[10.0, -4.0], [2.0, 12.0]])  # 1e-3
    travel = np.array([[-1.0, 1.0], [1.0, 0.5], [0.0, -1.0], [1.0, 1.0], [0.5, 0.0], [0.0, 0.5]])
    deflection = travel @ matrix.T + 0.5  # µm
    uses = ["calibration"] * 4 + ["verification"] * 2
    deflections = pd.DataFrame(
        {
            "pose": f"P{p}",
            "use": uses[p],
            "leg": leg,
            "actuator_displacement_mm": travel[p, leg - 1],
            "deflection_um": deflection[p, leg - 1],
            "deflection_sd_um": 0.4,
        }
        for p in range(len(travel))
        for leg in LEGS
    )
    rows = [("kappa", leg, leg, matrix[leg - 1, leg - 1], 0.5) for leg in LEGS]
    rows += [("K", i, j, matrix[i - 1, j - 1], 0.1) for i in LEGS for j in LEGS]
    return deflections, pd.DataFrame(rows, columns=["quantity", "leg", "actuator", "mean_permille", "sd_permille"])


def write_draws(path: Path) -> None:
    """The draws of a_x and b_x of leg 2 lie on a ridge, everything else is independent."""
    rng = np.random.default_rng(3)
    draws = {symbol: rng.standard_normal((4, 50, len(LEGS))) for symbol in (*SYMBOLS, "tau")}
    draws["b_x"][..., 1] = draws["a_x"][..., 1] + 0.1 * rng.standard_normal((4, 50))
    with h5py.File(path, "w") as file:
        for symbol, values in draws.items():
            file[f"posterior/{symbol}"] = values
        file["posterior/leg"] = np.array(LEGS)


def name_tables(variants: dict[str, tuple[float, float]]) -> dict[str, str]:
    """Return where a publication prints the values of the variants that it has."""
    pairs = {name: name.split("/") for name in variants}
    return {
        name: f"table {TABLES[deformation]}({LETTERS[model]})"
        for name, (model, deformation) in pairs.items()
        if model in LETTERS
    }


def describe_config(variants: dict[str, tuple[float, float]]) -> dict:
    pairs = [name.split("/") for name in variants]
    entries = [{"model": model, "deformation": deformation} for model, deformation in pairs]
    return {"model_error": {"terms": ["random"], "random_scale_um": 10.0}, "variants": entries}


def tabulate_claims() -> pd.DataFrame:
    rows = [
        ("late", "7.1.1", "A claim of section 7.", "one", "one after all", 1.0, "1", "holds", "Seen <i>twice</i>."),
        ("small", "2.3", "Motors place within a_x.", "6 µm", "5.9 µm", 5.9, "µm", "holds", "Worst signs."),
        ("wrong", "2.3", "It turns by 1e-6 deg.", "1e-6 deg", "", 0.002, "deg", "does not hold", "Worst signs."),
        ("open", "7.1.1", "The real platform stays stiff.", "", "", np.nan, "", "not testable", "No data."),
        ("far", "10.2, 11", "A claim of later sections.", "two", "three", 3.0, "1", "does not hold", "Counted."),
        ("mine", "own", "Table 7(c) is misprinted.", "1", "0.12", 0.12, "1", "does not hold", "Regression."),
    ]
    columns = ["claim", "section", "statement", "expected", "found", "value", "unit", "verdict", "reason"]
    return pd.DataFrame(rows, columns=columns)


def tabulate_flexure() -> pd.DataFrame:
    """Two flexures, of 5 and 10 mm; pivot and circle are half as much again and a millionth too far."""
    bending = np.linspace(0.0, 1.0, 11)
    frames = []
    for length in (5.0, 10.0):
        beam = 0.0508 * length * bending**2
        frames.append(
            pd.DataFrame(
                {
                    "flexure_length_mm": length,
                    "bending_deg": bending,
                    "across_um": 8.73 * length * bending,
                    "along_beam_um": beam,
                    "along_pivot_um": 1.5 * beam,
                    "along_circle_um": beam * (1 + 1e-6),
                    "circle_error_nm": 1e3 * beam * 1e-6,
                }
            )
        )
    return pd.concat(frames)


def complete(name: str, table: pd.DataFrame) -> pd.DataFrame:
    """Return a study's table with columns that a test does not care about: NaN, empty texts, zeros and False."""
    row = next((one for one in ROWS if one.table == name), None)
    missing = [one for one in row.list_columns() if one.name not in table and not one.is_optional] if row else []
    empty = {str: "", float: np.nan, int: 0, bool: False}
    return table.assign(**{one.name: one.choices[0] if one.choices else empty[one.kind] for one in missing})


def write_results(
    parent,
    change=None,
    variants=TWO,
    verification=True,
    ring=True,
    draws=True,
    published=True,
    claims=False,
    flexure=False,
    publication=None,
    drive="base",
    name="results",
    more=None,
    edits=None,
) -> Path:
    """Write a results directory below a parent and return its path.

    ``change``, one or several, edits the summary in place; ``edits`` edit tables, in place or by what they return;
    ``more`` are further tables.
    """
    folder = parent / name
    folder.mkdir()
    uses = USES if verification else {"calibration": USES["calibration"]}
    summary = describe_summary(uses, variants) | {"drive": drive}
    if publication is not None or claims:
        summary["publication"] = publication or PUBLICATION
    if published and len(variants) > len(TWO):
        summary["publication"] = summary.get("publication", PUBLICATION) | {"tables": name_tables(variants)}
    for one in [change] if callable(change) else change or ():
        one(summary)
    provenance = {"name": "tiny", "seed": 1, "config": describe_config(variants), "python": "3.12"}
    provenance |= {"platform": "linux", "files": {"t.csv": "f" * 64}, "versions": {"numpy": "2"}}
    tables = {
        "variants": pd.DataFrame([{"variant": n, "title": one["title"]} for n, one in summary["variants"].items()]),
        "parameters": tabulate_parameters(variants),
        "pose_errors": tabulate_pose_errors(uses, variants),
        "poses": tabulate_poses(summary["variants"]),
        "accuracy": tabulate_accuracy(variants),
        "model_error": tabulate_model_error(variants),
        "least_squares": tabulate_least_squares(variants, published),
        "sensitivity": tabulate_sensitivity(summary),
    }
    if ring:
        tables["joint_deflection"], tables["deformation"] = tabulate_deflections()
    if claims:
        tables["claims"] = tabulate_claims()
    if flexure:
        tables["flexure"] = tabulate_flexure()
    tables = {name: complete(name, table) for name, table in (tables | (more or {})).items()}
    for table, edit in (edits or {}).items():
        edited = edit(tables[table])
        tables[table] = tables[table] if edited is None else edited
    posteriors = {f"posterior/{variant.replace('/', '-')}.nc": write_draws for variant in variants if draws}
    frame.write_results(frame.Results(summary, tables, posteriors, provenance), folder, tables_in="tables")
    return folder


def set_fit(variant, **values):
    """Return a change of a summary: numbers of a posterior, the variants ranked by their evidence as it then is."""

    def change(summary):
        summary["variants"][variant].update(values)
        summary["rankings"][0].sort(key=lambda name: -summary["variants"][name]["log_evidence"])

    return change


def hide_poses(*variants):
    """Return a change of a summary: variants, all where none is named, whose poses no instrument saw."""

    def change(summary):
        for name in variants or summary["variants"]:
            summary["variants"][name] |= {"calibration": None, "verification": None}

    return change


def set_rows(where, **values):
    """Return a change of a table: values of the rows that have others, one for all or one for each."""

    def change(table):
        chosen = np.logical_and.reduce([table[column] == value for column, value in where.items()])
        for column, value in values.items():
            table.loc[chosen, column] = value

    return change


def edit_config(folder, change) -> None:
    """Change the config of a results directory in place."""
    path = folder / "provenance.json"
    provenance = json.loads(path.read_text())
    change(provenance["config"])
    path.write_text(json.dumps(provenance))


def read_study(folder) -> StudyResults:
    return StudyResults.of(frame.read_results(folder))


def read_page(folder) -> Page:
    return build_page(frame.read_results(folder))


def write_report(folder) -> Path:
    """Write the page of a results directory as the frame does."""
    results = frame.read_results(folder)
    earlier = [path.relative_to(folder).as_posix() for path in folder.glob("figures/*.png")]
    return write_page(build_page(results), folder, [show_provenance(results.provenance)], earlier)


def render_text(folder) -> str:
    """Return the page of a results directory without drawing its figures."""
    page = read_page(folder)
    pictures = {figure.name: Picture(b"") for figure in page.figures() if figure.draw is not None}
    return leave_out_script(render_page(page, pictures))
