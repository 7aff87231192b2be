"""The documentation site: `make docs` builds it without a network, warnings are errors."""

from importlib import metadata

project = "Sideslip"
author = "the Sideslip authors"
release = metadata.version("sideslip")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["examples", "_build"]
myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 3
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_mock_imports: list[str] = []
html_theme = "furo"
html_title = "Sideslip"
html_static_path = ["pictures"]
suppress_warnings = ["myst.xref_missing"]  # pages link files of the tree, which the site does not hold
