"""How the documentation is built: `sphinx-build -W --keep-going -b html docs docs/_build/html`."""

import os
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# a backend that somebody exports would take the place of the notebooks' own, and their figures would vanish
os.environ.pop("MPLBACKEND", None)

# sliders of the notebooks have no kernel behind them on a page: they show their picture at one value instead
paths = [str(HERE / "on_paper"), str(HERE.parent), os.environ.get("PYTHONPATH")]
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))

import house_pages  # noqa: E402
import kernels  # noqa: E402
import make_pages  # noqa: E402
from lost_pictures import doubled_pictures, lost_pictures, silent_cells  # noqa: E402
from proven_pages import collect, open_certificates  # noqa: E402
from sphinx.errors import ExtensionError  # noqa: E402

import sampling_design  # noqa: E402

CERTIFICATES = HERE / "_build" / "certificates"
if not os.environ.get("DOCS_FAST"):
    collect(HERE.parent, CERTIFICATES)
    if sys.platform == "linux":  # elsewhere each page starts a kernel of its own: libraries there do not bear a fork
        kernels.start()

project = "sampling_design"
author = "The sampling_design maintainers"
copyright = "the sampling_design maintainers"
release = version = sampling_design.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "numpydoc",
    "sphinxcontrib.bibtex",
    "house_pages",
]
exclude_patterns = [
    "_build",
    "**/.ipynb_checkpoints",
    "made/notebooks/solved/*",
    "README.md",
    "_static/mathjax/README.md",
]
suppress_warnings = ["mystnb.unknown_mime_type"]
nitpicky = False
smartquotes = False  # an option is copied with its two hyphens, and a text with the quotes that a shell knows

# Markdown with executed cells
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
myst_links_external_new_tab = True
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "cells")
nb_execution_timeout = 1200  # of a machine that has much else to do
# while writing pages: DOCS_FAST=1 shows the lecture notebooks without executing them
nb_execution_excludepatterns = ["made/notebooks/*"] if os.environ.get("DOCS_FAST") else []
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_number_source_lines = False

# Interfaces from docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

html_theme = "furo"
html_title = "sampling_design"
html_static_path = ["_static", "on_paper"]
html_extra_path = ["run_lectures.py"]
html_css_files = ["house.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "sidebar_hide_name": False,
    "light_css_variables": {
        "color-brand-primary": "#1f5fa8",
        "color-brand-content": "#1f5fa8",
        "font-stack": "Inter, 'Helvetica Neue', Helvetica, Arial, sans-serif",
    },
    "dark_css_variables": {"color-brand-primary": "#7db2ec", "color-brand-content": "#7db2ec"},
}

# Mathematics without a network: one file beside the pages holds fonts and extensions; its menu would load other parts.
mathjax_path = "mathjax/tex-svg-full.js"
mathjax3_config = {
    "svg": {"displayAlign": "left", "displayIndent": "1.5em", "fontCache": "global"},
    "options": {"enableMenu": False},
}
# Nothing of the pages comes from elsewhere.
nb_ipywidgets_js = {}

_CODE = re.compile(r"``.*?``|`[^`]*`")


def _norms_are_no_substitutions(line):
    """Escape what the mathematics of a docstring means and reStructuredText does not: |x|, a trailing underscore, *."""
    parts, last = [], 0
    for match in _CODE.finditer(line):
        parts += [_escaped(line[last : match.start()]), match.group()]
        last = match.end()
    return "".join([*parts, _escaped(line[last:])])


def _escaped(text):
    text = re.sub(r"(?<!\\)\|", r"\\|", text)
    return re.sub(r"(?<=\w)_(?!\w)", r"\\_", text)


def _equations_stand_as_they_are(lines):
    """Make every indented block before the first section a literal block: it is the docstring's equation."""
    head = next((i for i, line in enumerate(lines[1:]) if line.startswith("---")), len(lines))
    out, i = [], 0
    while i < min(head, len(lines)):
        begins = lines[i].startswith("    ") and i and not lines[i - 1].strip()
        if begins and not (out and out[-2:] and out[-2].rstrip().endswith("::")):
            out += [".. code-block:: text", ""]
            while i < head and (lines[i].startswith("    ") or not lines[i].strip()):
                out.append(lines[i])
                i += 1
        else:
            out.append(lines[i])
            i += 1
    lines[:] = out + lines[i:]


LABELS = house_pages.section_labels(HERE / "theory")


def escape_mathematics(app, what, name, obj, options, lines):
    """Escape running text of a docstring, and leave examples and displayed formulas as they are."""
    _equations_stand_as_they_are(lines)
    literal = False
    for i, line in enumerate(lines):
        indented = line.startswith("    ") or line.lstrip().startswith(">>>")
        if not line.strip():
            continue
        if line.startswith(".. ") or (literal and indented):
            literal = True
            continue
        literal = lines[i - 1].rstrip().endswith("::") if i else False
        if not line.lstrip().startswith((">>>", "...", ":")) and not literal:
            lines[i] = house_pages.linked(_norms_are_no_substitutions(line), LABELS)


def every_output_is_there(app, exception):
    """Fail the build where a page that draws, or a cell that prints, shows nothing, or a picture twice."""
    if exception is not None or app.builder.format != "html" or os.environ.get("DOCS_FAST"):
        return
    pages = {page: Path(app.env.doc2path(page)) for page in app.env.found_docs}
    lost = lost_pictures({p: s for p, s in pages.items() if s.suffix in (".md", ".ipynb")}, Path(app.outdir))
    if lost:
        told = ", ".join(f"{page} ({found} of {wanted})" for page, (wanted, found) in sorted(lost.items()))
        raise ExtensionError(f"pictures are missing on {told}: was a matplotlib backend set for the notebooks?")
    built = {page: (Path(app.outdir) / f"{page}.html").read_text() for page in pages}
    wrong = [f"{page} prints nothing: {cell}" for page, text in built.items() for cell in silent_cells(text)]
    wrong += [f"{page} shows {image} twice" for page, text in built.items() for image in doubled_pictures(text)]
    if wrong:
        raise ExtensionError("; ".join(wrong))


def every_certificate_is_proven(app, exception):
    """Fail the build where a page makes a certificate that balls do not prove."""
    if exception is not None or app.builder.format != "html" or os.environ.get("DOCS_FAST"):
        return
    told = open_certificates(CERTIFICATES)
    if told:
        raise ExtensionError("certificates of the pages are not proven: " + "; ".join(told))


def searches_show_words(app, pagename, templatename, context, doctree):
    """Give the search page what turns formulas into words, after the search itself."""
    if pagename == "search":
        app.add_js_file("search_words.js", priority=900, loading_method="defer")


def lectures_run(app, pagename, templatename, context, doctree):
    """Give lectures, and the list of them, what makes their cells run where a Jupyter server shows them."""
    if pagename.startswith("made/notebooks/"):
        app.add_js_file("live.js", loading_method="defer")


def setup(app):
    """Write the pages that are made from the package itself, then read all pages."""
    make_pages.write_all(HERE)
    app.connect("html-page-context", searches_show_words)
    app.connect("html-page-context", lectures_run)
    app.connect("build-finished", every_output_is_there)
    app.connect("build-finished", every_certificate_is_proven)
    app.connect("autodoc-process-docstring", escape_mathematics, priority=100)
