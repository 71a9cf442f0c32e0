"""OWLv2's image tower and SAM 2.1 tiny's image encoder, full size with random weights: ours and PyTorch's.

    python benches/peers/nets.py [--repeats 3]

Needs torch and transformers==5.23.0. Each runs in its own process with two threads; weights do not affect time. The best
of the repeats counts. On a busy machine compare CPU seconds, which are of the repeats and of all threads.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import measure

THREADS = 2
ENV = {"OMP_NUM_THREADS": str(THREADS), "OMP_WAIT_POLICY": "passive", "RAYON_NUM_THREADS": str(THREADS)}
WHAT = ("owlv2", "encoder")
MANIFEST = Path(__file__).resolve().parents[2] / "Cargo.toml"
OURS = ["cargo", "bench", "-q", "--manifest-path", str(MANIFEST), "-p", "sms-nets", "--bench", "speed", "--"]


def run_torch(what: str, repeats: int) -> None:
    """The child process of the peer."""
    import torch
    from transformers import Owlv2Config, Owlv2ForObjectDetection, Sam2VideoConfig, Sam2VideoModel

    torch.set_num_threads(THREADS)
    torch.set_grad_enabled(False)
    if what == "owlv2":
        model = Owlv2ForObjectDetection(Owlv2Config(vision_config=dict(image_size=960, patch_size=16))).eval()
        pixels = torch.randn(1, 3, 960, 960)

        def step():
            return model.owlv2.vision_model(pixels)
    else:
        model = Sam2VideoModel(Sam2VideoConfig()).eval()
        pixels = torch.randn(1, 3, 1024, 1024)

        def step():
            return model.get_image_features(pixels)

    walls, cpus = [], []
    for _ in range(repeats):
        with measure.Stopwatch() as watch:
            step()
        walls.append(watch.wall_s)
        cpus.append(watch.cpu_s)
    print(json.dumps({"what": what, "best_s": min(walls), "best_cpu_s": min(cpus)}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--timeout", type=float, default=600.0)
    parser.add_argument("--peer", choices=WHAT, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.peer:
        run_torch(args.peer, args.repeats)
        return
    print("| network | ours s | PyTorch s | ratio | ours CPU s | PyTorch CPU s | ratio |\n|---|--:|--:|--:|--:|--:|--:|")
    for what in WHAT:
        ours = measure.run([*OURS, what, str(args.repeats)], args.timeout, ENV)
        peer = measure.run([sys.executable, __file__, "--peer", what, "--repeats", str(args.repeats)], args.timeout, ENV)
        if ours.code or peer.code:
            print(f"| {what} | {ours.why() if ours.code else peer.why()} |")
            continue
        a, b = ours.json(), peer.json()
        row = [what]
        for key, digits in (("best_s", 2), ("best_cpu_s", 2)):
            row += [f"{a[key]:.{digits}f}", f"{b[key]:.{digits}f}", f"{a[key] / b[key]:.2f}"]
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    os.environ.update(ENV)
    main()
