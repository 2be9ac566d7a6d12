"""How the site is built: `make docs`, output in docs/_build/html."""

from __future__ import annotations

import logging
import os
import sys
from importlib.resources import files
from pathlib import Path

import lierb

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
# Notebooks run in folders of their own, with the `lierb` of this environment.
os.environ["DOCS"] = str(HERE)
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["COLUMNS"] = "80"
os.environ["TTY_COMPATIBLE"] = "0"  # of progress bars only their last state would be left

logging.getLogger("traitlets").setLevel(logging.WARNING)  # which notebook runs, says Sphinx

project = "lierb"
author = "The lierb developers"
version = release = lierb.__version__
language = "en"
smartquotes = False  # of `--n` it makes a dash

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "links",
    "outputs",
    "reference",
    "study_file",
]
exclude_patterns = ["_build", "_ext"]

# Notebooks run whenever their page is read; an error in one ends the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_execution_in_temp = True
nb_merge_streams = True
nb_render_markdown_format = "myst"  # has tables

myst_enable_extensions = ["colon_fence", "deflist"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4  # as GitHub makes them

# Docstrings have numpydoc's sections. `name` in one, and each word of a type, is a link where the
# name is documented, and code where it is not.
napoleon_google_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]  # a list, as of parameters
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [("py:(obj|class)", r".*")]
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings have shapes and units, which say more than ArrayLike
python_maximum_signature_line_length = 80
add_module_names = False
toc_object_entries_show_parents = "hide"

# MathJax from an installed package: the site asks no network for anything.
MATHJAX = files("sphinx-mathjax-offline") / "static" / "mathjax" / "tex-svg.js"
mathjax_path = "tex-svg.js"

html_theme = "furo"
html_title = "lierb"
templates_path = ["_templates"]
html_static_path = ["_static", str(MATHJAX)]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
