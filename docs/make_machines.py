"""The gallery's pictures of machines: what `bayescal show` draws of one of each family, at home. Run it by itself."""

from __future__ import annotations

import re
from pathlib import Path

from bayescal.experiments.shared.show import describe_machine
from bayescal.report.page import render_page

ROOT = Path(__file__).parents[1]
MACHINES = {
    "legs": "experiments/audit/m2_hexapod_mechanism.toml",
    "strut_machine": "experiments/m2_hexapod_table/machine.toml",
    "arm": "experiments/ur10/machine.toml",
    "scara": "examples/machines/scara.toml",
    "delta": "experiments/flsun_v400/machine.toml",
    "rotary_delta": "examples/machines/rotary_delta.toml",
    "five_bar": "examples/machines/five_bar.toml",
    "line_machine": "experiments/hangprinter/machine.toml",
    "mount": "experiments/mmt_mount/machine.toml",
    "sliding_platform": "experiments/sliding_star/machine.toml",
}
STYLE = "path{fill:none;stroke:#888}path.platform{stroke:#2a8fd0}circle{fill:#888}circle.platform{fill:#2a8fd0}"
WIDE = 160.0  # of a picture


def draw(path: Path) -> str:
    """Return the SVG of a machine's file, as large as what it shows at home."""
    page = render_page(describe_machine(path), {})
    drawn = re.search(r"<svg[^>]*data-scene[^>]*>(.*?)</svg>", page, re.DOTALL)
    assert drawn is not None
    ends = [(float(x), float(y)) for x, y in re.findall(r"[ML]?(-?[\d.]+) (-?[\d.]+)", " ".join(_find(drawn[1], "d")))]
    ends += list(zip(map(float, _find(drawn[1], "cx")), map(float, _find(drawn[1], "cy")), strict=True))
    low, high = (tuple(end(one) for one in zip(*ends, strict=True)) for end in (min, max))
    size = max(high[0] - low[0], high[1] - low[1])
    box = f"{low[0] - 0.05 * size:.1f} {low[1] - 0.05 * size:.1f} {1.1 * size:.1f} {high[1] - low[1] + 0.1 * size:.1f}"
    style = f"{STYLE}path{{stroke-width:{size / WIDE:.2f}}}circle{{r:{size / 60:.2f}px}}"
    shapes = "".join(re.findall(r"<(?:path|circle)[^>]*?(?=/?>)", drawn[1])).replace("<", "/><")[2:] + "/>"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDE:g}" viewBox="{box}">'
    return f"{head}<style>{style}</style>{shapes}</svg>\n"


def _find(text: str, attribute: str) -> list[str]:
    return re.findall(rf'\b{attribute}="([^"]*)"', text)


if __name__ == "__main__":
    for name, machine in MACHINES.items():
        (ROOT / "docs" / "images" / "machines" / f"{name}.svg").write_text(draw(ROOT / machine), encoding="utf-8")
