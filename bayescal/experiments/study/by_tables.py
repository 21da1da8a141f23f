"""Studies of tables of readings of any machine's channels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import name_faults
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.knowledge_page import NO_TOOL
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.measured_slips import find_calibration_slip
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.outlook import join_outlooks
from bayescal.experiments.shared.readings.inputs import ReadingInputs, read_inputs
from bayescal.experiments.shared.readings.memory import estimate_calibration
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.study.route import Route


class ByTables(Route):
    """Readings of channels: poses are eliminated from the readings of each row."""

    def read(self, config: StudyConfig, folder: Path) -> ReadingInputs:
        """Return machine, readings and variants."""
        return read_inputs(config, folder)

    def estimate_memory(self, inputs: ReadingInputs) -> Need:
        """Return what the largest variant's posterior takes, and all that is kept of each."""
        return estimate_calibration(inputs)

    def outlook(self, inputs: ReadingInputs) -> list[str]:
        """Return what each variant's readings can determine, columns that are not used, and that there is no tool."""
        stated = all(one.model.states_tool for one in inputs.variants.values())
        said = join_outlooks({name: one.tell_outlook() for name, one in inputs.variants.items()})
        return [*said, *filter(None, (inputs.unused, "" if stated else NO_TOOL))]

    def doubt(self, inputs: ReadingInputs) -> list[str]:
        """Return what may have happened to readings that no machine within its priors comes near."""
        said = find_calibration_slip(one.suspicion() for one in inputs.variants.values())
        return [] if said is None else [said.say()]

    def compute(self, inputs: ReadingInputs, run: Run) -> Results:
        """Return the posteriors of all variants and what they predict."""
        from bayescal.experiments.study.compute_readings import compute_calibration

        return compute_calibration(inputs, run)

    def calibrate(
        self, results: Results, config: StudyConfig, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant."""
        from bayescal.experiments.study.calibrated_readings import calibrate_machine

        return calibrate_machine(results, config, variant, experiment, trust)

    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return the posteriors of the calibration poses."""
        chosen = [one for one in config.variants if one.name in names]
        with name_faults(path):
            found = read_inputs(config.model_copy(update={"variants": chosen}), path.parent).variants
        origin = name_origin(config.origin.model_dump())
        return {
            name: MeasuredReadings(name, origin, one.posterior(), one.workspace.low, one.workspace.high, one.internal)
            for name, one in found.items()
        }
