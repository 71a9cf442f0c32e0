//! Meshes as Wavefront OBJ, with vertex colours as the common `v x y z r g b` extension.

use crate::{CoreError, InputError, Mesh, atomic};
use glamx::DVec3;
use std::path::Path;

impl Mesh {
    /// Writes OBJ atomically: metres, 1-based indices, vertex colours in [0, 1] if present.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_obj(&self, path: &Path) -> Result<(), CoreError> {
        use std::fmt::Write;
        let mut text = String::with_capacity(self.vertices.len() * 40 + self.triangles.len() * 20);
        for (i, v) in self.vertices.iter().enumerate() {
            let _ = write!(text, "v {:.9} {:.9} {:.9}", v.x, v.y, v.z);
            if let Some(c) = self.colors.get(i) {
                let [r, g, b] = c.map(|c| f64::from(c) / 255.0);
                let _ = write!(text, " {r:.4} {g:.4} {b:.4}");
            }
            text.push('\n');
        }
        for [a, b, c] in &self.triangles {
            let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
        }
        atomic::write_bytes(path, text.as_bytes())
    }

    /// Reads vertices, vertex colours and faces of an OBJ file. Polygons are fanned; texture and normal indices and materials
    /// are ignored.
    ///
    /// # Errors
    /// [`CoreError::Read`] when the file cannot be read, [`CoreError::Input`] naming the line that is wrong.
    pub fn read_obj(path: &Path) -> Result<Self, CoreError> {
        let text = std::fs::read_to_string(path).map_err(CoreError::read(path))?;
        let mut mesh = Self::default();
        for (number, line) in text.lines().enumerate() {
            let bad = || {
                let what = format!("line {} of this OBJ is invalid", number + 1);
                InputError::new(what, path, "export the mesh again")
            };
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let v: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>().map_err(|_| bad())?;
                    if v.len() < 3 || v.iter().any(|x| !x.is_finite()) {
                        return Err(bad().into());
                    }
                    mesh.vertices.push(DVec3::new(v[0], v[1], v[2]));
                    if v.len() >= 6 {
                        mesh.colors
                            .push([v[3], v[4], v[5]].map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8));
                    }
                }
                Some("f") => {
                    let mut corners = Vec::with_capacity(4);
                    for word in words {
                        let index: i64 = word.split('/').next().unwrap_or("").parse().map_err(|_| bad())?;
                        let n = mesh.vertices.len() as i64;
                        let index = if index < 0 { n + index } else { index - 1 };
                        if !(0..n).contains(&index) {
                            return Err(bad().into());
                        }
                        corners.push(index as u32);
                    }
                    if corners.len() < 3 {
                        return Err(bad().into());
                    }
                    for i in 1..corners.len() - 1 {
                        mesh.triangles.push([corners[0], corners[i], corners[i + 1]]);
                    }
                }
                _ => {}
            }
        }
        if mesh.colors.len() != mesh.vertices.len() {
            mesh.colors.clear();
        }
        Ok(mesh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn obj_round_trips() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.obj");
        let mut mesh = Mesh::icosphere(0.0291, 1);
        mesh.colors = (0..mesh.vertices.len()).map(|i| [i as u8, 7, 255]).collect();
        mesh.write_obj(&path).unwrap();
        let back = Mesh::read_obj(&path).unwrap();
        assert_eq!(back.triangles, mesh.triangles);
        assert_eq!(back.colors, mesh.colors);
        assert!(back.vertices.iter().zip(&mesh.vertices).all(|(a, b)| (*a - *b).length() < 1e-9));
    }
}
