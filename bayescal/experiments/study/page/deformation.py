"""Deformation of the platform as the targets at its joints show it: κ and K, and the residuals of either."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayescal.experiments.study.page.illustrations import illustrate_deflections
from bayescal.experiments.study.page.publication import cite_symbol
from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.blocks import Block, Column, Section, Statement, Table, make_table
from bayescal.report.numbers import format_estimate, format_significant

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array


def show_deformation(study: StudyResults) -> Section | None:
    """Return what targets at the joints show; None where there are none by design, on struts or of an instrument."""
    without = study.has_struts or study.instrument is not None or not study.has("pose_errors")
    if not study.has("ring") and without:
        return None
    tables, statements = tabulate_deformation(study)
    blocks: list[Block] = [*statements, illustrate_deflections(study), *tables]
    return Section("Deformation of the platform", tuple(blocks), anchor="deformation", short="Deformation")


def tabulate_deformation(results: StudyResults) -> tuple[list[Table], list[Statement]]:
    """Return κ and K from the targets on the platform, and how well each describes the measured deflections."""
    if not results.has("deformation") or not results.has("ring"):
        return [], []
    frame = results.table("deformation")
    kappa = frame[frame["quantity"] == "kappa"].set_index("leg")
    matrix = frame[frame["quantity"] == "K"]
    legs = [int(leg) for leg in kappa.index]
    defined = {symbol: cite_symbol(results.publication, symbol) for symbol in ("kappa", "K")}
    tables = [
        make_table(
            f"Coefficient κ of each leg in the linear description Δb_z = κ Δρ{defined['kappa']}, mean ± sd.",
            [Column("", kind="symbol"), *(Column(f"leg {leg}", "10⁻³") for leg in legs)],
            [["kappa", *map(format_estimate, kappa["mean_1e-3"], kappa["sd_1e-3"])]],
        )
    ]
    if len(matrix):
        mean, sd = (matrix.pivot(index="leg", columns="actuator", values=v) for v in ("mean_1e-3", "sd_1e-3"))
        tables.append(
            make_table(
                f"Matrix K in Δb_z = K Δρ{defined['K']}, mean ± sd; row: joint that moves, column: actuator.",
                [Column("Joint", kind="text"), *(Column(f"actuator {j}", "10⁻³") for j in mean.columns)],
                [[f"leg {i}", *map(format_estimate, mean.loc[i], sd.loc[i])] for i in mean.index],
            )
        )
    matrix_1e3 = mean.to_numpy() if len(matrix) else None
    return tables, _state_residuals(results.table("ring"), kappa["mean_1e-3"].to_numpy(), matrix_1e3)


def _state_residuals(ring: pd.DataFrame, kappa: Array, matrix: Array | None) -> list[Statement]:
    """Say how large the residuals of κ and K, in 1e-3, are."""
    statements = []
    for use, rows in ring.groupby("use", sort=True):
        travel = rows.pivot(index="pose", columns="leg", values="actuator_displacement_mm").to_numpy()
        measured = rows.pivot(index="pose", columns="leg", values="deflection_um").to_numpy()
        left = {"linear": measured - kappa * travel}
        if matrix is not None:
            left["matrix"] = measured - travel @ matrix.T
        described = "; ".join(
            f"residuals of the {name} description: {format_significant(float(np.mean(np.abs(r))), 2)} µm mean and "
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
