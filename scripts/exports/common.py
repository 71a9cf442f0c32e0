"""Functions shared by the checks of exports."""

import argparse
import importlib
import json
import math
import sys
from pathlib import Path

MISSING = 3


def arguments(doc, drift=True):
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=Path, help="folder of the export")
    if drift:
        parser.add_argument("--drift-mm", type=float, default=1.0, help="most that a body may move")
        parser.add_argument("--turn-deg", type=float, default=0.5, help="most that a body may turn")
    return parser.parse_args()


def need(module):
    """Exits with code 3 if a module has no wheel for this Python."""
    try:
        importlib.import_module(module)
    except ImportError as error:
        print(f"{module} is missing for Python {sys.version.split()[0]}: {error}", file=sys.stderr)
        sys.exit(MISSING)


def bodies(folder):
    """bodies.json, and its moving bodies."""
    scene = json.loads((folder / "bodies.json").read_text())
    return scene, [b for b in scene["bodies"] if b["kind"] == "dynamic"]


def moments(matrix):
    """Eigenvalues of a symmetric 3×3 matrix, ascending (Smith 1961)."""
    a = matrix
    off = a[0][1] ** 2 + a[0][2] ** 2 + a[1][2] ** 2
    if off == 0.0:
        return sorted(a[i][i] for i in range(3))
    q = sum(a[i][i] for i in range(3)) / 3
    p = math.sqrt((sum((a[i][i] - q) ** 2 for i in range(3)) + 2 * off) / 6)
    b = [[(a[i][j] - (q if i == j else 0.0)) / p for j in range(3)] for i in range(3)]
    det = (b[0][0] * (b[1][1] * b[2][2] - b[1][2] * b[2][1]) - b[0][1] * (b[1][0] * b[2][2] - b[1][2] * b[2][0])
           + b[0][2] * (b[1][0] * b[2][1] - b[1][1] * b[2][0]))
    angle = math.acos(max(-1.0, min(1.0, det / 2))) / 3
    high = q + 2 * p * math.cos(angle)
    low = q + 2 * p * math.cos(angle + 2 * math.pi / 3)
    return sorted([low, 3 * q - low - high, high])


def mass_errors(body, mass, principal):
    """Relative errors of a body's mass and principal moments of inertia."""
    expected = body["mass"]
    pairs = [(mass, expected["mass_kg"])] + list(zip(sorted(principal), moments(expected["inertia_kg_m2"])))
    return [abs(found / true - 1.0) for found, true in pairs]


def turn_deg(a, b):
    """Angle between two unit quaternions, degrees; exact for small angles too."""
    def product(p, q):
        return [p[0] * q[0] - sum(p[i] * q[i] for i in (1, 2, 3)),
                p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
                p[0] * q[2] + p[2] * q[0] + p[3] * q[1] - p[1] * q[3],
                p[0] * q[3] + p[3] * q[0] + p[1] * q[2] - p[2] * q[1]]
    w, *v = product([a[0], -a[1], -a[2], -a[3]], b)
    return math.degrees(2 * math.atan2(math.sqrt(sum(c * c for c in v)), abs(w)))


def moved(before, after):
    """(distance in mm, angle in degrees) between two poses (position, quaternion w x y z)."""
    return 1e3 * math.dist(before[0], after[0]), turn_deg(before[1], after[1])


def start_errors(moving, began):
    """Largest offsets of initial poses from bodies.json: (mm, degrees)."""
    def said(body):
        pose = body["pose_world"]
        return pose["position_m"], pose["quaternion_wxyz"]
    all_moved = [moved(said(b), began[b["name"]]) for b in moving]
    return [max((m[k] for m in all_moved), default=0.0) for k in (0, 1)]


def finish(arguments, simulator, version, moving, began, ended, mass_error, start):
    """Prints the result and exits with 0 or 1."""
    rows = {b["name"]: moved(began[b["name"]], ended[b["name"]]) for b in moving}
    nothing = ("", (0.0, 0.0))
    drift = max(rows.items(), key=lambda r: r[1][0], default=nothing)
    turn = max(rows.items(), key=lambda r: r[1][1], default=nothing)
    mass = max(mass_error, default=0.0)
    finite = all(math.isfinite(v) for r in rows.values() for v in r)
    passed = (finite and drift[1][0] <= arguments.drift_mm and turn[1][1] <= arguments.turn_deg and mass <= 1e-3
              and start[0] <= 1e-3 and start[1] <= 1e-2)
    print(json.dumps({
        "simulator": f"{simulator} {version}", "bodies": len(moving), "passed": passed,
        "drift_mm": round(drift[1][0], 4), "drift_body": drift[0],
        "turn_deg": round(turn[1][1], 4), "turn_body": turn[0],
        "mass_error": float(f"{mass:.2e}"), "start_error_mm": float(f"{start[0]:.2e}"),
        "start_error_deg": float(f"{start[1]:.2e}"),
        "all": {name: [round(v, 4) for v in row] for name, row in rows.items()},
    }))
    sys.exit(0 if passed else 1)
