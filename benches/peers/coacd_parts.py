"""Convex parts of sms-mesh and of PyPI `coacd`, side by side on the same meshes and measured by the same estimator.

    cargo build --release -p sms-mesh --examples
    python benches/peers/coacd_parts.py MESH.obj ... [--threshold 0.05] [--max-vertices 64] [--out runs/parts] [--reuse]

Each method decomposes each mesh in its own process with two threads. Times are of the decomposition only, CPU seconds over all
threads. coacd has no limit on parts and the same vertex limit on hulls (`decimate`); its other settings are defaults.
`--reuse` takes coacd's parts of an earlier run from OUT. Writes OUT/table.md and OUT/results.json.

Union IoU: columns along z, jittered on a grid of GRID x GRID over the object's box. On each, the solid is where the
mesh's signed crossings do not cancel, and the union where any hull is: lengths of overlap are exact along the column.
Columns on which the mesh's crossings do not close (holes) are left out for both methods.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import measure

ROOT = Path(__file__).resolve().parent.parent.parent
GRID = 400
THREADS = 2
ENV = {"OMP_NUM_THREADS": str(THREADS), "OMP_WAIT_POLICY": "passive", "RAYON_NUM_THREADS": str(THREADS)}


def read_obj(path: Path) -> tuple[list, list]:
    """Returns vertices (duplicates merged) and triangles (fans of polygons, without degenerate ones)."""
    ids: dict[tuple, int] = {}
    index, triangles = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            index.append(ids.setdefault(tuple(float(w) for w in words[1:4]), len(ids)))
        elif words[0] == "f":
            numbers = [int(w.split("/")[0]) for w in words[1:]]
            corners = [index[n - 1 if n > 0 else n] for n in numbers]
            for k in range(1, len(corners) - 1):
                triangle = (corners[0], corners[k], corners[k + 1])
                if len(set(triangle)) == 3:
                    triangles.append(triangle)
    return list(ids), triangles


def write_obj(path: Path, vertices, triangles) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")


def run_coacd(mesh: Path, out: Path, threshold: float, max_vertices: int) -> None:
    """The child process of the peer."""
    import coacd
    import numpy as np

    coacd.set_log_level("error")
    vertices, triangles = read_obj(mesh)
    given = coacd.Mesh(np.array(vertices), np.array(triangles))
    with measure.Stopwatch() as watch:
        parts = coacd.run_coacd(given, threshold=threshold, decimate=True, max_ch_vertex=max_vertices)
    for i, (v, t) in enumerate(parts):
        write_obj(out / f"{i:03}.obj", v, t)
    print(json.dumps({"seconds": watch.wall_s, "cpu_seconds": watch.cpu_s, "parts": len(parts)}))


def solid_columns(vertices, triangles, columns):
    """Per column the sorted intervals (low, high) inside the mesh; None where its crossings do not close."""
    import numpy as np

    v, t = np.asarray(vertices, float), np.asarray(triangles)
    x, y = columns
    nx, ny = len(x), len(y)
    hits: list[list] = [[] for _ in range(nx * ny)]
    for a, b, c in v[t]:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        i0, i1 = np.searchsorted(x, low[0]), np.searchsorted(x, high[0])
        j0, j1 = np.searchsorted(y, low[1]), np.searchsorted(y, high[1])
        if i0 == i1 or j0 == j1:
            continue
        px, py = np.meshgrid(x[i0:i1], y[j0:j1], indexing="ij")

        def weight(p, q):
            return ((p[0] - px) * (q[1] - py) - (p[1] - py) * (q[0] - px)) / area

        wa, wb, wc = weight(b, c), weight(c, a), weight(a, b)
        inside = (wa >= 0) & (wb >= 0) & (wc >= 0)
        z = wa * a[2] + wb * b[2] + wc * c[2]
        for i, j in zip(*np.nonzero(inside)):
            hits[(i0 + i) * ny + j0 + j].append((z[i, j], -1 if area > 0 else 1))
    out = []
    for crossings in hits:
        if sum(s for _, s in crossings) != 0:
            out.append(None)
            continue
        crossings.sort()
        intervals, winding, start = [], 0, 0.0
        for z, s in crossings:
            if winding == 0:
                start = z
            winding += s
            if winding == 0:
                intervals.append((start, z))
        out.append(intervals)
    return out


def hull_columns(parts, columns):
    """Per part an array (columns, 2) of the interval inside the hull; empty where low > high."""
    import numpy as np
    from scipy.spatial import ConvexHull

    px, py = (c.ravel() for c in np.meshgrid(*columns, indexing="ij"))
    spans = []
    for vertices, _ in parts:
        v = np.asarray(vertices, float)
        box = np.nonzero(
            (px >= v[:, 0].min()) & (px <= v[:, 0].max()) & (py >= v[:, 1].min()) & (py <= v[:, 1].max())
        )[0]
        low, high = np.full(len(box), -np.inf), np.full(len(box), np.inf)
        # Of the vertices, as simulators take parts; a file's faces without width have normals of rounding.
        for nx, ny, nz, d in np.unique(ConvexHull(v).equations.round(12), axis=0):
            rest = -d - nx * px[box] - ny * py[box]
            if nz > 1e-9:
                high = np.minimum(high, rest / nz)
            elif nz < -1e-9:
                low = np.maximum(low, rest / nz)
            else:
                high[rest < 0] = -np.inf
        keep = low < high
        spans.append((box[keep], low[keep], high[keep]))
    return spans


def overlap(a: list, b: list) -> float:
    """Common length of two sorted lists of disjoint intervals."""
    total, i, j = 0.0, 0, 0
    while i < len(a) and j < len(b):
        total += max(0.0, min(a[i][1], b[j][1]) - max(a[i][0], b[j][0]))
        if a[i][1] < b[j][1]:
            i += 1
        else:
            j += 1
    return total


def joined(intervals: list) -> list:
    """The union of intervals, sorted and disjoint."""
    out: list = []
    for low, high in sorted(intervals):
        if out and low <= out[-1][1]:
            out[-1][1] = max(out[-1][1], high)
        else:
            out.append([low, high])
    return out


def length(intervals: list) -> float:
    return sum(high - low for low, high in intervals)


class Estimator:
    """Union IoU against one mesh."""

    def __init__(self, mesh: Path):
        import numpy as np

        vertices, triangles = read_obj(mesh)
        v = np.asarray(vertices)
        low, high = v.min(0), v.max(0)
        margin = 0.03 * (high - low).max()
        rng = np.random.default_rng(0)
        self.columns = tuple(
            np.sort(low[k] - margin + (np.arange(GRID) + rng.random(GRID)) * (high[k] - low[k] + 2 * margin) / GRID)
            for k in range(2)
        )
        self.solid = solid_columns(vertices, triangles, self.columns)

    def score(self, parts: list) -> dict:
        """IoU of the union, and the missed and added shares of the solid."""
        hulls: list[list] = [[] for _ in self.solid]
        for index, low, high in hull_columns(parts, self.columns):
            for i, a, b in zip(index.tolist(), low.tolist(), high.tolist()):
                hulls[i].append((a, b))
        common = solid = union = 0.0
        for inside, covered in zip(self.solid, hulls):
            if inside is None:
                continue
            covered = joined(covered)
            common += overlap(inside, covered)
            solid += length(inside)
            union += length(covered)
        either = solid + union - common
        return {
            "iou": common / either if either > 0 else 0.0,
            "missed": 1.0 - common / solid if solid > 0 else 0.0,
            "added": (union - common) / solid if solid > 0 else 0.0,
        }


def read_parts(folder: Path) -> list:
    return [read_obj(p) for p in sorted(folder.glob("[0-9]*.obj"))]


def name_of(mesh: Path) -> str:
    return mesh.parent.name if mesh.stem == "model" else mesh.stem


def table(rows: list[dict]) -> str:
    """Both methods on each mesh, and the means."""
    head = "| mesh | parts | coacd | IoU | coacd | missed % | added % | s | coacd | CPU s | coacd |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
    keys = ["parts", "iou", "seconds", "cpu_seconds"]
    lines = [head]
    whole = [r for r in rows if r.get("ours") and r.get("coacd")]
    mean = {m: {k: sum(r[m][k] for r in whole) / max(len(whole), 1) for k in keys + ["missed", "added"]} for m in ("ours", "coacd")}
    for r in rows + ([{"mesh": "**mean**", **mean}] if whole else []):
        ours, peer = r.get("ours"), r.get("coacd")

        def cell(of, key, digits):
            return f"{of[key]:.{digits}f}" if of else "–"

        digits = 1 if r["mesh"].startswith("**") else 0
        cells = [r["mesh"], cell(ours, "parts", digits), cell(peer, "parts", digits), cell(ours, "iou", 3), cell(peer, "iou", 3)]
        cells += [f"{100 * ours['missed']:.1f}", f"{100 * ours['added']:.1f}"] if ours else ["–", "–"]
        cells += [cell(ours, "seconds", 2), cell(peer, "seconds", 1), cell(ours, "cpu_seconds", 2), cell(peer, "cpu_seconds", 1)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def decompose(command: list[str], folder: Path, timeout_s: float) -> dict | None:
    """Runs one method; returns its figures, or None with the reason on stderr."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.obj"):
        old.unlink()
    done = measure.run(command, timeout_s, ENV)
    if done.code != 0:
        print(f"{folder}: {done.why()}", file=sys.stderr)
        return None
    figures = done.json()
    figures.setdefault("cpu_seconds", done.cpu_s)
    (folder / "figures.json").write_text(json.dumps(figures) + "\n")
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--threshold", type=float, default=0.05)
    parser.add_argument("--max-vertices", type=int, default=64)
    parser.add_argument("--out", type=Path, default=ROOT / "runs/parts")
    parser.add_argument("--ours", type=Path, default=ROOT / "target/release/examples/decompose")
    parser.add_argument("--timeout", type=float, default=900.0)
    parser.add_argument("--reuse", action="store_true", help="take coacd's parts of an earlier run")
    parser.add_argument("--peer", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.peer:
        run_coacd(args.meshes[0], args.peer, args.threshold, args.max_vertices)
        return
    rows = []
    for mesh in args.meshes:
        row = {"mesh": name_of(mesh)}
        settings = [str(args.threshold), "1000", str(args.max_vertices)]
        folders = {m: args.out / m / row["mesh"] for m in ("ours", "coacd")}
        row["ours"] = decompose([str(args.ours), str(mesh), str(folders["ours"]), *settings], folders["ours"], args.timeout)
        kept = folders["coacd"] / "figures.json"
        if args.reuse and kept.exists():
            row["coacd"] = json.loads(kept.read_text())
        else:
            options = ["--threshold", str(args.threshold), "--max-vertices", str(args.max_vertices)]
            command = [sys.executable, __file__, str(mesh), "--peer", str(folders["coacd"]), *options]
            row["coacd"] = decompose(command, folders["coacd"], args.timeout)
        estimator = Estimator(mesh)
        for method, folder in folders.items():
            if row[method]:
                row[method].update(estimator.score(read_parts(folder)))
        rows.append(row)
        print(table([row]).splitlines()[2], flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
    (args.out / "table.md").write_text(table(rows))
    print(table(rows))


if __name__ == "__main__":
    os.environ.update(ENV)
    main()
