#!/usr/bin/env python3
"""Checks that the files and headings to which the repository's documents link exist.

    python3 scripts/links.py

Prints every broken link, and then exits with 1. Links to other sites are not followed.
"""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
# Code is skipped: text that looks like a link there is not one.
CODE = re.compile(r"^(```|~~~).*?^\1|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)|^\s*\[[^\]]+\]:\s*(\S+)", re.MULTILINE)
HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*\s*$", re.MULTILINE)
OTHER_SITE = re.compile(r"[a-z][a-z0-9+.-]*:")


def prose(path: Path) -> str:
    return CODE.sub(lambda code: "`" if code[0].startswith("`") else "", path.read_text("utf-8"))


@cache
def anchors(path: Path) -> set[str]:
    """Returns GitHub's anchors of the headings of a document."""
    # Inline code in a heading is part of the anchor, unlike a code block.
    text = re.sub(r"^(```|~~~).*?^\1", "", path.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    names: set[str] = set()
    for heading in HEADING.findall(text):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        # Repeated headings are numbered from the second on.
        number = 0
        while (unique := f"{name}-{number}" if number else name) in names:
            number += 1
        names.add(unique)
    return names


def links(document: Path) -> list[str]:
    """Returns the links of a document within this repository."""
    found = (inline or reference for inline, reference in LINK.findall(prose(document)))
    return [link for link in found if not OTHER_SITE.match(link)]


def fault(document: Path, link: str) -> str | None:
    """Returns the reason why a link is broken; None if it is not."""
    path, _, anchor = link.partition("#")
    target = (document.parent / unquote(path)).resolve() if path else document
    if not target.exists():
        return "there is no such file"
    if anchor and target.suffix == ".md" and anchor not in anchors(target):
        return "there is no such heading"
    return None


def main() -> None:
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, check=True, capture_output=True, text=True)
    documents = [ROOT / name for name in listed.stdout.splitlines()]
    checked = [(document, link) for document in documents for link in links(document)]
    broken = [(document, link, why) for document, link in checked if (why := fault(document, link))]
    for document, link, why in broken:
        print(f"{document.relative_to(ROOT)}: {link}: {why}")
    print(f"{len(documents)} documents, {len(checked)} links, {len(broken)} of which lead nowhere")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
