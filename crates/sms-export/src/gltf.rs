//! glTF 2.0 binary: the whole scene, and each object on its own.
//!
//! glTF has y up: a root node turns our z up to it; below it every number is as in `bodies.json`.

use crate::surface::{SplitMesh, drawn, split};
use crate::text::linear;
use glamx::DPose3;
use serde_json::{Map, Value, json};
use sms_core::{CoreError, Property, atomic, write_png_color};
use sms_scene::{Body, BodyKind, Scene};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// Writes `scene.glb` and `objects/<name>.glb`.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    let mut whole = GlbBuilder::new(dir);
    for body in &scene.bodies {
        whole.body(body, &body.x_wb)?;
        let mut alone = GlbBuilder::new(dir);
        alone.body(body, &DPose3::identity())?;
        let file = dir.join("objects").join(format!("{}.glb", body.name));
        atomic::write_bytes(&file, &alone.finish(&body.name, None))?;
    }
    let extras = json!({ "gravity_m_s2_in_z_up_frame": scene.gravity_w.to_array() });
    atomic::write_bytes(&dir.join("scene.glb"), &whole.finish(&scene.name, Some(extras)))
}

struct GlbBuilder<'a> {
    /// Folder for encoding images before they are added to the binary part.
    dir: &'a Path,
    binary: Vec<u8>,
    /// The arrays of the file by name.
    arrays: BTreeMap<&'static str, Vec<Value>>,
}

impl<'a> GlbBuilder<'a> {
    fn new(dir: &'a Path) -> Self {
        Self { dir, binary: Vec::new(), arrays: BTreeMap::new() }
    }

    /// Appends to an array of the file; returns the index of the value.
    fn push(&mut self, array: &'static str, value: Value) -> usize {
        let values = self.arrays.entry(array).or_default();
        values.push(value);
        values.len() - 1
    }

    /// Appends bytes at a four-byte boundary; returns the index of their buffer view.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.binary.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    /// Returns the accessor of vertex attributes.
    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> Value {
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes, Some(VERTICES));
        accessor(view, FLOAT, if N == 2 { "VEC2" } else { "VEC3" }, values.len())
    }

    fn primitive(&mut self, surface: &SplitMesh, material: usize) -> Value {
        let mut positions = self.floats(&surface.positions);
        let bound = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f64> {
            let fold = |k: usize| surface.positions.iter().map(|p| p[k]).fold(start, pick);
            (0..3).map(|k| f64::from(fold(k))).collect()
        };
        positions["min"] = json!(bound(f32::min, f32::INFINITY));
        positions["max"] = json!(bound(f32::max, f32::NEG_INFINITY));
        let mut accessors = vec![("POSITION", positions), ("NORMAL", self.floats(&surface.normals))];
        if !surface.uv.is_empty() {
            let down: Vec<[f32; 2]> = surface.uv.iter().map(|[u, v]| [*u, 1.0 - v]).collect();
            accessors.push(("TEXCOORD_0", self.floats(&down)));
        }
        if !surface.colors.is_empty() {
            // Linear light in 8 bits would show steps in dark colours.
            let short = |byte: u8| ((65535.0 * linear(byte)).round() as u16).to_le_bytes();
            let bytes: Vec<u8> = surface
                .colors
                .iter()
                .flat_map(|&[r, g, b]| [short(r), short(g), short(b), u16::MAX.to_le_bytes()])
                .flatten()
                .collect();
            let view = self.view(&bytes, Some(VERTICES));
            let mut colors = accessor(view, UNSIGNED_SHORT, "VEC4", surface.colors.len());
            colors["normalized"] = true.into();
            accessors.push(("COLOR_0", colors));
        }
        let bytes: Vec<u8> = surface.indices.iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&bytes, Some(INDICES));
        let index =
            |(name, accessor): (&str, Value)| (name.to_owned(), self.push("accessors", accessor).into());
        let attributes: Map<String, Value> = accessors.into_iter().map(index).collect();
        let indices = accessor(view, UNSIGNED_INT, "SCALAR", surface.indices.len());
        let indices = self.push("accessors", indices);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    fn material(&mut self, body: &Body, colored: bool) -> Result<usize, CoreError> {
        let mut look = json!({ "metallicFactor": 0.0, "roughnessFactor": 0.8 });
        if let Some(texture) = &body.texture {
            let file = self.dir.join("picture.png");
            write_png_color(&file, &texture.image)?;
            let bytes = fs::read(&file).map_err(CoreError::read(&file))?;
            fs::remove_file(&file).map_err(CoreError::write(&file))?;
            let view = self.view(&bytes, None);
            let image = json!({ "bufferView": view, "mimeType": "image/png", "name": body.name });
            let texture = json!({ "sampler": 0, "source": self.push("images", image) });
            look["baseColorTexture"] = json!({ "index": self.push("textures", texture) });
        } else if !colored {
            let [r, g, b] = body.color.map(linear);
            look["baseColorFactor"] = json!([r, g, b, 1.0]);
        }
        // Static surfaces are open, so their back is visible.
        let open = body.kind == BodyKind::Static;
        let material = json!({ "name": body.name, "pbrMetallicRoughness": look, "doubleSided": open });
        Ok(self.push("materials", material))
    }

    fn body(&mut self, body: &Body, pose: &DPose3) -> Result<(), CoreError> {
        let q = pose.rotation;
        let mut node = json!({
            "name": body.name,
            "translation": pose.translation.to_array(),
            "rotation": [q.x, q.y, q.z, q.w],
            "extras": extras(body),
        });
        let surface = split(&drawn(body), body.texture.as_ref());
        if !surface.indices.is_empty() {
            let material = self.material(body, !surface.colors.is_empty())?;
            let primitive = self.primitive(&surface, material);
            let mesh = json!({ "name": body.name, "primitives": [primitive] });
            node["mesh"] = self.push("meshes", mesh).into();
        }
        self.push("nodes", node);
        Ok(())
    }

    /// Returns the file: header, JSON chunk, binary chunk.
    fn finish(mut self, name: &str, extras: Option<Value>) -> Vec<u8> {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let children: Vec<usize> = (0..self.arrays.get("nodes").map_or(0, Vec::len)).collect();
        let mut root = json!({ "name": "z_up_to_y_up", "rotation": [-half, 0.0, 0.0, half] });
        if !children.is_empty() {
            root["children"] = json!(children);
        }
        let mut scene = json!({ "name": name, "nodes": [self.push("nodes", root)] });
        if let Some(extras) = extras {
            scene["extras"] = extras;
        }
        let mut file = json!({
            "asset": { "version": "2.0", "generator": "sms" },
            "scene": 0,
            "scenes": [scene],
            "nodes": self.arrays.remove("nodes"),
        });
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        if !self.binary.is_empty() {
            file["buffers"] = json!([{ "byteLength": self.binary.len() }]);
        }
        if self.arrays.contains_key("images") {
            // Linear with mipmaps; charts of a baked texture must not repeat at the border.
            file["samplers"] =
                json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }]);
        }
        // Empty arrays are not valid glTF.
        for key in ["bufferViews", "accessors", "meshes", "materials", "textures", "images"] {
            if let Some(values) = self.arrays.remove(key) {
                file[key] = values.into();
            }
        }
        let mut text = file.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut chunks = vec![(b"JSON", text)];
        if !self.binary.is_empty() {
            chunks.push((b"BIN\0", self.binary));
        }
        let length = 12 + chunks.iter().map(|c| 8 + c.1.len()).sum::<usize>();
        let mut out = Vec::with_capacity(length);
        out.extend_from_slice(b"glTF");
        out.extend_from_slice(&2u32.to_le_bytes());
        out.extend_from_slice(&(length as u32).to_le_bytes());
        for (kind, bytes) in chunks {
            out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
            out.extend_from_slice(kind);
            out.extend_from_slice(&bytes);
        }
        out
    }
}

