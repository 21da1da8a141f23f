"""Documentation: Sphinx reads these pages offline, runs the tutorials and generates the references."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "bayescal"
author = "the bayescal authors"
copyright = "2026, the bayescal authors"
version = release = version_of("bayescal")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "run", "references"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
suppress_warnings = ["myst.header"]

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["pictures.css"]
html_title = f"bayescal {release}"
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
