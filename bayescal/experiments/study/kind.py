"""Studies as a kind of experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from bayescal.errors import InputError, NumericalError, name_faults
from bayescal.experiments.runner.memory import MemoryEstimate
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.runner.terminal import show_verdict
from bayescal.experiments.shared.calibrating import CalibratingKind, load_same
from bayescal.experiments.shared.headline import list_candidates, read_rows
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuringKind
from bayescal.experiments.shared.readings.instruments import list_machines
from bayescal.experiments.shared.readings.machine_kind import MachineExperiment
from bayescal.experiments.shared.readings.measurement import list_file_faults
from bayescal.experiments.shared.search_memory import estimate_calibration
from bayescal.experiments.shared.slip_causes import WIDE
from bayescal.experiments.shared.slips import MisstatedInput, tell_denial
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.study.doubts import doubt_copies, doubt_zero
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import ROWS
from bayescal.experiments.study.terminal import show_comparison, show_ranking
from bayescal.report.blocks import Page

if TYPE_CHECKING:
    import pandas as pd

    from bayescal.calibrated.machine import CalibratedMachine


class Study(MachineExperiment[StudyConfig, StudyInputs], MeasuringKind, CalibratingKind):
    """A machine calibrated from what was measured of it: variants ranked by evidence and by prediction."""

    schema = StudyConfig
    tables_in = "tables"
    rows = ROWS
    tables_of_machine = ("parameters", "errors")
    imports = ("bayescal.experiments.study.compute", "arviz_stats", "emcee")

    def machines(self, config: StudyConfig) -> list[str]:
        """Return the files of the machine, those of single variants too."""
        return list_machines(config)

    def read(self, config: StudyConfig, folder: Path) -> StudyInputs:
        """Return everything the study computes with."""
        found = StudyInputs.load(config, folder)
        _ = found.claims  # a class at fault shows now
        return found

    def list_file_faults(self, content: Mapping[str, Any], folder: Path) -> list[str]:
        """Return what is wrong with the machine and each table by itself."""
        return list_file_faults(content, folder)

    def estimate_memory(self, inputs: StudyInputs) -> MemoryEstimate:
        """Return what the posteriors take."""
        return estimate_calibration(inputs)

    def estimate_seconds(self, inputs: StudyInputs) -> float:
        """Return what the posteriors take, from the time of some of their densities."""
        return inputs.estimate_seconds()

    def outlook(self, inputs: StudyInputs) -> list[str]:
        """Return what the data can determine of each variant, and that tolerances are too wide, which is no fault."""
        found = _find_misstated(inputs)
        return [*inputs.outlook(), *([found.say()] if found is not None and found.fault == WIDE else [])]

    def list_warnings(self, inputs: StudyInputs, *, before_run: bool = False) -> list[str]:
        """Return what may be wrong: a place that only wide tolerances explain, a noise or a tolerance."""
        copies = doubt_copies(inputs)
        if inputs.slip is not None:
            return copies
        found = None if before_run else _find_misstated(inputs)
        denied = [] if inputs.denied is None else [f"{inputs.denied.say()}, which the config denies"]
        return [*denied, *copies, *doubt_zero(inputs), *([] if found is None or found.fault == WIDE else [found.say()])]

    def suspect(self, inputs: StudyInputs) -> list[str]:
        """Return what seems to have happened to data that one slip explains far better than errors of the machine."""
        return [] if inputs.slip is None else [f"{inputs.slip.say()}{tell_denial('ignored_data_errors')}"]

    def compute(self, inputs: StudyInputs, run: Run) -> Results:
        """Return posteriors, evidence and predictions of all variants."""
        from bayescal.experiments.study.compute import compute_study  # seconds to import, as its inputs are read first

        return compute_study(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.study.page.build import build_page  # a second to import, while workers compute

        return build_page(results)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print what to use, the ranking, and what contradicts the stated noise and tolerances."""
        show_verdict(page, console)
        show_ranking(results.summary, console)

    def list_failures(self, results: Results) -> list[str]:
        """Return that data seem to be wrong, and that a posterior did not converge."""
        wrong = ["probable data error"] if results.summary.get("suspected_data_error") else []
        variants = results.summary["variants"].values()
        failed = [] if all(one["converged"] for one in variants) else ["not everything converged"]
        return [*wrong, *failed]

    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return variants of the study in a file."""
        with name_faults(path):
            inputs = StudyInputs.load(config, path.parent, names)
        return inputs.measure([one.name for one in config.variants if one.name in names], with_model_error)

    def calibrate(
        self,
        results: Results,
        variant: str | None,
        experiment: Path | None,
        mode: int | None,
        with_instruments: bool = False,
    ) -> CalibratedMachine:
        """Return the machine of a variant of the study."""
        config = self.config_of(results) if experiment is None else load_same(results, experiment, self.schema)
        from bayescal.experiments.study.calibrated import calibrate_machine

        return calibrate_machine(results, config, variant, experiment, mode, with_instruments)

    def show_comparison(self, table: pd.DataFrame, console: Console) -> None:
        """Print variants of several studies ranked together."""
        show_comparison(table, console)

    def compare(self, results: Mapping[str, Results]) -> pd.DataFrame:
        """Return the variants of several studies of the same data, the largest log-evidence first, if converged."""
        import pandas as pd  # a third of a second, for those who have tables

        rows, data = [], {}
        for name, one in results.items():
            try:
                data[name] = _identify_data(one.provenance)
                fits = read_rows(one.summary)
                rows += [
                    _describe_variant(name, variant, fits[variant])
                    for variant in (candidate.name for candidate in list_candidates(one.summary))
                ]
            except (KeyError, TypeError, AttributeError) as error:
                raise InputError(f"{name}: expected a study's results; {error} is missing") from error
        self.check_comparable(data)
        table = pd.DataFrame(rows)
        sound = table["converged"] == "yes"  # the others come last and are not compared
        table = table.assign(failed=~sound).sort_values(
            ["failed", "log_evidence"], ascending=[True, False], ignore_index=True
        )
        best = table["log_evidence"].where(~table["failed"])
        table.insert(4, "difference", best - best.max())
        return table.drop(columns="failed")


def _identify_data(provenance: Mapping[str, Any]) -> dict[str, object]:
    """Return what makes two data sets the same: contents of the files and what is assumed of the noise."""
    config, files = provenance["config"], provenance["files"]
    found = {
        f"{key} {k}" if k else key: files.get(value, value) if isinstance(value, str) else value
        for k, one in enumerate(config["data"])
        for key, value in one.items()
    }
    return found | {f"noise of {name}": one for name, one in config.get("sensors", {}).items()}


def _describe_variant(results: str, name: str, fit: Summary) -> dict[str, object]:
    return {
        "results": results,
        "variant": name,
        "n_parameters": fit["n_parameters"],
        "log_evidence": float(fit["log_evidence"]),
        "se": float(fit["log_evidence_se"]),
        "elpd_loo": float(fit["elpd_loo"]),
        "elpd_verification": float("nan" if fit["elpd"] is None else fit["elpd"]),
        "converged": "yes" if fit["converged"] else "NO",
    }


def _find_misstated(inputs: StudyInputs) -> MisstatedInput | None:
    """Return what is stated wrong; None, too, where that cannot be said, which takes nothing from what else is."""
    try:
        return inputs.misstated
    except NumericalError:
        return None
