"""How the documentation site is built: Sphinx, offline, warnings as errors."""

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "_extensions"), str(ROOT / "src")]

project = "rollkane"
author = "The rollkane authors"
copyright = author
VERSION = (ROOT / "src" / "rollkane" / "__init__.py").read_text()
release = re.findall('__version__ = "(.*)"', VERSION)[0]
extensions = [
    "sphinx.ext.autodoc",
    "docstrings",
    "equation_links",
    "gallery",
    "mathml",
    "notebooks",
    "myst_nb",
    "sphinx_copybutton",
]
exclude_patterns = [
    "_build",
    "_extensions",
    "_scene_files",
    "conf.py",
    "check_site.py",
    "images/*.py",
]

# Text and equations.
myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
html_math_renderer = "mathml"

# Notebooks are Python with cells; what they print and draw is kept between builds.
nb_custom_formats = {".py": "notebooks.read"}
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 600

# Docstrings.
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # types of arguments are told in words, with units
autodoc_preserve_defaults = True
autoclass_content = "both"
autodoc_default_options = {"members": True}

# Pages.
html_theme = "furo"
html_title = "rollkane"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_use_index = False  # the reference is by topic, the search by name
html_show_sphinx = False
html_copy_source = False
pygments_style = "friendly"
pygments_dark_style = "monokai"
