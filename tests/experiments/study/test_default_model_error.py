"""Studies of legs that are silent on their model error: all terms, by every instrument; floors; what is refused."""

import re

import numpy as np
import pytest
import studies
from experiments.study.test_instrument_study import FRAMES, write_points

from bayescal.density.functions import FunctionLikelihood
from bayescal.density.sorts import SORTS
from bayescal.errors import InputError
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.run import compute_experiment
from bayescal.experiments.shared.study_inputs import Task
from bayescal.experiments.study.fit import Legs
from bayescal.experiments.study.tables import format_poses

SCALES = ["tau", *(f"sigma_{name}" for name in SORTS)]
NAME = "six_pus/none"


def write_silent(folder, instrument="targets"):
    """Write a tiny study of one variant without a word on its model error."""
    config = write_points(folder) if instrument == "points" else studies.write_tiny_study(folder)
    text = re.sub(r"\[model_error\]\n.*?\n\n", "", config.read_text(), flags=re.DOTALL)
    text = re.sub(r"kappa = \{.*\n", "", text).replace("steps = 10", "steps = 6")
    first, second = (one.start() for one in re.finditer(r"\[\[variants\]\]", text))
    text = text[:second] + text[text.index("[sampler]") :]
    if instrument in ("poses", "positions"):
        lines = format_poses(studies.load_study(folder / "study.toml")).splitlines()
        head = next(line for line in lines if line.startswith("pose,")).split(",")
        kept = [k for k, name in enumerate(head) if instrument == "poses" or not re.search(r"r[xyz]", name)]
        rows = [line if line.startswith("#") else ",".join(line.split(",")[k] for k in kept) for line in lines]
        (folder / "data" / "poses.csv").write_text("\n".join(rows) + "\n")
        text = text.replace(studies.BY_TARGETS, studies.BY_POSES)
        if instrument == "positions":
            text = text.replace("[parameters]\n", FRAMES + "[parameters]\n")
    config.write_text(text)
    assert first
    return config


@pytest.fixture(scope="module")
def silent(tmp_path_factory):
    return write_silent(tmp_path_factory.mktemp("silent"))


def edited(config, of_variant="", **sections):
    """Write a copy of a study with more sections beside it, and of its first variant, and return it."""
    path = config.with_name(f"{'-'.join(sections) or 'edited'}.toml")
    more = "".join(f"[{name}]\n{text}\n" for name, text in sections.items())
    path.write_text(config.read_text().replace("[[variants]]", f"{more}\n[[variants]]\n{of_variant}", 1))
    return path


@pytest.mark.runs
@pytest.mark.parametrize("instrument", ["targets", "poses", "positions", "points"])
def test_every_instrument_tells_the_terms(instrument, tmp_path):
    config = write_silent(tmp_path, instrument)
    inputs = studies.load_study(config)
    results = compute_experiment(load_experiment(config), tmp_path)
    legs, names = [f"leg {k}" for k in range(1, 7)], list(inputs.names)
    terms = results.table("model_error")
    assert list(terms["term"]) == ["independent", *SORTS, "together"]
    assert (terms["q05_um"] <= terms["median_um"]).all()
    assert (terms["median_um"] <= terms["q95_um"]).all()
    # but for points the twin has a deformation matrix of some 1e-3, which the machine of the variant lacks
    deformed = instrument != "points"
    assert (terms.set_index("term").loc[list(SORTS), "q95_um"].max() > 10.0) == deformed
    members = results.table("model_error_members")
    assert list(members["member"]) == [leg for leg in legs for _ in SORTS]
    assert list(members["term"]) == list(SORTS) * 6
    assert (members["rms_um"] >= 0.0).all()
    poses = results.table("model_error_poses")
    assert list(poses["pose"]) == [name for name in names for _ in legs]
    assert list(poses["use"] == "verification") == [held for held in inputs.verification for _ in legs]
    assert ((poses["low_um"] < poses["mean_um"]) & (poses["mean_um"] < poses["high_um"])).all()
    found = results.table("parameters").query("model_error == 'free'")["parameter"]
    assert list(found)[-5:] == SCALES
    fit = results.summary["variants"][NAME]
    assert fit["n_parameters"] == fit["without_model_error"]["n_parameters"] + 5
    assert ("exact_density_shift" in fit) == (instrument in ("targets", "poses"))
    gain = fit["log_evidence"] - fit["without_model_error"]["log_evidence"]
    assert gain > 10.0 if deformed else -30.0 < gain < 0.0
    assert (fit["elpd"] > fit["without_model_error"]["elpd"]) == deformed
    assert 0.6 < fit["verification"]["interval_90_coverage"] <= 1.0
    pits = results.table("poses")
    pits = pits[pits["model_error"] == "free"]
    seen = "x_pit" if instrument != "points" else "position_pit"
    assert pits[seen].between(0.0, 1.0).all()
    own = results.table("errors")
    size = np.sqrt((poses["mean_um"] ** 2).mean())
    assert (1e3 * own["model_error"] > 0.3 * size).all()
    # the mean of all functions is not larger than they are themselves
    used = poses[poses["use"] == "calibration"]
    together = terms.set_index("term").loc["together"]
    assert np.sqrt((used["mean_um"] ** 2).mean()) < together["q95_um"]
    assert np.sqrt((1e6 * own["model_error"] ** 2).mean()) > together["q05_um"]


