"""One evaluation of a landing with particles in Genesis and in ours: five seconds of flight of a quadrotor over an overhanging
platform, with the same emitters, particle size, sound speed and step, two threads each, in the same run.

    python benches/peers/genesis_wash.py --out runs/genesis

`cargo bench -p sms-sim --bench wash` times ours and writes the propellers' positions in every step; Genesis (`pip install torch
genesis-world`) replays them. Times exclude building the scene and Genesis's first ten steps with particles, in which it compiles
kernels. Genesis keeps particles until their slots are needed; it gets as many slots as ours has particles at most, then four
times as many. `--seconds` shortens the flight.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path

THREADS = 2
ROOT = Path(__file__).resolve().parents[2]
WARM_STEPS = 10


def read_job(path: Path) -> dict:
    """The air, the boxes, and a list of propellers' centres for every step (empty: no wash)."""
    job: dict = {"boxes": [], "steps": []}
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:2] == ["#", "air"]:
            job["air"] = {key: float(value) for key, value in zip(words[2::2], words[3::2])}
        elif words[:2] == ["#", "box"]:
            v = [float(w) for w in words[3:]]
            job["boxes"].append({"name": words[2], "center": v[:3], "half": v[3:6], "mass": v[6]})
        else:
            v = [float(w) for w in words]
            job["steps"].append([v[i : i + 3] for i in range(0, len(v), 3)])
    return job


def run_ours(out: Path, spacing: float) -> dict:
    """Seconds of our evaluation and its largest number of particles; writes the propellers' positions to `out`."""
    command = ["cargo", "bench", "-q", "-p", "sms-sim", "--bench", "wash", "--", str(spacing), f"emitters={out}"]
    env = {**os.environ, "RAYON_NUM_THREADS": str(THREADS)}
    done = subprocess.run(command, cwd=ROOT, env=env, check=True, stdout=subprocess.PIPE, text=True).stdout
    found = re.search(r"sph .*: ([\d.]+) CPU-s, ([\d.]+) s wall .* at most (\d+) particles", done)
    if not found:
        sys.exit(f"the benchmark's line about `sph` is not what it was:\n{done}")
    return {"cpu_s": float(found[1]), "wall_s": float(found[2]), "particles": int(found[3])}


