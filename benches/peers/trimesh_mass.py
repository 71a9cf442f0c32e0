#!/usr/bin/env python3
"""Mass, centre of mass and inertia of closed meshes against trimesh.

    benches/peers/trimesh_mass.py [OBJ ...] [--write-reference]

Compares `polyhedron_mass_properties` with trimesh on the shapes of crates/sms-core/tests/shapes and on further OBJ files
that are closed (open meshes are named and left out), and fails if they differ by more than 1e-6, relative.
--write-reference renews crates/sms-core/tests/trimesh_mass.json, which the test of the same name reads.
Needs trimesh and numpy.
"""
import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "crates/sms-core/tests/trimesh_mass.json"
LIMIT = 1e-6


def load(path):
    """The mesh with equal vertices joined, regardless of texture coordinates."""
    mesh = trimesh.load(path, force="mesh", process=False)
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return trimesh.Trimesh(vertices, faces, process=False)


def ours(*arguments):
    command = ["cargo", "run", "--release", "-q", "-p", "sms-core", "--example", "mass_properties", "--", *arguments]
    lines = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    return [(Path(r["path"]), r["properties"]) for r in map(json.loads, lines)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", type=lambda p: Path(p).resolve())
    parser.add_argument("--write-reference", action="store_true")
    options = parser.parse_args()
    closed = [p for p in options.meshes if load(p).is_volume]
    for path in options.meshes:
        if path not in closed:
            print(f"left out, not closed: {path}")
    worst, reference = 0.0, []
    with tempfile.TemporaryDirectory() as folder:
        shapes = len(ours("--shapes", folder))
        for number, (path, found) in enumerate(ours("--shapes", folder, *map(str, closed))):
            mesh = load(path)
            mesh.density = 1.0
            size = np.linalg.norm(mesh.extents)
            inertia = np.array(mesh.moment_inertia)
            off = [
                abs(found["mass_kg"] / mesh.volume - 1.0),
                np.linalg.norm(np.array(found["com_m"]) - mesh.center_mass) / size,
                np.linalg.norm(np.array(found["inertia_kg_m2"]) - inertia) / np.linalg.norm(inertia),
            ]
            worst = max(worst, *off)
            name = path.stem if number < shapes else path.parent.name + "/" + path.name
            print(f"{name:<44} mass {off[0]:.1e}  centre {off[1]:.1e}  inertia {off[2]:.1e}")
            if number < shapes:
                reference.append({
                    "name": path.stem,
                    "volume_m3": float(mesh.volume),
                    "com_m": mesh.center_mass.tolist(),
                    "inertia_kg_m2": inertia.tolist(),
                })
    if options.write_reference:
        REFERENCE.write_text(json.dumps(reference, indent=1) + "\n")
    print(f"largest relative difference {worst:.1e}, allowed {LIMIT:.0e}")
    return worst > LIMIT


if __name__ == "__main__":
    sys.exit(main())
