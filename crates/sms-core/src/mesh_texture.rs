//! Image textures of meshes, and textured meshes as Wavefront OBJ.

use crate::{ColorImage, CoreError, InputError, Mesh, atomic, read_png_color, write_png_color};
use std::path::Path;

/// An image texture of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshTexture {
    /// Texture coordinates of each corner of each triangle, parallel to [`Mesh::triangles`]: u to the right and v **up**
    /// from the image's lower left corner, both in [0, 1] (OBJ's convention; glTF's v is 1 − v).
    pub corner_uv: Vec<[[f32; 2]; 3]>,
    /// The image, sRGB, first row at the top.
    pub image: ColorImage,
}

/// Merges equal texture coordinates of one vertex.
#[derive(Default)]
struct Coordinates {
    index_of: std::collections::BTreeMap<[u32; 2], usize>,
    all: Vec<[f32; 2]>,
}

impl Coordinates {
    fn index(&mut self, uv: [f32; 2]) -> usize {
        let next = self.all.len();
        let index = *self.index_of.entry(uv.map(f32::to_bits)).or_insert(next);
        if index == next {
            self.all.push(uv);
        }
        index
    }
}

/// Formats a mesh with its texture as OBJ text that refers to the material `material` in the library file `library`: metres,
/// 1-based indices, one `vt` for each distinct texture coordinate.
fn textured_obj(mesh: &Mesh, texture: &MeshTexture, library: &str, material: &str) -> String {
    use std::fmt::Write;
    let mut text = String::with_capacity(mesh.vertices.len() * 40 + mesh.triangles.len() * 60);
    let _ = writeln!(text, "mtllib {library}");
    for v in &mesh.vertices {
        let _ = writeln!(text, "v {:.9} {:.9} {:.9}", v.x, v.y, v.z);
    }
    let mut coordinates = Coordinates::default();
    let corners: Vec<[usize; 3]> =
        texture.corner_uv.iter().map(|uv| uv.map(|uv| coordinates.index(uv))).collect();
    for [u, v] in &coordinates.all {
        let _ = writeln!(text, "vt {u:.6} {v:.6}");
    }
    let _ = writeln!(text, "usemtl {material}");
    for (triangle, uv) in mesh.triangles.iter().zip(&corners) {
        let [a, b, c] = triangle.map(|i| i + 1);
        let [uv_a, uv_b, uv_c] = uv.map(|i| i + 1);
        let _ = writeln!(text, "f {a}/{uv_a} {b}/{uv_b} {c}/{uv_c}");
    }
    text
}

/// Writes `<stem>.obj`, `<stem>.mtl` and `<stem>.png` into `dir`; they refer to each other by file name.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_textured_obj(
    mesh: &Mesh,
    texture: &MeshTexture,
    dir: &Path,
    stem: &str,
) -> Result<(), CoreError> {
    write_png_color(&dir.join(format!("{stem}.png")), &texture.image)?;
    let library = format!("{stem}.mtl");
    let material = format!("newmtl {stem}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {stem}.png\n");
    atomic::write_bytes(&dir.join(&library), material.as_bytes())?;
    let text = textured_obj(mesh, texture, &library, stem);
    atomic::write_bytes(&dir.join(format!("{stem}.obj")), text.as_bytes())
}

/// Reads the texture coordinates of `<stem>.obj` and the image `<stem>.png` in `dir` that [`write_textured_obj`] wrote;
/// `None` without an image.
///
/// # Errors
/// [`CoreError::Read`] for files that cannot be read, [`CoreError::Input`] naming the line that is wrong.
pub fn read_mesh_texture(dir: &Path, stem: &str) -> Result<Option<MeshTexture>, CoreError> {
    let image_path = dir.join(format!("{stem}.png"));
    if !image_path.exists() {
        return Ok(None);
    }
    let path = dir.join(format!("{stem}.obj"));
    let text = std::fs::read_to_string(&path).map_err(CoreError::read(&path))?;
    let (mut coordinates, mut corner_uv): (Vec<[f32; 2]>, Vec<[[f32; 2]; 3]>) = (Vec::new(), Vec::new());
    for (number, line) in text.lines().enumerate() {
        let bad = || {
            let what = format!("the texture coordinates in line {} of this OBJ are invalid", number + 1);
            InputError::new(what, &path, "run `sms materialize` again")
        };
        let mut words = line.split_whitespace();
        match words.next() {
            Some("vt") => {
                let mut number =
                    || words.next().and_then(|w| w.parse::<f32>().ok()).filter(|v| v.is_finite());
                let (Some(u), Some(v)) = (number(), number()) else { return Err(bad().into()) };
                coordinates.push([u, v]);
            }
            Some("f") => {
                let mut corners = [[0.0; 2]; 3];
                for corner in &mut corners {
                    let index = words.next().and_then(|w| w.split('/').nth(1)?.parse::<usize>().ok());
                    let uv = index.and_then(|i| coordinates.get(i.checked_sub(1)?));
                    *corner = *uv.ok_or_else(bad)?;
                }
                corner_uv.push(corners);
            }
            _ => {}
        }
    }
    Ok(Some(MeshTexture { corner_uv, image: read_png_color(&image_path)? }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;
    use glamx::DVec3;

    #[test]
    fn a_textured_mesh_round_trips() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = Mesh::cuboid(DVec3::new(0.1, 0.2, 0.3));
        let corner_uv = (0..12).map(|t| [[t as f32 / 16.0, 0.0], [1.0, 0.5], [0.25, 1.0]]).collect();
        let image = Image::from_vec(2, 1, vec![[1, 2, 3], [250, 0, 9]]);
        let texture = MeshTexture { corner_uv, image };
        write_textured_obj(&mesh, &texture, dir.path(), "box").unwrap();
        assert_eq!(read_mesh_texture(dir.path(), "box").unwrap(), Some(texture));
        let back = Mesh::read_obj(&dir.path().join("box.obj")).unwrap();
        assert_eq!(back.triangles, mesh.triangles, "a reader without textures sees the same mesh");
        let text = std::fs::read_to_string(dir.path().join("box.obj")).unwrap();
        assert_eq!(text.lines().filter(|l| l.starts_with("vt")).count(), 14, "equal coordinates are shared");
        std::fs::write(dir.path().join("box.obj"), text.replacen("1/", "1/99", 1)).unwrap();
        assert!(matches!(read_mesh_texture(dir.path(), "box"), Err(CoreError::Input(_))));
        assert_eq!(read_mesh_texture(dir.path(), "other").unwrap(), None);
    }
}
