//! An observed view in the order the tile kernels read it, with unusable pixels marked.

use super::planes::PaddedPlanes;
use super::project::CameraView;
use super::tile::{PATCH_ROWS, PATCHES, PatchPlace, TILE, TilePlane};
use crate::TrainFrame;

/// Tiles of an image.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct TileGrid {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl TileGrid {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    pub(super) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// First pixel of a tile.
    pub(super) fn corner(&self, tile: usize) -> (usize, usize) {
        (tile % self.columns * TILE, tile / self.columns * TILE)
    }

    /// Returns the index of a patch in the lists of its band; `tile` counts within the band.
    pub(super) fn patch(&self, tile: usize, patch: usize) -> usize {
        (tile / self.columns * PATCHES + patch) * self.columns + tile % self.columns
    }

    /// The patch `patch` rows of patches below the first pixel of a tile.
    pub(super) fn place(&self, (x, y): (usize, usize), patch: usize) -> PatchPlace {
        let y = y + patch * PATCH_ROWS;
        PatchPlace {
            x: x as f32,
            y: y as f32,
            columns: self.width.saturating_sub(x).min(TILE),
            rows: self.height.saturating_sub(y).min(PATCH_ROWS),
        }
    }
}

/// Observations of one tile.
#[derive(Clone)]
pub(super) struct TargetTile {
    /// Pixels with valid colour, one bit per pixel of each patch.
    pub(super) colored: [u16; PATCHES],
    /// Depth in metres, 0 where invalid.
    pub(super) depth: TilePlane,
    /// Normals in the world, zero where invalid.
    pub(super) normal: [TilePlane; 3],
    /// Labels, `u16::MAX` where invalid.
    pub(super) label: [u16; TILE * TILE],
}

/// An observed view.
pub(super) struct TiledTarget {
    pub(super) view: CameraView,
    pub(super) grid: TileGrid,
    pub(super) tiles: Vec<TargetTile>,
    /// Colour row by row, zero where invalid.
    pub(super) color: PaddedPlanes,
    /// Pixels with colour.
    pub(super) colored: usize,
    /// Pixels with depth.
    pub(super) deep: usize,
    /// Pixels with a normal.
    pub(super) oriented: usize,
    /// Pixels with a label.
    pub(super) labelled: usize,
}

/// Greatest valid depth, metres.
const DEPTH_MAX: f32 = 1e3;

impl TiledTarget {
    /// Reorders a frame by tiles. Pixels with a colour, depth or normal that is not finite are excluded from that
    /// term, and labels not below `classes` from the segmentation.
    ///
    /// # Panics
    /// If a buffer has another size than the camera's image.
    pub(super) fn new(frame: &TrainFrame, classes: usize) -> Self {
        let (width, height) = (frame.camera.intrinsics.width, frame.camera.intrinsics.height);
        let pixels = width * height;
        let sizes = [frame.color.len(), frame.depth.len(), frame.normal_w.len(), frame.label.len()];
        assert_eq!(sizes, [pixels; 4], "every buffer has one entry per pixel of the camera");
        let grid = TileGrid::new(width, height);
        let unusable = TargetTile {
            colored: [0; PATCHES],
            depth: TilePlane::ZERO,
            normal: [TilePlane::ZERO; 3],
            label: [u16::MAX; TILE * TILE],
        };
        let mut tiles = vec![unusable; grid.len()];
        let mut colors = PaddedPlanes::default();
        colors.resize(3, grid.columns * TILE, grid.rows * TILE);
        let (mut colored, mut deep, mut oriented, mut labelled) = (0, 0, 0, 0);
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let tile = &mut tiles[y / TILE * grid.columns + x / TILE];
                let (row, column) = (y % TILE, x % TILE);
                let (color, depth, normal) = (frame.color[i], frame.depth[i], frame.normal_w[i]);
                // Colours far outside 0..1 can only be damaged data, and would overflow the sums.
                if color.iter().all(|c| c.abs() <= 1e3) {
                    colored += 1;
                    tile.colored[row / PATCH_ROWS] |= 1 << (row % PATCH_ROWS * TILE + column);
                    (0..3).for_each(|c| colors.row_mut(y, c)[x] = color[c]);
                }
                if depth > 0.0 && depth <= DEPTH_MAX {
                    deep += 1;
                    *tile.depth.at_mut(column, row) = depth;
                }
                let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
                if (length - 1.0).abs() < 0.5 {
                    oriented += 1;
                    (0..3).for_each(|c| *tile.normal[c].at_mut(column, row) = normal[c]);
                }
                if usize::from(frame.label[i]) < classes {
                    labelled += 1;
                    tile.label[row * TILE + column] = frame.label[i];
                }
            }
        }
        let view = CameraView::new(&frame.camera);
        Self { view, grid, tiles, color: colors, colored, deep, oriented, labelled }
    }
}