fn accessor(view: usize, component: u32, kind: &str, count: usize) -> Value {
    json!({ "bufferView": view, "componentType": component, "count": count, "type": kind })
}

/// Returns the physics of a body for programs that read extras (Blender shows them as custom properties).
fn extras(body: &Body) -> Value {
    let m = &body.material;
    let property = |p: &Property| json!([p.value.best, p.value.low, p.value.high]);
    let mut out = json!({
        "kind": body.kind,
        "description": body.description,
        "material": m.class,
        "density_kg_m3": property(&m.density),
        "friction": property(&m.friction),
        "restitution": property(&m.restitution),
        "rolling_m": property(&m.rolling_m),
        "observed_share": body.observed_share,
    });
    if let Some(mass) = &body.mass {
        out["mass_kg"] = json!(mass.mass());
        out["inertia_kg_m2"] = json!(mass.inertia().to_cols_array());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    /// The JSON part and the binary part.
    fn parts(bytes: &[u8]) -> (Value, &[u8]) {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let json_length = word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let at = 20 + json_length;
        assert_eq!((&bytes[at + 4..at + 8], word(at)), (&b"BIN\0"[..], bytes.len() - at - 8));
        (serde_json::from_slice(&bytes[20..at]).unwrap(), &bytes[at + 8..])
    }

    #[test]
    fn the_scene_holds_its_bodies_where_they_are() {
        let dir = tempfile::tempdir().unwrap();
        let scene = scene();
        write(dir.path(), &scene).unwrap();
        let bytes = fs::read(dir.path().join("scene.glb")).unwrap();
        let (file, binary) = parts(&bytes);
        assert_eq!(file["nodes"].as_array().unwrap().len(), scene.bodies.len() + 1);
        assert_eq!(file["buffers"][0]["byteLength"], binary.len());
        assert_eq!(
            (file["images"].as_array().unwrap().len(), file["textures"].as_array().unwrap().len()),
            (1, 1)
        );
        for accessor in file["accessors"].as_array().unwrap() {
            let view = &file["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
            let size = match (accessor["type"].as_str(), accessor["componentType"].as_u64()) {
                (Some("VEC3"), Some(5126)) => 12,
                (Some("VEC2"), Some(5126)) => 8,
                (Some("VEC4"), Some(5123)) => 8,
                (Some("SCALAR"), Some(5125)) => 4,
                other => panic!("{other:?}"),
            };
            assert_eq!(view["byteLength"].as_u64().unwrap(), size * accessor["count"].as_u64().unwrap());
            assert_eq!(view["byteOffset"].as_u64().unwrap() % 4, 0);
        }
        let image = &file["bufferViews"][file["images"][0]["bufferView"].as_u64().unwrap() as usize];
        let at = image["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(&binary[at..at + 8], b"\x89PNG\r\n\x1a\n");
        let ball = file["nodes"].as_array().unwrap().iter().find(|n| n["name"] == "ball").unwrap();
        assert_eq!(ball["translation"], json!([-0.2, 0.1, 0.03]));
        assert_eq!(fs::read_dir(dir.path().join("objects")).unwrap().count(), scene.bodies.len());
        assert!(!dir.path().join("picture.png").exists());
    }
}
