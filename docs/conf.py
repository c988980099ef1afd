"""Settings of the documentation's site: `sphinx-build -W docs site` (extra `docs`)."""

project = "KT3DMoSeg + mseg"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "index"
html_title = project
html_theme_options = {"page_width": "1280px", "body_max_width": "1000px"}
html_show_copyright = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_extra_path = ["croissant.json"]
myst_heading_anchors = 3
# Pages link to files of the repository, which are no part of the site.
suppress_warnings = ["myst.xref_missing"]
