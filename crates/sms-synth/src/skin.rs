//! Image textures of scanned models: filtered look-up.

use crate::texture::linear_from_srgb;
use glamx::Vec3;
use sms_core::{ColorImage, Mesh, MeshTexture};

/// A mesh's image texture prepared for rendering: copies of decreasing size, each half of the one before, so that detail finer
/// than a pixel fades instead of aliasing (Williams 1983, "Pyramidal Parametrics").
#[derive(Debug, Clone, PartialEq)]
pub struct Skin {
    corner_uv: Vec<[[f32; 2]; 3]>,
    /// Pixels of the image per metre of each triangle.
    density: Vec<f32>,
    levels: Vec<ColorImage>,
}

impl Skin {
    /// Prepares the texture of a mesh (metres); `None` if they do not match or the image is empty.
    pub fn new(mesh: &Mesh, texture: &MeshTexture) -> Option<Self> {
        let image = &texture.image;
        if texture.corner_uv.len() != mesh.triangles.len() || image.width == 0 || image.height == 0 {
            return None;
        }
        let (w, h) = (image.width as f64, image.height as f64);
        let density = texture.corner_uv.iter().enumerate().map(|(t, uv)| {
            let [a, b, c] = mesh.corners(t);
            let area = 0.5 * (b - a).cross(c - a).length();
            let at = uv.map(|[u, v]| [f64::from(u) * w, f64::from(v) * h]);
            let side = |i: usize| [at[i][0] - at[0][0], at[i][1] - at[0][1]];
            let ([ux, uy], [vx, vy]) = (side(1), side(2));
            let pixels = 0.5 * (ux * vy - uy * vx).abs();
            if area > 0.0 { (pixels / area).sqrt() as f32 } else { 0.0 }
        });
        let mut skin =
            Self { corner_uv: texture.corner_uv.clone(), density: density.collect(), levels: vec![] };
        let mut level = image.clone();
        while level.width > 1 && level.height > 1 {
            let next = halved(&level);
            skin.levels.push(std::mem::replace(&mut level, next));
        }
        skin.levels.push(level);
        Some(skin)
    }

    /// Returns the image at full size.
    pub fn image(&self) -> &ColorImage {
        &self.levels[0]
    }

    /// Returns the mean linear-light colour.
    pub(crate) fn mean(&self) -> Vec3 {
        let last = self.levels.len() - 1;
        sample(&self.levels[last], 0.5, 0.5)
    }

    /// Returns the linear-light RGB at the point of a triangle with these weights of its corners; detail finer than `footprint_m`
    /// (metres across one pixel) is averaged.
    pub fn albedo(&self, triangle: usize, weights: [f32; 3], footprint_m: f32) -> Vec3 {
        let uv = self.corner_uv[triangle];
        let blend = |axis: usize| (0..3).map(|i| uv[i][axis] * weights[i]).sum::<f32>();
        let (u, v) = (blend(0), 1.0 - blend(1));
        let level = (footprint_m * self.density[triangle]).max(1.0).log2();
        let last = self.levels.len() - 1;
        let low = (level as usize).min(last);
        let share = if low < last { level - low as f32 } else { 0.0 };
        let fine = sample(&self.levels[low], u, v);
        if share > 0.0 { fine.lerp(sample(&self.levels[low + 1], u, v), share) } else { fine }
    }
}

/// Halves the size; each pixel is the mean of four (of two or one at an odd border).
fn halved(image: &ColorImage) -> ColorImage {
    let (width, height) = (image.width.div_ceil(2), image.height.div_ceil(2));
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let columns = [2 * x, (2 * x + 1).min(image.width - 1)];
            let rows = [2 * y, (2 * y + 1).min(image.height - 1)];
            let mut sum = [0u32; 3];
            for (x, y) in rows.into_iter().flat_map(|y| columns.map(|x| (x, y))) {
                (0..3).for_each(|c| sum[c] += u32::from(image[(x, y)][c]));
            }
            data.push(sum.map(|s| ((s + 2) / 4) as u8));
        }
    }
    ColorImage::from_vec(width, height, data)
}

/// Samples bilinearly, repeated beyond the borders; `v` from the top.
fn sample(image: &ColorImage, u: f32, v: f32) -> Vec3 {
    let (x, y) = (u * image.width as f32 - 0.5, v * image.height as f32 - 0.5);
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let at = |dx: i64, dy: i64| {
        let column = (x.floor() as i64 + dx).rem_euclid(image.width as i64);
        let row = (y.floor() as i64 + dy).rem_euclid(image.height as i64);
        linear_from_srgb(image[(column as usize, row as usize)])
    };
    at(0, 0).lerp(at(1, 0), fx).lerp(at(0, 1).lerp(at(1, 1), fx), fy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;

    /// A square of 1 m with an image of 64 × 64: left half red, right half green, upper half at full brightness.
    fn square() -> Skin {
        let corners =
            [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]: [f64; 2]| DVec3::new(x, y, 0.0));
        let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]);
        let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let corner_uv = mesh.triangles.iter().map(|t| t.map(|i| uv[i as usize])).collect();
        let pixel = |i: usize| {
            let (x, y) = (i % 64, i / 64);
            let bright = if y < 32 { 255 } else { 100 };
            if x < 32 { [bright, 0, 0] } else { [0, bright, 0] }
        };
        let image = ColorImage::from_vec(64, 64, (0..4096).map(pixel).collect());
        Skin::new(&mesh, &MeshTexture { corner_uv, image }).unwrap()
    }

    #[test]
    fn the_picture_lies_the_right_way_round_and_fades_to_its_mean() {
        let skin = square();
        // Triangle 0 has the corners (0,0), (1,0), (1,1): these weights are the point (0.75, 0.25), right and low.
        let right_low = skin.albedo(0, [0.25, 0.5, 0.25], 1e-4);
        assert!(right_low.x == 0.0 && (right_low.y - linear_from_srgb([0, 100, 0]).y).abs() < 1e-6);
        // Triangle 1 has (0,0), (1,1), (0,1): the point (0.25, 0.75), left and high.
        let left_high = skin.albedo(1, [0.25, 0.25, 0.5], 1e-4);
        assert!((left_high - Vec3::X).length() < 1e-6);
        // From far away only the mean of the image is left, at every point.
        let (a, b) = (skin.albedo(0, [0.25, 0.5, 0.25], 10.0), skin.albedo(1, [0.2, 0.3, 0.5], 10.0));
        assert!((a - b).length() < 1e-6);
        assert!((a - linear_from_srgb([89, 89, 0])).length() < 0.02, "{a}");
        assert!(
            Skin::new(&Mesh::cuboid(DVec3::ONE), &MeshTexture { corner_uv: vec![], ..texture() }).is_none()
        );
    }

    fn texture() -> MeshTexture {
        MeshTexture { corner_uv: vec![], image: ColorImage::filled(1, 1, [0; 3]) }
    }
}
