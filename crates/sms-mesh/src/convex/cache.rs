//! Decompositions cached on disk.

use crate::convex::config::ConvexConfig;
use crate::convex::parts::convex_parts;
use serde::{Deserialize, Serialize};
use sms_core::{Hash, Hasher, Mesh, atomic, hash_serializable};
use std::path::Path;

/// Version of the algorithm: decompositions of other versions are not used.
const VERSION: u32 = 2;

#[derive(Serialize, Deserialize)]
struct Stored {
    /// Hash of `parts`: detects a damaged file that is still valid JSON.
    check: Hash,
    parts: Vec<Mesh>,
}

fn key(mesh: &Mesh, config: &ConvexConfig) -> Hash {
    let mut hasher = Hasher::new();
    hasher.text("convex parts").bytes(&VERSION.to_le_bytes()).text(&hash_serializable(config).0);
    let points: Vec<u8> =
        mesh.vertices.iter().flat_map(|v| v.to_array()).flat_map(|x| x.to_bits().to_le_bytes()).collect();
    let triangles: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    hasher.bytes(&points).bytes(&triangles).finish()
}

/// Returns [`convex_parts`], or the result cached in the folder `cache` for the same mesh and settings. The folder is
/// created if missing. A damaged or foreign file is replaced by a new result, and failure to write the cache is
/// ignored.
pub fn convex_parts_cached(mesh: &Mesh, config: &ConvexConfig, cache: Option<&Path>) -> Vec<Mesh> {
    let Some(cache) = cache else { return convex_parts(mesh, config) };
    let path = cache.join(format!("{}.json", key(mesh, config).0));
    if let Ok(stored) = atomic::read_json::<Stored>(&path)
        && hash_serializable(&stored.parts) == stored.check
    {
        return stored.parts;
    }
    let parts = convex_parts(mesh, config);
    let stored = Stored { check: hash_serializable(&parts), parts };
    // Best effort: without the file the same parts are computed again.
    let _ = atomic::write_json(&path, &stored);
    stored.parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;

    #[test]
    fn hits_are_equal_and_damage_is_mended() {
        let dir = tempfile::tempdir().unwrap();
        let cache = dir.path().join("parts");
        let mesh = Mesh::icosphere(0.0371, 2);
        let config = ConvexConfig::default();
        let first = convex_parts_cached(&mesh, &config, Some(&cache));
        let file = std::fs::read_dir(&cache).unwrap().next().unwrap().unwrap().path();
        let text = std::fs::read_to_string(&file).unwrap();
        assert_eq!(convex_parts_cached(&mesh, &config, Some(&cache)), first);
        // A file with changed parts is used only if its hash agrees.
        let box_parts = vec![Mesh::cuboid(DVec3::ONE)];
        atomic::write_json(&file, &Stored { check: hash_serializable(&box_parts), parts: box_parts.clone() })
            .unwrap();
        assert_eq!(convex_parts_cached(&mesh, &config, Some(&cache)), box_parts);
        for damaged in ["", "{", &text.replacen("0.0", "0.1", 1), &text[..text.len() / 2]] {
            std::fs::write(&file, damaged).unwrap();
            assert_eq!(convex_parts_cached(&mesh, &config, Some(&cache)), first);
            assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
        }
        // Another mesh or setting has a separate file.
        convex_parts_cached(&mesh, &ConvexConfig { max_vertices: 32, ..config }, Some(&cache));
        convex_parts_cached(&Mesh::icosphere(0.0372, 2), &ConvexConfig::default(), Some(&cache));
        assert_eq!(std::fs::read_dir(&cache).unwrap().count(), 3);
        assert_eq!(convex_parts_cached(&mesh, &ConvexConfig::default(), None), first);
    }
}
