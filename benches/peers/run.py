"""Compares sms, open3d's TSDF fusion and gsplat on the same frames, scored by the same program.

    python3 benches/peers/run.py [--scenes 3] [--preset standard] [--gsplat-cpu-seconds 100] [--out runs/peers]

Run it from the repository's root after `cargo build --release`. It needs only the standard library; the peers run in
the environment of --python (see README.md). A peer that cannot run gets a row with the reason. Writes
OUT/table.md and OUT/results.json and prints the table.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path

import measure

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SCORED = {
    # Column of the table: key of the scorer, without its prefix; heading; factor to the shown unit; digits.
    "psnr": ("holdout_psnr_db", "PSNR dB", 1.0, 2),
    "depth": ("holdout_depth_mae_m", "depth mm", 1e3, 2),
    "miou": ("holdout_miou", "mIoU", 1.0, 3),
    "median": ("surface_median_m", "median mm", 1e3, 3),
    "p90": ("surface_p90_m", "p90 mm", 1e3, 2),
    "f1": ("f1_2p5mm", "F1@2.5", 1.0, 4),
}
COSTS = {
    "seconds": ("wall s", 1.0, 1),
    "cpu_seconds": ("CPU s", 1.0, 1),
    "peak_bytes": ("MiB", 1.0 / 2**20, 0),
}
# Threads that wait spin by default, which would count as work of the peers.
PEER_ENV = {"OMP_WAIT_POLICY": "passive"}


@dataclass
class Row:
    """One method on one scene. `figures` has the keys of COSTS and SCORED; missing keys are not applicable."""

    method: str
    scene: str
    figures: dict[str, float] = field(default_factory=dict)
    notes: str = ""
    details: dict = field(default_factory=dict)


# TSDF variants: voxel, truncation, edge and weight settings were the best of fourteen tried on billiards_1001.
TSDF = {
    "open3d TSDF, objects, 1.5 mm": "--voxel-mm 1.5 --truncation 4 --weight 1 --edge 1 --objects 2",
    "open3d TSDF, objects, 2 mm": "--voxel-mm 2 --truncation 3 --weight 1 --edge 0 --objects 2",
    "open3d TSDF, whole scene, 3 mm": "--voxel-mm 3 --truncation 3 --weight 1 --edge 1",
}


def run_json(command: list, timeout_s: float, env: dict | None = None):
    """Returns the JSON that a command prints and its process; None with the reason if it failed."""
    done = measure.run([str(c) for c in command], timeout_s, env, ROOT)
    if done.code != 0:
        return None, done, done.why()
    try:
        return done.json(), done, ""
    except ValueError:
        return None, done, "printed no JSON"


def scored(args, export: Path, surface: Path | None, views: Path | None) -> tuple[dict, str]:
    """The figures of `sms-experiments score`, by our columns."""
    command = [args.sms, "score", "--json", "--truth", export]
    command += ["--surface", surface] if surface else []
    command += ["--views", views] if views else []
    found, _, why = run_json(command, 600)
    if found is None:
        return {}, f"not scored: {why}"
    return pick(found, "bench.score."), ""


def pick(metrics: dict, prefix: str, names: dict | None = None) -> dict:
    """The columns of flat metrics that exist and are numbers."""
    names = names or {column: spec[0] for column, spec in SCORED.items()}
    found = {column: metrics.get(prefix + key) for column, key in names.items()}
    return {k: float(v) for k, v in found.items() if isinstance(v, (int, float))}


def ours(args, scenes: list[str]) -> list[Row]:
    """Our rows: the Gaussians, and the meshes made of them."""
    folder = args.ours or args.out / "sms"
    if not args.ours:
        command = [args.sms, "scan", "--json", "--scenes", ",".join(scenes), "--preset", args.preset]
        metrics, _, why = run_json([*command, "--out", folder, "--cache", args.cache], 3600 * len(scenes))
    else:
        # Each scene's own file is there before that of all.
        metrics, why = {}, f"nothing in {folder}"
        for file in [*folder.glob("*/metrics.json"), folder / "results.json"]:
            metrics |= json.loads(file.read_text()) if file.is_file() else {}
    rows = []
    costs = {"seconds": "seconds", "cpu_seconds": "cpu_seconds", "peak_bytes": "peak_bytes"}
    for scene in scenes:
        prefix = f"bench.scan.{scene}."
        if metrics is None or f"{prefix}seconds" not in metrics:
            rows.append(Row("sms", scene, {}, f"did not run: {why or 'not among the results'}"))
            continue
        got = {**pick(metrics, prefix, costs), **pick(metrics, prefix)}
        details = {k.removeprefix(prefix): v for k, v in metrics.items() if k.startswith(prefix)}
        note = f"{details.get('steps', 0):.0f} steps, {details.get('gaussians', 0):.0f} Gaussians"
        rows.append(Row("sms", scene, got, note, details))
        names = {"median": "mesh_median_m", "p90": "mesh_p90_m", "f1": "mesh_f1_2p5mm"}
        mesh = pick(metrics, prefix, names)
        if mesh:
            seconds = got["seconds"] + details.get("mesh_seconds", 0.0)
            rows.append(Row("sms, closed meshes", scene, {"seconds": seconds, **mesh}, "scan and entities"))
    return rows


def tsdf(args, scene: str, name: str, options: str) -> Row:
    """One TSDF variant."""
    export, out = args.export / scene, args.out / scene / name.replace(" ", "_").replace(",", "")
    command = [args.python, HERE / "tsdf.py", export, "--out", out, *options.split()]
    found, _, why = run_json(command, args.timeout, PEER_ENV)
    if found is None:
        return Row(name, scene, {}, f"did not run: {why}")
    # Fused from object pixels only, it has no whole view.
    views = None if "--objects" in options else out / "views"
    figures, note = scored(args, export, out / "surface.ply", views)
    figures |= {k: found[k] for k in COSTS}
    note = note or "labels: vote of our masks"
    return Row(name, scene, figures, note, found)


def gsplat(args, scene: str, name: str) -> Row:
    """gsplat, trained as far as the limit allows."""
    export, out = args.export / scene, args.out / scene / "gsplat"
    command = [args.python, HERE / "gsplat_train.py", export, "--out", out, "--cpu-seconds", args.gsplat_cpu_seconds]
    command += ["--steps", args.gsplat_steps, "--gaussians", args.gsplat_gaussians]
    found, _, why = run_json(command, args.timeout + 10 * args.gsplat_cpu_seconds, PEER_ENV)
    if found is None:
        return Row(name, scene, {}, f"did not run: {why}")
    figures, note = scored(args, export, out / "surface.ply", out / "views")
    rendered, _ = scored(args, export, out / "rendered.ply", None)
    # Its Gaussians need not lie on surfaces: the better of their discs and of the depth that they render.
    source = "discs"
    if rendered.get("median", math.inf) < figures.get("median", math.inf):
        figures, source = figures | rendered, "rendered depth"
    figures |= {k: found[k] for k in COSTS}
    schedule = f"{found['rasteriser']}: {found['steps']} of {args.gsplat_steps} steps, {found['gaussians']} Gaussians, "
    return Row(name, scene, figures, note or f"{schedule}surface of {source}", found)


def step(args, scene: str, folder: Path) -> dict | str:
    """gsplat's step on the Gaussians of our scan, and ours in the same scan."""
    model = folder / scene / "scan" / "scene.ply"
    if not model.is_file():
        return f"no {model.name} of our scan"
    command = [args.python, HERE / "gsplat_step.py", args.export / scene, model, "--as-shipped"]
    found, _, why = run_json(command, args.timeout, PEER_ENV)
    return why if found is None else found


