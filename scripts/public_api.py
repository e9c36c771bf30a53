#!/usr/bin/env python3
"""Lists the public interface of lsdc-core, or compares it with the list in the repository.

    python3 scripts/public_api.py            prints the list
    python3 scripts/public_api.py --check    fails if crates/core/public-api.txt differs

Hidden items are not listed. Reads rustdoc's JSON output, whose format changes with the compiler: made for the version in
rust-toolchain.toml.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "crates/core/public-api.txt"


def documented() -> dict:
    command = ["cargo", "rustdoc", "-q", "--release", "-p", "lsdc-core", "--lib", "--"]
    command += ["-Z", "unstable-options", "--output-format", "json", "--document-hidden-items"]
    # A separate folder, because RUSTC_BOOTSTRAP would cause other builds to start over.
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "public-api"
    settings = {"RUSTC_BOOTSTRAP": "1", "CARGO_TARGET_DIR": str(target)}
    subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, **settings})
    return json.loads((target / "doc/lsdc_core.json").read_text())


def hidden(item: dict) -> bool:
    return any("hidden" in str(attribute) for attribute in item["attrs"])


def kind_of(item: dict) -> str:
    return next(iter(item["inner"]))


def members(item: dict) -> list:
    """Returns the identifiers of public items below an item."""
    kind = kind_of(item)
    inner = item["inner"][kind]
    if kind == "module":
        return inner["items"]
    if kind == "enum":
        return inner["variants"] + inner["impls"]
    if kind == "struct":
        fields = inner["kind"].get("plain", {}) if isinstance(inner["kind"], dict) else {}
        return fields.get("fields", []) + inner["impls"]
    if kind == "trait":
        return inner["items"]
    if kind == "impl":
        own = inner["trait"] is None and not inner["is_synthetic"]
        return inner["items"] if own else []
    return []


def listed(index: dict, identifier, path: str, seen: set) -> list:
    item = index.get(str(identifier))
    if item is None or (identifier, path) in seen:
        return []
    seen.add((identifier, path))
    kind = kind_of(item)
    if kind == "use":
        target = item["inner"]["use"]
        return [] if target["id"] is None else listed(index, target["id"], path, seen)
    name = item["name"] or ""
    here = path if kind == "impl" else f"{path}::{name}" if path else name
    shown = kind not in ("impl", "module") or kind == "module" and path
    inherited = kind in ("variant", "impl") or item["visibility"] in ("public", "default")
    if not inherited or hidden(item):
        return []
    lines = [f"{kind} {here}"] if shown else []
    for member in members(item):
        lines += listed(index, member, here, seen)
    return lines


def main() -> None:
    crate = documented()
    lines = listed(crate["index"], crate["root"], "", set())
    text = "\n".join(sorted(set(lines))) + "\n"
    if "--check" not in sys.argv:
        print(text, end="")
    elif text != KEPT.read_text():
        print(text)
        sys.exit(f"the interface is not that of {KEPT}: keep the list above there if that is meant")


if __name__ == "__main__":
    main()
