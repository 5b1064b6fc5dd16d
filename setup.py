"""What an index shows of the README: no picture, and a path where a link would lead to a file of the repository."""

import re
from pathlib import Path


def for_an_index(text: str) -> str:
    """Return the README without relative links: what they name stands in the source distribution."""
    text = re.sub(r"^!\[[^]]*\]\((?!https:)[^)]*\)\n+", "", text, flags=re.MULTILINE)
    return re.sub(r"\[([^]]*)\]\((?!https:)([^)]*)\)", r"\1 (`\2`)", text)


if __name__ == "__main__":
    from setuptools import setup

    readme = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    setup(long_description=for_an_index(readme), long_description_content_type="text/markdown")
