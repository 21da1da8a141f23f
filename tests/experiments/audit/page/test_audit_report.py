"""The report of an audit: the verdict follows the numbers, the page is whole, escaped and says what it lacks."""

from __future__ import annotations

import json
import re
import warnings
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from html_reader import Reader
from made_up_audit import OPTIONAL, describe_audit, make_audit_results, tabulate_rows, write_audit_results
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bayescal.experiments.audit.page.build import build_page
from bayescal.experiments.audit.page.figures import span_profile
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.tables import (
    build_ridges,
    tabulate_audit,
    tabulate_changes,
    tabulate_requirements,
    tabulate_ridge_help,
    tabulate_sets,
    tabulate_simulated,
    tabulate_symbols,
)
from bayescal.experiments.audit.page.verdict import (
    describe_determined,
    list_failures,
    rank_help,
    state_headline,
    state_verdict,
)
from bayescal.experiments.audit.page.wording import (
    format_contraction,
    format_fixed_span,
    format_probability,
    format_share,
    list_names,
)
from bayescal.experiments.runner.results import read_results
from bayescal.report.page import make_prose, write_page
from bayescal.report.pictures import render_picture

pytestmark = pytest.mark.runs

SECTIONS = (
    *("verdict", "parameters", "ridges", "selection", "requirements", "changes", "sweeps", "profiles", "draws"),
    *("simulated", "method"),
)


def make(change=None, planned=(9.0, 9.0, 9.0, 0.2, 0.0, 0.0, 0.0)) -> AuditResults:
    """Return a made-up audit; of its tables only what the plan tells of each combination."""
    summary = describe_audit()
    if change is not None:
        change(summary)
    return AuditResults(summary, {"spectrum": pd.DataFrame({"planned": planned}), **tabulate_rows(summary)})


def write_audit_report(folder: Path) -> Path:
    """Write the page of an audit's directory and return it."""
    return write_page(build_page(read_results(folder)), folder)


def read_audit(folder: Path) -> AuditResults:
    return AuditResults.of(read_results(folder))


def put(changes):
    """Return what puts values at keys of keys; an object that is there keeps what is not named."""

    def change(summary):
        for key, value in changes.items():
            *way, last = (int(part) if part.isdigit() else part for part in key.split("/"))
            place = reduce(getitem, way, summary)
            now = place[last] if isinstance(place, list) else place.get(last)
            place[last] = {**now, **value} if isinstance(now, dict) and value else value

    return change


def find(results: AuditResults, lead: str) -> list[tuple[str, float]]:
    """Return level and value of the findings of a subject."""
    return [(one.level, one.value) for one in state_verdict(results) if one.lead == lead]


# --- the page --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("checks", [False, True])
def test_the_page_is_whole_and_the_verdict_comes_first(tmp_path, checks, no_pictures):
    page = write_audit_report(write_audit_results(tmp_path, checks=checks))
    text = page.read_text(encoding="utf-8")
    reader = Reader(text)
    assert page.name == "report.html"
    assert reader.open == []
    assert reader.pictures == (8 if checks else 5)
    assert all(r.startswith(("data:image/png;base64,", "#")) for r in reader.references)
    assert reader.tags.count("script") == 1
    assert not {"link", "iframe"} & set(reader.tags)
    places = [text.index(f'id="{name}"') for name in SECTIONS]
    assert places == sorted(places)
    assert {r[1:] for r in reader.references if r.startswith("#")} <= set(re.findall(r'id="([^"]+)"', text))
    assert not list(page.parent.glob("*.tmp"))


def test_what_is_missing_is_said_to_be_left_out(tmp_path):
    results = make_audit_results()
    for name in OPTIONAL:
        results.tables.pop(name, None)
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "profiles.png").write_bytes(b"of an earlier report")
    earlier = ["figures/profiles.png"]
    text = write_page(build_page(results), tmp_path, earlier=earlier).read_text(encoding="utf-8")
    reasons = ("nothing was swept", "no profiles requested", "no posterior draws")
    for reason in reasons:
        assert text.count(f"Figure left out: {reason}.") == 1
    assert not (tmp_path / "figures" / "profiles.png").exists()
    assert Reader(text).pictures == 4


def test_without_requirements_and_changes_the_page_says_so(tmp_path, no_pictures):
    def change(summary):
        summary |= {"requirements": {}, "scenarios": [], "selection": []}
        for direction in summary["directions"]:
            direction |= {"effect_on_pose": "unknown", "sd_over_limit": None, "limit": ""}

    text = write_audit_report(write_audit_results(tmp_path, change)).read_text(encoding="utf-8")
    reasons = re.findall(r"Figure left out: ([^<]*)\.<", text)
    assert {"no requirement given", "no other plan"} <= set(reasons)


