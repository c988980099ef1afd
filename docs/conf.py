"""Settings of the documentation's site: `sphinx-build -W docs site` (extra `docs`)."""

project = "KT3DMoSeg + mseg"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
root_doc = "index"
html_title = project
html_extra_path = ["croissant.json"]
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3
# Pages link to files of the repository, which are no part of the site.
suppress_warnings = ["myst.xref_missing"]
napoleon_google_docstring = False
autodoc_typehints = "none"
