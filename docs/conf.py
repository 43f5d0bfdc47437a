"""Settings of Sphinx; `mjlab_docs.build` lays out the pages that it reads."""

project = "mjlab"
author = "The mjlab developers"
html_title = "mjlab"

extensions = ["myst_parser", "sphinx.ext.viewcode", "sphinx_design", "mjlab_docs.sources"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 4
add_module_names = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
toc_object_entries_show_parents = "hide"
highlight_language = "text"
viewcode_line_numbers = True

# Types in signatures are links where a name is unique, and plain where it is not.
suppress_warnings = ["ref.python"]

html_theme = "pydata_sphinx_theme"
html_theme_options = {
  "header_links_before_dropdown": 8,
  "navigation_with_keys": False,
  "show_nav_level": 1,
  "show_toc_level": 2,
  # A button, as the field does not fit beside the contents on a laptop.
  "navbar_persistent": ["search-button"],
  "navbar_end": ["theme-switcher"],
  "footer_start": [],
  "footer_end": [],
}
# Pages without others below them have nothing to navigate.
html_sidebars = {name: [] for name in ("index", "faq", "migration")}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_last_updated_fmt = ""
