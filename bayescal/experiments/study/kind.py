"""Studies as a kind of experiment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.config.classes import label_class
from bayescal.config.registry import find_class
from bayescal.density.legs import LegPosterior
from bayescal.errors import InputError
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.frame.terminal import print_text
from bayescal.experiments.shared.calibrating import Calibrating, load_same
from bayescal.experiments.shared.measured import MeasuredVariant, Measuring, VariantChoice
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.load import load_inputs
from bayescal.experiments.study.look import list_file_faults
from bayescal.experiments.study.memory import estimate_study
from bayescal.experiments.study.schema import StudyConfig, VariantConfig, name_variant
from bayescal.experiments.study.terminal import show_comparison, show_doubts, show_ranking
from bayescal.numerics.units import MICROMETRE
from bayescal.report.blocks import Page


@dataclass(frozen=True, eq=False)
class StudyTask:
    """A study's inputs, and the claims of a publication on it."""

    inputs: StudyInputs
    claims: Claims | None


class Study(Experiment[StudyConfig, StudyTask], Measuring, Calibrating):
    """A machine calibrated from measured poses: variants ranked by evidence and by prediction."""

    schema = StudyConfig
    tables_in = "tables"
    tables_of_machine = ("parameters",)
    imports = ("bayescal.experiments.study.compute", "arviz_stats", "emcee")
    page_imports = ("bayescal.report.canvas", "bayescal.experiments.study.page.build")

    def read(self, config: StudyConfig, folder: Path) -> StudyTask:
        """Return everything the study computes with."""
        claims = None
        if config.claims is not None:
            kind: type[Claims] = Claims  # type: ignore[type-abstract]  # only subclasses of it are found
            claims = find_class("CLAIMS", config.claims, kind, "claims", folder, folder)()
        inputs = load_inputs(config, folder)
        if claims is not None and inputs.targets is None:
            raise InputError(f"{folder}: claims: found {config.claims!r} without targets, expected measured targets")
        return StudyTask(inputs, claims)

    def list_file_faults(self, content: Mapping[str, Any], folder: Path) -> list[str]:
        """Return what is wrong with the machine and each table by itself."""
        return list_file_faults(content, folder)

    def config_of(self, results: Results) -> StudyConfig:
        """Return the config that results were made with; a variant's name with a slash is none of its own."""
        variants = [
            {key: value for key, value in variant.items() if not (key == "name" and "/" in value)}
            for variant in results.config.get("variants", [])
        ]
        provenance = {**results.provenance, "config": {**results.config, "variants": variants}}
        return super().config_of(replace(results, provenance=provenance))

    def estimate_memory(self, inputs: StudyTask) -> Need:
        """Return what the posteriors of all poses take."""
        return estimate_study(inputs.inputs)

    def outlook(self, inputs: StudyTask) -> list[str]:
        """Return what each variant's poses can determine."""
        from bayescal.experiments.study.doubts import list_outlooks

        return list_outlooks(inputs.inputs)

    def doubt(self, inputs: StudyTask) -> list[str]:
        """Return what may have happened to data that no machine explains, or only one within wide tolerances."""
        from bayescal.experiments.study.doubts import doubt_zero, find_study_slip

        slip = find_study_slip(inputs.inputs)
        return doubt_zero(inputs.inputs) if slip is None else [slip.say()]

    def compute(self, inputs: StudyTask, run: Run) -> Results:
        """Return posteriors, evidence and predictions of all variants."""
        from bayescal.experiments.study.compute import compute_study  # seconds to import, as its inputs are read first

        return compute_study(inputs.inputs, inputs.claims, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.study.page.build import build_page  # a second to import, while workers compute

        return build_page(results)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print what to use, the ranking, and what contradicts the stated noise and tolerances."""
        print_text(console, page.headline)
        show_ranking(results.summary, console)
        show_doubts(page.verdict, console)

    def list_failures(self, results: Results) -> list[str]:
        """Return whether a posterior, with or without model error, did not converge."""
        return [] if results.summary["converged"] else ["not everything converged"]

    def measure(
        self, config: StudyConfig, path: Path, choice: VariantChoice, with_model_error: bool
    ) -> MeasuredVariant:
        """Return a variant of the study in a file; InputError where no whole poses were measured by one noise each."""
        chosen, inputs = choose_variant(config, path, choice), load_inputs(config, path.parent)
        if not inputs.measured.has_poses:
            raise InputError(
                f"{path}: data: found poses measured in part, points, or frames to be found, expected whole poses in "
                "known frames, since audits and checks of data start from these"
            )
        posterior = inputs.posterior(chosen, with_model_error)
        _check_noise(posterior, path)
        left = inputs.matrix_variance(chosen, verification=False)
        priors, fixed = inputs.priors(chosen)
        return MeasuredVariant(
            name=chosen.name,
            origin=f"{config.data.origin}: study {config.name}, variant {chosen.name}",
            mechanism=path.parent / config.mechanism,
            free=tuple(chosen.free),
            machine=inputs.machine(chosen),
            priors=priors,
            fixed=fixed,
            posterior=posterior,
            poses=inputs.poses(verification=False),
            actuator_noise=config.data.actuator_noise_um * MICROMETRE,
            left_variance=0.0 if left is None else float(left.mean()),
            actuator_variance=left,
            shared_errors=inputs.without_shared_errors(chosen.name)[1],
            described=inputs.measured.describe(),
            n_held_back=int(inputs.verification.sum()),
        )

    def list_variants(self, config: StudyConfig) -> dict[str, VariantChoice]:
        """Return the study's variants by their names."""
        return {
            one.name: VariantChoice(label_class(one.model), label_class(one.deformation), one.name)
            for one in config.variants
        }

    def calibrate(
        self, results: Results, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant of the study."""
        from bayescal.experiments.study.calibrated import calibrate_study

        config = self.config_of(results) if experiment is None else load_same(results, experiment, self.schema)
        return calibrate_study(results, config, variant, experiment, trust)

    def show_comparison(self, table: pd.DataFrame, console: Console) -> None:
        """Print variants of several studies ranked together."""
        show_comparison(table, console)

    def compare(self, results: Mapping[str, Results]) -> pd.DataFrame:
        """Return the variants of several studies of the same data, the largest log-evidence first."""
        rows, data = [], {}
        for name, one in results.items():
            try:
                data[name] = _identify_data(one.provenance)
                rows += [_describe_variant(name, variant, fit) for variant, fit in one.summary["variants"].items()]
            except (KeyError, TypeError, AttributeError) as error:
                raise InputError(f"{name}: is no study's results directory, {error} is missing") from error
        self.check_comparable(data)
        table = pd.DataFrame(rows).sort_values("log_evidence", ascending=False, ignore_index=True)
        table.insert(4, "difference", table["log_evidence"] - table["log_evidence"].max())
        return table


def choose_variant(config: StudyConfig, path: Path, choice: VariantChoice) -> VariantConfig:
    """Return the variant of a study that is wanted.

    Raises
    ------
    InputError
        Where there is none, or where several share model and deformation and none is named.
    """
    wanted = name_variant(choice.model, choice.deformation)
    alike = [one for one in config.variants if name_variant(one.model, one.deformation) == wanted]
    if not alike:
        known = ", ".join(dict.fromkeys(name_variant(one.model, one.deformation) for one in config.variants))
        raise InputError(f"{path}: variants: found no {wanted}, expected one of {known}")
    named = [one for one in alike if choice.name in (None, one.name)]
    names = ", ".join(repr(one.name) for one in alike)
    if not named:
        raise InputError(f"{path}: variants: found no {choice.name!r} of {wanted}, expected {names}")
    if len(named) > 1:
        raise InputError(f"{path}: variants: found {wanted} as {names}, expected data.variant with one of these names")
    return named[0]


def _identify_data(provenance: Mapping[str, Any]) -> dict[str, object]:
    """Return what makes two data sets the same: contents of the files and what is assumed of the noise."""
    config, files = provenance["config"], provenance["files"]
    data = {key: value for key, value in config["data"].items() if key != "origin"}
    return {key: files.get(value, value) if isinstance(value, str) else value for key, value in data.items()}


def _describe_variant(results: str, name: str, fit: Mapping[str, Any]) -> dict[str, object]:
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


def _check_noise(posterior: LegPosterior, path: Path) -> None:
    """Raise InputError for poses that may be blunders, which audits and checks do not have."""
    if posterior.errors.outliers.expected:
        raise InputError(f"{path}: found blunders, expected none: audits and checks have no poses that may be spoilt")