def test_text_from_the_design_is_escaped(tmp_path, pictures):
    attack = "<script>alert('x')</script> & \"$_^{ $\" <b>"

    def change(summary):
        summary["title"] = summary["machine"] = summary["name"] = summary["posterior"]["origin"] = attack
        summary["plan"]["sensors"] = [attack]
        summary["scenarios"][1]["name"] = attack
        summary["directions"][0]["sentence"] = attack
        summary["parameters"]["l[1]"]["reason"] = summary["parameters"]["l[1]"]["unit"] = attack
        summary["directions"][1]["plot"]["formula"] = attack
        summary["requirements"][attack] = summary["requirements"].pop("x")
        for one in summary["scenarios"][:3]:
            one["requirements"][attack] = one["requirements"]["x"]

    text = write_audit_report(write_audit_results(tmp_path, change, checks=True)).read_text(encoding="utf-8")
    reader = Reader(text)
    assert reader.tags.count("script") == 1
    assert "b" not in reader.tags
    assert text.count("&lt;script&gt;") >= 8


def test_ridges_of_a_kind_stand_together_and_are_open_in_print(tmp_path, no_pictures):
    blocks = build_ridges(make())
    assert [(b.symbol, b.where, len(b.more)) for b in blocks] == [
        *(("k1_d", "machine", 0), ("rho0", "legs 1, 2", 1), ("l", "leg 1", 0)),
    ]
    assert [mark.level for mark in blocks[1].marks] == ["bad", "good"]  # never seen, and harmless
    assert "Contraction 0.05." in blocks[2].facts
    assert any("better camera" in fact and "0.45" in fact for fact in blocks[2].facts)
    assert any("0.000020 mm and 2.0e−6°" in fact for fact in blocks[2].facts)
    text = write_audit_report(write_audit_results(tmp_path)).read_text(encoding="utf-8")
    folded = text[text.index("1 more") :]
    assert "Leg 2: changing <i>ρ</i><sup>0</sup>" in folded[: folded.index("</details>")]
    assert "details::details-content { content-visibility: visible" in text


# --- the verdict -----------------------------------------------------------------------------------------------------


def count_determined(results: AuditResults) -> list[int]:
    """Return the numbers of what is said to be determined."""
    return list(map(int, re.findall(r"\d+", describe_determined(results))))


def test_the_headline_counts_what_is_determined():
    assert count_determined(make()) == [40, 2, 7, 3, 1]

    def know_all(summary):
        summary["directions"] = [d for d in summary["directions"] if d["kind"] == "informed"]
        for parameter in summary["parameters"].values():
            parameter["verdict"] = "identifiable"

    assert count_determined(make(know_all, [9.0] * 7)) == [40, 7, 7]

    def know_nothing(summary):
        summary["plan"]["n_verification_poses"] = 0
        summary["directions"][3]["contraction"] = 0.5
        for parameter in summary["parameters"].values():
            parameter["verdict"] = "weak"

    assert count_determined(make(know_nothing, [9.0, 9.0, 9.0, 1.0, 0.0, 0.0, 0.0])) == [40, 0, 7, 3, 1]


def test_the_headline_says_whether_the_requirements_are_met():
    audit = make()
    assert describe_determined(audit) in state_headline(audit)
    assert "requirements pass" in state_headline(audit).lower()
    none = make(lambda summary: summary.update(requirements={}))
    assert "[requirements]" in state_headline(none)


FAILED = {"probability": 0.4, "predicted_sd": 0.08, "parameter_sd": 0.02}
FAR = {"channels": ["rho[1]", "rho[2]"], "reading_mm": 731.2, "moved_mm": 0.3656}
DRAWN = {"origin": "here", "n_draws": 4000, "converged": True, "parameters": {}}
SAID = [
    ({}, "Parameters", "warning", 3.0),
    ({}, "Unidentifiable combinations", "good", 0.004),
    ({}, "Requirements", "good", 0.999),
    ({}, "Requirements", "plain", 0.04),
    (
        {"directions/3": {"effect_on_pose": "harmful", "sd_over_limit": 2.3}},
        "Unidentifiable combinations",
        "bad",
        2.3,
    ),
    (
        {"directions/3": {"effect_on_pose": "noticeable", "sd_over_limit": 0.3}},
        "Unidentifiable combinations",
        "warning",
        0.3,
    ),
    ({"requirements/x": FAILED}, "Requirements", "bad", 0.4),
    ({"requirements/x": FAILED}, "Requirements", "bad", 0.8),
    ({"total_nats": 44.0}, "Design alternatives", "plain", 45.0),
    ({"posterior": DRAWN | {"principal_angle_deg": 2.5}}, "Posterior draws", "good", 2.5),
    ({"posterior": DRAWN | {"principal_angle_deg": 30.0}}, "Posterior draws", "warning", 30.0),
    ({"far_readings": FAR}, "Actuators' zero", "plain", 731.2),
    ({"structural_rank_elsewhere": 5}, "Symmetry", "warning", 4.0),
    ({}, "Reduced set", "warning", 86.0),
]


