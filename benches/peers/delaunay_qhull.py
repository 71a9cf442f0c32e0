#!/usr/bin/env python3
"""Our Delaunay tetrahedralisation against SciPy's Qhull, on the same points in the same run.

    benches/peers/delaunay_qhull.py [--points N ...] [--repeats N]

Points in general position (near a sphere, as scans give them): the time of each and whether the sets of tetrahedra are
the same. Degenerate sets (grid, box, duplicates, cospherical, coplanar) have several valid answers: no point strictly
inside the circumsphere of one of 400 tetrahedra, by exact rational arithmetic, and the hull's volume. Fails when a set
differs or a sphere is not empty. Needs numpy and scipy.
"""
import argparse
import json
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

ROOT = Path(__file__).resolve().parents[2]
SAMPLED = 400


def ours(first, out):
    command = ["cargo", "bench", "-q", "-p", "sms-mesh", "--bench", "delaunay_time", "--", str(first)]
    done = subprocess.run([*command, str(out)], cwd=ROOT, check=True, capture_output=True, text=True)
    points = np.fromfile(f"{out}.f64", "<f8").reshape(-1, 3)
    tetrahedra = np.fromfile(f"{out}.u32", "<u4").reshape(-1, 4).astype(np.int64)
    return json.loads(done.stdout.splitlines()[-1]), points, tetrahedra


def qhull(points, repeats):
    """The smallest wall time, and the tetrahedra."""
    seconds = float("inf")
    for _ in range(repeats):
        began = time.perf_counter()
        found = Delaunay(points).simplices
        seconds = min(seconds, time.perf_counter() - began)
    return seconds, found


def as_set(tetrahedra):
    rows = np.sort(np.asarray(tetrahedra, np.int64), axis=1)
    return rows[np.lexsort(rows.T[::-1])]


def determinant(rows):
    if len(rows) == 1:
        return rows[0][0]
    minor = lambda k: [r[:k] + r[k + 1:] for r in rows[1:]]
    return sum((-1) ** k * v * determinant(minor(k)) for k, v in enumerate(rows[0]) if v)


def is_inside_exactly(corners, p):
    """Whether p lies strictly inside the circumsphere, in rational arithmetic."""
    exact = [[Fraction(x) for x in q] for q in (*corners, p)]
    rows = [[a - b for a, b in zip(q, exact[4])] for q in exact[:4]]
    turn = determinant([[a - b for a, b in zip(exact[k], exact[3])] for k in range(3)])
    sphere = determinant([row + [sum(x * x for x in row)] for row in rows])
    return sphere * turn > 0


def check_predicate():
    """Checks the predicate: both orders of corners; inside, outside, and on the sphere."""
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    for order in ([0, 1, 2, 3], [1, 0, 2, 3]):
        found = [is_inside_exactly([corners[k] for k in order], [x] * 3) for x in (0.25, 1.01, 1.0, 0.999)]
        assert found == [True, False, False, True], found


def violations(points, tetrahedra, rng):
    """Sampled circumspheres that contain a point: floating point finds candidates, exact arithmetic decides."""
    chosen = rng.permutation(len(tetrahedra))[:SAMPLED]
    held = 0
    for t in chosen:
        corners = points[tetrahedra[t]]
        edges = corners[1:] - corners[0]
        size = np.abs(edges).max()
        if abs(np.linalg.det(edges / size)) < 1e-12:
            suspects = np.arange(len(points))[:: max(1, len(points) // 300)]
        else:
            center = np.linalg.solve(edges, 0.5 * (edges**2).sum(1))
            radius = np.linalg.norm(center)
            distance = np.linalg.norm(points - corners[0] - center, axis=1)
            suspects = np.argsort(distance)[:12]
            suspects = suspects[distance[suspects] < radius * (1 + 1e-9)]
        suspects = [s for s in suspects if not (points[s] == corners).all(1).any()]
        held += any(is_inside_exactly(corners.tolist(), points[s].tolist()) for s in suspects)
    return held, len(chosen)


def degenerate_sets(rng):
    axis = np.arange(16) * 0.01
    grid = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    box = rng.uniform(-1, 1, (4000, 3))
    box[np.arange(4000), rng.integers(0, 3, 4000)] = rng.choice([-1.0, 1.0], 4000)
    sphere = rng.normal(size=(3000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    ring = np.array([[x, y, z] for x in range(-15, 16) for y in range(-15, 16) for z in range(-15, 16)
                     if x * x + y * y + z * z == 225], float)
    return {
        "grid": grid,
        "box": box,
        "duplicates": np.concatenate([grid[:2000], grid[:2000], rng.permutation(grid[:2000])]),
        "cospherical": sphere,
        "cospherical, exactly": ring,
        "coplanar": np.c_[rng.uniform(size=(2000, 2)), np.zeros(2000)],
        "coplanar and one": np.r_[np.c_[rng.uniform(size=(2000, 2)), np.zeros(2000)], [[0.5, 0.5, 1.0]]],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", nargs="+", type=int, default=[20_000, 100_000])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    check_predicate()
    rng = np.random.default_rng(1)
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "ours"
        for n in options.points:
            report, points, tetrahedra = ours(n, out)
            seconds, theirs = qhull(points, options.repeats)
            same = np.array_equal(as_set(tetrahedra), as_set(theirs))
            failed |= not same
            print(f"{n} points: {report['seconds']:.3f} s, Qhull {seconds:.3f} s, ratio {seconds / report['seconds']:.1f};"
                  f" {len(tetrahedra)} and {len(theirs)} tetrahedra, {'the same' if same else 'DIFFERENT'}", flush=True)
        for name, points in degenerate_sets(rng).items():
            source = Path(folder) / "points.f64"
            points.astype("<f8").tofile(source)
            _, _, tetrahedra = ours(source, out)
            held, sampled = violations(points, tetrahedra, rng)
            corners = points[tetrahedra]
            volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
            try:
                hull = ConvexHull(points).volume
            except QhullError:
                hull = 0.0
            filled = abs(volume - hull) <= 1e-9 * max(hull, 1e-30)
            failed |= held > 0 or not filled
            print(f"{name}: {len(points)} points, {len(tetrahedra)} tetrahedra, {held} of {sampled} spheres hold a point,"
                  f" volume {'that of the hull' if filled else f'{volume} for {hull}'}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
