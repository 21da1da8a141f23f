"""Several free sets of one model and deformation: each has files, rows and a seed by its name, and stands on pages."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from efforts import searching_little
from refusals import line_of

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import RunOutcome, run_experiment, write_report
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.study.readings import fit_variant

pytestmark = pytest.mark.runs

JOINTS = """
[[variants]]
model = "six_pus"
deformation = "none"
name = "joints alone"
free = ["a_x"]

[[variants]]
model = "six_pus"
deformation = "none"
name = "lengths"
free = ["l"]

[sampler]"""
PRIOR = 'b_z = { prior = "fixed", offset = 0.0 }'


def write_study(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write a tiny study with two named variants beside its own, with some lines changed."""
    path = studies.write_tiny_study(folder)
    for old, new in (("\n[sampler]", JOINTS), (PRIOR, f'{PRIOR}\na_x = {{ prior = "normal", sd = 2.0 }}'), *changes):
        studies.edit(path, old, new)
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return write_study(
        tmp_path_factory.mktemp("free sets"), ("seed = 11", f'seed = 11\npublished_claims = "{studies.CLAIMS}"')
    )


@pytest.fixture(scope="module")
def result(path) -> RunOutcome:
    """Return the finished study of four variants, three of them of one model and deformation."""
    with searching_little():
        return run_experiment(load_experiment(path), path.parent, path.parent / "results", 1)


@pytest.fixture(scope="module")
def converged(result, tmp_path_factory) -> Path:
    """Return the results as if so little sampling had converged: what did not is compared nowhere."""
    folder = tmp_path_factory.mktemp("converged") / "results"
    shutil.copytree(result.out, folder)
    summary = json.loads((folder / "summary.json").read_text())
    for variant in summary["variants"].values():
        variant["converged"] = True
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


@pytest.fixture(scope="module")
def page(converged) -> str:
    return write_report(converged).read_text()


def test_every_variant_has_its_rows_and_files(result):
    names = {"six_pus/none", "six_pus/matrix", "joints alone", "lengths"}
    assert set(result.summary["variants"]) == set(result.summary["rankings"][0]) == names
    for table in ("variants", "parameters", "pose_errors"):
        assert set(pd.read_csv(result.out / "tables" / f"{table}.csv")["variant"]) == names, table
    stems = {"six_pus-none", "six_pus-matrix", "joints_alone", "lengths"}
    assert {file.stem for file in (result.out / "posterior").iterdir()} == stems
    joints = studies.read_posterior(result.out, "joints alone")
    assert {name.partition("[")[0] for name in joints} == {"a_x", "tau"}


def test_numbers_of_unnamed_variants_are_those_without_named_ones(path, tmp_path, search_little):
    alone = studies.load_study(studies.write_tiny_study(tmp_path))
    one, other = (fit_variant(inputs, "six_pus/none") for inputs in (alone, studies.load_study(path)))
    assert one.names == other.names
    assert (one.importance, one.bridge) == (other.importance, other.bridge)
    np.testing.assert_array_equal(one.draws, other.draws)
    np.testing.assert_array_equal(one.evaluated[TREE], other.evaluated[TREE])


def test_page_says_which_free_sets_are_told_apart(page):
    assert "joints alone" in page


def test_compare_ranks_named_variants_too(call, result, tmp_path):
    code, out, err = call("compare", result.out)
    assert code == 0, err
    assert "joints" in out


def test_claims_take_the_variants_without_names(result, tmp_path, no_pictures, search_little):
    path = studies.write_tiny_study(tmp_path)
    studies.edit(path, "seed = 11", f'seed = 11\npublished_claims = "{studies.CLAIMS}"')
    other = run_experiment(load_experiment(path), tmp_path, tmp_path / "out", 1)
    claims = [pd.read_csv(one.out / "tables" / "claims.csv") for one in (result, other)]
    pd.testing.assert_frame_equal(*claims)


