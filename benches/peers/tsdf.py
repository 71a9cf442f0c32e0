"""Fuses an exported scan by open3d's TSDF (`t.geometry.VoxelBlockGrid`, on the CPU) and writes the files that are scored.

    python tsdf.py EXPORT --out DIR [--voxel-mm 1.5] [--truncation 8] [--weight 3] [--edge 1]

Writes DIR/surface.ply (points sampled on the mesh, with labels) and DIR/views/ (held-out views ray cast from the
mesh), and prints its time, memory and settings as JSON. Times are of fusion and mesh extraction with the frames in
memory, as for our scan.

Colour comes from the fused colour at the vertices. TSDF fusion has no labels; to score it by object, each
vertex takes the vote of the masks of the training frames that see it on the surface, outside the timed part.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import open3d as o3d
from export import Export, edge_mask, grown, write_points, write_view
from measure import Stopwatch, own_peak_bytes

DEVICE = o3d.core.Device("CPU:0")
POINTS_PER_M2 = 1e6


def fuse(scan: Export, frames, voxel_m: float, truncation_voxels: float, weight: float, edge: int, objects):
    """The mesh of the frames."""
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(o3d.core.float32, o3d.core.float32, o3d.core.float32),
        attr_channels=((1), (1), (3)),
        voxel_size=voxel_m,
        block_resolution=8,
        block_count=10_000,
        device=DEVICE,
    )
    K = o3d.core.Tensor(scan.K, o3d.core.float64)
    far = float(max(f.depth.max() for f in frames)) + 1e-3
    for frame in frames:
        keep = frame.depth > 0
        if objects is not None:
            keep &= grown((frame.label > 0) & (frame.label < 65535), objects)
        if edge:
            keep &= ~edge_mask(frame.depth, edge)
        depth = o3d.t.geometry.Image(np.ascontiguousarray(np.where(keep, frame.depth, 0.0).astype(np.float32)))
        color = o3d.t.geometry.Image(np.ascontiguousarray(frame.color.astype(np.float32)))
        x_cw = o3d.core.Tensor(np.linalg.inv(frame.x_wc), o3d.core.float64)
        blocks = grid.compute_unique_block_coordinates(depth, K, x_cw, 1.0, far, truncation_voxels)
        grid.integrate(blocks, depth, color, K, x_cw, 1.0, far, truncation_voxels)
    return grid.extract_triangle_mesh(weight_threshold=weight)


def vote_labels(scan: Export, frames, vertices: np.ndarray, tolerance_m: float) -> np.ndarray:
    """For each vertex the most frequent label in the masks of frames whose depth shows it on the surface."""
    count = max((int(f.label[f.label < 65535].max(initial=0)) for f in frames if f.label is not None), default=0) + 1
    votes = np.zeros((len(vertices), count), np.uint16)
    height, width = frames[0].depth.shape
    for frame in frames:
        if frame.label is None:
            continue
        x_cw = np.linalg.inv(frame.x_wc)
        p_c = vertices @ x_cw[:3, :3].T + x_cw[:3, 3]
        z = p_c[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.floor(p_c[:, 0] / z * scan.K[0, 0] + scan.K[0, 2])
            v = np.floor(p_c[:, 1] / z * scan.K[1, 1] + scan.K[1, 2])
        inside = np.nonzero((z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height))[0]
        ui, vi = u[inside].astype(int), v[inside].astype(int)
        label = frame.label[vi, ui].astype(int)
        agrees = (np.abs(frame.depth[vi, ui] - z[inside]) < tolerance_m) & (label < count)
        np.add.at(votes, (inside[agrees], label[agrees]), 1)
    return votes.argmax(1).astype(np.uint16)


def sample(vertices, triangles, labels, density_per_m2, seed=0):
    """Points spread evenly over a mesh, each with the label of its triangle's nearest corner."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(seed)
    count = int(areas.sum() * density_per_m2)
    which = np.searchsorted(np.cumsum(areas), (np.arange(count) + rng.random(count)) / count * areas.sum())
    which = which.clip(max=len(triangles) - 1)
    s, t = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - s, s * (1 - t), s * t], -1)
    points = sum(weights[:, k, None] * (a, b, c)[k][which] for k in range(3))
    return points, labels[triangles[which, weights.argmax(1)]]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("export", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--voxel-mm", type=float, default=1.5)
    parser.add_argument("--truncation", type=float, default=8.0, help="truncation distance in voxels")
    parser.add_argument("--weight", type=float, default=3.0, help="observations that a voxel must have")
    parser.add_argument("--edge", type=int, default=1, help="pixels dropped next to depth edges")
    parser.add_argument("--objects", type=int, metavar="PX", help="fuse only pixels within PX of an object's mask")
    args = parser.parse_args()

    scan = Export(args.export)
    frames = scan.training()
    start_bytes = own_peak_bytes()
    with Stopwatch() as watch:
        mesh = fuse(scan, frames, args.voxel_mm * 1e-3, args.truncation, args.weight, args.edge, args.objects)
    peak_bytes = own_peak_bytes()

    vertices = mesh.vertex.positions.numpy().astype(np.float64)
    triangles = mesh.triangle.indices.numpy().astype(np.int64)
    colors = mesh.vertex.colors.numpy().astype(np.float32).clip(0, 1)
    if not len(triangles):
        raise SystemExit("fusion gave no triangles")
    labels = vote_labels(scan, frames, vertices, tolerance_m=0.005)
    points, point_labels = sample(vertices, triangles, labels, POINTS_PER_M2)
    write_points(args.out / "surface.ply", points, point_labels)

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(triangles.astype(np.uint32))
    )
    for frame in scan.heldout():
        height, width = frame.depth.shape
        v, u = np.mgrid[:height, :width].astype(np.float64)
        x = u + 0.5 - scan.K[0, 2]
        y = v + 0.5 - scan.K[1, 2]
        d_c = np.stack([x / scan.K[0, 0], y / scan.K[1, 1], np.ones_like(x)], -1)
        d_w = d_c @ frame.x_wc[:3, :3].T
        o_w = np.broadcast_to(frame.x_wc[:3, 3], d_w.shape)
        hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([o_w, d_w], -1).astype(np.float32)))
        # Directions have unit z in the camera, so that the ray's parameter is the depth.
        z = hit["t_hit"].numpy()
        seen = np.isfinite(z)
        triangle = triangles[np.where(seen, hit["primitive_ids"].numpy(), 0).astype(np.int64)]
        uv = hit["primitive_uvs"].numpy()
        weights = np.stack([1 - uv[..., 0] - uv[..., 1], uv[..., 0], uv[..., 1]], -1)
        color = np.einsum("hwk,hwkc->hwc", weights, colors[triangle])
        corner = np.take_along_axis(triangle, weights.argmax(-1)[..., None], -1)[..., 0]
        write_view(
            args.out / "views",
            frame,
            color=np.where(seen[..., None], color, scan.background),
            depth=np.where(seen, z, 0.0),
            label=np.where(seen, labels[corner], 0),
        )

    print(
        json.dumps(
            {
                "seconds": watch.wall_s,
                "cpu_seconds": watch.cpu_s,
                "peak_bytes": peak_bytes,
                "start_bytes": start_bytes,
                "triangles": len(triangles),
                "settings": {k: v for k, v in vars(args).items() if k not in ("export", "out")},
                "open3d": o3d.__version__,
            }
        )
    )


if __name__ == "__main__":
    main()
