"""A made-up head of a Ray cluster, which answers one question as the real one does: whether it admits the asker."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import version

import grpc

METHOD = "/ray.rpc.NodeInfoGcsService/CheckAlive"


class _Head(grpc.GenericRpcHandler):
    def __init__(self, token, ray_version):
        self._token, self._answer = token, b"\n\x00\x12" + bytes([len(ray_version)]) + ray_version.encode() + b" \x01"

    def service(self, details):
        return grpc.unary_unary_rpc_method_handler(self._check) if details.method == METHOD else None

    def _check(self, request, context):
        given = dict(context.invocation_metadata()).get("authorization")
        if self._token is not None and given != f"Bearer {self._token}":
            context.abort(
                grpc.StatusCode.UNAUTHENTICATED, "InvalidAuthToken: Authentication token is missing or incorrect"
            )
        return self._answer


@contextmanager
def ray_head(token=None, ray_version=None):
    """Yield the port of a head that asks for a token, or for none, and runs a version of Ray, by default this one."""
    with ThreadPoolExecutor(2) as pool:
        server = grpc.server(pool, handlers=[_Head(token, ray_version or version("ray"))])
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        try:
            yield port
        finally:
            server.stop(None).wait()
