"""Audits of calibrations of any machine as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from bayescal.experiments.audit.page.reading_build import build_page, list_variants
from bayescal.experiments.audit.reading_compute import compute_audit
from bayescal.experiments.audit.reading_inputs import AuditInputs, read_audit
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.readings.machine_kind import MachineExperiment
from bayescal.experiments.shared.readings.memory import find_largest, list_variant
from bayescal.experiments.shared.readings.schema import CalibrationAuditConfig
from bayescal.report.blocks import Page


class CalibrationAudit(MachineExperiment[CalibrationAuditConfig, AuditInputs]):
    """What readings of any machine would tell."""

    schema = CalibrationAuditConfig

    def machines(self, config: CalibrationAuditConfig) -> list[str]:
        """Return the machine's file."""
        return [config.machine]

    def read(self, config: CalibrationAuditConfig, folder: Path) -> AuditInputs:
        """Return machine, planned poses and sets of sensors."""
        return read_audit(config, folder)

    def estimate_memory(self, inputs: AuditInputs) -> Need:
        """Return what the derivatives at all planned poses take."""
        sensors = {} if inputs.sensors is None else {"": inputs.sensors}
        largest = find_largest(inputs.variants | sensors)
        counts = {"planned poses": len(largest.start), "parameters": len(largest.priors)}
        return estimate_arrays(counts, list_variant(largest), "fewer poses")

    def compute(self, inputs: AuditInputs, run: Run) -> Results:
        """Return what each set of sensors would tell."""
        return compute_audit(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.tables, results.summary)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the verdict, then the sets of sensors."""
        super().show(results, page, console)
        for line in list_variants(results.tables):
            console.print(line, soft_wrap=True)
