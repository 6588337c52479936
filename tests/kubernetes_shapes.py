"""Shapes of the Kubernetes objects in `deploy/`: which fields there are, as far as the files use them, and their types.

They are a part of the schemas of Kubernetes 1.35 and KubeRay 1.7. A field that is misspelt or at the wrong place is
found without these schemas, which have megabytes; `make manifests` compares with them.
"""

from typing import Any

QUANTITY, PORT = (str, int), (int, str)
TEXTS: dict[Any, Any] = {str: str}
META = {"name": str, "labels": TEXTS}
SELECTOR = {"matchLabels": TEXTS}
RESOURCES = {"requests": {str: QUANTITY}, "limits": {str: QUANTITY}}
PROBE = {
    "httpGet": {"path": str, "port": PORT},
    **dict.fromkeys(("initialDelaySeconds", "periodSeconds", "timeoutSeconds", "failureThreshold"), int),
}
CONTAINER = {
    "name": str,
    "image": str,
    "command": [str],
    "args": [str],
    "env": [{"name": str, "value": str}],
    "securityContext": {"allowPrivilegeEscalation": bool, "capabilities": {"drop": [str]}},
    "livenessProbe": PROBE,
    "readinessProbe": PROBE,
    "ports": [{"containerPort": int, "name": str}],
    "resources": RESOURCES,
    "volumeMounts": [{"name": str, "mountPath": str, "readOnly": bool}],
}
POD = {
    "metadata": META,
    "spec": {
        "hostname": str,
        "subdomain": str,
        "restartPolicy": str,
        "securityContext": {"runAsNonRoot": bool, "runAsUser": int, "fsGroup": int, "seccompProfile": {"type": str}},
        "containers": [CONTAINER],
        "volumes": [
            {
                "name": str,
                "secret": {"secretName": str, "defaultMode": int},
                "persistentVolumeClaim": {"claimName": str},
                "emptyDir": {},
            }
        ],
    },
}
GROUP = {"rayStartParams": TEXTS, "labels": TEXTS, "template": POD}
WORKERS = GROUP | {"groupName": str, "replicas": int, "minReplicas": int, "maxReplicas": int}
RAY_CLUSTER = {
    "rayVersion": str,
    "authOptions": {"mode": str, "secretName": str},
    "headGroupSpec": GROUP,
    "workerGroupSpecs": [WORKERS],
}
RAY_JOB = {
    "entrypoint": str,
    "submissionMode": str,
    "submitterConfig": {"backoffLimit": int},
    "backoffLimit": int,
    "shutdownAfterJobFinishes": bool,
    "ttlSecondsAfterFinished": int,
    "submitterPodTemplate": POD,
    "rayClusterSpec": RAY_CLUSTER,
}
PEER = {"podSelector": SELECTOR, "namespaceSelector": SELECTOR}
SPECS = {
    ("ray.io/v1", "RayJob"): RAY_JOB,
    ("ray.io/v1", "RayCluster"): RAY_CLUSTER,
    ("v1", "Service"): {
        "clusterIP": str,
        "publishNotReadyAddresses": bool,
        "selector": TEXTS,
        "ports": [{"name": str, "port": int}],
    },
    ("v1", "PersistentVolumeClaim"): {"accessModes": [str], "resources": RESOURCES},
    ("apps/v1", "Deployment"): {"replicas": int, "selector": SELECTOR, "template": POD},
    ("policy/v1", "PodDisruptionBudget"): {"minAvailable": int, "selector": SELECTOR},
    ("networking.k8s.io/v1", "NetworkPolicy"): {
        "podSelector": SELECTOR,
        "policyTypes": [str],
        "ingress": [{"from": [PEER], "ports": [{"port": PORT}]}],
    },
    ("monitoring.coreos.com/v1", "PodMonitor"): {
        "selector": SELECTOR,
        "podMetricsEndpoints": [{"port": str, "path": str, "interval": str}],
    },
}


def problems(manifest: dict[str, Any]) -> list[str]:
    """Return what is wrong with a manifest, each with its place."""
    kind = (manifest.get("apiVersion"), manifest.get("kind"))
    if kind == ("v1", "ConfigMap"):
        return _differences(manifest, {"apiVersion": str, "kind": str, "metadata": META, "data": TEXTS}, "ConfigMap")
    if kind not in SPECS:
        return [f"unknown kind {kind}"]
    return _differences(manifest, {"apiVersion": str, "kind": str, "metadata": META, "spec": SPECS[kind]}, kind[1])


def _differences(value: Any, shape: Any, place: str) -> list[str]:
    if isinstance(shape, list):
        if not isinstance(value, list):
            return [f"{place} is no list"]
        return [found for at, item in enumerate(value) for found in _differences(item, shape[0], f"{place}[{at}]")]
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return [f"{place} is no mapping"]
        found = [f"{place}.{key} is no field" for key in value if key not in shape and str not in shape]
        known = [(key, shape.get(key, shape.get(str))) for key in value if key in shape or str in shape]
        return found + [line for key, inner in known for line in _differences(value[key], inner, f"{place}.{key}")]
    kinds = shape if isinstance(shape, tuple) else (shape,)
    fits = isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))
    return [] if fits else [f"{place} is {value!r}; allowed is {' or '.join(kind.__name__ for kind in kinds)}"]
