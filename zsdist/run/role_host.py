"""Content of the process of one role, whichever runner has started it: it builds the role and steps it to its end."""

import os
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import nullcontext

from zsdist.common import output_files, search_path
from zsdist.errors import ZsdistError
from zsdist.roles.base import HOST, Role
from zsdist.run import profiling, program
from zsdist.run.allocator import keep_freed_memory
from zsdist.run.heartbeats import HUB
from zsdist.run.processes import ProcessIdentity, name_role_thread
from zsdist.run.program import ActorParts, RoleSpec, RunSpec
from zsdist.transport.base import Transport
from zsdist.transport.zenoh import ZenohHub


class RoleHost:
    """Content of a Ray actor, which builds one role and steps it until it has finished."""

    def __init__(self, spec: RunSpec) -> None:
        search_path.apply()
        keep_freed_memory()
        self.spec = spec
        self.wake = threading.Event()
        self._stop = False
        self._hub: ZenohHub | None = None
        self._parts: ActorParts | None = None

    def place(self) -> tuple[str, ProcessIdentity]:
        """Return the machine's name and the identity of this process."""
        return HOST, ProcessIdentity.here()

    def warm_up(self) -> None:
        """Make and use the parts of an actor, which take longest, so that any role can start here at once later."""
        from zsdist.run import preflight

        parts = self.spec.make_parts(self.spec.config)
        preflight.try_out(parts, self.spec.config)
        program.reading_fingerprint(self.spec.config, parts.visual_act)  # it reads all of the code, once in a process
        self._parts = parts

    def open_hub(self, endpoint: str | None) -> str:
        """Open the router in this process and return the endpoint at which it listens.

        Args:
            endpoint: endpoint of the hub's predecessor; None: this is the run's first hub.
        """
        self._hub = self.spec.open_hub(endpoint)
        return self._hub.endpoint

    def drive(self, role_spec: RoleSpec, endpoint: str) -> str:
        """Build a role and step it to its end; return an empty string, or the reason of its failure in one line."""
        transport = None
        name_role_thread()
        if role_spec.role == "learner":
            import torch

            torch.set_num_threads(1)
        try:
            self._redirect_output(role_spec)
            if role_spec.name == HUB and self._hub is None:
                self.open_hub(endpoint)
            elif role_spec.role == "hub" and self._hub is None:
                branch = self.spec.config.cluster.branches[int(role_spec.id) - 1]
                self._hub = self.spec.open_branch(branch.endpoint, root=endpoint)
            transport = self._connect(role_spec, endpoint)
            parts, self._parts = self._parts, None  # they are an actor's; any other role needs their memory
            if self._hub is None:
                role = self.spec.build(role_spec, transport, self.wake, parts)
            else:
                role = program.make_hub(self.spec, role_spec, transport, self.wake, self._hub.endpoint)
            with profiling.sampled(self.spec.folder, role_spec) if self.spec.profile else nullcontext():
                self._step(role)
        except ZsdistError as error:
            return role_spec.reason(error)
        except OSError as error:
            if error.errno in output_files.OF_THE_SYSTEM:
                return role_spec.reason(error)
            traceback.print_exc()
            raise
        except Exception:
            traceback.print_exc()  # into the role's log; the supervisor ends the run
            raise
        finally:
            if transport is not None:
                transport.close()
            if self._hub is not None:
                self._hub.close()
        return ""

    def labels(self) -> Mapping[str, str]:
        """Return the labels of the node on which this process lives."""
        return {}

    def _connect(self, role_spec: RoleSpec, endpoint: str) -> Transport:
        """Connect a role to the hub of its process, an actor to that of its rack or site, others to the run's own."""
        if self._hub is not None:
            return self.spec.connect(role_spec, self._hub.endpoint)
        if role_spec.role == "actor":
            labels = self.labels().items()
            for branch in self.spec.config.cluster.branches:
                if branch.labels.items() <= labels:
                    return self.spec.connect(role_spec, branch.endpoint, (endpoint,))
        return self.spec.connect(role_spec, endpoint)

    def stop(self) -> None:
        """Make `drive` return after the current step; called from another thread of the Ray actor."""
        self._stop = True
        self.wake.set()

    def _step(self, role: Role) -> None:
        offset_s = time.time() - time.monotonic()  # unix time that never runs backwards
        while not self._stop:
            due_s = role.step(offset_s + time.monotonic())
            if due_s is None:
                return
            self.wake.wait(max(0.0, due_s - offset_s - time.monotonic()))
            self.wake.clear()

    def _redirect_output(self, role_spec: RoleSpec) -> None:
        """Redirect output to `logs/{role}.log` of the run directory, where that is on this machine."""
        logs = self.spec.folder / "logs"
        if not logs.is_dir():
            return
        log = os.open(logs / f"{role_spec.name}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            os.dup2(log, stream.fileno())
        os.close(log)