def test_functions_stand_where_no_term_is_named(silent):
    inputs = studies.load_study(silent)
    posterior = inputs.posterior(inputs.config.variants[0], with_model_error=True)
    assert isinstance(posterior.likelihood, FunctionLikelihood)
    assert list(posterior.names[-5:]) == SCALES
    # places in the order of the table, held-back poses counted
    expected = np.flatnonzero(~inputs.verification) / len(inputs.names)
    assert posterior.likelihood.place.time == pytest.approx(expected)
    plain = inputs.posterior(inputs.config.variants[0], with_model_error=False)
    assert not isinstance(plain.likelihood, FunctionLikelihood)
    assert plain.errors.n_parameters == 0


def test_chosen_terms_alone_are_there(silent):
    path = edited(silent, model_error='terms = ["linear", "drift"]\nat_least_um = { linear = 7.0 }')
    inputs = studies.load_study(path)
    posterior = inputs.posterior(inputs.config.variants[0], with_model_error=True)
    assert list(posterior.names[-2:]) == ["sigma_linear", "sigma_drift"]
    amplitudes = posterior.errors.amplitudes(np.full(2, -30.0))
    assert amplitudes == pytest.approx([0.0] * 6 + [7e-3, 0.0], abs=1e-12)


@pytest.mark.runs
def test_no_model_error_is_one_task_of_each_variant(silent):
    path = edited(silent, model_error="terms = []")
    inputs = studies.load_study(path)
    assert inputs.list_tasks() == [Task(NAME)]
    results = compute_experiment(load_experiment(path), path.parent)
    assert "without_model_error" not in results.summary["variants"][NAME]
    assert "model_error" not in results.tables
    assert set(results.table("parameters")["model_error"]) == {"free"}
    assert (results.table("errors")["model_error"] == 0.0).all()


@pytest.mark.runs
def test_beside_variants_with_a_model_error_one_without_stands_for_both(silent, tmp_path):
    text = silent.read_text()
    start, stop = text.index("[[variants]]"), text.index("[sampler]")
    other = text[start:stop].replace('deformation = "none"', 'deformation = "none"\nname = "bare"\nmodel_error = []')
    path = silent.with_name("both.toml")
    path.write_text(text[:stop] + other + text[stop:])
    inputs = studies.load_study(path)
    assert inputs.list_tasks() == [Task(NAME), Task("bare"), Task(NAME, False)]
    results = compute_experiment(load_experiment(path), path.parent)
    bare = results.summary["variants"]["bare"]
    assert bare["without_model_error"]["log_evidence"] == bare["log_evidence"]
    rows = results.table("parameters")
    assert list(dict.fromkeys(zip(rows["variant"], rows["model_error"], strict=True))) == [
        (NAME, "free"),
        ("bare", "free"),
        (NAME, "zero"),
        ("bare", "zero"),
    ]
    assert set(results.table("model_error")["variant"]) == {NAME}


