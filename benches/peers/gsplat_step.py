"""Times gsplat's training step on the Gaussians of one of our scans.

    python gsplat_step.py EXPORT SCENE.ply [--channels 3] [--ours RESULTS.json] [--limit N] [--as-shipped]

EXPORT is what `sms-experiments scan --export` wrote of the scene, SCENE.ply what `--out DIR` left in DIR/SCENE/scan, and
RESULTS.json its results.json, whose step is printed for comparison (`--device gpu`: the step on the first frame).

A step is forward and backward of L1 + SSIM on colour and L1 on depth for one training view of the export, and Adam. With
22 channels it also composites normals and 16 affinities, with an L1 loss. Ours also computes the classifier with its
cross-entropy, and regularisers. Prints JSON.

On a GPU, Adam is PyTorch's fused one, and times are of submissions of 20 steps without waiting, as ours; the sum of kernel
times without launches is printed too. On the CPU, `--as-shipped` also times
gsplat's own listing of tiles (`_isect_tiles`, a Python loop), which is measured on a share of the Gaussians and scaled up.
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
from gsplat_train import Model, loss_of, ssim, view_of
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


def with_more_channels(model: Model, channels: int):
    """Trainable features beyond the three colours, and the loss of a view with all of them."""
    more = torch.rand(len(model.means), channels - 3, device=model.means.device, requires_grad=True)

    def loss(rasterise, view, background):
        shown, depth, alpha = model.render(rasterise, view, torch.cat([model.colors, more], -1))
        image = shown[..., :3] + (1.0 - alpha[..., None]) * background
        photo = 0.8 * (image - view["color"]).abs().mean() + 0.2 * (1.0 - ssim(image, view["color"]))
        valid = (view["depth"] > 0) & (alpha > 0.05)
        error = (depth / alpha.clamp_min(1e-3) - view["depth"]).abs()
        return photo + (error * valid).sum() / valid.sum().clamp_min(1) + (shown[..., 3:] - 0.5).abs().mean()

    return more, loss


def time_on_cpu(step, views) -> dict:
    """Milliseconds of a step, the median over the views."""
    wall_ms, cpu_ms = [], []
    for view in [views[0], *views]:  # the first warms up
        with Stopwatch() as watch:
            step(view)
        wall_ms.append(1e3 * watch.wall_s)
        cpu_ms.append(1e3 * watch.cpu_s)
    return {"step_wall_ms": statistics.median(wall_ms[1:]), "step_cpu_ms": statistics.median(cpu_ms[1:])}


def time_on_gpu(step, views, steps: int = 20, batches: int = 9) -> dict:
    """Milliseconds of a step on the first view and over all views: medians of batches; and of the kernels on the first."""

    def batch_ms(of_batch) -> float:
        torch.cuda.synchronize()
        with Stopwatch() as watch:
            for view in of_batch:
                step(view)
            torch.cuda.synchronize()
        return 1e3 * watch.wall_s / len(of_batch)

    first = [views[0]] * steps
    batch_ms(first)
    torch.cuda.reset_peak_memory_stats()
    result = {"step_wall_ms": statistics.median(batch_ms(first) for _ in range(batches))}
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profiler:
        batch_ms(first)
    kernels_us = sum(e.self_device_time_total for e in profiler.key_averages())
    if kernels_us > 0.0:  # some drivers report nothing
        result["step_kernels_ms"] = 1e-3 * kernels_us / steps
    result["step_views_ms"] = statistics.median(batch_ms(views) for _ in range(3))
    result["device_bytes"] = torch.cuda.max_memory_allocated()
    result["device"] = torch.cuda.get_device_name()
    return result


def ours_of(results: Path, scene: str) -> dict:
    """Our step of the scene from `results.json`."""
    found = json.loads(results.read_text())
    keys = {"step_ms": "ours_step_ms", "step_views_ms": "ours_step_views_ms", "scan_step_cpu_ms": "ours_step_cpu_ms"}
    values = {name: found.get(f"bench.scan.{scene}.{key}") for key, name in keys.items()}
    return {name: value for name, value in values.items() if value is not None}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("export", type=Path)
    parser.add_argument("gaussians", type=Path)
    parser.add_argument("--repeats", type=int, default=5, help="views that are timed on the CPU")
    parser.add_argument("--limit", type=int, help="use at most so many Gaussians")
    parser.add_argument("--channels", type=int, default=3, help="features composited: 3, or 22 as ours")
    parser.add_argument("--ours", type=Path, help="results.json of our scan of the same scene")
    parser.add_argument("--as-shipped", action="store_true")
    args = parser.parse_args()

    scan = Export(args.export)
    rasterise, name = best_rasteriser()
    on_gpu = name == "cuda"
    device = torch.device("cuda" if on_gpu else "cpu")
    start_bytes = own_peak_bytes()
    model = model_of(args.gaussians, device, args.limit)
    frames = scan.training()
    if not on_gpu:
        frames = frames[:: max(1, len(frames) // args.repeats)][: args.repeats]
    views = [view_of(scan, f, device) for f in frames]
    background = torch.as_tensor(scan.background, dtype=torch.float32, device=device)
    optimiser = model.optimiser(2e-5)
    loss_of_view = lambda rasterise, view, background: loss_of(model, rasterise, view, background, 1.0)
    if args.channels > 3:
        more, loss_of_view = with_more_channels(model, args.channels)
        optimiser.add_param_group({"params": [more], "lr": 2.5e-3})
    if on_gpu:
        rates = [{"params": group["params"], "lr": group["lr"]} for group in optimiser.param_groups]
        optimiser = torch.optim.Adam(rates, eps=1e-15, fused=True)

    def step(view):
        optimiser.zero_grad(set_to_none=True)
        loss_of_view(rasterise, view, background).backward()
        optimiser.step()

    times = time_on_gpu(step, views) if on_gpu else time_on_cpu(step, views)
    result = times | {
        "gaussians": len(model.means),
        "channels": args.channels,
        "width": views[0]["width"],
        "height": views[0]["height"],
        "peak_bytes": own_peak_bytes(),
        "start_bytes": start_bytes,
        "rasteriser": name,
    }
    if args.as_shipped and not on_gpu:
        view = view_of(scan, frames[0], torch.device("cpu"))
        result["shipped_tiles_cpu_ms"] = 1e3 * tiles_as_shipped_s(model, view)
    if args.ours:
        result |= ours_of(args.ours, args.export.name)
        if on_gpu and "ours_step_ms" in result:
            result["ratio"] = result["ours_step_ms"] / result["step_wall_ms"]
            result["ratio_views"] = result.get("ours_step_views_ms", math.nan) / result["step_views_ms"]
            result["ratio_to_kernels"] = result["ours_step_ms"] / result.get("step_kernels_ms", math.nan)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
