//! Wavefront OBJ: the whole scene in the world frame, each body's meshes in its own, and their convex parts.

use crate::surface::drawn;
use sms_core::{CoreError, atomic};
use sms_scene::{Scene, visual_file, write_meshes};
use std::fmt::Write;
use std::path::Path;

/// Writes `scene.obj`, `scene.mtl` and `meshes/`.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    write_meshes(scene, dir)?;
    let mut library = String::from("# Written by sms.\n");
    let mut text = String::from("# Written by sms. Metres; world z up.\nmtllib scene.mtl\n");
    let (mut first_vertex, mut first_uv) = (1, 1);
    for body in &scene.bodies {
        let mesh = drawn(body);
        if mesh.triangles.is_empty() {
            continue;
        }
        let name = &body.name;
        let _ = writeln!(library, "newmtl {name}\nKs 0 0 0\nd 1\nillum 1");
        if body.texture.is_some() {
            let _ = writeln!(library, "Kd 1 1 1\nmap_Kd {}", visual_file(body).replace(".obj", ".png"));
        } else {
            let [r, g, b] = body.color.map(|c| f64::from(c) / 255.0);
            let _ = writeln!(library, "Kd {r:.4} {g:.4} {b:.4}");
        }
        let _ = writeln!(text, "o {name}\nusemtl {name}");
        for (i, &p) in mesh.vertices.iter().enumerate() {
            let p = body.x_wb.transform_point(p);
            let _ = write!(text, "v {:.9} {:.9} {:.9}", p.x, p.y, p.z);
            if let Some(c) = mesh.colors.get(i).filter(|_| body.texture.is_none()) {
                let [r, g, b] = c.map(|c| f64::from(c) / 255.0);
                let _ = write!(text, " {r:.4} {g:.4} {b:.4}");
            }
            text.push('\n');
        }
        let uv = body.texture.as_ref().map(|t| t.corner_uv.as_slice()).unwrap_or_default();
        for [u, v] in uv.as_flattened() {
            let _ = writeln!(text, "vt {u:.6} {v:.6}");
        }
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|i| i as usize + first_vertex);
            if uv.is_empty() {
                let _ = writeln!(text, "f {a} {b} {c}");
            } else {
                let k = first_uv + 3 * t;
                let _ = writeln!(text, "f {a}/{k} {b}/{} {c}/{}", k + 1, k + 2);
            }
        }
        first_vertex += mesh.vertices.len();
        first_uv += 3 * uv.len();
    }
    atomic::write_bytes(&dir.join("scene.mtl"), library.as_bytes())?;
    atomic::write_bytes(&dir.join("scene.obj"), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;
    use sms_core::Mesh;

    #[test]
    fn the_scene_reads_back_in_the_world_frame() {
        let dir = tempfile::tempdir().unwrap();
        let scene = scene();
        write(dir.path(), &scene).unwrap();
        let all = Mesh::read_obj(&dir.path().join("scene.obj")).unwrap();
        let expected: Vec<Mesh> = scene.bodies.iter().map(|b| drawn(b).transformed(&b.x_wb)).collect();
        assert_eq!(all.triangles.len(), expected.iter().map(|m| m.triangles.len()).sum::<usize>());
        let volume: f64 = expected.iter().map(Mesh::volume).sum();
        assert!((all.volume() - volume).abs() < 1e-9);
        assert_eq!(all.vertices.len(), expected.iter().map(|m| m.vertices.len()).sum::<usize>());
        let library = std::fs::read_to_string(dir.path().join("scene.mtl")).unwrap();
        assert!(library.contains("map_Kd meshes/wedge.1-a_visual.png"));
        assert!(dir.path().join("meshes/wedge.1-a_visual.png").is_file());
    }
}
