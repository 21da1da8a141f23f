"""Calibrations of any machine as a kind of experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.experiments.calibration.compute import compute_calibration
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.calibrating import Calibrating, load_same
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuringReadings
from bayescal.experiments.shared.outlook import join_outlooks
from bayescal.experiments.shared.reading_slips import find_calibration_slip
from bayescal.experiments.shared.readings.inputs import CalibrationInputs, list_machines, read_inputs
from bayescal.experiments.shared.readings.machine_kind import MachineExperiment
from bayescal.experiments.shared.readings.memory import estimate_calibration
from bayescal.experiments.shared.readings.schema import CalibrationConfig
from bayescal.experiments.study.page.build import build_page
from bayescal.experiments.study.page.readings import NO_TOOL
from bayescal.experiments.study.terminal import show_ranking
from bayescal.report.blocks import Page


class Calibration(MachineExperiment[CalibrationConfig, CalibrationInputs], Calibrating, MeasuringReadings):
    """Any machine calibrated from any of its readings."""

    schema = CalibrationConfig
    tables_of_machine = ("parameters", "errors")

    def machines(self, config: CalibrationConfig) -> list[str]:
        """Return the files of the machine, those of single variants too."""
        return list_machines(config)

    def read(self, config: CalibrationConfig, folder: Path) -> CalibrationInputs:
        """Return machine, readings and variants."""
        return read_inputs(config, folder)

    def estimate_memory(self, inputs: CalibrationInputs) -> Need:
        """Return what the largest variant's posterior takes, and all that is kept of each."""
        return estimate_calibration(inputs)

    def outlook(self, inputs: CalibrationInputs) -> list[str]:
        """Return what each variant's readings can determine, columns that are not used, and that there is no tool."""
        stated = all(one.model.states_tool for one in inputs.variants.values())
        said = join_outlooks({name: one.tell_outlook() for name, one in inputs.variants.items()})
        return [*said, *filter(None, (inputs.unused, "" if stated else NO_TOOL))]

    def doubt(self, inputs: CalibrationInputs) -> list[str]:
        """Return what may have happened to readings that no machine within its priors comes near."""
        said = find_calibration_slip(one.suspicion() for one in inputs.variants.values())
        return [] if said is None else [said.say()]

    def measure_readings(
        self, config: CalibrationConfig, folder: Path, names: Sequence[str]
    ) -> dict[str, MeasuredReadings]:
        """Return the posteriors of the calibration poses."""
        known = [one.name for one in config.variants]
        for name in names:
            if name not in known:
                raise InputError(f"variant {name!r}: unknown here, expected one of {', '.join(known)}")
        chosen = [one for one in config.variants if not names or one.name in names]
        found = read_inputs(config.model_copy(update={"variants": chosen}), folder).variants
        origin = f"{config.origin.status.capitalize()}: {config.origin.text}"
        return {
            name: MeasuredReadings(name, origin, one.posterior(), one.workspace.low, one.workspace.high, one.internal)
            for name, one in found.items()
        }

    def compute(self, inputs: CalibrationInputs, run: Run) -> Results:
        """Return the posteriors of all variants and what they predict."""
        return compute_calibration(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results)

    def calibrate(
        self, results: Results, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant of the calibration."""
        from bayescal.experiments.calibration.calibrated import calibrate_machine

        config = self.config_of(results) if experiment is None else load_same(results, experiment, self.schema)
        return calibrate_machine(results, config, variant, experiment, trust)

    def config_of(self, results: Results) -> CalibrationConfig:
        """Return the config that results were made with, its variants' names for their titles."""
        content = dict(results.config)
        for section in ("variants", "beside"):
            content[section] = [{"title": one.get("name", section), **one} for one in content.get(section, [])]
        return super().config_of(replace(results, provenance={**results.provenance, "config": content}))

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the verdict, then the variants."""
        super().show(results, page, console)
        show_ranking(results.summary, console)

    def list_failures(self, results: Results) -> list[str]:
        """Return that a posterior did not converge."""
        return [] if results.summary["converged"] else ["not everything converged"]
