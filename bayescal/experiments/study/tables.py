"""What a study tells of its variants: comparison, parameters, errors of poses, scales of the model error, legs."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.config.classes import label_class
from bayescal.density.calibration.model_error import RandomTerm
from bayescal.density.prediction import Prediction
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.error_sizes import find_units
from bayescal.experiments.shared.estimate import Fit, Moments
from bayescal.experiments.shared.function_errors import choose_size_unit
from bayescal.experiments.shared.headline import rank_evidence
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.readings.measurement import Measured
from bayescal.experiments.shared.readings.pads import SeenPads
from bayescal.experiments.shared.readings.schema import ProvenanceConfig
from bayescal.experiments.shared.rows import USES
from bayescal.experiments.shared.study_schema import VariantConfig
from bayescal.experiments.study.rows import (
    DeformationRow,
    FlexureRow,
    JointDeflectionRow,
    ParameterRow,
    PoseErrorRow,
    RandomScaleRow,
)
from bayescal.files.csv_tables import format_table
from bayescal.inference.importance import smooth_weights
from bayescal.inference.leave_one_out import LeaveOneOut
from bayescal.limits import PARETO_K_LIMIT
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.beam import CIRCLE, PIVOT, compute_beam_shift, compute_circle_shift
from bayescal.machines.models.legs import list_dimensions
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix
from bayescal.numerics.units import MICROMETRE

if TYPE_CHECKING:
    from arviz_stats.utils import ELPDDataLOO

BENDING, N_BENDINGS = 1.0, 51  # deg
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
AXIS = re.compile(r"(?P<before>|.*[\W_]|.*[a-z0-9](?=[XYZ]))(?P<axis>[xyzXYZ])(?P<after>[\[_]?\d*\]?)")
"""Name of a position's channel."""
SAME_SCALE = 1e-6
"""Relative difference of two scales up to which they are one: units are converted with rounding."""
NOISE = "noise"
"""Verdict on a parameter that is not one of the machine's."""
SEVERAL, DIFFERENT = "several", 3.0
"""Verdict on a parameter in which solutions differ, and from how many of their standard deviations on they do."""


# --- variants and their parameters -----------------------------------------------------------------------------------


