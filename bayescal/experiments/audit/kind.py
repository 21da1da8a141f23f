"""Audits as a kind of experiment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from bayescal.experiments.audit.design import AuditDesign, read_design
from bayescal.experiments.audit.rows import ROWS
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.derived import list_study_files
from bayescal.experiments.shared.readings.machine_kind import MachineExperiment, look_at_machine
from bayescal.experiments.shared.search_memory import find_largest, list_variant
from bayescal.report.blocks import Page


class Audit(MachineExperiment[AuditConfig, AuditDesign]):
    """What a machine's measurements can and cannot determine."""

    schema = AuditConfig
    rows = ROWS
    tables_in = "tables"
    digits = 0

    def machines(self, config: AuditConfig) -> list[str]:
        """Return the machine's file; none where a study names it."""
        return [] if config.machine is None else [config.machine]

    def files(self, config: AuditConfig, folder: Path) -> list[str]:
        """Return the audit's files; those of a study whose data are audited, too."""
        names = super().files(config, folder)
        if config.data is not None:
            names += list_study_files(config.data.study, folder)
        return list(dict.fromkeys(names))

    def modules(self, config: AuditConfig, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules, those of a study's classes too."""
        found = super().modules(config, folder)
        if config.data is not None:
            experiment, study = load(folder / config.data.study)
            found |= experiment.modules(study, (folder / config.data.study).parent)
        return found

    def read(self, config: AuditConfig, folder: Path) -> AuditDesign:
        """Return machine and plan, read and checked."""
        return read_design(config, folder)

    def list_file_faults(self, content: Mapping[str, object], folder: Path) -> list[str]:
        """Return what is wrong with the machine's file by itself."""
        return look_at_machine(content, folder)[1]

    def estimate_memory(self, inputs: AuditDesign) -> MemoryEstimate:
        """Return what the derivatives at all planned poses take, the what-ifs' among them."""
        variants = {name: one.variant for name, one in inputs.plans.items()}
        if inputs.sensors is not None:
            variants[""] = inputs.sensors.variant
        if inputs.measured is not None:
            variants = {"": inputs.measured.build(inputs.config.variants[0], inputs.measured.own_poses)}
        largest = find_largest(variants)
        n_poses, n_parameters, held = len(largest.start), len(largest.priors), list_variant(largest)
        return estimate_arrays({"planned poses": n_poses, "parameters": n_parameters}, held, "fewer poses")

    def compute(self, inputs: AuditDesign, run: Run) -> Results:
        """Return everything the audit says."""
        from bayescal.experiments.audit.compute import compute_audit  # pandas, for those who compute

        return compute_audit(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the audit's page."""
        from bayescal.experiments.audit.page.build import build_page  # with matplotlib, for those who make pages

        return build_page(results)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the verdict, what is known of each symbol, and the requirements."""
        from bayescal.experiments.audit.terminal import show_audit

        show_audit(results, page, console)

    def list_failures(self, results: Results) -> list[str]:
        """Return why a posterior did not converge."""
        posterior = results.summary.get("posterior")
        return [] if posterior is None or posterior["converged"] else ["posterior not converged"]
