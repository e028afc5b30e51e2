"""Sphinx's settings: ``make docs`` builds the pages, with the root of the repository as source.

So a page may link to any other one, such as a measurement in ``results/experiments``, by the same
relative path here and on GitHub.
"""

from importlib.metadata import version as version_of
from typing import TYPE_CHECKING

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import benchmark_envs

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

benchmark_envs.TrajectoryVecEnv = benchmark_envs.TrajectoryVecEnv  # lazy, and autodoc asks dir()

project = "sb3-nmp"
author = "The sb3-nmp authors"
project_copyright = author
release = version = version_of("sb3-nmp")

root_doc = "docs/index"
include_patterns = ["docs/**", "results/experiments/*.md", "results/leaderboard/data/README.md"]
include_patterns += ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
exclude_patterns = [".*", "docs/_*", "**/__pycache__"]

extensions = ["myst_nb", "sphinx.ext.autodoc"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4

# Pages that say so in their first lines are executed, and again only when their code has changed.
nb_execution_mode = "cache"
nb_execution_cache_path = "docs/_build/jupyter-cache"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
nb_execution_show_tb = True

autodoc_typehints = "signature"
autodoc_member_order = "alphabetical"
autodoc_default_options = {"members": True, "show-inheritance": True}
maximum_signature_line_length = 88
add_module_names = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"sb3-nmp {release}"
html_extra_path = ["_root"]  # an index.html that leads to docs/index.html
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style, pygments_dark_style = "friendly", "monokai"
html_math_renderer = "mathml"


def _inline_math(writer: "HTML5Translator", node: nodes.math) -> None:
    writer.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _display_math(writer: "HTML5Translator", node: nodes.math_block) -> None:
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: "Sphinx") -> None:
    """Let browsers draw formulas by themselves: MathML needs neither a script nor a network."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_display_math, None))
