"""Errors that a config names in [error_terms]: functions, and terms of custom classes."""

from __future__ import annotations

import json

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.shared.readings.knowledge import inform, see
from bayescal.report.pictures import Picture

OWN = '''
"""Errors of a delta printer's own: a drift that wanders, and noise that grows away from the middle."""

import numpy as np

from bayescal.config.sections import Positive, Section
from bayescal.density.calibration.terms import ErrorTerm
from bayescal.density.priors import HalfNormalPrior


class WanderConfig(Section):
    scale_mm: Positive


class Wander(ErrorTerm):
    """All carriages drift together by a random walk from row to row."""

    Config = WanderConfig

    def __init__(self, config, rows):
        self.names, self.units = (f"wander({rows.name})",), ("mm",)
        self.priors = (HalfNormalPrior(config.scale_mm),)
        self.own = rows.select(["s"])

    def columns(self, zeta, data):
        steps = np.tril(np.ones((24, 24)))[np.minimum(data.order, 23)] / 5.0
        found = np.zeros((len(zeta), data.n_poses, data.sd.shape[1], 24))
        found[:, :, self.own] = self.natural(zeta)[:, 0, None, None, None] * steps[:, None]
        return found


class Edge(ErrorTerm):
    """Noise that grows with a channel's distance from its middle."""

    names, units, priors = ("edge",), ("mm",), (HalfNormalPrior(0.01),)

    def __init__(self, config, rows):
        self.home, self.reach = rows.home, rows.reach

    def variance(self, zeta, data):
        away = np.where(data.present, (data.values - self.home) / self.reach, 0.0)
        return (self.natural(zeta)[:, 0, None, None] * away) ** 2


class Short(Edge):
    units = ()


class Both(Edge):
    def factor(self, zeta):
        return np.ones((len(zeta), 3))


class Failing(Edge):
    def variance(self, zeta, data):
        return data.nothing
'''
TERMS = """
[error_terms.wander]
kind = "own_errors.py:Wander"
scale_mm = 0.01

[error_terms.edge]
kind = "own_errors.py:Edge"

[error_terms.motors]
channels = ["s"]
kernel = "quadratic"
scale_um = 20.0
shared = false

[error_terms.drift]
channels = ["s"]
input = "order"
scale_um = 5.0

[error_terms.bed]
channels = ["s"]
input = "commands"
log_length_scale_sd = 0.2
scale_um = 5.0
"""


def write(folder, terms=TERMS):
    path = calibrations.write_delta(folder)
    (path.parent / "own_errors.py").write_text(OWN)
    path.write_text(path.read_text() + terms)
    return path


def read(path):
    config = load(path)[1]
    return read_inputs(config, path.parent)


@pytest.mark.runs
@pytest.mark.parametrize("outliers", ["student_t_dof = 4.0", "outlier_fraction = 0.05"])
def test_all_terms_hold_together_and_have_their_gradient(outliers, tmp_path, rng):
    """Own terms, functions of three inputs, unknown noise and outliers: slopes are those of differences."""
    path = write(tmp_path)
    calibrations.change(path, 'name = "all"', f'name = "all"\n{outliers}')
    posterior = read(path).variants["all"].posterior().with_pose_guesses()
    expected = ("wander(wander)", "edge", *(f"sigma_g(motors, s[{k}])" for k in (1, 2, 3)))
    terms = [name for name in posterior.errors.names if name != "epsilon"]
    assert terms[-8:] == [*expected, "sigma_g(drift)", "sigma_g(bed)", "L_g(bed)"]
    assert (posterior.names[-1] == "epsilon") == ("fraction" in outliers)
    y = posterior.least_squares_start() + 0.05 * rng.standard_normal(posterior.n_parameters)
    gradient, hessian = posterior.gradient(y)
    assert (np.linalg.eigvalsh(-hessian) > 0.0).all()
    moves = 1e-3 * np.eye(len(y))
    values = [posterior.log_density(y + times * moves) for times in (-2.0, -1.0, 1.0, 2.0)]
    differences = (8.0 * (values[2] - values[1]) - (values[3] - values[0])) / 12e-3
    np.testing.assert_allclose(gradient, differences, rtol=1e-4, atol=2e-2)
    assert np.isfinite(posterior.pointwise(y[None])).all()


