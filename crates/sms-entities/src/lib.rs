//! From Gaussians to objects: grouping, meshing, spheres, convex parts.
