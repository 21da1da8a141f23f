"""A real browser, headless, and what a page has to be in it. Chromium is the system's; Playwright drives it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
SIZES = (1400, 390)
SCHEMES = ("light", "dark")
PRINTED = 703  # pixels between the margins of A4
SMALLEST = 9.0  # pixels of a letter

TOO_WIDE = """() => {
  const width = document.documentElement.clientWidth;
  const wide = [...document.querySelectorAll("body *")].filter((one) => {
    const box = one.getBoundingClientRect();
    return box.width && box.right > width + 1 && !one.closest(".scroll, .picture, nav");
  });
  const page = document.documentElement.scrollWidth > width ? ["the page"] : [];
  return [...page, ...wide.map((one) => `${one.tagName} ${one.className} ${one.textContent.slice(0, 40)}`)];
}"""
TOO_SMALL = """(least) => [...document.querySelectorAll("main *")].filter((one) =>
  [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim())
  && one.checkVisibility() && !one.closest("svg") && parseFloat(getComputedStyle(one).fontSize) < least
).map((one) => `${one.tagName} ${one.className} ${one.textContent.slice(0, 40)}`)"""
OVERLAPS = """() => {
  const walker = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT), boxes = [];
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    if (!node.data.trim() || !parent.checkVisibility() || parent.closest("nav, svg, .skip, title, option")) continue;
    if (innerWidth < 800 && parent.closest(".claims thead")) continue;
    const clip = parent.closest(".scroll")?.getBoundingClientRect(), range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      const right = Math.min(box.right, clip?.right ?? Infinity);
      if (right - box.left > 2 && box.height > 2 && !(innerWidth < 800 && clip && !parent.closest(".lead")))
        boxes.push({ top: box.top + 3, bottom: box.bottom - 3, left: box.left + 1, right: right - 1, node });
    }
  }
  boxes.sort((one, other) => one.top - other.top);
  const found = [];
  boxes.forEach((one, k) => {
    for (let j = k + 1; j < boxes.length && boxes[j].top < one.bottom; j++) {
      const other = boxes[j];
      const raised = [one, other].some((box) => box.node.parentElement.closest("sub, sup"));
      if (other.left < one.right && one.left < other.right && !raised)
        found.push(`${one.node.data.slice(0, 30)} | ${other.node.data.slice(0, 30)}`);
    }
  });
  return found.slice(0, 5);
}"""
CLIPPED = """(width) => [...document.querySelectorAll("table, .picture > *, pre, .scene svg")].filter((one) =>
  one.checkVisibility() && one.getBoundingClientRect().right > width + 24
).map((one) => `${one.tagName} ${one.closest(".table")?.querySelector(".caption")?.textContent ?? ""}`)"""


@contextmanager
def start_browser() -> Iterator[Any]:
    """Yield a browser; the test is skipped, and says so, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright: pip install bayescal[browser]")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this system")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def open_page(browser: Any, path: Path, width: int = 1400, scheme: str = "light") -> Iterator[Any]:
    """Yield a page, and check at its end that it wrote nothing to the console and asked for no other file."""
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, permissions=["clipboard-read", "clipboard-write"]
    )
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    yield page
    assert said == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [path.as_uri()]
    context.close()


def unfold(page: Any) -> None:
    """Open all folds."""
    page.evaluate('document.querySelectorAll("details").forEach((fold) => { fold.open = true; })')


def check_layout(page: Any) -> None:
    """Nothing is wider than the page, too small to read, or over something else."""
    assert page.evaluate(TOO_WIDE) == []
    assert page.evaluate(TOO_SMALL, SMALLEST) == []
    assert page.evaluate(OVERLAPS) == []


def check_print(browser: Any, path: Path, tmp_path: Path) -> None:
    """On A4 nothing is cut off and every fold is open."""
    with open_page(browser, path, PRINTED) as page:
        page.emulate_media(media="print")
        assert page.evaluate(CLIPPED, PRINTED) == []
        page.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True, print_background=True)
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


def check_accessible(page: Any) -> None:
    """Find no violation by axe-core, where it is installed."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core").Axe()
    drawn = {"exclude": [[".picture svg"]]}  # glyphs by the thousand, which say nothing to it
    found = axe.run(page, context=drawn, options={"runOnly": ["wcag2a", "wcag2aa", "best-practice"]}).response[
        "violations"
    ]
    assert [(one["id"], one["nodes"][0]["html"][:200]) for one in found] == []
