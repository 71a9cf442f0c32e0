"""Fits capsules around the collision meshes of the FR3's links.

    python fit_capsules.py FOLDER_WITH_STL > fr3_capsules.json

The triangles are split until their edges are below 12 mm; every small triangle then lies inside one capsule (a capsule is
convex, so its three corners suffice). The sum of the capsules' volumes is minimised by Nelder-Mead from random clusters. Needs NumPy, SciPy. The meshes are those of
frankaemika/franka_description @ b299b39d9692 (Apache-2.0); only the fitted numbers are kept here.
"""
import json
import struct
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

COUNTS = {"link0": 2, "link1": 2, "link2": 2, "link3": 2, "link4": 2, "link5": 3, "link6": 2, "link7": 2}
EDGE_M = 0.012


def read_stl(path):
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    rows = np.frombuffer(data, dtype=np.dtype([("n", "<3f4"), ("v", "<9f4"), ("a", "<u2")]), count=count, offset=84)
    return rows["v"].reshape(count, 3, 3).astype(float)


def split(triangles):
    while True:
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = edges.max(1) > EDGE_M
        if not long.any():
            return triangles
        t, k = triangles[long], edges[long].argmax(1)
        rows = np.arange(len(t))
        a, b, c = t[rows, k], t[rows, (k + 1) % 3], t[rows, (k + 2) % 3]
        m = (a + b) / 2
        triangles = np.concatenate([triangles[~long], np.stack([a, m, c], 1), np.stack([m, b, c], 1)])


def to_segment(points, a, b):
    d = b - a
    t = np.clip((points - a) @ d / max(d @ d, 1e-12), 0, 1)
    return np.linalg.norm(points - a - t[..., None] * d, axis=-1)


def volume(length, radius):
    return np.pi * radius**2 * (length + 4 / 3 * radius)


def best_capsule(triangles, start):
    points = triangles.reshape(-1, 3)
    points = points[ConvexHull(points, qhull_options="QJ").vertices]

    def cost(x):
        a, b = x[:3], x[3:]
        return volume(np.linalg.norm(b - a), to_segment(points, a, b).max()) * 1e3

    x = start
    for _ in range(3):
        x = minimize(cost, x, method="Nelder-Mead", options={"maxiter": 800, "xatol": 1e-5, "fatol": 1e-7}).x
    return x, cost(x)


def principal(triangles):
    points = triangles.reshape(-1, 3)
    c = points.mean(0)
    axis = np.linalg.svd(points - c, full_matrices=False)[2][0]
    s = (points - c) @ axis
    return np.concatenate([c + 0.6 * s.min() * axis, c + 0.6 * s.max() * axis])


def fit(triangles, count, rng):
    best = None
    for attempt in range(1 if count == 1 else 10):
        centres = triangles.mean(1)
        # k-means as the first split.
        seeds = centres[rng.choice(len(centres), count, replace=False)]
        for _ in range(20):
            label = np.argmin(np.linalg.norm(centres[:, None] - seeds, axis=-1), axis=1)
            seeds = np.array([centres[label == k].mean(0) if (label == k).any() else seeds[k] for k in range(count)])
        for _ in range(6):
            capsules = []
            total = 0.0
            for k in range(count):
                part = triangles[label == k]
                if len(part) < 4:
                    total = np.inf
                    break
                x, v = best_capsule(part, principal(part))
                capsules.append((x, to_segment(part.reshape(-1, 3), x[:3], x[3:]).max()))
                total += v
            if not np.isfinite(total):
                break
            if best is None or total < best[0]:
                best = (total, capsules)
            # Every triangle to the capsule in which it lies deepest.
            depth = np.stack([to_segment(triangles, x[:3], x[3:]).max(1) - r for x, r in capsules])
            label = depth.argmin(0)
    return best


def main():
    folder = Path(sys.argv[1])
    rng = np.random.default_rng(7)
    out = {}
    for name, count in COUNTS.items():
        triangles = split(read_stl(folder / f"{name}.stl"))
        total, capsules = fit(triangles, count, rng)
        out[name] = [
            {"a": np.round(x[:3], 4).tolist(), "b": np.round(x[3:], 4).tolist(), "radius": round(r + 2e-4, 4)}
            for x, r in capsules
        ]
        print(name, f"{total:.3f} l", file=sys.stderr)
    json.dump(out, sys.stdout, indent=1)
    print()


main()
