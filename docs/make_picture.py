"""The picture in README: the head of a report, from committed results by a headless Chromium. `make picture` runs it.

With a copy of the results, so that none of them is touched.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from bayescal.experiments.runner.run import write_report

ROOT = Path(__file__).parents[1]
RESULTS, PICTURE = ROOT / "results" / "hangprinter", ROOT / "docs" / "images" / "report.png"
WIDTH, HEIGHT, COLOURS = 1200, 1160, 128
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def take_picture(page: Path, picture: Path) -> None:
    """Write what a window of the page shows as a PNG file of few colours."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"found none of {', '.join(BROWSERS)}, expected one of them to draw the page")
    subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
            *(f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={picture}", page.as_uri()),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    Image.open(picture).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(picture, optimize=True)


def main() -> None:
    """Write the page of the committed results again and take its picture."""
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(RESULTS, Path(folder) / RESULTS.name)
        take_picture(write_report(copy), PICTURE)
    print(f"wrote {PICTURE.relative_to(ROOT)}, {PICTURE.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
