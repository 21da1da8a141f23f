"""A page of the kit in a real browser: sorting, filters, copies, values under the pointer, folds, machines in space."""

from __future__ import annotations

import pytest
from browser import SCHEMES, SIZES, check_accessible, check_layout, check_print, open_page, start_browser, unfold
from matplotlib.figure import Figure as Drawing

from bayescal.report.blocks import Cell, Column, Figure, Fold, Page, PageSection, Side, Statement, Table, make_table
from bayescal.report.page import write_page
from bayescal.report.pictures import render_picture
from bayescal.report.scene import Scene, SceneLine, ScenePoint

pytestmark = pytest.mark.slow  # a browser takes its time

NUMBERS = ("−3.5", "1,200", "2.0 ± 0.1", "3.3·10⁴", "–", "10⁻²", "7 %", "0", "<1", "12 / 14")
ORDER = ["−3.5", "0", "10⁻²", "<1", "2.0 ± 0.1", "7 %", "12 / 14", "1,200", "3.3·10⁴", "–"]


def draw() -> Drawing:
    drawing = Drawing(figsize=(9.4, 3.0))
    axes = drawing.subplots()
    axes.barh([0, 1], [3.0, 8.6])
    axes.set_yticks([0, 1], ["stiff", "soft"])
    axes.set_xlabel("Error (µm)")
    return drawing


def make_tables() -> list[Table]:
    columns = (Column("Variant", kind="name"), Column("Error", "µm", "found"), Column("Why", kind="text"))
    rows = [[f"v{k}", text, "=1+1" if k == 1 else f"reason, {k}"] for k, text in enumerate(NUMBERS)]
    spans = [[Cell("l", span=2), "mm", "1"], [Cell("", span=0), "deg", "2"], [Cell("b", span=2), "mm", "0"]]
    spans.append([Cell("", span=0), "deg", "3"])
    long = make_table(
        "Spans.", (Column("S", kind="symbol"), Column("Unit", kind="text"), Column("x")), spans, style="long"
    )
    wide = make_table("Wide.", [Column(f"Column number {k}") for k in range(16)], [["1.234567"] * 16] * 3)
    return [make_table("Numbers.", columns, rows), long, wide]


