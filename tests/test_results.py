"""Results for notebooks: tables, posteriors, HTML and axes of finished runs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import arviz
import matplotlib.axes
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayescal
from bayescal.errors import InputError
from bayescal.experiments.runner.results import Results, read_results
from bayescal.results import AuditResult, LoadedResults

RESULTS = Path(__file__).parents[1] / "results"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The committed telescope study with draws of one posterior, made up."""
    committed = shutil.ignore_patterns("posterior")  # a user-defined run has more
    folder = shutil.copytree(RESULTS / "telescope", tmp_path_factory.mktemp("loaded") / "telescope", ignore=committed)
    (folder / "posterior").mkdir()
    draws = xr.Dataset({"l": (("chain", "draw", "leg"), np.random.default_rng(1).normal(size=(4, 50, 6)))})
    tree = xr.DataTree.from_dict({"posterior": draws})
    tree.to_netcdf(folder / "posterior" / "six_pus-matrix.nc", engine="h5netcdf")
    return bayescal.load_results(folder)


@pytest.fixture(scope="module")
def audit():
    """The committed audit of the M2 hexapod, as far as it is committed."""
    folder = RESULTS / "audit_m2_hexapod"
    summary, provenance = (json.loads((folder / name).read_text()) for name in ("summary.json", "provenance.json"))
    table = pd.read_csv(folder / "tables" / "parameters.csv")
    return AuditResult(Results(summary, {"parameters": table}, {}, provenance, folder))


def test_a_study_has_variants_tables_and_predictions(study):
    assert isinstance(study, bayescal.StudyResult)
    assert len(study.variants) == 12
    assert study.best.name == study.summary["rankings"][0][0]
    assert study.ranking["log_evidence"].is_monotonic_decreasing
    assert {"variant", "pose"} <= set(study.predictions.columns)
    assert set(study.parameters["variant"]) == set(study.variants)


def test_posteriors_are_trees_that_arviz_takes(study):
    tree = study.posterior("six_pus/matrix")
    assert isinstance(tree, xr.DataTree)
    assert len(arviz.summary(tree)) == 6
    with pytest.raises(InputError, match="draws of 'beam/none'"):
        study.posterior("beam/none")
    with pytest.raises(InputError, match="mean 'six_pus/matrix'"):
        study.posterior("six_pus/matix")


def test_results_show_themselves(study, audit):
    html = study._repr_html_()
    assert study.summary["headline"].split(";")[0][:40] in html
    assert html.count("<table") == 2  # the ranking, and how accurate the tool is
    assert "stiffness/matrix" in html
    assert "stiffness/matrix" in repr(study)
    assert "posterior_sd" in audit._repr_html_()
    assert "&lt;" in LoadedResults(Results({"title": "a < b"}))._repr_html_()


def test_evidences_of_other_data_are_not_ranked_beside():
    hangprinter = bayescal.StudyResult(read_results(RESULTS / "hangprinter"))
    lead, other = hangprinter.summary["rankings"]
    assert hangprinter.variants == lead + other
    assert hangprinter.ranking["log_evidence"].idxmax() in other
    said = repr(hangprinter)
    assert lead[1] in said
    assert other[1] not in said
    assert re.search(f"uncertainty .*'{lead[0]}'", said)


def test_plots_return_axes(study, audit):
    axes = study.plot_parameters("six_pus/none")
    assert isinstance(axes, matplotlib.axes.Axes)
    assert study.plot_parameters(axes=axes) is axes
    assert isinstance(audit.plot_contraction(), matplotlib.axes.Axes)