@pytest.mark.parametrize(("changes", "lead", "level", "value"), SAID)
def test_findings_follow_the_numbers(changes, lead, level, value):
    found = find(make(put(changes)), lead)
    assert (level, pytest.approx(value, rel=0.02)) in found, found


def test_nothing_is_said_of_what_is_not_there():
    leads = {"Parameters", "Unidentifiable combinations", "Requirements", "Design alternatives", "Reduced set"}
    assert {one.lead for one in state_verdict(make(put({"structural_rank_elsewhere": 4})))} == leads
    assert list_failures(make()) == []


def test_a_requirement_that_is_not_met_is_seen_at_once(tmp_path, no_pictures):
    page = write_audit_report(write_audit_results(tmp_path, put({"requirements/x": FAILED})))
    assert 'class="verdict bad"' in page.read_text(encoding="utf-8")


def test_help_is_ranked_by_nats_and_by_the_requirement_at_risk():
    more, better = "twice the poses", "better camera"
    assert [one.name for one, _ in rank_help(make())] == [better, more]
    assert rank_help(make(), beyond_range=True)[0][0].name == "longer strokes"
    assert find(make(), "Design alternatives") == [("plain", 45.0)]

    def change(summary):
        summary["requirements"]["x"] |= FAILED
        summary["scenarios"][0]["requirements"]["x"] = 0.03
        summary["scenarios"][1]["requirements"]["x"] = 0.05

    assert [one.name for one, _ in rank_help(make(change))] == [more, better]


def test_doubt_about_rank_and_draws_opens_the_page(tmp_path, no_pictures):
    def change(summary):
        summary |= {"structural_rank_is_clear": False, "structural_gap": 3.0}
        summary["posterior"]["converged"] = False

    text = write_audit_report(write_audit_results(tmp_path, change, checks=True)).read_text(encoding="utf-8")
    places = [text.index(s) for s in ("is unclear", "not converged", 'headline"')]
    assert places == sorted(places)


@pytest.mark.parametrize(("ratio", "se", "level"), [(1.02, 0.003, "good"), (1.06, 0.01, "warning"), (1.4, 0.2, "good")])
def test_simulated_calibrations_bear_the_prediction_out_or_not(ratio, se, level):
    def change(summary):
        one = {"predicted_sd": 0.1, "simulated_sd": 0.1 * ratio, "ratio": ratio, "ratio_se": se, "unit": "mm"}
        whole = {"n": 200, "n_converged": 200, "coverage_90": 0.9, "requirements": {}}
        summary["simulated_calibrations"] = whole | {"symbols": {"l": one}}

    assert (level, ratio) in find(make(change), "Simulated calibrations")


def test_without_anything_left_out_there_is_no_reduced_set():
    def change(summary):
        summary["reduced_set"] = None
        for parameter in summary["parameters"].values():
            parameter |= {"reduced_set": False, "reduced_claimed_sd": np.nan, "reduced_true_error": np.nan}

    assert not find(make(change), "Reduced set")
    assert tabulate_sets(make(change)) is None


def test_both_sets_are_compared():
    table = tabulate_sets(make())
    rows = {row[0].text: [cell.text for cell in row] for row in table.rows}
    assert rows["l"][2:] == ["2.0", "1.5", "1.5", "90 %", "0.020", "1.3", "2 %"]
    assert rows["rho0"][-3:] == ["nominal", "2.0", "–"]


def test_simulated_calibrations_of_both_sets_stand_side_by_side(tmp_path):
    def change(summary):
        off = json.loads(json.dumps(summary["simulated_calibrations"]))
        summary["simulated_calibrations_reduced"] = off | {"coverage_90": 0.2, "rms_z": 74.0}

    results = read_audit(write_audit_results(tmp_path, change, checks=True))
    assert ("good", pytest.approx(0.89, abs=5e-3)) in find(results, "Simulated calibrations")
    tables = tabulate_simulated(results)
    assert len({table.caption.split("; ")[1] for table in tables}) == 2
    assert re.findall(r"\d+(?:\.\d+)?", tables[1].notes[0].text)[1:3] == ["20", "74.0"]
    assert re.findall(r"\d+", tables[0].notes[1].text) == ["200", "200", "198", "200"]