def join_tables(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return tables below each other, those without rows left out."""
    there = [one for one in tables if not one.empty]
    return pd.concat(there, ignore_index=True) if there else pd.DataFrame()


def compute_contraction(sd: Array, prior_sd: Array) -> Array:
    """Return the share of the prior variance that the data removed, 1 − (sd / prior sd)²: the only formula of it."""
    return np.asarray(1.0 - (sd / prior_sd) ** 2)


def tabulate_parameters(variant: Variant, fit: Fit, verdicts: Sequence[str]) -> pd.DataFrame:
    """Return a posterior's rows of ``parameters.csv``, with a verdict on each parameter of the machine.

    Of several solutions each has its rows, the most probable first, and parameters in which they differ have no
    contraction.
    """
    posterior = variant.posterior()
    errors, n = posterior.errors, posterior.errors.n_parameters
    medians = zip(errors.units, errors.natural(np.zeros(n)), strict=True)
    nominal = [*variant.model.layout.nominal[posterior.sampling.free]]
    nominal += [float(x) if unit == "1" else 0.0 for unit, x in medians]
    found: list[Moments] = [Moments(fit.mean, fit.sd, fit.q05, fit.q95), *fit.others]
    differ, (factor, units) = find_differing(found), find_units(variant.model, fit.names, fit.units)
    tables, several = [], len(found) > 1
    for k, one in enumerate(found):
        p, se = fit.solutions.probability, fit.solutions.standard_error
        solution = {"mode": k + 1, "probability": p[k], "probability_se": se[k]} if several else {}
        table = ParameterRow.tabulate(
            variant=variant.name,
            parameter=fit.names,
            unit=units,
            nominal=nominal,
            prior_sd=factor * fit.prior_sd,
            mean=factor * one.mean,
            sd=factor * one.sd,
            q05=factor * one.q05,
            q95=factor * one.q95,
            contraction=np.where(differ, np.nan, compute_contraction(one.sd, fit.prior_sd)),
            prior_sensitivity=fit.power_scaling[:, 0],
            likelihood_sensitivity=fit.power_scaling[:, 1],
            verdict=np.where(differ, SEVERAL, np.array([*verdicts, *[NOISE] * n], dtype=object)),
            rhat=fit.diagnostics.rhat,
            ess_bulk=fit.diagnostics.ess_bulk,
            ess_tail=fit.diagnostics.ess_tail,
            **solution,
        )
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def find_differing(found: Sequence[Moments]) -> np.ndarray:
    """Return in which parameters solutions differ, shape (n,)."""
    mean, sd = np.stack([one.mean for one in found]), np.stack([one.sd for one in found]).max(axis=0)
    return np.asarray(np.ptp(mean, axis=0) > DIFFERENT * sd)


def describe_solutions(model: ReadingModel, fit: Fit) -> Summary:
    """Return the solutions of a posterior that has several, the most probable first, as the summary has them.

    Small ones count together.
    """
    p, se = fit.solutions.probability, fit.solutions.standard_error
    found = [Moments(fit.mean, fit.sd, fit.q05, fit.q95), *fit.others]
    places, (factor, units) = np.flatnonzero(find_differing(found)), find_units(model, fit.names, fit.units)
    modes = [
        {
            "probability": float(p[k]),
            "standard_error": float(se[k]),
            "parameters": {
                fit.names[j]: [float(factor[j] * one.mean[j]), float(factor[j] * one.sd[j]), units[j]] for j in places
            },
        }
        for k, one in enumerate(found)
    ]
    small = float(p[len(found) :].sum())
    return ({"modes": modes} if fit.others else {}) | ({"other_modes": small} if small else {})


def rank_variants(rows: Mapping[str, Summary]) -> list[list[str]]:
    """Return names of variants of the same data together: the largest log-evidence first, what did not converge last.

    Of each variant a row has ``data_set``, ``converged`` and ``log_evidence``.
    """
    groups: dict[Any, list[str]] = {}
    for name, row in rows.items():
        groups.setdefault(row["data_set"], []).append(name)
    return [
        sorted(names, key=lambda name: (not rows[name]["converged"], -rank_evidence(rows[name]["log_evidence"])))
        for names in groups.values()
    ]


def compare_variants(left_out: Mapping[str, LeaveOneOut]) -> pd.DataFrame:
    """Return elpd differences from the best variant with standard errors over the rows, and stacking weights.

    The densities of each row are taken relative to the best variant's there: neither differences nor weights change,
    and no exponential overflows.
    """
    from arviz_stats import compare

    best = np.max([one.elpd for one in left_out.values()], axis=0)
    data = {name: _as_elpd_data(one.elpd - best, one.pareto_k) for name, one in left_out.items()}
    with warnings.catch_warnings(), np.errstate(divide="ignore"):  # trial weights at which no variant predicts a row
        # bad poses are refitted or counted, and which variant to choose the evidence says
        warnings.simplefilter("ignore", UserWarning)
        return compare(data, method="stacking", round_to="none")


def _as_elpd_data(elpd: Array, pareto_k: Array) -> ELPDDataLOO:
    import xarray as xr
    from arviz_stats.utils import ELPDDataLOO

    n = len(elpd)
    pointwise, k = (xr.DataArray(values, dims=["row"]) for values in (elpd, pareto_k))
    se = float(np.sqrt(n * np.var(elpd)))
    return ELPDDataLOO(
        elpd=float(elpd.sum()),
        se=se,
        p=0.0,
        n_samples=0,
        n_data_points=n,
        scale="log",
        warning=False,
        good_k=PARETO_K_LIMIT,
        elpd_i=pointwise,
        pareto_k=k,
    )


def tabulate_comparison(variants: pd.DataFrame, left_out: Mapping[str, LeaveOneOut]) -> pd.DataFrame:
    """Return a table of variants with how each predicts rows left out, beside the others of the same ``data_set``."""
    rows = []
    for _, some in variants.groupby("data_set", sort=False):
        group = {str(name): left_out[str(name)] for name in some["variant"]}
        several = compare_variants(group) if len(group) > 1 else None
        for name, one in group.items():
            elpd, se = one.summarise()
            rows.append(
                {
                    "variant": name,
                    "elpd_loo": elpd,
                    "elpd_loo_se": se,
                    "elpd_loo_difference": 0.0 if several is None else several["elpd_diff"][name],
                    "elpd_loo_difference_se": 0.0 if several is None else several["dse"][name],
                    "stacking_weight": 1.0 if several is None else several["weight"][name],
                    "loo_pareto_k_max": float(one.pareto_k.max()),
                    "n_loo_refitted": int(one.was_refitted.sum()),
                    "n_loo_bad_k": int(one.is_doubtful.sum()),
                }
            )
    return variants.merge(pd.DataFrame(rows), on="variant")


# --- errors of poses that an instrument saw --------------------------------------------------------------------------


def find_seen(model: ReadingModel) -> list[int | None]:
    """Return the channels (6,) by which an instrument sees position and rotation, None where it sees none of them.

    Channels are a position where their names end with different axes and share all else, as ``cam_x`` and ``cam_y``,
    ``tracker[x]`` or ``x[1]``: of several targets that of the first, of which most axes are seen.
    """
    nothing: list[int | None] = [None] * len(COMPONENTS)
    found = next(iter(list_seen(model)), nothing)
    turned = [k for k, one in enumerate(model.channels) if one.external and one.rotation][:3]
    if len(turned) == 3:
        found[3:] = turned
    return found


def list_seen(model: ReadingModel) -> list[list[int | None]]:
    """Return the channels (6,) of the position of each target of which most axes are seen; none of a rotation."""
    targets: dict[str, dict[str, int]] = {}
    for k, one in enumerate(model.channels):
        if one.external and one.unit == "mm" and (named := AXIS.fullmatch(one.name)):
            targets.setdefault(named["before"] + named["after"], {}).setdefault(named["axis"].lower(), k)
    most = max(map(len, targets.values()), default=0)
    found = [one for one in targets.values() if len(one) == most]
    return [[*(one.get(axis) for axis in "xyz"), None, None, None] for one in found]


def tabulate_pose_errors(variant: Variant, prediction: Prediction) -> pd.DataFrame:
    """Return one row per pose: errors, predictive intervals and bounds (mm, degrees)."""
    scale = np.array([1.0, 1.0, 1.0, *[np.degrees(1.0)] * 3])
    error, low, high = (part * scale for part in (prediction.error, prediction.low, prediction.high))
    components = {
        f"{component}_{what}_{'mm' if k < 3 else 'deg'}": values[:, k]
        for k, component in enumerate(COMPONENTS)
        for what, values in (("error", error), ("low", low), ("high", high))
    }
    return PoseErrorRow.tabulate(
        variant=variant.name,
        pose=variant.data.poses,
        use=np.where(variant.verification, *reversed(USES)),
        position_error_mm=prediction.position_error,
        position_bound_95_mm=prediction.position_bound,
        orientation_error_deg=np.degrees(prediction.orientation_error),
        orientation_bound_95_deg=np.degrees(prediction.orientation_bound),
        **components,
    )


def describe_errors(variant: Variant, prediction: Prediction) -> tuple[dict[str, float], Summary]:
    """Return errors of poses by use as columns of a variant's row, and as the summary has them."""
    row: dict[str, float] = {}
    found: Summary = dict.fromkeys(USES)
    for use, chosen in zip(USES, (~variant.verification, variant.verification), strict=True):
        if chosen.any():
            found[use] = summarise_errors(prediction.select(chosen))
            for what, unit in (("position", "mm"), ("orientation", "deg")):
                sizes = found[use][f"{what}_error_{unit}"]
                row |= {f"{use}_{what}_error_{k}_{unit}": sizes[k] for k in ("mean", "max")}
    return row, found


def summarise_errors(prediction: Prediction) -> Summary:
    """Return mean and largest errors of a prediction, and the coverage of its intervals."""
    position, orientation = prediction.position_error, np.degrees(prediction.orientation_error)
    return {
        "position_error_mm": _summarise_sizes(position),
        "orientation_error_deg": _summarise_sizes(orientation),
        "interval_90_coverage": prediction.coverage,
        "bound_95_coverage": float(np.mean((position <= prediction.position_bound)[np.isfinite(position)])),
    }


def _summarise_sizes(sizes: Array) -> dict[str, float | None]:
    """Return mean and largest of what was measured; None where nothing was."""
    known = sizes[np.isfinite(sizes)]
    return {"mean": float(known.mean()) if len(known) else None, "max": float(known.max()) if len(known) else None}


# --- scales of the model error's prior -------------------------------------------------------------------------------


def tabulate_tau_scale(inputs: ReadingInputs, fits: Mapping[str, Fit]) -> pd.DataFrame:
    """Return the log-evidence of every variant for other scales of the model error's half-normal prior.

    Only this prior changes: Z(s) / Z(s0) is the mean of Π p(τ; s) / p(τ; s0) over the posterior's draws. Where the
    weights of these have a heavy tail the posterior lies elsewhere, and there is no answer.
    """
    rows = []
    for name, fit in fits.items():
        terms = inputs.variants[name].errors.terms_of(RandomTerm)
        if not terms:
            continue
        places = [fit.names.index(one.names[0]) for one in terms]
        own, square = terms[0].scale, np.sum(fit.draws[..., places] ** 2, axis=-1).ravel()
        asked = MICROMETRE * np.array(inputs.config.sensitivity.random_scale_grid_um)
        listed = [float(one) for one in asked if not np.isclose(one, own, rtol=SAME_SCALE)]
        factor, unit = choose_size_unit(inputs.variants[name].model)
        for scale in sorted({own, *listed}):
            log_weights = len(terms) * np.log(own / scale) + 0.5 * square * (own**-2 - scale**-2)
            gain = float(logsumexp(log_weights) - np.log(len(log_weights)))
            relative = np.exp(log_weights - gain)
            pareto_k = 0.0 if scale == own else smooth_weights(log_weights)[1]
            trusted = pareto_k <= PARETO_K_LIMIT
            rows.append(
                RandomScaleRow(
                    variant=name,
                    unit=unit,
                    prior_scale=factor * own,
                    scale=factor * scale,
                    log_evidence=fit.importance.log_evidence + gain if trusted else np.nan,
                    efficiency=1.0 / float(np.mean(relative**2)),
                    pareto_k=pareto_k,
                )
            )
    table = RandomScaleRow.collect(rows)
    return table.sort_values(["scale", "log_evidence"], ascending=[True, False], ignore_index=True)


# --- machines on legs ------------------------------------------------------------------------------------------------


def tabulate_legs(inputs: ReadingInputs) -> dict[str, pd.DataFrame]:
    """Return joints, flexures, and what targets on pads show of the platform, of a machine on legs."""
    first = next(iter(inputs.variants.values()))
    legs, seen = first.whole.legs, inputs.pads
    if legs is None:
        return {}
    rho = [k for k, one in enumerate(first.model.channels) if one.kind == "rho"]
    found = {"flexure": tabulate_flexure(legs.machine.mechanism)}
    if len(rho) == legs.n_legs and np.isfinite(first.data.values[:, rho]).all():
        actuators = first.data.values[:, rho]
        found["joints"] = tabulate_joints(legs.machine.mechanism, actuators, first.data.poses)
    if seen is not None and seen.pads is not None:
        found |= {"joint_deflection": _tabulate_deflections(seen), "deformation": _tabulate_deformation(seen)}
    return found


def describe_legs(inputs: ReadingInputs) -> Summary:
    """Return what the summary has of models, drive and measurement of a machine on legs."""
    every = {name: one.whole.legs for name, one in inputs.variants.items()}
    seen = {one.name: one for one in inputs.config.variants if one.model is not None}
    if not seen:
        return inputs.described
    machines = {name: one.machine for name, one in every.items() if one is not None}
    named = {
        name: dict(zip(("model", "deformation"), map(label_class, one.seen), strict=True))
        for name, one in seen.items()
        if one.has_own_name
    }
    free = {split for one in inputs.variants.values() for split in (n.partition("[")[0] for n in one.priors)}
    held = {name: [one for one in list_dimensions(m.layout) if one not in free] for name, m in machines.items()}
    optional = {
        "own_names": named,
        "not_free": {name: symbols for name, symbols in held.items() if symbols},
        "measurement_noise_um": _measure_noise(inputs),
    }
    return {
        "models": {label_class(one.seen[0]): machines[name].model.title for name, one in seen.items()},
        "drive": next(iter(machines.values())).mechanism.drive,
        **inputs.described,
        **{key: value for key, value in optional.items() if value},
    }


def _measure_noise(inputs: ReadingInputs) -> dict[str, float]:
    """Return the noise of measured positions, rms over the poses of each use, µm; nothing where none is measured."""
    variant = next(iter(inputs.variants.values()))
    places = [k for k in find_seen(variant.model)[:3] if k is not None]
    if len(places) < 3:
        return {}
    square = (variant.data.sd[:, places] ** 2).sum(axis=1)
    uses = zip(USES, (~variant.verification, variant.verification), strict=True)
    return {use: float(np.sqrt(square[some].mean()) / MICROMETRE) for use, some in uses if some.any()}


def title_variant(section: VariantConfig, model: ReadingModel) -> str:
    """Return what tables call a variant: its title, or model and deformation of legs that has no name of its own."""
    legs = model.legs
    if section.model is None or section.has_own_name or legs is None:
        return section.title
    return f"{legs.machine.model.title}/{label_class(section.deformation)}"


def tabulate_flexure(mechanism: Mechanism) -> pd.DataFrame:
    """Return how a flexure's end moves as it bends up to 1 deg: beam, ideal pivot and circle (RR-8096 figure 9)."""
    if mechanism.flexures is None:
        return pd.DataFrame()
    degrees = np.linspace(0.0, BENDING, N_BENDINGS)
    frames = []
    for length in np.unique(mechanism.flexures.lengths):
        along, across = compute_beam_shift(np.radians(degrees), float(length))
        circle = compute_circle_shift(across, CIRCLE * length)
        table = FlexureRow.tabulate(
            flexure_length_mm=length,
            bending_deg=degrees,
            across_um=1e3 * across,
            along_beam_um=1e3 * along,
            along_pivot_um=1e3 * compute_circle_shift(across, PIVOT * length),
            along_circle_um=1e3 * circle,
            circle_error_nm=1e6 * (circle - along),
        )
        frames.append(table)
    return pd.concat(frames, ignore_index=True)


def _tabulate_deflections(seen: SeenPads) -> pd.DataFrame:
    """Return the measured deflection of every joint at every pose, µm, with its standard deviation."""
    assert seen.pads is not None
    deflection, verification = seen.pads.deflection, seen.measured.verification
    sd = np.sqrt(np.diagonal(deflection.covariance, axis1=-2, axis2=-1))
    n_poses, n_legs = seen.displacement.shape
    return JointDeflectionRow.tabulate(
        pose=np.repeat(seen.measured.poses.names, n_legs),
        use=np.repeat(np.where(verification, *reversed(USES)), n_legs),
        leg=np.tile(np.arange(1, n_legs + 1), n_poses),
        actuator_displacement_mm=seen.displacement.ravel(),
        deflection_um=1e3 * deflection.displacement.ravel(),
        deflection_sd_um=1e3 * sd.ravel(),
    )


def _tabulate_deformation(seen: SeenPads) -> pd.DataFrame:
    """Return κ and K from the targets with posterior standard deviations, in 1e-3."""
    assert seen.pads is not None
    n, matrix, kappa = seen.mechanism.n_legs, seen.pads.matrix, seen.pads.kappa
    each = np.arange(1, n + 1)
    return DeformationRow.tabulate(
        quantity=["kappa"] * n + ["K"] * n**2,
        leg=np.concatenate([each, np.repeat(each, n)]),
        actuator=np.concatenate([each, np.tile(each, n)]),
        mean_permille=1e3 * np.concatenate([kappa.kappa, matrix.matrix.ravel()]),
        sd_permille=1e3 * np.concatenate([kappa.sd, matrix.sd.ravel()]),
    )


def format_poses(measured: Measured, origin: ProvenanceConfig) -> str:
    """Return the extracted poses as CSV text: position (mm), rotation vector (degrees) and covariance (µm, µrad)."""
    poses = measured.poses
    pairs = [(i, j) for i in range(6) for j in range(i, 6)]
    rotation = np.degrees(rotation_vector_from_matrix(poses.rotation))
    scale = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])  # mm and rad to µm and µrad
    covariance = poses.covariance * np.outer(scale, scale)
    columns = ["pose", "use", "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    columns += [f"cov_{COMPONENTS[i]}_{COMPONENTS[j]}" for i, j in pairs]
    rows = [
        (
            name,
            "verification" if held else "calibration",
            *(f"{x:.7f}" for x in poses.position[k]),
            *(f"{x:.8f}" for x in rotation[k]),
            *(f"{covariance[k, i, j]:.6g}" for i, j in pairs),
        )
        for k, (name, held) in enumerate(zip(poses.names, measured.verification, strict=True))
    ]
    comments = [
        name_origin(origin.model_dump()),
        "Platform pose, base frame; mm, rotation vector in degrees.",
        "cov: covariance of position (µm) and rotation vector (µrad), base axes.",
    ]
    return format_table(comments, columns, rows)
