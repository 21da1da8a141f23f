"""What every study writes of its variants, whatever its machine: their comparison, parameters and poses left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import pandas as pd

    from bayescal.experiments.shared.estimate import Fit

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
    variant: str, fit: Fit, nominal: Sequence[float], verdicts: Sequence[str] | None = None
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
    """
    import pandas as pd  # a third of a second, for those who have tables

    contraction = compute_contraction(fit.sd, fit.prior_sd)
    return pd.DataFrame(
        {
            "variant": variant,
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


def tabulate_left_out(variant: str, fit: Fit, poses: Sequence[str]) -> pd.DataFrame:
    """Return the common columns of one posterior's rows of ``poses.csv``.

    Parameters
    ----------
    variant : str
    fit : Fit
        Each calibration pose of which was left out.
    poses : sequence of str
        Names of these.
    """
    import pandas as pd  # a third of a second, for those who have tables

    return pd.DataFrame(
        {
            "variant": variant,
            "pose": list(poses),
            "elpd_loo": fit.left_out.elpd,
            "pareto_k": fit.left_out.pareto_k,
            "refitted": fit.left_out.was_refitted.astype(bool),
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
