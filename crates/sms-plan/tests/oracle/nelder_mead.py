"""Writes nelder_mead.json, the table that tests/nelder_mead.rs compares with. Needs SciPy.

Run:  python nelder_mead.py > nelder_mead.json
The functions use only +, - and *, so that they round alike in every language.
"""

import json
import warnings

import scipy
from scipy.optimize import minimize


def rosenbrock(x):
    total = 0.0
    for a, b in zip(x[:-1], x[1:]):
        u = b - a * a
        v = 1.0 - a
        total = total + (100.0 * (u * u) + v * v)
    return float(total)


def himmelblau(x):
    u = x[0] * x[0] + x[1] - 11.0
    v = x[0] + x[1] * x[1] - 7.0
    return float(u * u + v * v)


def quadratic(x):
    total = 0.0
    for i, v in enumerate(x):
        d = v - 0.25 * i
        total = total + (1.0 + i) * (d * d)
    return float(total + 0.5 * (x[0] * x[1]))


FUNCTIONS = {"rosenbrock": rosenbrock, "himmelblau": himmelblau, "quadratic": quadratic}

CASES = [
    ("rosenbrock", [-1.2, 1.0], False, None, 2000),
    ("rosenbrock", [-1.2, 1.0, 0.7, 1.7], True, None, 3000),
    ("rosenbrock", [0.5, 0.5], False, [[-0.5, 0.8], [-0.2, 2.0]], 2000),
    ("rosenbrock", [-1.2, 1.0], False, None, 31),
    ("himmelblau", [0.0, 0.3], False, None, 2000),
    ("himmelblau", [3.9, 3.9], False, [[0.0, 4.0], [0.0, 4.0]], 2000),
    ("himmelblau", [-4.0, 1.0], True, [[-4.0, -2.9], [0.0, 3.0]], 2000),
    ("quadratic", [2.0, -1.0, 0.5], False, None, 2000),
    ("quadratic", [2.0, -1.0, 0.5], True, [[0.3, 3.0], [-1.0, 0.1], [0.2, 0.6]], 2000),
]

warnings.simplefilter("ignore")
table = []
for name, x0, adaptive, bounds, maxiter in CASES:
    evaluated = []

    def objective(x, f=FUNCTIONS[name]):
        value = f([float(v) for v in x])
        evaluated.append([float(v) for v in x] + [value])
        return value

    best = []
    result = minimize(
        objective,
        x0,
        method="Nelder-Mead",
        bounds=bounds,
        callback=lambda intermediate_result: best.append(float(intermediate_result.fun)),
        options={"adaptive": adaptive, "xatol": 1e-4, "fatol": 1e-4, "maxiter": maxiter, "maxfev": 100000},
    )
    table.append(
        {
            "function": name,
            "x0": x0,
            "adaptive": adaptive,
            "bounds": bounds,
            "maxiter": maxiter,
            "x": [float(v) for v in result.x],
            "f": float(result.fun),
            "evaluations": int(result.nfev),
            "nit": int(result.nit),
            # Every tenth point, to show that the whole path is the same.
            "path": evaluated[::10],
            "best": best[::10],
        }
    )
print(json.dumps({"scipy": scipy.__version__, "cases": table}, indent=None, separators=(",", ":")))
