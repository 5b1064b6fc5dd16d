"""What these pages have beyond their text: boxes with numbers, folded solutions, alternative texts, links.

* On the theory's pages what begins with **Theorem 9**, **Statement**, **E14** becomes a box; a statement takes the
  number of its section. What begins with *Proof* becomes a quieter one.
* **Solution.** begins a part that stays folded until the next exercise.
* A picture that a cell has drawn gets an alternative text: the heading it stands under, and what its axes say.
* A command that is longer than its line breaks between words, and not within an option or a date.
* What a cell prints in columns scrolls sideways; other text goes on below.
* "theory 3.1" and "E4" in a docstring lead to the theory.
"""

import ast
import re
from pathlib import Path

from docutils import nodes

CLAIM = re.compile(r"(Definition|Assumption|Theorem|Lemma|Proposition|Corollary|Remark|Statement)\b")
ERRATUM = re.compile(r"E\d+ ")
PROOF = re.compile(r"Proof\b")
NUMBER = re.compile(r"(\d+(?:\.\d+)*)\s")

COLUMNS = re.compile(r"\S {2,}\S")
LONGEST_WORD = 60  # characters of a command's word that is shown unbroken: a longer one may be wider than a page


def boxes(app, doctree):
    """Put every statement, correction and proof of a page of the theory in a box, with what belongs to it."""
    if not app.env.docname.startswith("theory/"):
        return
    source = Path(app.env.doc2path(app.env.docname)).read_text().splitlines()
    for section in list(doctree.findall(nodes.section)):
        found = NUMBER.match(section.next_node(nodes.title).astext())
        _box_section(section, found[1] if found else "", source)


def _box_section(section, number, source):
    box = None
    for child in list(section.children):
        kind = _kind(child)
        if kind:
            box = nodes.container(classes=["box", kind])
            _numbered(child, number)
            section.replace(child, box)
            box += child
        elif box is not None and _belongs(child, box, source):
            section.remove(child)
            box += child
        elif not isinstance(child, nodes.target):
            box = None


def _kind(node):
    """'statement', 'wrong', 'proof', or '' for a paragraph that begins nothing."""
    first = _leading(node)
    if not isinstance(first, nodes.strong | nodes.emphasis):
        return ""
    text = first.astext()
    if isinstance(first, nodes.strong) and ERRATUM.match(text):
        return "wrong"
    if isinstance(first, nodes.strong) and CLAIM.match(text):
        return "statement"
    return "proof" if PROOF.match(text) else ""


def _leading(node):
    """The first thing that a paragraph says."""
    said = (c for c in node.children if c.astext().strip()) if isinstance(node, nodes.paragraph) else iter(())
    return next(said, None)


def _numbered(paragraph, number):
    """A bare **Statement.** takes the number of its section, so that it can be cited."""
    first = _leading(paragraph)
    if number and re.fullmatch(r"Statement[.]?", first.astext()):
        first.children[:] = [nodes.Text(f"Statement {number}.")]


def _belongs(child, box, source):
    """A displayed formula belongs to the box, and so does text that follows a formula or the line before it."""
    if isinstance(child, nodes.math_block):
        return True
    if not isinstance(child, nodes.paragraph) or isinstance(_leading(child), nodes.strong):
        return False
    joined = bool(child.line) and 2 <= child.line <= len(source) and bool(source[child.line - 2].strip())
    return joined or isinstance(box.children[-1], nodes.math_block)


class details(nodes.Element, nodes.General):
    """A folded part of a page."""


def open_details(self, node):
    """Begin it, with what is seen while it is folded."""
    self.body.append(f'<details class="solution"><summary>{node["summary"]}</summary>\n')


def close_details(self, node):
    """End it."""
    self.body.append("</details>\n")


def solutions(app, doctree):
    """Fold what follows **Solution.** up to the next exercise, executed cells included."""
    for section in list(doctree.findall(nodes.section)):
        folded = None
        for child in list(section.children):
            first = _leading(child)
            strong = first.astext() if isinstance(first, nodes.strong) else ""
            if strong == "Solution.":
                folded = details(summary="Solution")
                section.replace(child, folded)
                child.remove(first)
                folded += child
            elif isinstance(child, nodes.section) or re.fullmatch(r"\d+[.]", strong):
                folded = None
            elif folded is not None:
                section.remove(child)
                folded += child


