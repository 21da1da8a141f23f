"""Running an experiment of simulated calibrations: results as tables and figures, and a page that shows them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import joblib

from bayescal.experiments.frame.run import identify_experiment, publish
from bayescal.experiments.frame.store import Store
from bayescal.reproductions.yu2023.accuracy import run_accuracy
from bayescal.reproductions.yu2023.indices import run_indices
from bayescal.reproductions.yu2023.numbers import run_numbers
from bayescal.reproductions.yu2023.outcome import Outcome
from bayescal.reproductions.yu2023.page.pages import build_page
from bayescal.reproductions.yu2023.schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig
from bayescal.reproductions.yu2023.setting import Setting, read_setting

DIGITS = 9
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
    return publish(store, identity, outcome.tables, outcome.summary, page, DIGITS)


def _compute(setting: Setting, workers: int) -> Outcome:
    study = setting.config.study
    if isinstance(study, IndexStudyConfig):
        return run_indices(setting, study, workers)
    if isinstance(study, AccuracyStudyConfig):
        return run_accuracy(setting, study, workers)
    return run_numbers(setting, study, workers)


def identify(config: HexapodCalibrationsConfig, folder: Path) -> dict[str, Any]:
    """Return what determines the results."""
    return identify_experiment(config, folder, [config.mechanism, *(getattr(config.study, f, None) for f in FILES)])
