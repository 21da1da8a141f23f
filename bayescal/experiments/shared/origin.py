"""Where data come from, in words."""

from __future__ import annotations

STATUS = {
    "measured": "Measured",
    "simulated": "Simulated, never measured",
    "reconstructed": "Reconstructed",
    "unstated": "Not stated",
}


def name_origin(origin: dict[str, str]) -> str:
    """Return where the data come from, in words: measured or not, source, licence."""
    words = f"{STATUS[origin['status']]}: {origin['text']}" if origin["status"] else origin["text"]
    for name in ("source", "licence"):
        words += f"; {name} {origin[name]}" if origin[name] else ""
    return words
