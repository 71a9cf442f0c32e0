//! Vertices of mesh files; faces are not read because only the hull is used.

use glamx::DVec3;
use sms_core::{CoreError, InputError, Mesh};
use std::path::Path;

/// Vertices of a mesh file.
pub(super) fn read_points(path: &Path) -> Result<Vec<DVec3>, InputError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let points = match extension.as_str() {
        "stl" => {
            let bytes = std::fs::read(path).map_err(|e| unreadable(path, e))?;
            stl_points(&bytes).ok_or_else(|| {
                InputError::new(
                    "this STL file is cut off or damaged",
                    path,
                    "export the mesh again, as binary or ASCII STL",
                )
            })?
        }
        "obj" => match Mesh::read_obj(path) {
            Ok(mesh) => mesh.vertices,
            Err(CoreError::Input(e)) => return Err(e),
            Err(e) => return Err(unreadable(path, e)),
        },
        _ => {
            return Err(InputError::new(
                format!("collision meshes of type `.{extension}` are not supported"),
                path,
                "convert it to STL or OBJ and name that file in the URDF",
            ));
        }
    };
    if points.iter().any(|p| !p.is_finite()) {
        return Err(InputError::new("this mesh has a non-finite vertex", path, "export the mesh again"));
    }
    Ok(points)
}

fn unreadable(path: &Path, why: impl std::fmt::Display) -> InputError {
    InputError::new("this mesh file cannot be read", path, "check the file and its permissions").because(why)
}

fn stl_points(bytes: &[u8]) -> Option<Vec<DVec3>> {
    // An ASCII file begins with `solid`, but so do some binary ones: the length decides.
    let binary = bytes.get(80..84).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if binary.is_some_and(|count| bytes.len() == 84 + 50 * count) {
        let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let corner = |b: &[u8]| DVec3::new(float(b), float(&b[4..]), float(&b[8..]));
        let facets = bytes[84..].chunks_exact(50);
        return Some(facets.flat_map(|facet| facet[12..48].chunks_exact(12).map(corner)).collect());
    }
    let text = std::str::from_utf8(bytes).ok().filter(|t| t.trim_start().starts_with("solid"))?;
    if !text.contains("endsolid") {
        return None;
    }
    let mut points = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(rest) = line.strip_prefix("vertex") {
            let v: Vec<f64> = rest.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
            points.push(DVec3::from_array(<[f64; 3]>::try_from(v).ok()?));
        }
    }
    Some(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(mesh: &Mesh) -> Vec<u8> {
        let mut bytes = vec![0u8; 80];
        bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
        for t in 0..mesh.triangles.len() {
            bytes.extend([0u8; 12]);
            for p in mesh.corners(t) {
                p.to_array().iter().for_each(|&x| bytes.extend((x as f32).to_le_bytes()));
            }
            bytes.extend([0u8; 2]);
        }
        bytes
    }

    #[test]
    fn both_kinds_of_stl_are_read_and_damage_is_noticed() {
        let mesh = Mesh::cuboid(DVec3::new(0.5, 0.25, 0.125));
        let bytes = binary(&mesh);
        let points = stl_points(&bytes).unwrap();
        assert_eq!(points.len(), 36);
        assert_eq!(points[4], mesh.corners(1)[1]);
        assert!(stl_points(&bytes[..bytes.len() - 3]).is_none());
        assert!(stl_points(b"").is_none());
        let ascii = "solid a\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 0 1e0 0\n endloop\n endfacet\nendsolid a\n";
        assert_eq!(stl_points(ascii.as_bytes()).unwrap()[2], DVec3::Y);
        assert!(stl_points(ascii.replace("endsolid", "").as_bytes()).is_none());
        assert!(stl_points(ascii.replace("1e0", "x").as_bytes()).is_none());
    }
}
