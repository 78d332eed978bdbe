"""Options of the documentation site: ``make docs`` builds it, and a warning fails the build."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported; spinning threads are slow beside each other

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "extensions"))

project = "ppt_rl"
author = "ppt_rl developers"
copyright = author
version = release = installed_version("ppt_rl")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "matplotlib.sphinxext.plot_directive",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "code_roles",
    "mathml",
    "public_names",
    "repository_links",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = [
    "_build",
    "extensions",
    "figures",
    "templates",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
]
templates_path = ["templates"]
nitpicky = True

# -- Markdown ---------------------------------------------------------------------------------------------------------

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

# -- API reference ----------------------------------------------------------------------------------------------------

autosummary_generate = True
autosummary_imported_members = True
autodoc_default_options = {"member-order": "bysource", "show-inheritance": True}
autodoc_inherit_docstrings = False  # those of torch and torchrl are not ours to repeat
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_custom_sections = ["Source"]
viewcode_follow_imported_members = True

# Objects of other projects resolve only where intersphinx is on, which needs a network: DOCS_INTERSPHINX=1 make docs.
if os.environ.get("DOCS_INTERSPHINX") == "1":
    extensions.append("sphinx.ext.intersphinx")
    intersphinx_mapping = {
        "python": ("https://docs.python.org/3", None),
        "torch": ("https://docs.pytorch.org/docs/stable", None),
        "torchrl": ("https://docs.pytorch.org/rl/stable", None),
        "tensordict": ("https://docs.pytorch.org/tensordict/stable", None),
        "numpy": ("https://numpy.org/doc/stable", None),
    }
nitpick_ignore_regex = [
    # Other projects: they resolve with intersphinx only.
    (r"py:.*", r"(torch|torchrl|tensordict|numpy|np|mujoco|dm_control|matplotlib|pathlib|collections|typing|abc)\..*"),
    (r"py:.*", r"(nn|optim|mjcf)\..*"),
    (r"py:(class|obj|exc)", r"[a-z]+"),  # builtins: int, float, str, ...
    (r"py:(class|obj|exc)", r"(Any|Callable|Iterator|Iterable|Literal|Mapping|None|Path|Protocol|Sequence|Self)"),
    (r"py:(class|obj|exc)", r"(Tensor|TensorDict|TensorDictBase|TensorSpec|Composite|NestedKey|Transform|EnvBase)"),
    (r"py:exc", r"[A-Z][A-Za-z]*(Error|Warning|Interrupt)"),
]

# -- figures of the concepts: the scripts in figures/ ------------------------------------------------------------------

plot_basedir = str(HERE)
plot_formats = [("png", 110)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_include_source = False

# -- tutorials --------------------------------------------------------------------------------------------------------

sphinx_gallery_conf = {
    "examples_dirs": "../examples/tutorials",
    "gallery_dirs": "tutorials",
    "filename_pattern": r"/\d\d_",
    "ignore_pattern": r"wind\.py",  # what the tutorials import
    "within_subsection_order": "FileNameSortKey",
    "nested_sections": False,
    "remove_config_comments": True,
    "write_computation_times": False,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "reset_modules": ("matplotlib", "code_roles.one_thread"),
    "plot_gallery": os.environ.get("DOCS_TUTORIALS", "1") == "1",
}

# -- HTML -------------------------------------------------------------------------------------------------------------

html_theme = "furo"
html_title = "ppt_rl"
html_static_path = ["static"]
html_css_files = ["ppt_rl.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
copybutton_exclude = ".linenos, .gp, .go"
