"""Every kind's page in a real browser: wide and narrow, light and dark, and printed."""

from __future__ import annotations

import pytest
from browser import SCHEMES, SIZES, check_accessible, check_layout, check_print, open_page, start_browser, unfold
from test_kind_contract import MAKE, WITHOUT_TASKS, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser():
    with start_browser() as started:
        yield started


@pytest.mark.parametrize("kind", sorted(set(MAKE) - set(WITHOUT_TASKS)))
def test_the_page_of_every_kind(kind, browser, tmp_path, search_little, pictures):
    run(MAKE[kind](tmp_path), tmp_path / "out")
    path = tmp_path / "out" / "report.html"
    for width in SIZES:
        for scheme in SCHEMES:
            with open_page(browser, path, width, scheme) as page:
                check_layout(page)
                unfold(page)
                check_layout(page)
                if width == SIZES[0]:
                    check_accessible(page)
    check_print(browser, path, tmp_path)
