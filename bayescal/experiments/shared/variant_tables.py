"""What every study writes of its variants, whatever its machine: their comparison, parameters and poses left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import pandas as pd

    from bayescal.experiments.shared.estimate import Fit

FREE, ZERO = "free", "zero"
"""Settings of the model error: with it as the variant has it, and without."""
NOISE = "noise"
"""Verdict on a parameter that is not one of the machine's."""
INFORMED, HARDLY = 0.75, 0.05
"""Contractions from which on a standard uncertainty is at least halved, and below which nothing is learnt."""


def describe_fit(fit: Fit) -> dict[str, Any]:
    """Return one posterior as columns of ``variants.csv`` and keys of the summary: evidence, χ², chains."""
    return {
        "n_parameters": len(fit.names),
        **fit.describe_evidence(),
        "misfit_chi2": fit.misfit.value,
        "misfit_dof": fit.misfit.dof,
        "pulls_chi2": fit.pulls.value,
        "pulls_dof": fit.pulls.dof,
        **fit.describe_chains(),
    }


def compute_contraction(sd: Array, prior_sd: Array) -> Array:
    """Return the share of the prior variance that the data removed, 1 − (sd / prior sd)²: the only formula of it."""
    return np.asarray(1.0 - (sd / prior_sd) ** 2)


def judge_contraction(contraction: Array) -> list[str]:
    """Return the verdict on parameters of which nothing but their contractions is known."""
    words = ("not", "weak", "identifiable")
    return [words[int(one >= HARDLY) + int(one >= INFORMED)] for one in contraction]


def tabulate_parameters(
    variant: str, fit: Fit, nominal: Sequence[float], verdicts: Sequence[str] | None = None, setting: str = FREE
) -> pd.DataFrame:
    """Return one posterior's rows of ``parameters.csv``.

    Parameters
    ----------
    variant : str
    fit : Fit
    nominal : sequence of float
        Of each parameter, in its unit.
    verdicts : sequence of str, optional
        ``identifiable``, ``weak``, ``not``, or ``noise`` of what is no parameter of the machine; by their contractions
        without it.
    setting : str
        Of the model error.
    """
    import pandas as pd  # a third of a second, for those who have tables

    contraction = compute_contraction(fit.sd, fit.prior_sd)
    return pd.DataFrame(
        {
            "variant": variant,
            "model_error": setting,
            "parameter": fit.names,
            "unit": fit.units,
            "nominal": nominal,
            "prior_sd": fit.prior_sd,
            "mean": fit.mean,
            "sd": fit.sd,
            "q05": fit.q05,
            "q95": fit.q95,
            "contraction": contraction,
            "prior_sensitivity": fit.power_scaling[:, 0],
            "likelihood_sensitivity": fit.power_scaling[:, 1],
            "verdict": judge_contraction(contraction) if verdicts is None else verdicts,
            "rhat": fit.diagnostics.rhat,
            "ess_bulk": fit.diagnostics.ess_bulk,
            "ess_tail": fit.diagnostics.ess_tail,
        }
    )


def tabulate_left_out(
    variant: str, fit: Fit, poses: Sequence[str], held: np.ndarray, elpd_held: Array | None = None, setting: str = FREE
) -> pd.DataFrame:
    """Return the common columns of one posterior's rows of ``poses.csv``.

    Parameters
    ----------
    variant : str
    fit : Fit
        Each calibration pose of which was left out.
    poses : sequence of str
        Names of all poses.
    held : ndarray of bool, shape (P,)
        Which were held back for verification.
    elpd_held : ndarray, shape (V,), optional
        Log predictive density of each of these; NaN without it.
    setting : str
        Of the model error.
    """
    import pandas as pd  # a third of a second, for those who have tables

    def spread(values: Array, elsewhere: Any) -> Array:
        every = np.full(len(held), np.nan)
        every[~held] = values
        every[held] = elsewhere
        return every

    return pd.DataFrame(
        {
            "variant": variant,
            "model_error": setting,
            "pose": list(poses),
            "use": np.where(held, "verification", "calibration"),
            "elpd_loo": spread(fit.left_out.elpd, np.nan if elpd_held is None else elpd_held),
            "pareto_k": spread(fit.left_out.pareto_k, np.nan),
            "refitted": spread(fit.left_out.was_refitted, 0.0).astype(bool),
        }
    )


def rank_variants(rows: Mapping[str, Mapping[str, Any]], same: str = "data") -> list[list[str]]:
    """Return names of variants of the same data together: the largest log-evidence first, what did not converge last.

    Parameters
    ----------
    rows : mapping of str to mapping
        Each variant's ``converged``, ``log_evidence`` and what is the same for variants of the same data.
    same : str
        Key of that.
    """
    groups: dict[Any, list[str]] = {}
    for name, row in rows.items():
        groups.setdefault(row[same], []).append(name)
    return [
        sorted(names, key=lambda name: (not rows[name]["converged"], -rows[name]["log_evidence"]))
        for names in groups.values()
    ]
