"""The documentation site: `make docs` builds it without a network, warnings are errors."""

import os
import runpy
from importlib import metadata
from pathlib import Path

os.environ["MPLBACKEND"] = (
    "module://matplotlib_inline.backend_inline"  # notebooks show figures, whatever the shell says
)
runpy.run_path(str(Path(__file__).with_name("generated_pages.py")))["write_pages"]()
project = "Sideslip"
author = project_copyright = "the Sideslip authors"
release = metadata.version("sideslip")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "myst-nb"}
exclude_patterns = ["examples", "_build"]
myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 3
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_mock_imports: list[str] = []
nb_execution_mode = "force"  # the notebooks run at every build, so that what they show is what the code gives
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # seconds of a cell on a loaded machine; idle, a notebook takes ten
nb_merge_streams = True
html_theme = "furo"
html_title = "Sideslip"
html_static_path = ["pictures", "style"]
html_css_files = ["site.css"]
suppress_warnings = ["myst.xref_missing"]  # pages link files of the tree, which the site does not hold