def average(rows: list[Row]) -> Row:
    """Means over scenes of the figures that all of them have."""
    done = [r for r in rows if r.figures]
    if not done:
        return Row(rows[0].method, "mean", {}, rows[0].notes)
    keys = [k for k in done[0].figures if all(k in r.figures for r in done)]
    figures = {k: sum(r.figures[k] for r in done) / len(done) for k in keys}
    notes = done[0].notes if len(done) == len(rows) else f"{len(done)} of {len(rows)} scenes; {rows[-1].notes}"
    return Row(done[0].method, "mean", figures, notes)


def table(rows: list[Row]) -> str:
    """Markdown of the means and, below, of each scene."""
    columns = {**COSTS, **{k: v[1:] for k, v in SCORED.items()}}
    head = "| {} | " + " | ".join(c[0] for c in columns.values()) + " | |\n"
    head += "|---|" + "--:|" * len(columns) + "---|\n"

    def line(name: str, row: Row) -> str:
        cells = [
            f"{row.figures[k] * factor:.{digits}f}" if k in row.figures else "–"
            for k, (_, factor, digits) in columns.items()
        ]
        return f"| {name} | " + " | ".join(cells) + f" | {row.notes} |\n"

    methods = list(dict.fromkeys(r.method for r in rows))
    scenes = list(dict.fromkeys(r.scene for r in rows))
    text = head.format(f"mean of {len(scenes)}")
    text += "".join(line(m, average([r for r in rows if r.method == m])) for m in methods)
    for scene in scenes:
        text += "\n" + head.format(scene)
        text += "".join(line(r.method, r) for r in rows if r.scene == scene)
    return text


