"""Compare the files of `deploy/` with the schemas of KubeRay, Kubernetes and Compose: `make manifests`.

python deploy/check_manifests.py CRDS, a folder with ray.io_rayjobs.yaml and ray.io_rayclusters.yaml of KubeRay's
release. The schemas have megabytes and come from the net, so `make test` checks what it can without them
(tests/kubernetes_shapes.py).
"""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import compose_spec
import jsonschema
import kubernetes_validate
import yaml

DEPLOY = Path(__file__).parent
KUBERNETES_VERSION = "1.35"
UNCHECKED = {"PodMonitor"}  # of the Prometheus operator


def strict(schema: Any) -> Any:
    """Return a schema of Kubernetes as JSON schema that refuses unknown fields, which Kubernetes drops in silence."""
    if isinstance(schema, list):
        return [strict(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    made = {key: strict(value) for key, value in schema.items()}
    if made.get("x-kubernetes-int-or-string"):
        return {}
    if "properties" in made and not made.get("x-kubernetes-preserve-unknown-fields"):
        made.setdefault("additionalProperties", False)
    return made


def custom_schemas(folder: Path) -> dict[tuple[str, str], Any]:
    """Return the schema of each kind that the definitions in a folder define."""
    found = {}
    for path in sorted(folder.glob("*.yaml")):
        spec = yaml.load(path.read_text(), yaml.CSafeLoader)["spec"]
        for version in spec["versions"]:
            schema = strict(version["schema"]["openAPIV3Schema"])
            schema["properties"]["metadata"] = {"type": "object"}
            found[f"{spec['group']}/{version['name']}", spec["names"]["kind"]] = schema
    return found


def problems(manifest: dict[str, Any], schemas: dict[tuple[str, str], Any]) -> list[str]:
    """Return what is wrong with one manifest."""
    kind = (manifest["apiVersion"], manifest["kind"])
    if kind in schemas:
        errors = jsonschema.Draft7Validator(schemas[kind]).iter_errors(manifest)
        return [f"{'.'.join(map(str, error.absolute_path))}: {error.message[:200]}" for error in errors]
    try:
        kubernetes_validate.validate(manifest, KUBERNETES_VERSION, strict=True)
    except (kubernetes_validate.ValidationError, kubernetes_validate.SchemaNotFoundError) as error:
        return [str(error)[:300]]
    return []


def main(folder: Path) -> int:
    """Print the result for each object; return 1 where something is wrong."""
    schemas, wrong = custom_schemas(folder), 0
    if not {"RayJob", "RayCluster"} <= {kind for _, kind in schemas}:
        sys.exit(f"{folder} has no definitions of RayJob and RayCluster")
    for kustomization in sorted(DEPLOY.glob("kubernetes/*/kustomization.yaml")):
        command = ["kubectl", "kustomize", str(kustomization.parent)]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        for manifest in yaml.safe_load_all(text):
            kind = manifest["kind"]
            found = [] if kind in UNCHECKED else problems(manifest, schemas)
            wrong += len(found)
            how = "not compared" if kind in UNCHECKED else "; ".join(found) or "ok"
            print(f"{kustomization.parent.name:12} {kind:22} {how}")
    text = re.sub(r"\$\{\w+:-(\w+)\}", r"\1", (DEPLOY / "compose.yaml").read_text())
    try:
        compose_spec.PyCompose.from_yaml(yaml.safe_dump(yaml.safe_load(text)))
        print(f"{'compose':12} {'':22} ok")
    except ValueError as error:
        wrong += 1
        print(f"{'compose':12} {'':22} {error}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
