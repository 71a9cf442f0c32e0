"""Times gsplat's training step on the fixed wall of our GPU benchmark, on a CUDA device.

    cargo bench -p sms-gaussians-gpu --bench step_times -- 50000 640 400 --export DIR
    python gsplat_wall.py DIR [--repeats 50]

A step is forward and backward of L1 on 22 channels (colour 3, normal 3, affinity 16) and depth, and fused Adam. Our
step also computes SSIM, the classifier with cross-entropy, and regularisers. Prints JSON.
"""

import argparse
import json
import statistics
from pathlib import Path

import numpy as np
import torch
from gsplat import rasterization
from gsplat_step import read_gaussians

CHANNELS = 22


def load(folder: Path, device):
    """Parameters, camera and size of an exported wall."""
    columns = read_gaussians(folder / "scene.ply")
    stack = lambda stem, names: torch.as_tensor(np.stack([columns[f"{stem}{n}"] for n in names], -1), device=device)
    camera = json.loads((folder / "camera.json").read_text())
    features = torch.rand(len(columns["x"]), CHANNELS, device=device)
    parameters = [stack("", "xyz"), stack("rot_", "0123"), stack("scale_", "012"), stack("", ["opacity"])[:, 0], features]
    parameters = [p.contiguous().requires_grad_() for p in parameters]
    matrix = lambda name: torch.tensor(camera[name], dtype=torch.float32, device=device)[None]
    return parameters, matrix("x_cw"), matrix("k"), camera["width"], camera["height"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeats", type=int, default=50)
    args = parser.parse_args()
    device = torch.device("cuda")
    torch.manual_seed(0)
    parameters, x_cw, k, width, height = load(args.folder, device)
    means, quaternions, scales, opacities, features = parameters
    optimiser = torch.optim.Adam(parameters, lr=1e-4, fused=True)
    target = torch.rand(1, height, width, CHANNELS + 1, device=device)

    def step():
        image, _, _ = rasterization(
            means, quaternions, scales.exp(), opacities.sigmoid(), features, x_cw, k, width, height,
            render_mode="RGB+D", packed=False,
        )
        (image - target).abs().mean().backward()
        optimiser.step()
        optimiser.zero_grad(set_to_none=True)

    for _ in range(10):
        step()
    times = []
    for _ in range(args.repeats):
        begin, end = torch.cuda.Event(True), torch.cuda.Event(True)
        begin.record()
        step()
        end.record()
        torch.cuda.synchronize()
        times.append(begin.elapsed_time(end))
    result = {
        "step_ms": statistics.median(times),
        "gaussians": len(means),
        "width": width,
        "height": height,
        "device": torch.cuda.get_device_name(),
        "device_bytes": torch.cuda.max_memory_allocated(),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