def test_misfit_counts_functions_as_noise(silent):
    inputs = studies.load_study(silent)
    legs = Legs(inputs, Task(NAME))
    posterior = legs.posterior
    y = posterior.approach()
    rows = (~inputs.verification).sum() * 6
    y[posterior.n_geometry :] = [-1.0, 1.0, 1.0, 1.0, 1.0]
    found = legs.measure_misfit(posterior, posterior.polish(y))
    bare = Legs(inputs, Task(NAME, False))
    alone = bare.measure_misfit(bare.posterior, bare.posterior.approach())
    assert found.value / found.dof < 1.5
    assert alone.value / alone.dof > 10.0
    assert found.dof == pytest.approx(rows - 6.0, abs=0.5)


@pytest.mark.parametrize(
    ("sections", "fault"),
    [
        (
            {"of_variant": "outlier_share = 0.02", "model_error": 'terms = ["independent", "own"]'},
            r"outlier_share: found it beside the terms own .* terms = \[\"indep",
        ),
        (
            {"model_error": 'terms = ["independent"]\nat_least_um = 10.0'},
            r"model_error.at_least_um: found 10 with the terms \['independent'\], expected some of \['linear', 'own'",
        ),
        (
            {"model_error": "at_least_um = 4000.0"},
            r"model_error.at_least_um: found .* for 'linear', .* tolerance, 2000 µm",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(silent, sections, fault):
    with pytest.raises(InputError, match=fault) as caught:
        studies.load_study(edited(silent, **sections))
    assert "\n" not in str(caught.value)


def test_poses_that_memory_cannot_hold_are_refused_before_their_columns_are_made(silent, monkeypatch):
    inputs = studies.load_study(silent)
    variant = inputs.config.variants[0]
    base = inputs.likelihood(variant, verification=False)
    monkeypatch.setattr("bayescal.experiments.frame.memory.measure_available", lambda: 1e6)
    monkeypatch.setattr("bayescal.experiments.study.inputs.FunctionLikelihood", None)
    with pytest.raises(
        InputError, match=r"13 calibration poses with errors that .* fewer poses or \[model_error\] with"
    ):
        inputs.give_functions(base, variant)


def test_beside_outliers_tau_alone_is_left_and_said(silent):
    inputs = studies.load_study(edited(silent, of_variant="outlier_share = 0.02"))
    names = inputs.posterior(inputs.config.variants[0], with_model_error=True).names
    assert set(SCALES) & set(names) == {"tau"}
    assert "the model error has no terms linear, own, smooth, drift, as each pose may be an outlier" in inputs.unused


def test_terms_that_too_few_poses_cannot_show_are_left_out_and_said(silent):
    path = silent.with_name("few.toml")
    table = silent.parent / "data" / "actuators.csv"
    lines = table.read_text().splitlines()
    kept, used = [], 0
    for line in lines:
        used += ",calibration," in line
        kept.append(line.replace(",calibration,", ",verification,") if used > 2 else line)
    (silent.parent / "data" / "few.csv").write_text("\n".join(kept) + "\n")
    path.write_text(silent.read_text().replace("data/actuators.csv", "data/few.csv"))
    inputs = studies.load_study(path)
    posterior = inputs.posterior(inputs.config.variants[0], with_model_error=True)
    assert posterior.names[-1] == "tau"
    said = "the model error has no terms linear, own, smooth, drift, as fewer than 3 poses calibrate the machine"
    assert said in inputs.unused
    assert any(said in line for line in inputs.outlook())
    assert not studies.load_study(silent).unused
    named = edited(path, model_error='terms = ["own"]')
    with pytest.raises(InputError, match=r"found term 'own', but fewer than 3 poses calibrate the machine, expected"):
        studies.load_study(named)
