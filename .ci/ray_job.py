"""Checks a RayJob: `ray_job.py FILE FOLDER [CRD]`.

Writes the pods that KubeRay creates from it to FOLDER, as manifests for a validator. With KubeRay's definition of RayJob
(`ray-operator/config/crd/bases/ray.io_rayjobs.yaml`), checks the job itself; unknown fields are errors.
"""

import json
import sys
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft7Validator


def pods(job: dict[str, Any]) -> list[dict[str, Any]]:
    cluster = job["spec"]["rayClusterSpec"]
    groups = [cluster["headGroupSpec"], *cluster["workerGroupSpecs"]]
    return [{"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "pod"}, **group["template"]} for group in groups]


def closed(schema: Any) -> Any:
    """Returns the schema without additional properties, and without keywords that JSON Schema lacks."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {key: closed(part) for key, part in schema.items()}
    if schema.get("x-kubernetes-int-or-string"):
        schema.pop("type", None)
    if isinstance(schema.get("properties"), dict) and not schema.get("x-kubernetes-preserve-unknown-fields"):
        schema.setdefault("additionalProperties", False)
    return schema


def main() -> int:
    file, folder, *definition = map(Path, sys.argv[1:])
    job = yaml.safe_load(file.read_text())
    for index, pod in enumerate(pods(job)):
        (folder / f"ray-pod-{index}.json").write_text(json.dumps(pod))
    if not definition:
        return 0
    versions = yaml.safe_load(definition[0].read_text())["spec"]["versions"]
    schema = closed(next(version for version in versions if version["name"] == "v1")["schema"]["openAPIV3Schema"])
    # Not part of the definition: the metadata of every object.
    schema["properties"]["metadata"] = {"type": "object"}
    errors = list(Draft7Validator(schema).iter_errors(job))
    for error in errors:
        print(f"{file}: {'.'.join(map(str, error.absolute_path))}: {error.message[:200]}", file=sys.stderr)
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
