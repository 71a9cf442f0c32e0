//! Procedural scenes with their truth, and the simulated RGB-D camera that scans them.