def make_scene() -> Scene:
    home = ((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (0.0, 100.0, 80.0))
    points = tuple(
        ScenePoint(f"a of leg {k}", "base", (at, (at[0], at[1], 50.0)), (0.1, 0.0, 0.0), (0.1, 0.1, 0.1))
        for k, at in enumerate(home, start=1)
    )
    return Scene("m", "Turn it.", "Drawing.", points, (SceneLine((0, 1, 2), "base", True),), ("home", "P1"), (), 100.0)


@pytest.fixture(scope="module")
def browser():
    with start_browser() as started:
        yield started


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    numbers, long, wide = make_tables()
    blocks = (numbers, long, wide, Side((numbers, long)), Figure("errors", "Errors.", draw), make_scene())
    verdict = tuple(Statement(f"The posterior's sd is {k} nat.", "good", "Found") for k in range(7))
    sections = (
        PageSection("Numbers", blocks),
        PageSection("More", (Fold("Folded", ("The prior is wide.", wide)),), "more"),
    )
    page = Page("Kind", "name", "Title", "Simulated", "The headline.", verdict, sections)
    with pytest.MonkeyPatch.context() as patched:  # drawn before a test's own fixtures would let it be
        patched.setattr("bayescal.report.page.render_picture", render_picture)
        return write_page(page, tmp_path_factory.mktemp("page"))


def read_column(page, table: int, column: int) -> list[str]:
    rows = page.locator("div.table").nth(table).locator("tbody tr:visible")
    return [rows.nth(k).locator("td").nth(column).inner_text() for k in range(rows.count())]


def test_tables_are_sorted_by_mouse_and_keyboard(browser, path):
    with open_page(browser, path) as page:
        heading = page.locator("div.table").first.get_by_role("columnheader", name="Error")
        heading.get_by_role("button").click()
        assert read_column(page, 0, 1) == ORDER
        assert heading.get_attribute("aria-sort") == "ascending"
        heading.get_by_role("button").press("Enter")
        assert read_column(page, 0, 1) == [*ORDER[:-1][::-1], "–"]  # what is no number stays last
        page.locator("div.table").nth(1).get_by_role("button", name="x").click()
        assert read_column(page, 1, 0) == ["b", "l", "l", "b"]  # a cell over two rows goes with each


def test_tables_are_filtered_and_copied(browser, path):
    with open_page(browser, path) as page:
        box = page.locator("div.table").first
        box.get_by_role("searchbox").fill("v1 1,2")
        assert read_column(page, 0, 0) == ["v1"]
        assert box.get_by_role("status").inner_text() == "1 of 10 rows"
        box.get_by_role("button", name="Copy").click()
        page.wait_for_function("() => document.querySelector('.tools button').textContent === 'Copied'")
        copied = page.evaluate("navigator.clipboard.readText()").splitlines()
        assert [line.split("\t") for line in copied] == [["Variant", "found Error µm", "Why"], ["v1", "1,200", "=1+1"]]
        with page.expect_download() as download:
            box.get_by_role("button", name="CSV").click()
        assert download.value.suggested_filename == "numbers.csv"
        text = download.value.path().read_text(encoding="utf-8-sig")
        assert text == 'Variant,found Error µm,Why\nv1,"1,200",\'=1+1\n'


def test_values_and_terms_are_told(browser, path):
    with open_page(browser, path) as page:
        page.locator(".picture svg .tip path").first.hover()
        assert page.locator("#tip").inner_text() == "stiff; Error (µm) 3"
        term = page.locator("#verdict abbr", has_text="posterior")
        term.focus()
        assert page.locator("#tip").inner_text().startswith("Probability distribution of the parameters")
        page.keyboard.press("Escape")
        assert page.locator("#tip").is_hidden()


def test_folds_open_by_keyboard_and_by_links(browser, path):
    with open_page(browser, path) as page:
        more = page.locator("#verdict summary")
        assert page.locator("#verdict li:visible").count() == 5
        more.press("Enter")
        assert page.locator("#verdict li:visible").count() == 7
        page.get_by_role("link", name="More").click()
        page.wait_for_function("() => document.querySelector('nav a[aria-current]')?.textContent === 'More'")


def test_a_machine_is_turned_by_mouse_touch_and_keyboard(browser, path):
    with open_page(browser, path) as page:
        scene = page.locator(".scene svg")
        looks = [scene.inner_html()]

        def turned() -> bool:
            looks.append(scene.inner_html())
            return looks[-1] not in looks[:-1]

        scene.scroll_into_view_if_needed()
        box = scene.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y + 25)
        page.mouse.up()
        assert turned()
        scene.press("ArrowLeft")
        assert turned()
        scene.press("+")
        assert turned()
        touch = {"pointerType": "touch", "pointerId": 7, "bubbles": True, "isPrimary": True}
        page.evaluate("Element.prototype.setPointerCapture = () => {}")
        for kind, shift in (("pointerdown", 0), ("pointermove", 80), ("pointerup", 80)):
            scene.dispatch_event(kind, {**touch, "clientX": x + shift, "clientY": y})
        assert turned()
        page.get_by_label("Pose").select_option("P1")
        assert turned()
        page.get_by_label("Magnified").press("End")
        assert turned()
        page.get_by_role("button", name="Reset").click()
        page.get_by_label("Pose").select_option("home")
        scene.locator("circle.tip").first.hover()
        assert page.locator("#tip").inner_text().startswith("a of leg")


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", SIZES)
def test_the_page_fits_and_is_accessible(browser, path, width, scheme):
    with open_page(browser, path, width, scheme) as page:
        check_layout(page)
        unfold(page)
        check_layout(page)
        check_accessible(page)


def test_the_page_prints(browser, path, tmp_path):
    check_print(browser, path, tmp_path)


def test_without_a_script_everything_can_be_read(browser, path):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(path.as_uri())
    assert page.locator(".scene svg circle").count() == 3
    assert page.locator("#glossary dt").count() > 2
    page.locator("#verdict summary").click()
    assert page.locator("#verdict li:visible").count() == 7
    context.close()