def steps_text(steps: dict, rows: list[Row]) -> str:
    """Markdown of the training steps."""
    text = "\n| one step on our scan's Gaussians | Gaussians | sms CPU ms | gsplat CPU ms | gsplat MiB |\n"
    text += "|---|--:|--:|--:|--:|\n"
    for scene, found in steps.items():
        if isinstance(found, str):
            text += f"| {scene} | | | {found} | |\n"
            continue
        own = next((r.details.get("scan_step_cpu_ms") for r in rows if r.method == "sms" and r.scene == scene), None)
        own = f"{own:.0f}" if own else "–"
        size = f"{found['width']}×{found['height']}"
        cells = [f"{scene}, {size}", found["gaussians"], own, f"{found['step_cpu_ms']:.0f}"]
        text += "| " + " | ".join(map(str, [*cells, f"{found['peak_bytes'] / 2**20:.0f}"])) + " |\n"
    return text


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    path = lambda text: Path(text).absolute()
    parser.add_argument("--scenes", default="3", help="as `sms-experiments scan --scenes`; generated scenes only")
    parser.add_argument("--preset", default="standard", choices=["draft", "standard", "fine"])
    parser.add_argument("--sms", type=path, default=ROOT / "target/release/sms-experiments")
    parser.add_argument("--python", type=path, default=ROOT / ".venv-peers/bin/python", help="has the requirements")
    parser.add_argument("--out", type=path, default=ROOT / "runs/peers")
    parser.add_argument("--cache", type=path, default=ROOT / "runs/bench-recordings")
    parser.add_argument("--ours", type=path, help="OUT of an earlier `sms-experiments scan --out OUT` of these scenes")
    parser.add_argument("--export", type=path, help="what an earlier `sms-experiments scan --export` of these scenes wrote")
    parser.add_argument("--gsplat-cpu-seconds", type=float, default=100.0, help="limit of its training, CPU time")
    parser.add_argument("--gsplat-steps", type=int, default=7000)
    parser.add_argument("--gsplat-gaussians", type=int, default=30_000)
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds for a peer's other work")
    parser.add_argument("--skip", action="append", default=[], choices=["tsdf", "gsplat", "step"])
    return parser.parse_args()


def main() -> int:
    args = parse()
    if not args.sms.is_file():
        print(f"{args.sms} is missing; cargo build --release -p sms-experiments, or name it with --sms", file=sys.stderr)
        return 2
    if args.export is None:
        args.export = args.out / "export"
        command = [args.sms, "scan", "--scenes", args.scenes, "--preset", args.preset, "--quiet"]
        command += ["--export", args.export, "--cache", args.cache]
        done = measure.run([str(c) for c in command], 3600, None, ROOT)
        if done.code != 0:
            print(f"the scenes could not be exported: {done.why()}", file=sys.stderr)
            return 1
    written = sorted(p.parent.name for p in args.export.glob("*/transforms.json"))
    named = [s for s in written if s in args.scenes or s.removeprefix("billiards_") in args.scenes.split(",")]
    scenes = written[: int(args.scenes)] if args.scenes.isdigit() and int(args.scenes) <= 10 else named or written
    if not scenes:
        print(f"no exported scene lies in {args.export}", file=sys.stderr)
        return 1
    args.out.mkdir(parents=True, exist_ok=True)
    args.python = args.python if args.python.is_file() else Path(shutil.which("python3") or sys.executable)

    own, peers, steps = ours(args, scenes), [], {}
    for scene in scenes:
        if "tsdf" not in args.skip:
            peers += [tsdf(args, scene, name, options) for name, options in TSDF.items()]
        if "gsplat" not in args.skip:
            peers.append(gsplat(args, scene, "gsplat 1.5.3"))
        if "step" not in args.skip:
            steps[scene] = step(args, scene, args.ours or args.out / "sms")
        rows = (ours(args, scenes) if args.ours else own) + peers
        text = table(rows) + (steps_text(steps, rows) if steps else "")
        # After every scene, so that an interrupted run leaves its results.
        (args.out / "table.md").write_text(text)
        record = {"preset": args.preset, "rows": [vars(r) for r in rows], "steps": steps, "cores": os.cpu_count()}
        (args.out / "results.json").write_text(json.dumps(record, indent=1) + "\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
