"""Trains gsplat on an exported scan within a limit of CPU time, and writes the files that are scored.

    python gsplat_train.py EXPORT --out DIR [--cpu-seconds 100] [--steps 7000] [--gaussians 30000]

Writes DIR/surface.ply (points sampled on the Gaussians' discs, with labels), DIR/rendered.ply (points of the depth
rendered at every fourth training view, with labels) and DIR/views/ (rendered held-out views), and prints its time,
memory and the schedule that it got as JSON. The rasteriser is gsplat's own: CUDA if there is a
GPU, else its PyTorch functions (see gsplat_cpu.py).

The recipe is that of gsplat's `simple_trainer.py`: (1 - 0.2) L1 + 0.2 (1 - SSIM) on colour and its learning rates, plus
L1 on depth normalised by opacity, since the peers are given depth. Gaussians start from the depth images: points of
all training frames, averaged in cells, as discs along the normal of their neighbourhood. Their number is fixed;
densification is for scans without depth. Centres start on measured surfaces, so their learning rate is lower than
gsplat's (1.6e-4 of the scene's extent would move them by millimetres). Labels are not learnt: each Gaussian keeps the
most frequent label of its cell, and labels of views are composited from those.
"""

import argparse
import functools
import json
import math
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from export import Export, edge_mask, write_points, write_view
from gsplat_cpu import best_rasteriser
from measure import Stopwatch, own_peak_bytes

POINTS_PER_M2 = 1e6
MIN_OPACITY = 0.1


