"""Ranking the variants of several studies together: only densities of the same data can be compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.store import PROVENANCE_FILE
from bayescal.files.atomic import read_json

DATA_KEYS = ("targets", "actuators", "reference", "target_noise_um", "actuator_noise_um", "pose_method")


def compare_results(folders: list[Path]) -> pd.DataFrame:
    """Return the variants of several results directories, the largest log-evidence first.

    Raises
    ------
    InputError
        Where a directory is no study's results, or two studies do not have the same data and noise.
    """
    rows, first = [], None
    for folder in folders:
        provenance, summary = read_json(folder / PROVENANCE_FILE), read_json(folder / "summary.json")
        try:
            data = _identify_data(provenance)
            variants = summary["variants"].items()
        except (KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{folder}: is no study's results directory, {error} is missing") from error
        first = first or (folder, data)
        for key, value in data.items():
            if value != first[1][key]:
                raise InputError(
                    f"{folder}: {key} differs from {first[0]} ({value} and {first[1][key]}), expected the same data"
                )
        for name, fit in variants:
            held = fit["verification"] or {}
            rows.append(
                {
                    "results": str(folder),
                    "variant": name,
                    "n_parameters": fit["n_parameters"],
                    "log_evidence": float(fit["log_evidence"]),
                    "se": float(fit["log_evidence_se"]),
                    "elpd_loo": float(fit["elpd_loo"]),
                    "elpd_verification": float(held.get("elpd", float("nan"))),
                    "converged": "yes" if fit["converged"] else "NO",
                }
            )
    table = pd.DataFrame(rows).sort_values("log_evidence", ascending=False, ignore_index=True)
    table.insert(4, "difference", table["log_evidence"] - table["log_evidence"].max())
    return table


def _identify_data(provenance: dict[str, Any]) -> dict[str, object]:
    """Return what makes two data sets the same: contents of the files and what is assumed of the noise."""
    config, files = provenance["config"], provenance["files"]
    data = {key: config["data"][key] for key in DATA_KEYS}
    return {key: files.get(value, value) if isinstance(value, str) else value for key, value in data.items()}
