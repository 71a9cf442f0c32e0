#!/usr/bin/env python3
"""Runs the parts of an experiment as Ray tasks and merges them. See experiments/studies/large-runs.md.

    pip install ray
    python scripts/ray_shards.py --parts 8 --results RESULTS robust --seeds 1001..1032
    python scripts/ray_shards.py --parts 18 --results RESULTS --address auto billiards

Without --address, Ray starts on this machine. All nodes must see the folder RESULTS and have the program (--sms) at the same
path. A failed part is restarted up to --retries times; billiards and landing resume.
"""

import argparse
import os
import pathlib
import subprocess
import sys

import ray


def command(options: argparse.Namespace, part: int) -> list[str]:
    """The command of one part, counted from 1."""
    results = pathlib.Path(options.results).resolve()
    parts = results / "parts"
    # Results in folders, which parts may share: no two parts have the same scene or flight.
    folder = options.bench in ("billiards", "landing", "masks", "scan")
    out = [str(parts)] if folder else [str(parts / f"{options.bench}-{part}.json")]
    keep = ["--keep", str(results / "scans")] if options.bench in ("billiards", "landing", "materialize") else []
    shard = ["--shard", f"{part}/{options.parts}"]
    return [options.sms, options.bench, *shard, "--out", *out, *keep, *options.rest]


@ray.remote
def run(arguments: list[str], threads: int) -> tuple[int, str]:
    """Returns the exit code and the end of the output."""
    environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, (done.stdout + done.stderr)[-2000:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=int, required=True, help="number of parts")
    parser.add_argument("--results", required=True, help="folder visible to all nodes")
    parser.add_argument("--sms", default="sms-experiments", help="the program")
    parser.add_argument("--threads", type=int, default=2, help="cores of each part")
    parser.add_argument("--retries", type=int, default=1)
    parser.add_argument("--address", help="a Ray cluster, such as auto")
    parser.add_argument("bench", help="experiment: billiards, landing, robust, optimisers, plan, scan, masks, materialize, scenes")
    parser.add_argument("rest", nargs=argparse.REMAINDER, help="its options")
    options = parser.parse_args()

    parts = pathlib.Path(options.results).resolve() / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    ray.init(address=options.address, log_to_driver=False)
    task = run.options(num_cpus=options.threads)
    running = {task.remote(command(options, i), options.threads): (i, 0) for i in range(1, options.parts + 1)}
    failed = []
    while running:
        (ready,), _ = ray.wait(list(running), num_returns=1)
        part, tries = running.pop(ready)
        try:
            code, said = ray.get(ready)
        except ray.exceptions.RayError as error:
            code, said = 1, str(error)
        if code == 0:
            print(f"part {part}/{options.parts} is done", flush=True)
        elif tries < options.retries:
            print(f"part {part}/{options.parts} failed and is restarted", flush=True)
            running[task.remote(command(options, part), options.threads)] = (part, tries + 1)
        else:
            print(f"part {part}/{options.parts} failed:\n{said}", file=sys.stderr, flush=True)
            failed.append(part)
    ray.shutdown()
    if failed:
        return 1
    merge = [options.sms, "merge", str(parts), "--out", str(parts.parent / "merged")]
    return subprocess.run(merge, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
