"""Running an experiment of simulated calibrations: results as tables and figures, and a page that shows them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import joblib

from bayescal.calibration_study.accuracy import run_accuracy
from bayescal.calibration_study.indices import run_indices
from bayescal.calibration_study.numbers import run_numbers
from bayescal.calibration_study.outcome import Outcome
from bayescal.calibration_study.setting import Setting, read_setting
from bayescal.config.calibration_schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig
from bayescal.config.load import dump_config
from bayescal.files import read_text
from bayescal.report.calibration_pages import build_page
from bayescal.report.experiment_page import write_experiment_page
from bayescal.study.inputs import hash_identity
from bayescal.study.store import PROVENANCE_FILE, Store

FILES = ("published", "published_parameters", "parameter_errors")


def run_hexapod_calibrations(
    config: HexapodCalibrationsConfig, folder: Path, out: Path, workers: int | None = None
) -> str:
    """Run an experiment, put tables, figures and the page in ``out`` and return a summary of a few lines.

    Parameters
    ----------
    config : HexapodCalibrationsConfig
    folder : Path
        Where the config's file names start.
    out : Path
        Results directory.
    workers : int, optional
        Processes that select poses; one per core by default. The results do not depend on it.
    """
    identity = identify(config, folder)
    store = Store(out)
    store.check_results(identity)
    outcome = _compute(read_setting(config, folder), workers or joblib.cpu_count())
    page = build_page(config.study.of, config.name, config.title, outcome.tables, outcome.summary)
    staged = store.stage()
    for name, table in outcome.tables.items():
        table.to_csv(staged / f"{name}.csv", index=False, float_format="%.9g", lineterminator="\n")
    (staged / "summary.json").write_text(json.dumps(outcome.summary, indent=1) + "\n")
    write_experiment_page(page, staged)
    provenance = {"config_sha256": hash_identity(identity), **identity}
    (staged / PROVENANCE_FILE).write_text(json.dumps(provenance, indent=1) + "\n")
    store.publish()
    lines = [page.headline, *(statement.text for statement in page.verdict), f"report: {out / 'report.html'}"]
    return "\n".join(lines)


def _compute(setting: Setting, workers: int) -> Outcome:
    study = setting.config.study
    if isinstance(study, IndexStudyConfig):
        return run_indices(setting, study, workers)
    if isinstance(study, AccuracyStudyConfig):
        return run_accuracy(setting, study, workers)
    return run_numbers(setting, study, workers)


def identify(config: HexapodCalibrationsConfig, folder: Path) -> dict[str, object]:
    """Return what determines the results: the config without its title, and the hashes of its files."""
    names = {config.mechanism, *(getattr(config.study, field, None) for field in FILES)} - {None}
    files = {}
    for name in sorted(str(name) for name in names):
        read_text(folder / name, "a file of the experiment")
        files[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    return {"config": {k: v for k, v in dump_config(config).items() if k != "title"}, "files": files}
