"""gsplat's pure PyTorch rasteriser, made to run without a GPU.

`gsplat.cuda._torch_impl` is in PyTorch except for two functions that call CUDA: the list of Gaussians by
pixel (`rasterize_to_indices_in_range`), and the transmittance along a
pixel (`nerfacc.render_weight_from_alpha`). Both are implemented here in vectorised PyTorch, with a gradient by one suffix sum;
projection and compositing (`_fully_fused_projection`, `accumulate`) are gsplat's own. Its `_isect_tiles`, a Python
loop over Gaussians that only the first of the two needs, is not used; `gsplat_step.py` can time it.
"""

import sys
import types

import torch

ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.999
TRANSMITTANCE_MIN = 1e-4


def _segment_starts(rays: torch.Tensor) -> torch.Tensor:
    """For each entry of a sorted list of ray ids, the index of the first entry of its ray."""
    index = torch.arange(len(rays), device=rays.device)
    first = torch.ones_like(rays, dtype=torch.bool)
    first[1:] = rays[1:] != rays[:-1]
    return torch.cummax(torch.where(first, index, torch.zeros_like(index)), 0).values


def _transmittance(alphas: torch.Tensor, starts: torch.Tensor) -> torch.Tensor:
    """Product of 1 - alpha over the earlier entries of the same ray. Sums of logarithms in double precision: the sum
    runs over the whole image before a ray's own start is taken off."""
    logs = torch.log1p(-alphas.double())
    before = torch.cumsum(logs, 0) - logs
    return torch.exp(before - before[starts]).to(alphas.dtype)


class _Weights(torch.autograd.Function):
    """w_k = T_k alpha_k, with dw/dalpha by one suffix sum per ray."""

    @staticmethod
    def forward(ctx, alphas, rays):
        starts = _segment_starts(rays)
        trans = _transmittance(alphas, starts)
        ctx.save_for_backward(alphas, trans, starts)
        ctx.mark_non_differentiable(trans)
        return alphas * trans, trans

    @staticmethod
    def backward(ctx, grad_weights, _):
        alphas, trans, starts = ctx.saved_tensors
        pulled = (alphas * trans * grad_weights).double()
        running = torch.cumsum(pulled, 0)
        upto = running - (running - pulled)[starts]  # within the ray, this entry included
        last = torch.ones_like(starts, dtype=torch.bool)
        last[:-1] = starts[1:] != starts[:-1]
        total = torch.zeros_like(pulled)
        total[starts[last]] = upto[last]
        behind = total[starts] - upto
        return trans * grad_weights - (behind / (1.0 - alphas.double())).to(alphas.dtype), None


def _render_weight_from_alpha(alphas, packed_info=None, ray_indices=None, n_rays=None, prefix_trans=None):
    if packed_info is not None or prefix_trans is not None or ray_indices is None:
        raise NotImplementedError("only sorted ray_indices, as gsplat passes them")
    return _Weights.apply(alphas, ray_indices)


def _accumulate_along_rays(weights, values=None, ray_indices=None, n_rays=None):
    source = weights[:, None] if values is None else weights[:, None] * values
    out = torch.zeros((n_rays, source.shape[-1]), device=source.device, dtype=source.dtype)
    return out.index_add(0, ray_indices, source)


def install_nerfacc() -> None:
    """Gives gsplat's `accumulate` the two functions of nerfacc 0.5 that it imports; nerfacc's own run on CUDA only."""
    module = types.ModuleType("nerfacc")
    module.render_weight_from_alpha = _render_weight_from_alpha
    module.accumulate_along_rays = _accumulate_along_rays
    sys.modules["nerfacc"] = module


def _ranges(low, high, size):
    """Whole numbers i with i + 0.5 between low and high, within 0 to size: the range's index and i, one entry each."""
    first = torch.ceil(low - 0.5).clamp(0, size).int()
    counts = (torch.floor(high - 0.5).clamp(-1, size - 1).int() - first + 1).clamp_min(0)
    which = torch.repeat_interleave(torch.arange(len(first), device=low.device, dtype=torch.int32), counts)
    begin = torch.cumsum(counts, 0, dtype=torch.int32) - counts
    return which, torch.arange(len(which), device=low.device, dtype=torch.int32) + (first - begin)[which]


