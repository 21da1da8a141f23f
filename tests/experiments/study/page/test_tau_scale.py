"""The block about the scale of the model error's prior: what to do, and how sure that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from made_up_results import read_study

from bayescal.experiments.frame import results as frame
from bayescal.experiments.study.page.build import build_page
from bayescal.experiments.study.page.evidence import show_tau_scale
from bayescal.report.blocks import Statement

OWN, OTHER = "pus/linear", "pus/none"


@pytest.fixture
def study(make_results):
    """Return a study of two variants whose model error's prior has a scale of 10 µm."""
    found = read_study(make_results())
    return replace(found, config={**found.config, "model_error": {"scale_um": 10.0}})


def add(study, leads):
    """Return the study with its first variant ahead by so many nats at each scale."""
    rows = [(name, scale, 100.0 + lead * (name == OWN)) for scale, lead in leads.items() for name in (OWN, OTHER)]
    table = pd.DataFrame(rows, columns=["variant", "tau_scale_um", "log_evidence"]).assign(efficiency=1.0, pareto_k=0.0)
    return replace(study, tables={**study.tables, "tau_scale": table})


def test_an_order_that_holds_at_every_scale_is_kept(study):
    statement, table = show_tau_scale(add(study, {1.0: 5.0, 10.0: 20.0, 100.0: 0.5}))
    assert statement.text.startswith("Keep the scale of τ's prior, 10 µm")
    assert "from 1 to 100 µm" in statement.text
    assert "are reliable" not in statement.text
    assert statement.level == "good"
    assert [cell.text for cell in table.rows[0]][1:] == ["105.0 (1)", "120.0 (1)", "100.5 (1)"]


def test_a_variant_that_is_overtaken_is_named_with_the_scale(study):
    statement, _ = show_tau_scale(add(study, {1.0: -3.0, 3.0: -8.0, 10.0: 20.0}))
    assert statement.text.startswith("State the scale of τ's prior with the order")
    assert "linear is ahead of" in statement.text
    assert "by 20.0 nat, at 3 µm behind by 8.0 nat" in statement.text
    assert statement.level == "warning"


def test_what_draws_cannot_tell_is_counted(study):
    statement, table = show_tau_scale(add(study, {1.0: np.nan, 10.0: 20.0}))
    assert "2 of 4 evidences are reliable" in statement.text
    assert statement.level == "plain"
    assert table.rows[0][1].text == "–"


def test_ties_are_no_order(study):
    assert show_tau_scale(add(study, {1.0: -9.0, 10.0: 0.5}))[0].text.startswith("Keep")


def test_the_stated_scale_stands_among_the_others(study):
    _, table = show_tau_scale(add(study, {1.0: 5.0, 100.0: 5.0}))
    assert [column.title for column in table.columns][1:] == ["1 µm", "10 µm", "100 µm"]


def test_without_the_table_there_is_no_block(study):
    assert not study.has("tau_scale")
    assert show_tau_scale(study) == []


def test_the_page_shows_it_with_the_evidence(study, make_results):
    results = frame.read_results(make_results(name="again"))
    tables = {**results.tables, "tau_scale": add(study, {1.0: 5.0, 10.0: 20.0}).table("tau_scale")}
    results.provenance["config"]["model_error"] = {"scale_um": 10.0}
    (evidence,) = (part for part in build_page(replace(results, tables=tables)).sections if part.anchor == "evidence")
    assert any(isinstance(block, Statement) and block.text.startswith("Keep the scale") for block in evidence.blocks)
