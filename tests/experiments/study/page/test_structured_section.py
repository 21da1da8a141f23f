"""What a study's page says of model errors that are functions of the pose."""

from __future__ import annotations

import pandas as pd
import pytest
from made_up_results import read_page, read_study

from bayescal.experiments.study.page.model_error import show_structured
from bayescal.report.blocks import Figure, Fold, Statement, Table, unfold

ERROR = {
    "kernel": "smooth, length 5",
    "present": [0.99, 0.99],
    "rms_um": {"mean": [4.0, 9.0], "q05": [2.0, 6.0], "q95": [6.0, 13.0]},
    "scale": [{"median_um": 11.0, "q05_um": 8.0, "q95_um": 15.0, "prior_sd_left": 0.4}],
    "slope_um": [[1.0, -2.0], [7.0, 3.0]],
    "slope_sd_um": [[2.0, 2.0], [1.0, 9.0]],
    "linear_share": 1.0,
    "surest": {"leg": 2, "actuator": 1, "um": 7.0, "q05_um": 5.0, "q95_um": 9.0},
    "explained": {"linear": 0.04, "matrix": 0.97},
}


def read_section(make_results, **changes):
    """Return the section of a study whose first variant has an error, and the second none."""

    def change(summary):
        there, none = (summary["variants"][name] for name in ("pus/none", "pus/linear"))
        there["structured_error"] = {**ERROR, **changes}
        none["structured_error"] = {**ERROR, "present": [0.001, 0.001], "scale": [], "explained": {}}

    row = ["pus/none", "C0", "calibration", 1, 1, 0.5, 3.0, 2.0, 4.0]
    columns = ["variant", "pose", "use", "leg", "actuator", "travel_mm", "mean_um", "low_um", "high_um"]
    frame = pd.DataFrame([row, [*row[:3], 2, *row[4:]]], columns=columns)
    folder = make_results(change=change, structured=frame, name=f"results{len(changes)}")
    return show_structured(read_study(folder)), folder


def texts(section):
    return [block.text for block in section.blocks if isinstance(block, Statement)]


def test_says_how_large_where_and_why(make_results):
    section, folder = read_section(make_results)
    none, there = texts(section)
    assert none == "pus/linear: no structured error (probability of one at most 0.10 %)."
    assert "largest in leg 2, 9.0 [6.0, 13.0] µm rms" in there
    assert "actuator 1 at the end of its range moves leg 2 by +7.0 [+5.0, +9.0] µm" in there
    assert "a linear deformation explains 4 % of it and a matrix deformation explains 97 % of it: try matrix." in there
    assert "The measurements tell its scale: 40 %" in there
    table = next(block for block in section.blocks if isinstance(block, Table))
    assert [cell.text for cell in table.rows[1]][1:] == [
        "smooth, length 5",
        "99.0",
        "11.0 [8.0, 15.0]",
        "40",
        "leg 2, actuator 1: +7.0 [+5.0, +9.0]",
        "100",
        "4",
        "97",
    ]
    assert "Structured model error" in [one.title for one in read_page(folder).sections]


@pytest.mark.parametrize(("left", "said"), [(0.98, "rests on the prior"), (0.4, "The measurements tell its scale")])
def test_says_whether_the_scale_is_measured(left, said, make_results):
    section, _ = read_section(make_results, scale=[{**ERROR["scale"][0], "prior_sd_left": left}])
    assert said in texts(section)[1]


def test_a_free_length_is_told(make_results):
    length = {"median": 4.1, "q05": 2.9, "q95": 6.3, "prior_sd_left": 0.47}
    section, _ = read_section(make_results, kernel="smooth, length free", length=length)
    assert "It changes over 4.1 [2.9, 6.3] ranges of the actuators; 47 % of the standard deviation" in texts(section)[1]
    table = next(block for block in section.blocks if isinstance(block, Table))
    assert table.rows[1][1].text == "smooth, length free: 4.1 [2.9, 6.3]"


def test_what_no_deformation_explains_is_said(make_results):
    section, _ = read_section(make_results, explained={"linear": 0.5})
    assert "explains 50 % of it: no known deformation explains it" in texts(section)[1]


def test_pictures_are_of_slopes_and_of_the_course_where_these_are_not_all(make_results):
    section, _ = read_section(make_results)
    straight = [one for one in unfold(section.blocks) if isinstance(one, Figure)]
    section, _ = read_section(make_results, linear_share=0.6)
    bent = [one for one in unfold(section.blocks) if isinstance(one, Figure)]
    assert [figure.name for figure in straight] == ["structured-pus-none"]
    assert [figure.name for figure in bent] == ["structured-pus-none", "structured-course-pus-none"]
    assert not any(isinstance(block, Fold) for block in section.blocks)
    panels = [[axes.get_title() for axes in figure.draw().axes] for figure in bent if isinstance(figure, Figure)]
    assert panels[0] == ["Error with the actuator at the end of its range (µm)", "Size over the poses (µm, rms)"]
    assert panels[1][:2] == ["leg 1", "leg 2"]
    written = {text.get_text() for text in bent[0].draw().axes[0].texts}
    assert written == {"+1 ± 2", "−2 ± 2", "+7 ± 1", "+3 ± 9"}