def test_figures_tell_free_sets_apart(converged):
    from bayescal.experiments.runner.results import read_results
    from bayescal.experiments.study.page.errors import draw_error_bars
    from bayescal.experiments.study.page.results import StudyResults
    from bayescal.experiments.study.page.styles import assign_styles

    study = StudyResults.of(read_results(converged))
    styles = assign_styles(study)
    assert len({style.marker for style in styles.values()}) == 3
    assert len({(style.marker, style.colour) for style in styles.values()}) == 4
    assert styles["lengths"].label == "lengths"
    bars = draw_error_bars(study.table("pose_errors"), study.error_scales, styles, list(styles)).axes[0]
    assert [label.get_text() for label in bars.get_xticklabels()] == [
        *("6-PUS/none", "6-PUS/matrix", "“joints alone”", "lengths")
    ]
    assert study.split("lengths") == ("six_pus", "none")
    assert study.find_best("six_pus", "none") in ("six_pus/none", "lengths")
    assert study.find_best("six_pus", "linear") is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (('name = "lengths"\n', ""), "variant 'six_pus/none' is there twice, expected a name for each free set"),
        (('name = "lengths"', 'name = "joints alone"'), "variant 'joints alone' is there twice"),
        (
            ('name = "lengths"', 'name = "six_pus/none"'),
            "variant 'six_pus/none' is there twice, expected a name for each",
        ),
        (('name = "lengths"', 'name = "six_pus-none"'), "variants 'six_pus/none' and 'six_pus-none' would share their"),
        (('name = "lengths"', 'name = "Joints_alone"'), "variants 'joints alone' and 'Joints_alone' would share"),
        (('name = "lengths"', 'name = "../lengths"'), "variants.3: name: found '../lengths', expected"),
        (('name = "lengths"', 'name = " "'), "variants.3.name: found ' ', expected"),
    ],
)
def test_names_at_fault_are_told_in_one_line(tmp_path, change, expected):
    path = write_study(tmp_path, change)
    line = line_of(load_experiment, path)
    assert expected in line
    assert line.startswith(str(path))


# --- an audit of one of them -----------------------------------------------------------------------------------------

DESIGN = """
kind = "audit"
name = "audit_free_sets"
title = "Audit of a free set"
seed = 5

[data]
study = "study.toml"

[[variants]]
model = "six_pus"
deformation = "none"

[posterior]
draws = 0
"""


def read_design(folder: Path, *changes: tuple[str, str]):
    from bayescal.experiments.audit.design import load_audit, read_plans

    write_study(folder)
    design = folder / "design.toml"
    design.write_text(DESIGN)
    for old, new in changes:
        studies.edit(design, old, new)
    (plan,) = read_plans(load_audit(design), folder).values()
    return plan


@pytest.mark.parametrize(("name", "symbol"), [("joints alone", "a_x"), ("six_pus/none", "l"), ("lengths", "l")])
def test_an_audit_takes_a_variant_by_its_name(tmp_path, name, symbol):
    inputs = read_design(tmp_path, ("[[variants]]", f'variant = "{name}"\n[[variants]]'))
    assert {one.partition("[")[0] for one in inputs.names} == {symbol}
    assert inputs.maker.found.name == name


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ((), "found 'six_pus/none', 'joints alone', 'lengths', expected data.variant"),
        (
            (("[[variants]]", 'variant = "length"\n[[variants]]'),),
            "found no 'length', expected 'six_pus/none', 'joints alone', 'lengths'",
        ),
        (
            (("[[variants]]", 'variant = "lengths"\n[[variants]]'), ('deformation = "none"', 'deformation = "matrix"')),
            "found no 'lengths', expected 'six_pus/matrix'",
        ),
        (
            (("[[variants]]", 'variant = "lengths"\n[[variants]]\nfree = ["a_x"]'),),
            "variants.free: found with [data]",
        ),
    ],
)
def test_an_audit_of_no_or_several_variants_is_refused_in_one_line(tmp_path, changes, expected):
    assert expected in line_of(read_design, tmp_path, *changes)
