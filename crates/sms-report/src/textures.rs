//! Image textures of bodies within a budget of bytes.

use crate::photo::jpeg_address;
use rayon::prelude::*;
use sms_core::{ColorImage, Mesh, MeshTexture};
use sms_frames::resize_color;
use sms_scene::Body;

/// Quality of textures, 1 to 100. An atlas has an edge at every triangle, which lower values blur.
const QUALITY: u8 = 86;
/// Factors by which the sides shrink until the textures fit.
const FACTORS: [f64; 6] = [1.0, 0.75, 0.5, 0.35, 0.25, 0.125];

/// Returns the texture of each body as a `data:` address, together at most `budget` bytes; `None` for a body without a
/// texture, and for all if even the smallest are too large.
pub(crate) fn texture_addresses(bodies: &[Body], budget: usize) -> Vec<Option<String>> {
    for factor in FACTORS {
        let addresses: Vec<Option<String>> = bodies
            .par_iter()
            .map(|b| {
                fitting(&b.visual, b.texture.as_ref()?)
                    .map(|t| jpeg_address(&scaled(&t.image, factor), QUALITY))
            })
            .collect();
        if addresses.iter().flatten().map(String::len).sum::<usize>() <= budget {
            return addresses;
        }
    }
    vec![None; bodies.len()]
}

/// Returns the texture if it belongs to this mesh and has pixels.
pub(crate) fn fitting<'a>(mesh: &Mesh, texture: &'a MeshTexture) -> Option<&'a MeshTexture> {
    let fits = texture.corner_uv.len() == mesh.triangles.len() && !texture.image.data.is_empty();
    fits.then_some(texture)
}

fn scaled(image: &ColorImage, factor: f64) -> ColorImage {
    let side = |n: usize| ((n as f64 * factor).round() as usize).max(1);
    resize_color(image, side(image.width), side(image.height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;
    use sms_core::Image;
    use sms_scene::{example_material, floor_body};

    #[test]
    fn textures_shrink_until_they_fit() {
        let mesh = Mesh::cuboid(DVec3::splat(0.1));
        // Noise, which JPEG cannot compress.
        let noise: Vec<[u8; 3]> = (0..128 * 128u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 8).to_le_bytes())
            .map(|b| [b[0], b[1], b[2]])
            .collect();
        let texture =
            MeshTexture { corner_uv: vec![[[0.5; 2]; 3]; 12], image: Image::from_vec(128, 128, noise) };
        let bodies = vec![
            floor_body(0.0, example_material()),
            Body {
                visual: mesh.clone(),
                texture: Some(texture.clone()),
                ..floor_body(0.0, example_material())
            },
        ];
        let full = texture_addresses(&bodies, usize::MAX);
        assert!(full[0].is_none());
        let length = full[1].as_ref().unwrap().len();
        let small = texture_addresses(&bodies, length / 2);
        assert!((100..=length / 2).contains(&small[1].as_ref().unwrap().len()));
        assert_eq!(texture_addresses(&bodies, 10), [None, None]);
        assert!(fitting(&Mesh::default(), &texture).is_none() && fitting(&mesh, &texture).is_some());
    }
}