@torch.no_grad()
def list_pairs(means2d, conics, opacities, depths, radii, width, height):
    """(Gaussian, pixel) pairs that contribute, pixel by pixel and front to back within each.

    As in gsplat's CUDA kernels, the box of a Gaussian is where its alpha can reach 1/255, and pairs below that or behind a
    transmittance of 1e-4 are left out. Returns two int64 tensors.
    """
    visible = (radii > 0).all(-1) & (opacities > ALPHA_MIN)
    ids = torch.nonzero(visible)[:, 0]
    ids = ids[torch.argsort(depths[ids], stable=True)]
    a, b, c = conics[ids].unbind(-1)
    det = (a * c - b * b).clamp_min(1e-12)
    reach = 2.0 * torch.log(opacities[ids] / ALPHA_MIN)
    half_y = torch.sqrt(reach * a / det)
    mx, my = means2d[ids].unbind(-1)
    # First the rows that each ellipse crosses, then the pixels between its two sides in each. Pixel i has its centre
    # at i + 0.5.
    which, y = _ranges(my - half_y, my + half_y, height)
    dy = y + 0.5 - my[which]
    slope = b[which] * dy / a[which]
    half_x = torch.sqrt((reach[which] - det[which] / a[which] * dy * dy).clamp_min(0.0) / a[which])
    middle = mx[which] - slope
    row, x = _ranges(middle - half_x, middle + half_x, width)
    dx = x + 0.5 - middle[row]
    along, rest = a[which], 0.5 * (det[which] / a[which]) * dy * dy
    power = 0.5 * along[row] * dx * dx + rest[row]
    alphas = (opacities[ids][which][row] * torch.exp(-power)).clamp_max(ALPHA_MAX)
    pixels, which = (y * width)[row] + x, which[row]
    # The list is front to back; a stable sort by pixel keeps that within each pixel.
    pixels, order = torch.sort(pixels, stable=True)
    which, alphas = which[order], alphas[order]
    seen = _transmittance(alphas, _segment_starts(pixels)) * (1.0 - alphas) > TRANSMITTANCE_MIN
    return ids[which[seen]], pixels[seen].long()


def rasterise(means, quats, scales, opacities, features, viewmat, K, width, height):
    """Composites `features` [N, C] and depth by gsplat's PyTorch functions.

    Returns features [H, W, C], depth [H, W] in metres (weighted sum, not normalised) and alpha [H, W].
    """
    from gsplat.cuda import _torch_impl as impl

    if "nerfacc" not in sys.modules:
        install_nerfacc()
    covariances, _ = impl._quat_scale_to_covar_preci(quats, scales, True, False)
    radii, means2d, depths, conics, _ = impl._fully_fused_projection(
        means, covariances, viewmat[None], K[None], width, height
    )
    radii, means2d, depths, conics = radii[0], means2d[0], depths[0], conics[0]
    gaussians, pixels = list_pairs(means2d, conics, opacities, depths, radii, width, height)
    channels = torch.cat([features, depths[:, None]], -1)
    image, alpha = impl.accumulate(
        means2d, conics, opacities, channels, gaussians, pixels, torch.zeros_like(pixels), width, height
    )
    return image[..., :-1], image[..., -1], alpha[..., 0]


def rasterise_cuda(means, quats, scales, opacities, features, viewmat, K, width, height):
    """The same by gsplat's CUDA rasteriser."""
    from gsplat import rasterization

    image, alpha, _ = rasterization(
        means, quats, scales, opacities, features, viewmat[None], K[None], width, height, packed=False,
        render_mode="RGB+D",
    )
    return image[0, ..., :-1], image[0, ..., -1], alpha[0, ..., 0]


def best_rasteriser():
    """The CUDA rasteriser if there is a GPU, else the PyTorch one; with its name."""
    if torch.cuda.is_available():
        return rasterise_cuda, "cuda"
    return rasterise, "torch-cpu"
