"""Time and memory of a block and of a whole process. Standard library only."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path


class Stopwatch:
    """Wall and CPU seconds of a `with` block, CPU over all threads of the process."""

    def __enter__(self):
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self.wall_s = self.cpu_s = 0.0
        return self

    def so_far_s(self) -> float:
        """Wall seconds since the block began."""
        return time.perf_counter() - self._wall

    def cpu_so_far_s(self) -> float:
        """CPU seconds since the block began."""
        return time.process_time() - self._cpu

    def __exit__(self, *_):
        self.wall_s = time.perf_counter() - self._wall
        self.cpu_s = time.process_time() - self._cpu


def own_peak_bytes() -> int:
    """Peak resident memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@dataclass
class Finished:
    """A child process that has ended."""

    code: int
    stdout: str
    stderr: str
    wall_s: float
    cpu_s: float
    peak_bytes: int
    timed_out: bool

    def json(self) -> dict:
        """The last JSON object that the child printed; raises ValueError if there is none."""
        text = self.stdout
        start = 0 if text.lstrip().startswith("{") else text.rfind("\n{") + 1
        found = json.loads(text[start:])
        if not isinstance(found, dict):
            raise ValueError("not an object")
        return found

    def why(self) -> str:
        """One line with the reason of the failure."""
        if self.timed_out:
            return f"stopped after {self.wall_s:.0f} s"
        lines = [line.strip() for line in self.stderr.splitlines() if line.strip()]
        return lines[-1][:200] if lines else f"exit code {self.code}"


def run(command: list[str], timeout_s: float, env: dict | None = None, cwd: Path | None = None) -> Finished:
    """Runs a command and measures its process (with the CPU time of children it has waited for)."""
    began = time.perf_counter()
    try:
        child = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **(env or {})},
            cwd=cwd,
        )
    except OSError as error:
        return Finished(127, "", str(error), 0.0, 0.0, 0, False)
    # Threads drain both pipes, so that wait4, the only call that reports the usage of one child, can block here.
    texts = {}

    def drain(name, pipe):
        with pipe:
            texts[name] = pipe.read()

    pipes = {"out": child.stdout, "err": child.stderr}
    readers = [threading.Thread(target=drain, args=pair, daemon=True) for pair in pipes.items()]
    for reader in readers:
        reader.start()
    late = threading.Event()
    alarm = threading.Timer(timeout_s, lambda: (late.set(), child.kill()))
    alarm.start()
    _, status, usage = os.wait4(child.pid, 0)
    alarm.cancel()
    child.returncode = os.waitstatus_to_exitcode(status)
    for reader in readers:
        reader.join()
    scale = 1 if sys.platform == "darwin" else 1024
    return Finished(
        child.returncode,
        texts["out"].decode(errors="replace"),
        texts["err"].decode(errors="replace"),
        time.perf_counter() - began,
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss * scale,
        late.is_set(),
    )