class Flight:
    """Genesis with the structure and the four emitters."""

    def __init__(self, job: dict, places: int):
        import genesis as gs
        import numpy as np

        self.np, self.job = np, job
        air, steps = job["air"], [s for s in job["steps"] if s]
        gs.init(backend=gs.cpu, logging_level="error")
        # As ours: the longest step that waves and stream allow.
        substeps = math.ceil(air["step_s"] * (air["sound_speed"] + air["stream_speed"]) / air["support_m"] - 1e-9)
        around = [b for s in steps for b in s] + [b["center"] for b in job["boxes"]]
        low = [min(p[i] for p in around) - 0.6 for i in range(3)]
        high = [max(p[i] for p in around) + 0.6 for i in range(3)]
        self.scene = gs.Scene(
            sim_options=gs.options.SimOptions(dt=air["step_s"], substeps=substeps, gravity=(0.0, 0.0, -9.81)),
            sph_options=gs.options.SPHOptions(
                particle_size=air["spacing_m"],
                lower_bound=(low[0], low[1], -0.02),
                upper_bound=tuple(high),
                gravity=(0.0, 0.0, 0.0),
            ),
            show_viewer=False,
        )
        self.scene.add_entity(gs.morphs.Plane())
        self.boxes = {}
        for box in job["boxes"]:
            size = [2.0 * h for h in box["half"]]
            density = box["mass"] / math.prod(size)
            self.boxes[box["name"]] = self.scene.add_entity(
                gs.morphs.Box(pos=tuple(box["center"]), size=tuple(size)),
                material=gs.materials.Rigid(rho=density, needs_coup=True, friction=0.5),
            )
        # A linear equation of state with our sound speed.
        liquid = {
            "rho": air["density"],
            "stiffness": air["sound_speed"] ** 2 * air["density"],
            "exponent": 1.0,
            "mu": 1e-5,
            "gamma": 0.0,
        }
        rotors = len(steps[0])
        self.emitters = [
            self.scene.add_emitter(material=gs.materials.SPH.Liquid(**liquid), max_particles=places // rotors)
            for _ in range(rotors)
        ]
        self.substeps = substeps
        began = time.perf_counter()
        self.scene.build()
        self.build_s = time.perf_counter() - began

    def step(self, centers: list[list[float]]) -> None:
        air = self.job["air"]
        for emitter, center in zip(self.emitters, centers):
            emitter.emit(
                droplet_shape="circle",
                droplet_size=2.0 * air["stream_radius_m"],
                pos=tuple(center),
                direction=(0.0, 0.0, -1.0),
                speed=air["stream_speed"],
            )
        self.scene.step()

    def fly(self, seconds: float | None) -> dict:
        steps = self.job["steps"]
        if seconds is not None:
            steps = steps[: round(seconds / self.job["air"]["step_s"])]
        for centers in [s for s in steps if s][:WARM_STEPS]:
            self.step(centers)
        self.scene.reset()
        for emitter in self.emitters:
            emitter.reset()
        platform = self.boxes["platform"]
        at_first = platform.get_pos().cpu().numpy()
        wall, cpu = time.perf_counter(), time.process_time()
        for centers in steps:
            self.step(centers)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        moved = float(self.np.linalg.norm(platform.get_pos().cpu().numpy() - at_first))
        return {
            "cpu_s": cpu,
            "wall_s": wall,
            "steps": len(steps),
            "substeps": self.substeps,
            "build_s": self.build_s,
            "platform_moved_m": moved,
        }


def genesis_in_own_process(job: Path, places: int, seconds: float | None) -> dict:
    """Runs Genesis in its own process: it can be set up only once in a process."""
    command = [sys.executable, __file__, "--job", str(job), "--places", str(places)]
    if seconds is not None:
        command += ["--seconds", str(seconds)]
    env = {**os.environ, **{k: str(THREADS) for k in ("OMP_NUM_THREADS", "QD_NUM_THREADS", "TI_NUM_THREADS")}}
    done = subprocess.run(command, env=env, stdout=subprocess.PIPE, text=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode != 0 or not lines:
        return {"failed": f"exit status {done.returncode}"}
    return json.loads(lines[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/genesis"))
    parser.add_argument("--spacing", type=float, default=0.025, help="metres")
    parser.add_argument("--seconds", type=float, help="end the flight here")
    parser.add_argument("--job", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--places", type=int, help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.job:
        print(json.dumps(Flight(read_job(a.job), a.places).fly(a.seconds)))
        return
    a.out.mkdir(parents=True, exist_ok=True)
    job = (a.out / "emitters.txt").resolve()
    ours = run_ours(job, a.spacing)
    print(f"ours: {ours['cpu_s']:.2f} CPU-s, {ours['wall_s']:.2f} s, at most {ours['particles']} particles", flush=True)
    found = {"ours": ours}
    for times in (1, 4):
        places = times * ours["particles"]
        genesis = genesis_in_own_process(job, places, a.seconds)
        found[f"genesis_{places}"] = genesis
        if "failed" in genesis:
            print(f"Genesis, {places} particles: {genesis['failed']}", flush=True)
            continue
        whole = len(read_job(job)["steps"]) == genesis["steps"]
        ratio = f"{genesis['wall_s'] / ours['wall_s']:.0f} times our wall time" if whole else "not the whole flight"
        print(
            f"Genesis, {places} particles: {genesis['cpu_s']:.1f} CPU-s, {genesis['wall_s']:.1f} s for {genesis['steps']} steps of "
            f"{genesis['substeps']} substeps: {ratio}; platform moved by {1e3 * genesis['platform_moved_m']:.1f} mm; "
            f"{genesis['build_s']:.0f} s before that to build",
            flush=True,
        )
    (a.out / "results.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
