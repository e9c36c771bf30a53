#!/usr/bin/env python3
"""Checks the licence of every crate that is built against the list in deny.toml.

`cargo deny check` does the same and more; this needs nothing but Cargo and Python.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def allowed(expression: str, permitted: set[str]) -> bool:
    """Evaluates an SPDX expression (or the older `A/B`) over the permitted identifiers."""
    tokens = re.findall(r"\(|\)|[^\s()]+", expression.replace("/", " OR "))
    words = []
    while tokens:
        token = tokens.pop(0)
        if token in ("AND", "OR", "(", ")"):
            words.append(token.lower())
            continue
        if tokens and tokens[0] == "WITH":
            token = f"{token} WITH {tokens[1]}"
            del tokens[:2]
        words.append(str(token in permitted))
    return bool(words) and bool(eval(" ".join(words), {"__builtins__": {}}))


def main() -> int:
    rules = tomllib.loads((ROOT / "deny.toml").read_text())["licenses"]
    permitted = set(rules["allow"])
    clarified = {rule["crate"]: rule["expression"] for rule in rules.get("clarify", [])}
    command = ["cargo", "tree", "--locked", "--all-features", "--edges", "normal,build"]
    command += ["--prefix", "none", "--format", "{p}\t{l}"]
    lines = set(subprocess.check_output(command, cwd=ROOT, text=True).splitlines())
    crates = sorted(tuple(line.removesuffix(" (*)").split("\t")) for line in lines if line)
    licence = lambda crate: crate[1] or clarified.get(crate[0].split()[0], "")
    bad = [crate for crate in crates if not allowed(licence(crate), permitted)]
    print(f"{len(crates)} crates, {len(bad)} with a licence that deny.toml does not allow")
    for crate in bad:
        print("  ", *crate)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
