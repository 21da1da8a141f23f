"""Self-calibrations as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.self_calibration.blunders import check_readings
from bayescal.experiments.self_calibration.compute import compute_self_calibration
from bayescal.experiments.self_calibration.inputs import ReadingInputs, read_inputs
from bayescal.experiments.self_calibration.page.pages import build_page, list_variants
from bayescal.experiments.self_calibration.schema import SelfCalibrationConfig
from bayescal.experiments.shared.search_memory import list_readings, list_sampling, list_saved
from bayescal.report.blocks import Page


class SelfCalibration(Experiment[SelfCalibrationConfig, ReadingInputs]):
    """One machine calibrated from the readings of its own sensors."""

    schema = SelfCalibrationConfig

    def read(self, config: SelfCalibrationConfig, folder: Path) -> ReadingInputs:
        """Return machine, readings and variants; readings that no machine can have are refused."""
        inputs = read_inputs(config, folder)
        check_readings(inputs, folder / config.data.readings)
        return inputs

    def estimate_memory(self, inputs: ReadingInputs) -> Need:
        """Return what the largest variant's posterior takes, and all that is kept of each."""
        n_poses, config = len(inputs.table.poses), inputs.config
        largest = max(inputs.variants.values(), key=lambda one: len(one.free.places))
        n_parameters, sensors = len(largest.free.places), largest.sensors
        held = list_readings(n_poses, len(sensors.chosen), n_parameters, sensors.n_coordinates)
        return estimate_arrays(
            {"poses": n_poses, "parameters": n_parameters, "variants": len(inputs.variants)},
            [*held, *list_sampling(config.sampler, config.evidence, n_parameters)],
            "fewer poses or variants",
            kept=list_saved(len(inputs.variants), n_poses, len(sensors.chosen)),
        )

    def compute(self, inputs: ReadingInputs, run: Run) -> Results:
        """Return the posteriors of all variants and what they say of the tool."""
        return compute_self_calibration(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.tables, results.summary)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the verdict, then the variants."""
        super().show(results, page, console)
        for line in list_variants(results.tables):
            console.print(line, soft_wrap=True)

    def list_failures(self, results: Results) -> list[str]:
        """Return that a posterior did not converge."""
        return [] if results.summary["converged"] else ["not everything converged"]
