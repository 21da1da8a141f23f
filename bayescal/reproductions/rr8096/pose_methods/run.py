"""The experiment of RR-8096 figure 5: two methods of pose extraction compared on simulated targets."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from bayescal.config.load import dump_config
from bayescal.config.schema import PoseMethodsConfig
from bayescal.experiments.frame.store import PROVENANCE_FILE, Store
from bayescal.reproductions.rr8096.pose_methods.comparison import compare_pose_methods, summarise_comparison
from bayescal.reproductions.rr8096.pose_methods.figure import draw_pose_methods

MICROMETRE = 1e-3


def run_pose_methods(config: PoseMethodsConfig, folder: Path, out: Path, workers: int = 1) -> str:
    """Run the comparison, put its table and figure in ``out`` and return a one-line summary.

    It reads no files from ``folder`` and is too short for ``workers``.
    """
    del folder, workers
    identity = {"config": {k: v for k, v in dump_config(config).items() if k != "title"}, "files": {}}
    store = Store(out)
    store.check_results(identity)
    comparison = compare_pose_methods(
        config.n_targets,
        config.repeats,
        config.length_mm,
        config.radius_mm,
        config.target_noise_um * MICROMETRE,
        np.random.default_rng(config.seed),
    )
    summary = summarise_comparison(comparison)
    staged = store.stage()
    comparison.to_csv(staged / "repeats.csv", index=False, float_format="%.9g", lineterminator="\n")
    summary.to_csv(staged / "summary.csv", index=False, float_format="%.9g", lineterminator="\n")
    draw_pose_methods(summary).savefig(staged / "figure5.png", dpi=120, metadata={"Software": None})
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    provenance = {"config_sha256": hashlib.sha256(text.encode()).hexdigest(), **identity}
    (staged / PROVENANCE_FILE).write_text(json.dumps(provenance, indent=1) + "\n")
    store.publish()
    means = comparison.groupby("method")[["position_error_mm", "orientation_error_deg", "axis_error_deg"]].mean()
    parts = [
        f"{method}: position {1e3 * row.position_error_mm:.2f} µm, orientation {row.orientation_error_deg:.4f}°, "
        f"axis {row.axis_error_deg:.4f}°"
        for method, row in means.iterrows()
    ]
    return f"mean errors; {'; '.join(parts)}\nfigure: {out / 'figure5.png'}"
