"""Settings of the documentation's site: `sphinx-build -W docs site` (extra `docs`)."""

import os
import subprocess
import sys
from importlib import import_module

from docutils import nodes
from docutils.parsers.rst import Directive

project = "KT3DMoSeg + mseg"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
html_title = project
html_theme_options = {"page_width": "1280px", "body_max_width": "1000px"}
html_show_copyright = False
html_show_sourcelink = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_extra_path = ["croissant.json"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # tools/run_notebooks.py executes them
default_role = "literal"
autodoc_typehints = "none"  # docstrings state types with shapes and units
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
napoleon_use_rtype = False
# Pages link to files of the repository, which are no part of the site.
suppress_warnings = ["myst.xref_missing"]


class Commands(Directive):
    """The help of every command of a program, as the command line prints it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        program = self.arguments[0]
        return [self.section(program, name) for name in import_module(f"{program}.cli").COMMANDS]

    def section(self, program: str, name: str) -> nodes.section:
        command = [sys.executable, "-m", program, name, "--help-all"]
        wide = os.environ | {"COLUMNS": "100"}
        text = subprocess.run(command, check=True, capture_output=True, text=True, env=wide).stdout
        title, ids = f"{program} {name}", [f"{program}-{name}"]
        return nodes.section("", nodes.title("", title), nodes.literal_block(text, text), ids=ids)


def setup(app: object) -> None:
    app.add_directive("commands", Commands)
