"""Times gsplat's training step on the Gaussians of one of our scans.

    python gsplat_step.py EXPORT SCENE.ply [--repeats 5] [--limit N] [--as-shipped]

A step is forward and backward of L1 + SSIM on colour and L1 on depth for one training view of the export, and Adam.
Ours does more in its step: normals, affinities, the classifier and regularisers. Prints JSON. `--as-shipped` also
times gsplat's own listing of tiles (`_isect_tiles`, a Python loop), which is measured on a share of the Gaussians and
scaled up.
"""

import argparse
import json
import math
import statistics
from pathlib import Path

import numpy as np
import torch
from export import Export
from gsplat_cpu import best_rasteriser
from gsplat_train import Model, loss_of, view_of
from measure import Stopwatch, own_peak_bytes


def read_gaussians(path: Path) -> dict[str, np.ndarray]:
    """The columns of a 3D Gaussian Splatting PLY (binary, little endian)."""
    data = path.read_bytes()
    header, body = data.split(b"end_header\n", 1)
    names, kinds, count, inside = [], [], 0, False
    kind_of = {"float": "<f4", "float32": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2", "int": "<i4"}
    for line in header.decode().splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            inside = words[1] == "vertex"
            count = int(words[2]) if inside else count
        elif words[:1] == ["property"] and inside:
            kinds.append(kind_of[words[1]])
            names.append(words[2])
    table = np.frombuffer(body, np.dtype(list(zip(names, kinds))), count)
    return {name: table[name].astype(np.float32) for name in names}


def model_of(path: Path, device, limit: int | None) -> Model:
    """The Gaussians of a PLY as gsplat's parameters; at most `limit` of them, evenly taken."""
    c = read_gaussians(path)
    columns = lambda stem, names: np.stack([c[f"{stem}{n}"] for n in names], -1)
    centers = columns("", "xyz")
    count = min(limit or len(centers), len(centers))
    keep = np.linspace(0, len(centers) - 1, count).astype(int)
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    model = Model(centers[keep], np.zeros((count, 3)), up, np.ones(count), device)
    with torch.no_grad():
        model.scales.copy_(torch.as_tensor(columns("scale_", "012")[keep]))
        model.quats.copy_(torch.as_tensor(columns("rot_", "0123")[keep]))
        model.opacities.copy_(torch.as_tensor(c["opacity"][keep]))
        model.colors.copy_(torch.as_tensor(0.5 + 0.28209479 * columns("f_dc_", "012")[keep]))
    return model


def tiles_as_shipped_s(model: Model, view, share: int = 500) -> float:
    """CPU seconds of gsplat's `_isect_tiles` for all Gaussians, from a timing of some."""
    from gsplat.cuda import _torch_impl as impl

    with torch.no_grad():
        covariances, _ = impl._quat_scale_to_covar_preci(model.quats, torch.exp(model.scales), True, False)
        radii, means2d, depths, _, _ = impl._fully_fused_projection(
            model.means, covariances, view["x_cw"][None], view["K"][None], view["width"], view["height"]
        )
        some = torch.linspace(0, len(model.means) - 1, min(share, len(model.means))).long()
        size = (math.ceil(view["width"] / 16), math.ceil(view["height"] / 16))
        with Stopwatch() as watch:
            impl._isect_tiles(means2d[:, some], radii[:, some], depths[:, some], 16, *size)
    return watch.cpu_s * len(model.means) / len(some)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("export", type=Path)
    parser.add_argument("gaussians", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--limit", type=int, help="use at most so many Gaussians")
    parser.add_argument("--as-shipped", action="store_true")
    args = parser.parse_args()

    scan = Export(args.export)
    rasterise, name = best_rasteriser()
    device = torch.device("cuda" if name == "cuda" else "cpu")
    start_bytes = own_peak_bytes()
    model = model_of(args.gaussians, device, args.limit)
    frames = scan.training()
    views = [view_of(scan, f, device) for f in frames[:: max(1, len(frames) // args.repeats)][: args.repeats]]
    background = torch.as_tensor(scan.background, dtype=torch.float32, device=device)
    optimiser = model.optimiser(2e-5)
    wall_ms, cpu_ms = [], []
    for view in [views[0], *views]:  # the first warms up
        if name == "cuda":
            torch.cuda.synchronize()
        with Stopwatch() as watch:
            optimiser.zero_grad(set_to_none=True)
            loss = loss_of(model, rasterise, view, background, 1.0)
            loss.backward()
            optimiser.step()
            if name == "cuda":
                torch.cuda.synchronize()
        wall_ms.append(1e3 * watch.wall_s)
        cpu_ms.append(1e3 * watch.cpu_s)
    result = {
        "step_wall_ms": statistics.median(wall_ms[1:]),
        "step_cpu_ms": statistics.median(cpu_ms[1:]),
        "gaussians": len(model.means),
        "width": views[0]["width"],
        "height": views[0]["height"],
        "peak_bytes": own_peak_bytes(),
        "start_bytes": start_bytes,
        "rasteriser": name,
    }
    if args.as_shipped and name != "cuda":
        view = view_of(scan, frames[0], torch.device("cpu"))
        result["shipped_tiles_cpu_ms"] = 1e3 * tiles_as_shipped_s(model, view)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
