"""Says what a wheel and an sdist hold that they should not, or lack: `python tests/house/packages.py DIST`.

Standard library only, so that it runs before anything is installed.
"""

import sys
import tarfile
import zipfile
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "sampling_design"
SHIPPED = (".py", ".pyi", ".md", ".js", ".typed")


def wanted(package: Path) -> set[str]:
    """Everything of the package: code, the stub, the mark that it is typed, and the rooms' READMEs."""
    files = (p for p in package.rglob("*") if p.suffix in SHIPPED or p.name == "py.typed")
    return {f"{package.name}/{p.relative_to(package).as_posix()}" for p in files}


def beside(root: Path) -> set[str]:
    """What a source distribution holds beside the package, so that the README's commands and all tests run in it."""
    files = (p.relative_to(root) for folder in (".ci", "docs", "examples", "tests") for p in (root / folder).rglob("*"))
    built = {"__pycache__", "_build", "made"}
    kept = {p.as_posix() for p in files if (root / p).is_file() and not built & set(p.parts)}
    return kept | {"pyproject.toml", "setup.py", "LICENSE", "README.md", "CITATION.cff"}


def faults(names: set[str], package: Path) -> list[str]:
    """What is missing in a list of files, and what of it is neither the package nor about it."""
    own = wanted(package)
    strange = {n for n in names - own if not n.split("/")[0].endswith(".dist-info") and not n.endswith("/")}
    return [f"lacks {n}" for n in sorted(own - names)] + [f"holds {n}" for n in sorted(strange)]


def main(folder: Path) -> int:
    """Judge the one wheel and the one sdist of a folder; the exit code is the number of faults."""
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    found = [f"{wheel.name} {fault}" for fault in faults(set(zipfile.ZipFile(wheel).namelist()), PACKAGE)]
    with tarfile.open(sdist) as archive:
        inside = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    found += [f"{sdist.name} lacks {name}" for name in sorted((wanted(PACKAGE) | beside(PACKAGE.parent)) - inside)]
    print("\n".join(found) or f"{wheel.name} and {sdist.name} hold what they should")
    return len(found)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