def test_requirements_met_less_often_than_claimed_are_a_warning(tmp_path):
    change = put({"simulated_calibrations/requirements/x": {"kept": 150, "agrees": False}})
    found = find(read_audit(write_audit_results(tmp_path, change, checks=True)), "Simulated calibrations")
    assert ("warning", 150) in found


def test_draws_that_break_a_requirement_are_bad_news(tmp_path):
    drawn = {"x": {"probability": 0.3}, "rx": {"probability": 0.99}}
    results = read_audit(write_audit_results(tmp_path, put({"posterior/requirements": drawn}), checks=True))
    assert [one for one in find(results, "Posterior draws") if one[0] == "bad"] == [("bad", 0.3)]
    rows = tabulate_requirements(results).rows
    assert [[row[k].text for k in (-4, -2, -1)] for row in rows] == [
        [">99.9 %", "30 %", "not reliably"],
        ["99.9 %", "99.0 %", "yes"],
    ]


def test_data_show_their_origin_and_draws_left_out_their_reason(tmp_path, no_pictures):
    measured = write_audit_results(tmp_path, put({"plan/n_verification_poses": 0}), checks=True)
    text = write_audit_report(measured).read_text(encoding="utf-8")
    assert "<strong>Data origin</strong> simulated" in text
    without = write_audit_results(tmp_path, put({"no_posterior_reason": "none wanted"}), name="without")
    text = write_audit_report(without).read_text(encoding="utf-8")
    assert "none wanted." in text
    assert "Data origin" not in text


# --- tables ----------------------------------------------------------------------------------------------------------


def test_tables_follow_the_numbers():
    rows = {row[0].text: row for row in tabulate_symbols(make()).rows}
    assert [cell.text for cell in rows["l"]][2:7] == ["2.0", "1.5", "77 %", "0.40", "weak"]
    assert (rows["rho0"][6].text, rows["rho0"][6].level) == ("not identifiable", "bad")
    assert rows["rho0"][7].text.startswith("Leg 1: The planned measurements hardly tell it from l[1]")

    changes = tabulate_changes(make())
    assert [row[0].text for row in changes.rows] == [
        *("as planned", "twice the poses", "better camera", "longer strokes †", "out of reach † ‡"),
    ]
    assert [cell.text for cell in changes.rows[4]][2:] == ["–"] * 5
    assert len(changes.notes) == 2

    (row,) = tabulate_ridge_help(make()).rows
    assert [cell.text for cell in row] == ["l", "1", "0.05", "better camera", "0.45", "still not"]


def test_mixed_verdicts_are_counted():
    change = put({"parameters/l[2]": {"verdict": "identifiable"}})
    assert {row[0].text: row for row in tabulate_symbols(make(change)).rows}["l"][6].text == "1 identifiable, 1 weak"


def test_words():
    assert [format_contraction(x) for x in (0.0, 1e-4, 0.5, 0.999, 1.0, np.nan)] == [
        *("0", "<0.01", "0.50", ">0.99", "1", "–"),
    ]
    assert [format_share(x) for x in (1e-5, 0.0058, 0.5, 12.3)] == ["<0.1 %", "0.58 %", "50 %", "1,230 %"]
    assert [format_probability(x) for x in (1.0, 0.0, 0.42, 0.9765)] == [">99.9 %", "<0.1 %", "42 %", "97.7 %"]
    assert [format_fixed_span(-np.inf, np.inf), format_fixed_span(-0.5, np.inf)] == ["open", "−0.50 to open"]
    assert re.fullmatch(r"u_y \D*4\D*5\D* k", list_names(["u_y[5]", "u_y[4]", "k"]))


def test_parameters_in_running_text_are_set_and_all_else_is_escaped():
    prose = make_prose(["a", "a_z", "l", "rho0"])
    assert prose("a_z[3] with l[1] & rho0") == (
        "<i>a</i><sub>z,3</sub> with <i>l</i><sub>1</sub> &amp; <i>ρ</i><sup>0</sup>"
    )
    assert prose("<l> all al l.") == "&lt;l&gt; all al <i>l</i>."


# --- figures ---------------------------------------------------------------------------------------------------------


def test_every_figure_is_drawn_without_a_warning():
    page = build_page(make_audit_results(checks=True))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        images = {one.name: render_picture(one.draw).png for one in page.figures()}
    assert set(images) == {
        *("contraction", "spectrum", "requirements", "changes", "sweeps", "profiles", "ridges", "ridges_others"),
    }
    assert all(image.startswith(b"\x89PNG") for image in images.values())


