"""Reads what `sms-experiments scan --export DIR` writes, and writes what `sms-experiments score` reads. NumPy and Pillow."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image


@dataclass
class Frame:
    """One view. Colour [H, W, 3] 0 to 1, depth [H, W] in metres with 0 for none, label [H, W] or None (65535: not to
    be used), x_wc [4, 4] the camera's pose in the world (OpenCV axes)."""

    name: str
    color: np.ndarray
    depth: np.ndarray
    label: np.ndarray | None
    x_wc: np.ndarray


class Export:
    """Frames as the scan itself trains on them: resampled, noisy, with its poses and masks.

    `K` takes pixel (0, 0) to have its centre at (0.5, 0.5).
    """

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        about = json.loads((self.folder / "transforms.json").read_text())
        center = about.get("pixel_center", 0.5)
        cx, cy = about["cx"] + 0.5 - center, about["cy"] + 0.5 - center
        self.K = np.array([[about["fl_x"], 0.0, cx], [0.0, about["fl_y"], cy], [0.0, 0.0, 1.0]])
        self.depth_unit_m = about["depth_unit_scale_factor"]
        self._frames = about["frames"]
        self._held = set(about.get("holdout", []))
        self.background = self._backdrop()

    def _read(self, index: int) -> Frame:
        entry = self._frames[index]
        image = lambda key: np.asarray(Image.open(self.folder / entry[key]))
        x_wc = np.array(entry["transform_matrix"], float) @ np.diag([1.0, -1.0, -1.0, 1.0])
        return Frame(
            Path(entry["file_path"]).stem,
            image("file_path")[..., :3].astype(np.float32) / 255.0,
            image("depth_file_path").astype(np.float32) * np.float32(self.depth_unit_m),
            image("mask_path") if "mask_path" in entry else None,
            x_wc,
        )

    def _backdrop(self) -> np.ndarray:
        """Mean colour of training pixels without depth, the colour of unreconstructed pixels (as in ours)."""
        total, count = np.zeros(3), 0
        for frame in self.training():
            empty = frame.depth == 0
            total, count = total + frame.color[empty].sum(0), count + int(empty.sum())
        return total / max(count, 1)

    def training(self) -> list[Frame]:
        """Frames to reconstruct from."""
        return [self._read(i) for i in range(len(self._frames)) if i not in self._held]

    def heldout(self) -> list[Frame]:
        """Frames to be scored on; only their names, poses and sizes may be used."""
        return [self._read(i) for i in sorted(self._held)]


def edge_mask(depth: np.ndarray, pixels: int, relative: float = 0.02) -> np.ndarray:
    """Pixels within `pixels` of a depth edge. Inverse depth is linear over the image of a plane, so that its second
    difference separates edges from slanted surfaces."""
    inverse = np.where(depth > 0, 1.0 / np.maximum(depth, 1e-6), np.nan)
    edge = np.zeros(depth.shape, bool)
    with np.errstate(invalid="ignore"):
        for axis in (0, 1):
            before, after = np.roll(inverse, 1, axis), np.roll(inverse, -1, axis)
            bend = np.abs(before - 2 * inverse + after) > relative * inverse
            inner = [slice(None), slice(None)]
            inner[axis] = slice(1, -1)
            edge[tuple(inner)] |= bend[tuple(inner)]
    return grown(edge, pixels - 1)


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Dilates a mask by `steps` pixels."""
    for _ in range(pixels):
        more = mask.copy()
        more[1:] |= mask[:-1]
        more[:-1] |= mask[1:]
        more[:, 1:] |= mask[:, :-1]
        more[:, :-1] |= mask[:, 1:]
        mask = more
    return mask


def write_points(path: Path, points: np.ndarray, labels: np.ndarray, room_m: float = 0.03) -> None:
    """A binary PLY of points with labels (0: background). Background points are kept only in the box around all
    objects is kept, `room_m` wider: the rest is scored nowhere and would be most of the file."""
    on = labels > 0
    if on.any():
        low, high = points[on].min(0) - room_m, points[on].max(0) + room_m
        keep = on | ((points >= low) & (points <= high)).all(1)
        points, labels = points[keep], labels[keep]
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.zeros(len(points), dtype=[("xyz", "<f4", 3), ("label", "<u2")])
    rows["xyz"], rows["label"] = points, labels
    header = f"ply\nformat binary_little_endian 1.0\ncomment frame: world, metres, z up\nelement vertex {len(points)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "property ushort label\nend_header\n"
    path.write_bytes(header.encode() + rows.tobytes())


def write_view(folder: Path, frame: Frame, color: np.ndarray, depth: np.ndarray, label: np.ndarray | None) -> None:
    """Writes a rendered held-out view: depth in tenths of millimetres, 0 for no depth."""
    for kind in ("color", "depth", "label"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    Image.fromarray((color.clip(0, 1) * 255 + 0.5).astype(np.uint8)).save(folder / "color" / f"{frame.name}.png")
    Image.fromarray((depth * 1e4 + 0.5).clip(0, 65535).astype(np.uint16)).save(folder / "depth" / f"{frame.name}.png")
    if label is not None:
        Image.fromarray(label.astype(np.uint16)).save(folder / "label" / f"{frame.name}.png")
