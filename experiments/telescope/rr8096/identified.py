"""A study's variants identified by least squares, as in section 7, beside the report's tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import PublishedParameterRow
from bayescal.machines.kinematics import Machine
from bayescal.numerics.units import MICROMETRE
from rr8096.least_squares import LeastSquaresFit, identify, list_identified
from rr8096.published import FILES, N_LEGS, read_published

POINTS = ("a_x", "a_y", "b_x", "b_y")
FREE = {"none": {*POINTS, "l", "u_x"}, "linear": {*POINTS, "l", "kappa"}, "matrix": {*POINTS, "l", "kappa"}}
"""What the report identifies with each deformation."""


def machine_of(variant: Variant) -> Machine:
    """Return the mechanism as a variant sees it."""
    legs = variant.whole.legs
    assert legs is not None
    return legs.machine


def list_free(variant: Variant) -> tuple[str, ...]:
    """Return the symbols of a variant's free parameters."""
    known = machine_of(variant).layout.symbols
    free = dict.fromkeys(name.partition("[")[0] for name in variant.priors)
    return tuple(symbol for symbol in free if symbol in known)


def identify_variants(inputs: StudyInputs) -> dict[str, LeastSquaresFit]:
    """Return the least-squares identification of every variant by its name, from the calibration poses."""
    assert inputs.pads is not None
    poses = inputs.pads.measured.poses.select(~inputs.pads.measured.verification)
    return {
        name: identify(machine_of(variant), poses, list_free(variant))
        for name, variant in inputs.variants.items()
    }


def read_tables(inputs: StudyInputs) -> dict[str, dict[tuple[str, int], float]]:
    """Return the report's offsets by variant, then by symbol and leg, of variants that free no more than it does.

    What is identified depends on what is free with it: along a ridge that the report does not have its values say
    nothing. Nor do they of variants with names of their own, or of another number of legs.
    """
    assert inputs.pads is not None
    if inputs.pads.mechanism.n_legs != N_LEGS:
        return {}
    return {
        name: read_published(FILES[name])
        for name, variant in inputs.variants.items()
        if name in FILES and set(list_free(variant)) <= FREE[variant.config.deformation]
    }


def tabulate_least_squares(inputs: StudyInputs, fits: Mapping[str, LeastSquaresFit]) -> pd.DataFrame:
    """Return what least squares found for every variant, beside the published values."""
    rows, published = [], read_tables(inputs)
    for name, variant in inputs.variants.items():
        machine, fit, printed = machine_of(variant), fits[name], published.get(name, {})
        for symbol in list_identified(machine, list_free(variant)):
            for leg, k in enumerate(machine.layout.index[symbol], start=1):
                offset = fit.theta[k] - machine.layout.nominal[k]
                known = printed.get((symbol, leg), np.nan)
                rows.append(
                    PublishedParameterRow(
                        variant=name,
                        parameter=symbol,
                        leg=leg,
                        unit=machine.layout.units[k],
                        nominal=machine.layout.nominal[k],
                        offset=offset,
                        published_offset=known,
                        difference=offset - known,
                        leg_residual_rms_um=fit.residual_rms[leg - 1] / MICROMETRE,
                        converged=fit.converged,
                    )
                )
    return PublishedParameterRow.collect(rows)