def seeds(scan: Export, frames, wanted: int):
    """Centres, colours, labels, normals and radii of about `wanted` cells of the fused depth points."""
    points, colors, labels, toward = [], [], [], []
    for frame in frames:
        v, u = np.nonzero((frame.depth > 0) & ~edge_mask(frame.depth, 1))
        points.append(unproject(scan, frame, u, v, frame.depth[v, u]))
        colors.append(frame.color[v, u])
        labels.append(frame.label[v, u] if frame.label is not None else np.zeros(len(u), np.uint16))
        toward.append(frame.x_wc[:3, 3] - points[-1])
    points, colors, toward = (np.concatenate(a) for a in (points, colors, toward))
    labels = np.where((l := np.concatenate(labels)) == 65535, 0, l).astype(np.int64)
    # Cells are as wide as some pixels are at the nearest camera, in steps of two.
    cameras = np.stack([frame.x_wc[:3, 3] for frame in frames[:: max(1, len(frames) // 8)]])
    nearest = torch.cdist(torch.as_tensor(points).float(), torch.as_tensor(cameras).float()).amin(1).numpy()
    pixels = 3.0
    while True:
        size = 2.0 ** np.round(np.log2(pixels * nearest / scan.K[0, 0]))
        cell = np.floor(points / size[:, None]).astype(np.int64) + (1 << 19)
        key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
        key = key * 2 + (labels > 0)
        _, first, which = np.unique(key, return_index=True, return_inverse=True)
        count = len(first)
        if count <= wanted:
            break
        pixels *= max(math.sqrt(count / wanted), 1.05)
    size = size[first]
    weight = np.bincount(which, minlength=count).astype(np.float64)
    mean = lambda a: np.stack([np.bincount(which, a[:, k], count) / weight for k in range(a.shape[1])], -1)
    centers, rgb, toward = mean(points), mean(colors), mean(toward)
    kinds = int(labels.max()) + 1
    label = np.bincount(which * kinds + labels, minlength=count * kinds).reshape(count, kinds).argmax(1)
    # Cells that one or two points fell into are mostly flying pixels.
    solid = weight >= 3
    centers, rgb, toward, label, size = (a[solid] for a in (centers, rgb, toward, label, size))
    normals, radii = disc_shapes(centers, toward)
    return centers, rgb, label, normals, 0.6 * np.minimum(radii, 1.5 * size)


def disc_shapes(centers, toward, neighbours: int = 12):
    """Normals by plane fits, facing `toward`, and the distance to the third neighbour."""
    near = torch.as_tensor(centers).float()
    order = np.empty((len(centers), neighbours), np.int64)
    distance = np.empty((len(centers), neighbours))
    for begin in range(0, len(centers), 1024):
        d = torch.cdist(near[begin : begin + 1024], near)
        values, index = d.topk(neighbours, largest=False)
        order[begin : begin + 1024], distance[begin : begin + 1024] = index.numpy(), values.numpy()
    around = centers[order] - centers[order].mean(1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    normals = vectors[:, :, 0]
    normals *= np.where((normals * toward).sum(1) < 0, -1.0, 1.0)[:, None]
    return normals, distance[:, 3]


def quaternions(normals: np.ndarray) -> np.ndarray:
    """w, x, y, z of the shortest turn from z to each normal."""
    w = 1.0 + normals[:, 2]
    q = np.stack([w, -normals[:, 1], normals[:, 0], np.zeros_like(w)], -1)
    q[w < 1e-6] = [0.0, 1.0, 0.0, 0.0]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


@functools.lru_cache
def blur_matrix(size: int, device, window: int = 11, sigma: float = 1.5) -> torch.Tensor:
    """Matrix that blurs a line of pixels, zeros beyond its ends. On a CPU a product with it is several times faster
    than a convolution of one channel and its gradient."""
    t = torch.arange(size, device=device, dtype=torch.float32)
    apart = t[:, None] - t[None, :]
    kernel = torch.exp(-apart.square() / (2 * sigma**2)) * (apart.abs() <= window // 2)
    middle = torch.exp(-torch.arange(-(window // 2), window // 2 + 1).float().square() / (2 * sigma**2)).sum()
    return kernel / middle


def ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean SSIM of two [H, W, 3] images, Gaussian window of 11 pixels, sigma 1.5; `b` needs no gradient."""
    rows, columns = blur_matrix(a.shape[0], a.device), blur_matrix(a.shape[1], a.device)
    blur = lambda *images: (rows @ torch.stack(images).permute(0, 3, 1, 2) @ columns).unbind(0)
    ma, aa, ab = blur(a, a * a, a * b)
    mb, bb = blur(b, b * b)
    va, vb, vab = aa - ma * ma, bb - mb * mb, ab - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    value = (2 * ma * mb + c1) * (2 * vab + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
    return value.mean()


class Model:
    """Parameters of the Gaussians in gsplat's units."""

    def __init__(self, centers, rgb, normals, radii, device):
        tensor = lambda a: torch.as_tensor(np.asarray(a), dtype=torch.float32, device=device).requires_grad_(True)
        scales = np.stack([radii, radii, 0.2 * radii], -1).clip(1e-4)
        opacity = np.full(len(centers), math.log(0.7 / 0.3))
        self.means, self.quats, self.scales = tensor(centers), tensor(quaternions(normals)), tensor(np.log(scales))
        self.opacities, self.colors = tensor(opacity), tensor(rgb)

    def optimiser(self, position_rate: float) -> torch.optim.Adam:
        """gsplat's `simple_trainer` defaults except for the centres; colours directly instead of by the constant harmonic."""
        rates = [(self.means, position_rate), (self.scales, 5e-3), (self.quats, 1e-3)]
        rates += [(self.opacities, 5e-2), (self.colors, 2.5e-3)]
        return torch.optim.Adam([{"params": [p], "lr": lr} for p, lr in rates], eps=1e-15)

    def render(self, rasterise, view, features=None):
        """Features (colours unless given), mean depth along the pixel and alpha."""
        shown, depth, alpha = rasterise(
            self.means,
            F.normalize(self.quats, dim=-1),
            torch.exp(self.scales),
            torch.sigmoid(self.opacities),
            self.colors if features is None else features,
            view["x_cw"],
            view["K"],
            view["width"],
            view["height"],
        )
        return shown, depth, alpha


def view_of(scan: Export, frame, device):
    tensor = lambda a: torch.as_tensor(np.ascontiguousarray(a), dtype=torch.float32, device=device)
    height, width = frame.depth.shape
    return {
        "x_cw": tensor(np.linalg.inv(frame.x_wc)),
        "K": tensor(scan.K),
        "width": width,
        "height": height,
        "color": tensor(frame.color),
        "depth": tensor(frame.depth),
    }


def loss_of(model: Model, rasterise, view, background, depth_weight: float):
    """The loss of a view."""
    shown, depth, alpha = model.render(rasterise, view)
    image = shown + (1.0 - alpha[..., None]) * background
    photo = 0.8 * (image - view["color"]).abs().mean() + 0.2 * (1.0 - ssim(image, view["color"]))
    valid = (view["depth"] > 0) & (alpha > 0.05)
    error = (depth / alpha.clamp_min(1e-3) - view["depth"]).abs()
    return photo + depth_weight * (error * valid).sum() / valid.sum().clamp_min(1)


@torch.no_grad()
def disc_points(model: Model, labels: np.ndarray):
    """Points on the discs of Gaussians, uniform by area out to one sigma."""
    from gsplat.cuda._torch_impl import _quat_to_rotmat

    keep = torch.sigmoid(model.opacities) >= MIN_OPACITY
    axes = _quat_to_rotmat(model.quats[keep]).transpose(1, 2).cpu().double().numpy()
    scales = torch.exp(model.scales[keep]).cpu().double().numpy()
    means = model.means[keep].cpu().double().numpy()
    order = np.argsort(-scales, axis=1)[:, :2]
    long = np.take_along_axis(axes, order[..., None], 1) * np.take_along_axis(scales, order, 1)[..., None]
    area = math.pi * np.prod(np.take_along_axis(scales, order, 1), axis=1)
    counts = np.rint(area * POINTS_PER_M2).astype(int).clip(1, 5000)
    which = np.repeat(np.arange(len(means)), counts)
    k = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    radius = np.sqrt((k + 0.5) / counts[which])
    angle = math.pi * (3 - math.sqrt(5)) * (k + which)
    offset = long[which, 0] * (radius * np.cos(angle))[:, None] + long[which, 1] * (radius * np.sin(angle))[:, None]
    return means[which] + offset, labels[keep.cpu().numpy()][which]


@torch.no_grad()
def shown_view(model: Model, rasterise, view, background, one_hot):
    """Colour, depth in metres and label of a view; depth and label are 0 where opacity is below a half."""
    shown, depth, alpha = model.render(rasterise, view)
    share, _, _ = model.render(rasterise, view, one_hot)
    covered = alpha >= 0.5
    return (
        (shown + (1 - alpha[..., None]) * background).cpu().numpy(),
        torch.where(covered, depth / alpha.clamp_min(1e-3), 0.0).cpu().numpy(),
        torch.where(covered, share.argmax(-1), 0).cpu().numpy(),
    )


def unproject(scan: Export, frame, u, v, z) -> np.ndarray:
    """World points of pixels at a depth."""
    z = z.astype(np.float64)
    x, y = (u + 0.5 - scan.K[0, 2]) / scan.K[0, 0], (v + 0.5 - scan.K[1, 2]) / scan.K[1, 1]
    return (np.stack([x, y, np.ones_like(x)], -1) * z[:, None]) @ frame.x_wc[:3, :3].T + frame.x_wc[:3, 3]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("export", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cpu-seconds", type=float, default=100.0, help="limit of the training, seeding included")
    parser.add_argument("--steps", type=int, default=7000, help="steps at most")
    parser.add_argument("--gaussians", type=int, default=30_000, help="Gaussians at most")
    parser.add_argument("--depth-weight", type=float, default=1.0, help="weight of the depth loss per metre")
    parser.add_argument("--position-rate", type=float, default=2e-5, help="learning rate of centres, metres a step")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    scan = Export(args.export)
    frames = scan.training()
    rasterise, name = best_rasteriser()
    device = torch.device("cuda" if name == "cuda" else "cpu")
    background = torch.as_tensor(scan.background, dtype=torch.float32, device=device)
    rng = np.random.default_rng(args.seed)
    start_bytes = own_peak_bytes()
    with Stopwatch() as watch:
        centers, rgb, labels, normals, radii = seeds(scan, frames, args.gaussians)
        model = Model(centers, rgb, normals, radii, device)
        optimiser = model.optimiser(args.position_rate)
        # The learning rate of the means falls to a hundredth over the schedule it gets, as in gsplat's trainer.
        initial = optimiser.param_groups[0]["lr"]
        views = [view_of(scan, frame, device) for frame in frames]
        seeded_s = watch.so_far_s()
        order, steps, first, last = [], 0, None, None
        while steps < args.steps and watch.cpu_so_far_s() < args.cpu_seconds:
            done = max(steps / args.steps, watch.cpu_so_far_s() / args.cpu_seconds)
            optimiser.param_groups[0]["lr"] = initial * 0.01**done
            order = order or list(rng.permutation(len(views)))
            optimiser.zero_grad(set_to_none=True)
            loss = loss_of(model, rasterise, views[order.pop()], background, args.depth_weight)
            loss.backward()
            optimiser.step()
            steps += 1
            last = float(loss.detach())
            first = last if first is None else first
        if name == "cuda":
            torch.cuda.synchronize()
    peak_bytes = own_peak_bytes()

    points, point_labels = disc_points(model, labels)
    write_points(args.out / "surface.ply", points, point_labels)
    one_hot = F.one_hot(torch.as_tensor(labels, device=device)).float()
    points, point_labels = [], []
    for frame in frames[::4]:
        _, depth, label = shown_view(model, rasterise, view_of(scan, frame, device), background, one_hot)
        v, u = np.nonzero(depth > 0)
        points.append(unproject(scan, frame, u, v, depth[v, u]))
        point_labels.append(label[v, u])
    write_points(args.out / "rendered.ply", np.concatenate(points), np.concatenate(point_labels))
    for frame in scan.heldout():
        shown = shown_view(model, rasterise, view_of(scan, frame, device), background, one_hot)
        write_view(args.out / "views", frame, *shown)

    import gsplat

    print(
        json.dumps(
            {
                "seconds": watch.wall_s,
                "cpu_seconds": watch.cpu_s,
                "peak_bytes": peak_bytes,
                "start_bytes": start_bytes,
                "gpu_peak_bytes": torch.cuda.max_memory_allocated() if name == "cuda" else 0,
                "seed_seconds": seeded_s,
                "steps": steps,
                "gaussians": len(centers),
                "loss_first": first,
                "loss_last": last,
                "rasteriser": name,
                "settings": {k: v for k, v in vars(args).items() if k not in ("export", "out")},
                "gsplat": gsplat.__version__,
                "torch": torch.__version__,
            }
        )
    )


if __name__ == "__main__":
    main()