def draw(results, name):
    (one,) = (one for one in build_page(results).figures() if one.name == name)
    figure = one.draw()
    FigureCanvasAgg(figure).draw()
    return figure


def test_heat_maps_show_numbers_and_outline_the_reduced_set():
    results = make_audit_results()
    axes = draw(results, "contraction").axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["leg 1", "leg 2", "machine"]
    assert sorted(text.get_text() for text in axes.texts) == ["0", "0.02", "0.02", "0.40", "0.40", "0.90", "0.90"]
    outlined = sorted((round(p.get_x() + 0.46, 9), round(p.get_y() + 0.42, 9)) for p in axes.patches)
    assert outlined == [(0, 0), (0, 1), (1, 0), (1, 1)]
    axes = draw(results, "changes").axes[0]
    assert [text.get_text() for text in axes.texts] == ["0.05", "0.30", "0.45", "0.60"]  # none where it cannot be


def test_many_weak_combinations_are_shown_by_symbol():
    def change(summary):
        for k in range(3, 30):
            name = f"l[{k}]"
            summary["parameters"][name] = summary["parameters"]["l[1]"]
            summary["directions"].append({**summary["directions"][3], "pivot": name, "contraction": 0.01 * k})
            for one in summary["scenarios"][:3]:
                one["ridges"][name] = 0.02 * k

    axes = draw(make_audit_results(change), "changes").axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["$l$"]
    assert [text.get_text() for text in axes.texts] == ["0.03", "0.06", "0.06", "0.06"]


def test_sweeps_have_a_panel_each_and_open_marks_beyond_the_range():
    figure = draw(make_audit_results(), "sweeps")
    assert len(figure.axes) == 6
    left = figure.axes[0]
    lines = {line.get_label(): line for line in left.lines if line.get_label().startswith("$")}
    assert list(lines) == ["$a_{z}$", "$l$", "$ρ^{0}$", "$k_{1d}$"]
    assert lines["$l$"].get_ydata() == pytest.approx(np.full(3, 100 * 0.6**0.5))
    faces = [line.get_markerfacecolor() for line in left.lines if line.get_marker() == "o" and len(line.get_xdata())]
    assert faces.count("white") == 4
    assert figure.axes[3].lines[0].get_ydata() == pytest.approx([4.0, 4.0])


def test_profiles_are_bounded_or_open():
    value = np.linspace(-3, 3, 601)
    closed = pd.DataFrame({"value": value, "deviance_data": value**2})
    assert span_profile(closed) == pytest.approx((-(3.841**0.5), 3.841**0.5), abs=1e-4)
    half = pd.DataFrame({"value": value, "deviance_data": np.where(value > 0, value**2, 0.0)})
    low, high = span_profile(half)
    assert (low, high) == (-np.inf, pytest.approx(3.841**0.5, abs=1e-4))


def test_ridge_plots_show_draws_prior_and_curves():
    figure = draw(make_audit_results(checks=True), "ridges")
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert len(shown) == 2  # one of the two legs of rho0, and l
    assert len(shown[0].lines) == 4
    assert [key.get_text() for key in figure.legends[0].get_texts()] == [
        *("prior", "posterior", "profile path", "information direction"),
    ]
    assert shown[0].get_xlabel() == "$ρ_{1}^{0}$ (mm)"
    others = draw(make_audit_results(checks=True), "ridges_others")
    assert sum(axes.get_visible() for axes in others.axes) == 1


# --- files -----------------------------------------------------------------------------------------------------------


def test_an_empty_sweep_is_no_fault():
    results = make_audit_results()
    results.tables["sweeps"] = results.tables["sweeps"].head(0)
    assert "sweeps" not in AuditResults.of(results).tables


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({}, "none stated"),
        (
            {"position_mm": [7.0, 7.0, 6.5], "rotation_deg": [0.1, 0.1, 0.05], "shape": "box", "poses": 200},
            "±7 × ±7 × ±6.5 mm, ±0.1 × ±0.1 × ±0.05 deg, box, 200 poses",
        ),
        ({"x": [-100.0, 300.0], "phi": [105.0, 165.0]}, "x −100 to 300, phi 105 to 165"),
    ],
    ids=["none", "about home", "coordinates"],
)
def test_the_workspace_is_shown_as_stated(stated, said):
    table = tabulate_audit(make(lambda summary: summary["plan"].update(workspace=stated)))
    assert {name.text: value.text for name, value in table.rows}["Workspace"] == said
