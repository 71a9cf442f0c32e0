//! Row-major images.

/// A row-major image: pixel (x, y) is `data[y * width + x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// The pixels, row by row from the top.
    pub data: Vec<T>,
}

/// Colour, sRGB, 8 bits a channel.
pub type ColorImage = Image<[u8; 3]>;
/// Depth along the camera's z axis in metres; 0 where there is no measurement.
pub type DepthImage = Image<f32>;
/// Unit surface normals facing the camera, in the producer's frame; zero where unknown.
pub type NormalImage = Image<[f32; 3]>;

impl<T: Clone> Image<T> {
    /// Creates an image filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height] }
    }

    /// Returns the rectangle from `min` to `max`, exclusive, clamped to the image: at least one pixel of an image that has
    /// any.
    pub fn cropped(&self, min: (usize, usize), max: (usize, usize)) -> Self {
        let (x0, y0) = (min.0.min(self.width.saturating_sub(1)), min.1.min(self.height.saturating_sub(1)));
        let (x1, y1) =
            (max.0.clamp(x0 + 1, self.width.max(x0 + 1)), max.1.clamp(y0 + 1, self.height.max(y0 + 1)));
        let rows = (y0..y1).flat_map(|y| self.data[y * self.width..][x0..x1].iter().cloned());
        Self::from_vec(x1 - x0, y1 - y0, rows.collect())
    }
}

impl<T> Image<T> {
    /// Creates an image from its pixels.
    ///
    /// # Panics
    /// If `data.len() != width * height`.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Self {
        assert_eq!(data.len(), width * height, "pixel count must match the size");
        Self { width, height, data }
    }

    /// Returns the pixel at (x, y), or `None` outside.
    pub fn get(&self, x: i64, y: i64) -> Option<&T> {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        inside.then(|| &self.data[y as usize * self.width + x as usize])
    }

    /// Returns (width, height).
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Maps every pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image { width: self.width, height: self.height, data: self.data.iter().map(f).collect() }
    }
}

impl ColorImage {
    /// Draws the outline of a box from `(x0, y0)` to `(x1, y1)`, `thick` pixels wide, clamped to the image.
    pub fn draw_box(
        &mut self,
        (x0, y0): (usize, usize),
        (x1, y1): (usize, usize),
        thick: usize,
        color: [u8; 3],
    ) {
        let (x1, y1) = (x1.min(self.width), y1.min(self.height));
        for y in y0..y1 {
            for x in x0..x1 {
                if x < x0 + thick || y < y0 + thick || x + thick >= x1 || y + thick >= y1 {
                    self[(x, y)] = color;
                }
            }
        }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Image<T> {
    type Output = T;
    fn index(&self, (x, y): (usize, usize)) -> &T {
        &self.data[y * self.width + x]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Image<T> {
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        &mut self.data[y * self.width + x]
    }
}
