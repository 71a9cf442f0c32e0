//! Differentiable 3D Gaussians: model, losses, training schedule, CPU back end, checkpoint and PLY.
