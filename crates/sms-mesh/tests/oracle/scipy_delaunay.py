"""Writes scipy_delaunay.json: tetrahedron counts and hull volumes of SciPy's Delaunay (Qhull) for small point sets.

The points come from a 64-bit linear congruential generator that the Rust test repeats, so that only counts are
stored. All sets are in general position: degenerate sets have no unique count.

Usage: python scipy_delaunay.py > scipy_delaunay.json
"""

import json

import numpy as np
from scipy.spatial import ConvexHull, Delaunay


class Lcg:
    def __init__(self, seed):
        self.state = seed

    def uniform(self):
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self.state >> 11) / 2**53


def points(kind, n, seed):
    rng = Lcg(seed)
    out = []
    while len(out) < n:
        p = np.array([rng.uniform(), rng.uniform(), rng.uniform()]) * 2 - 1
        if kind == "cube":
            out.append(p)
        else:
            r = float(np.sqrt(p @ p))
            if 0.1 < r < 1.0:
                # "ball": as drawn; "shell": near a sphere, as surface points of a scan are.
                out.append(p if kind == "ball" else p / r * (1.0 + 0.02 * p[0]))
    return np.array(out)


rows = []
for kind in ("cube", "ball", "shell"):
    for n, seed in ((5, 1), (20, 2), (100, 3), (1000, 4), (5000, 5)):
        p = points(kind, n, seed)
        rows.append(
            {
                "kind": kind,
                "n": n,
                "seed": seed,
                "tetrahedra": int(len(Delaunay(p).simplices)),
                "hull_volume": float(ConvexHull(p).volume),
            }
        )
print(json.dumps(rows, indent=1))