def test_variants_choose_their_errors_by_name(tmp_path):
    path = write(tmp_path)
    calibrations.change(path, 'name = "all"', 'name = "all"\nerror_terms = ["drift", "edge"]')
    variants = read(path).variants
    assert variants["all"].errors.names[-2:] == ("edge", "sigma_g(drift)")
    others = next(one for name, one in variants.items() if name != "all")
    assert "wander(wander)" in others.errors.names


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('channels = ["s"]\nkernel', 'channels = ["sx"]\nkernel', "found channel 'sx', expected one of"),
        ("scale_um = 20.0", "scale_arcsec = 20.0", "found scale_arcsec for s.1., which reads in mm, expected scale_um"),
        ("scale_um = 20.0", "scale_um = 20.0\nscale_mm = 1.0", "found scale_um and scale_mm, expected one of scale"),
        (
            'kernel = "quadratic"',
            'kernel = "smooth"\nlength_scale = 0.01',
            "found smooth errors of length 0.01",
        ),
        ("own_errors.py:Wander", "own_errors.py:Wanderer", "Wanderer"),
        ("scale_mm = 0.01", "scale_m = 0.01", "scale_m"),
        ("own_errors.py:Edge", "own_errors.py:Short", "error_terms.edge: found 0 units for 1 names, expected one each"),
        ("own_errors.py:Edge", "own_errors.py:Both", "error_terms.edge: .*factor, variance"),
        ("own_errors.py:Edge", "own_errors.py:Failing", "fails with AttributeError"),
        (
            'name = "all"',
            'name = "all"\nerror_terms = ["drfit"]',
            "error_terms: found 'drfit', expected one of wander, edge, motors",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, old, new, message):
    path = write(tmp_path)
    calibrations.change(path, old, new)
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_verdicts_hold_beside_errors_that_the_geometry_imitates(tmp_path):
    """Carriages that all may be off by functions of what they read leave less to know of the machine."""
    path = write(tmp_path, TERMS[TERMS.index("[error_terms.motors]") : TERMS.index("[error_terms.drift]")])
    calibrations.change(path, "scale_um = 20.0", "scale_mm = 1.0")
    calibrations.change(path, 'name = "one_rod"', 'name = "one_rod"\nerror_terms = []')
    calibrations.change(path, 'tied = ["l"]', "")
    inputs = read(path)
    left = {}
    for name, variant in inputs.variants.items():
        posterior = variant.posterior().with_pose_guesses()
        y = posterior.least_squares_start()
        left[name] = 1.0 - inform(posterior, y, see(posterior, y)).contraction
    assert (left["all"] > (1.0 - 1e-9) * left["one_rod"]).all()
    assert (left["all"] > 1.2 * left["one_rod"]).any()


@pytest.mark.runs
def test_an_own_term_and_functions_run_to_a_page(tmp_path, monkeypatch):
    monkeypatch.setattr("bayescal.report.page.render_picture", lambda draw: Picture(b"not drawn"))
    path = write(tmp_path, TERMS.partition("[error_terms.drift]")[0].replace("quadratic", "linear"))
    text = path.read_text()
    path.write_text(text.replace(text[text.index('[[variants]]\nname = "one_rod"') : text.index("[sampler]")], ""))
    run_experiment(load(path)[1], path.parent, tmp_path / "out")
    found = pd.read_csv(tmp_path / "out" / "tables" / "functions.csv")
    assert set(found["sensor"]) == {f"s[{k}]" for k in (1, 2, 3)}
    assert found["probability_present"].between(0.0, 1.0).all()
    assert set(pd.read_csv(tmp_path / "out" / "tables" / "function_curves.csv")["input"]) == {"reading"}
    provenance = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert "own_errors.py" in provenance["files"]
    names = set(pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv")["parameter"])
    assert {"wander(wander)", "edge", "sigma_g(motors, s[1])"} <= names
    assert "<h2>Systematic" in (tmp_path / "out" / "report.html").read_text()