def alternative_texts(app, doctree):
    """Say in words what each drawn picture shows: heading, title and axes of the cell that drew it."""
    for image in doctree.findall(nodes.image):
        if image.get("alt"):
            continue
        parent = image.parent
        while parent is not None and "cell" not in parent.get("classes", ()):
            parent = parent.parent
        code = parent.next_node(nodes.literal_block) if parent is not None else None
        section = image.parent
        while section is not None and not isinstance(section, nodes.section):
            section = section.parent
        heading = section.next_node(nodes.title).astext() if section is not None else app.config.project
        said = words_of(code.astext() if code is not None else "")
        image["alt"] = f"Picture under “{heading}”" + (f": {said}" if said else "")


def words_of(code):
    """What a cell writes into its picture: titles, axes, legends; where it draws a record, the line that does."""
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return ""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        found += [k.value.value for k in node.keywords if k.arg in ("title", "xlabel", "ylabel", "label") and _text(k)]
        if getattr(node.func, "attr", "") in ("set_title", "set_xlabel", "set_ylabel", "suptitle"):
            found += [a.value for a in node.args if isinstance(a, ast.Constant)]
    if not found:
        drawn = [line.strip() for line in code.splitlines() if ".plot(" in line or "draw(" in line]
        found = [f"drawn by {line}" for line in drawn[-1:]]
    return "; ".join(dict.fromkeys(str(f) for f in found))


def _text(keyword):
    return isinstance(keyword.value, ast.Constant) and isinstance(keyword.value.value, str)


def whole_words(body):
    """Keep each word of a command on one line: a browser breaks `--open 7-22` at any of its hyphens."""
    gap = r'(<span class="w">[^<]*</span>|\n)'

    def block(found):
        parts = re.split(gap, found[2])
        words = (f'<span class="word">{part}</span>' if _short(part) else part for part in parts[::2])
        return found[1] + "".join(word + space for word, space in zip(words, [*parts[1::2], ""], strict=True))

    return re.sub(
        r'(<div class="highlight-sh\b[^>]*><div class="highlight"><pre>)(.*?)(?=</pre>)', block, body, flags=re.S
    )


def _short(html):
    return 0 < len(re.sub(r"<[^>]*>", "", html)) <= LONGEST_WORD


def kept_columns(body):
    """Name the output of cells that stands in columns: two lines or more with a gap of two blanks inside."""

    def block(found):
        lines = re.sub(r"<[^>]*>", "", found[2]).splitlines()
        return (
            found[1]
            + ('<pre class="columns">' if sum(map(bool, map(COLUMNS.search, lines))) > 1 else "<pre>")
            + found[2]
        )

    return re.sub(
        r'(<div class="output (?:stream|text_plain)\b[^>]*><div class="highlight">)<pre>(.*?)(?=</pre>)',
        block,
        body,
        flags=re.S,
    )


def lines_as_they_are_read(app, pagename, templatename, context, doctree):
    """Show the commands of a page with whole words, and what is printed in columns in columns."""
    if "body" in context:
        context["body"] = kept_columns(whole_words(context["body"]))


def section_labels(theory):
    """Return {section number: label} of the theory's pages."""
    found = {}
    for page in sorted(theory.glob("*.md")):
        text = page.read_text()
        for label, number in re.findall(r"^\(([\w-]+)\)=\n(?:\([\w-]+\)=\n)*#+ (\d+(?:\.\d+)?) ", text, re.MULTILINE):
            found[number] = label
        for label, correction in re.findall(r"^\((errata-e\d+)\)=\n\*\*(E\d+) ", text, re.MULTILINE):
            found[correction] = label
    return found


def linked(line, labels):
    """Turn what a docstring cites of the theory into links."""

    def link(match):
        text = match.group()
        key = match.group("section") or match.group("erratum")
        return f":ref:`{text} <{labels[key]}>`" if key in labels else text

    pattern = r"theory (?:section )?(?P<section>\d+(?:\.\d+)?)|(?<![\w.`])(?P<erratum>E\d+)(?![\w`+])"
    return re.sub(pattern, link, line) if "theory" in line else line


def setup(app):
    """Register all of it."""
    app.add_node(details, html=(open_details, close_details))
    app.connect("doctree-read", boxes)
    app.connect("doctree-read", solutions)
    app.connect("doctree-read", alternative_texts)
    app.connect("html-page-context", lines_as_they_are_read)
    return {"parallel_read_safe": True}
