"""Calls side by side: what they give is the same for any number of workers, and what they raise is raised here."""

from __future__ import annotations

from functools import partial

import pytest
from matplotlib.figure import Figure as Drawing

from bayescal.errors import InputError
from bayescal.experiments.frame.engine import call_side_by_side
from bayescal.report.blocks import Figure, Page, Section
from bayescal.report.page import write_page

pytestmark = pytest.mark.runs


def draw(n: int) -> Drawing:
    """Return a figure with a line to n."""
    drawing = Drawing(figsize=(4.5, 1.0))
    for panel in drawing.subplots(1, 2):
        panel.plot([0.0, 1.0], [0.0, n])
    return drawing


def fail() -> None:
    """Raise what is the user's fault."""
    raise InputError("found nothing")


def test_a_page_is_the_same_however_many_processes_draw_it(tmp_path):
    figures = tuple(Figure(f"f{n}", f"line to {n}", partial(draw, n)) for n in range(5))
    page = Page("Kind", "a", "b", "c", "d", (), (Section("Lines", figures),), ())
    for n in (1, 2):
        (tmp_path / str(n)).mkdir()
    one, two = (write_page(page, tmp_path / str(n), render=partial(call_side_by_side, n)) for n in (1, 2))
    assert one.read_bytes() == two.read_bytes()
    drawn = sorted((tmp_path / "1" / "figures").iterdir())
    assert [path.name for path in drawn] == [f"f{n}.png" for n in range(5)]
    for path in drawn:
        assert path.read_bytes() == (tmp_path / "2" / "figures" / path.name).read_bytes()


@pytest.mark.parametrize("workers", [1, 2])
def test_calls_keep_their_names_and_order_and_raise_what_they_raise(workers):
    calls = {name: partial(str.upper, name) for name in "cab"}
    assert list(call_side_by_side(workers, calls).items()) == [("c", "C"), ("a", "A"), ("b", "B")]
    with pytest.raises(InputError, match=r"^found nothing$"):
        call_side_by_side(workers, {"good": partial(str, 1), "bad": fail})
