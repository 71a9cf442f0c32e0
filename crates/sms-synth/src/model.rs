//! Scanned models: a mesh from files, standing on a floor.

use crate::scene::{Hollow, TruthObject, TruthScene};
use crate::skin::Skin;
use crate::texture::{Pattern, Texture};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::{
    Aabb, ColorImage, CoreError, InputError, MassProperties, Material, Mesh, MeshTexture, StageRng,
    box_mass_properties, polyhedron_mass_properties, read_color,
};
use std::collections::BTreeMap;
use std::path::Path;

/// A scanned model: metres, z up.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannedModel {
    /// The surface with equal vertices merged and degenerate triangles removed.
    pub mesh: Mesh,
    /// Its image texture, if the material names one.
    pub texture: Option<MeshTexture>,
    /// The material's diffuse colour, sRGB.
    pub color: [u8; 3],
}

/// Reads a Wavefront OBJ with one material: positions, texture coordinates, polygons (fanned), and the material library's
/// diffuse colour and image (JPEG or PNG).
///
/// # Errors
/// [`CoreError::Read`] when a file cannot be read, [`CoreError::Input`] naming the invalid line.
pub fn read_model(path: &Path) -> Result<ScannedModel, CoreError> {
    let text = std::fs::read_to_string(path).map_err(CoreError::read(path))?;
    let mut obj = Obj::default();
    for (number, line) in text.lines().enumerate() {
        obj.line(line).ok_or_else(|| {
            let what = format!("line {} of this OBJ is invalid", number + 1);
            InputError::new(what, path, "export the mesh again, as triangles or convex polygons")
        })?;
    }
    if obj.mesh.triangles.is_empty() {
        return Err(InputError::new("this OBJ has no faces", path, "export the mesh again").into());
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut look = ObjMaterial { color: [204; 3], image: None };
    if let Some(library) = &obj.library {
        look = read_library(&folder.join(library))?;
    }
    let texture = match look.image {
        Some(image) if obj.corner_uv.iter().all(|uv| uv[0][0].is_finite()) => {
            Some(MeshTexture { corner_uv: obj.corner_uv, image })
        }
        _ => None,
    };
    Ok(ScannedModel { mesh: obj.mesh, texture, color: look.color })
}

#[derive(Default)]
struct Obj {
    mesh: Mesh,
    /// NaN for corners without texture coordinates.
    corner_uv: Vec<[[f32; 2]; 3]>,
    library: Option<String>,
    /// The merged vertex of each vertex of the file.
    joined: Vec<u32>,
    index_of: BTreeMap<[u64; 3], u32>,
    uv: Vec<[f32; 2]>,
}

impl Obj {
    fn line(&mut self, line: &str) -> Option<()> {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || words.next()?.parse::<f64>().ok().filter(|v| v.is_finite());
                let p = DVec3::new(next()?, next()?, next()?);
                // + 0.0 turns −0.0 into 0.0.
                let key = (p + DVec3::ZERO).to_array().map(f64::to_bits);
                let vertices = &mut self.mesh.vertices;
                let index = *self.index_of.entry(key).or_insert_with(|| {
                    vertices.push(p);
                    vertices.len() as u32 - 1
                });
                self.joined.push(index);
            }
            Some("vt") => {
                let mut next = || words.next()?.parse::<f32>().ok().filter(|v| v.is_finite());
                self.uv.push([next()?, next()?]);
            }
            Some("mtllib") => self.library = Some(line.trim_start()["mtllib".len()..].trim().to_owned()),
            Some("f") => {
                let corners: Vec<(u32, [f32; 2])> =
                    words.map(|word| self.corner(word)).collect::<Option<_>>()?;
                if corners.len() < 3 {
                    return None;
                }
                for k in 1..corners.len() - 1 {
                    let [a, b, c] = [corners[0], corners[k], corners[k + 1]];
                    if a.0 != b.0 && b.0 != c.0 && c.0 != a.0 {
                        self.mesh.triangles.push([a.0, b.0, c.0]);
                        self.corner_uv.push([a.1, b.1, c.1]);
                    }
                }
            }
            _ => {}
        }
        Some(())
    }

    /// Parses `7`, `7/3`, `7/3/1` or `7//1`, counted from 1, or from the end if negative.
    fn corner(&self, word: &str) -> Option<(u32, [f32; 2])> {
        let resolve = |text: &str, count: usize| {
            let index: i64 = text.parse().ok()?;
            let index = if index < 0 { count as i64 + index } else { index - 1 };
            usize::try_from(index).ok().filter(|&i| i < count)
        };
        let mut fields = word.split('/');
        let vertex = self.joined[resolve(fields.next()?, self.joined.len())?];
        let uv = match fields.next().filter(|f| !f.is_empty()) {
            Some(text) => self.uv[resolve(text, self.uv.len())?],
            None => [f32::NAN; 2],
        };
        Some((vertex, uv))
    }
}

struct ObjMaterial {
    color: [u8; 3],
    image: Option<ColorImage>,
}

fn read_library(path: &Path) -> Result<ObjMaterial, CoreError> {
    let text = std::fs::read_to_string(path).map_err(CoreError::read(path))?;
    let mut look = ObjMaterial { color: [204; 3], image: None };
    for line in text.lines() {
        let line = line.trim();
        if let Some(rest) = line.strip_prefix("Kd ") {
            let values: Vec<f64> = rest.split_whitespace().filter_map(|w| w.parse().ok()).collect();
            if let [r, g, b] = values[..] {
                look.color = [r, g, b].map(|c| (c * 255.0).round().clamp(0.0, 255.0) as u8);
            }
        } else if let Some(name) = line.strip_prefix("map_Kd ") {
            look.image = Some(read_color(&path.with_file_name(name.trim()))?);
        }
    }
    Ok(look)
}

/// A scene with the image textures of its objects (parallel to `scene.objects`).
#[derive(Debug, Clone)]
pub struct ModelScene {
    /// The scene.
    pub scene: TruthScene,
    /// For [`crate::Renderer::with_skins`].
    pub skins: Vec<Option<Skin>>,
}

/// Places a model on the floor, turned, its middle above the origin, with its image texture. Its mass is that of the enclosed
/// volume (of a box around it if it encloses none) at this effective density, kg/m³.
pub fn standing(
    name: &str,
    model: &ScannedModel,
    turn: DQuat,
    material: Material,
    density: f64,
    rng: &mut StageRng,
) -> (TruthObject, Option<Skin>) {
    let turned = model.mesh.transformed(&DPose3::from_parts(DVec3::ZERO, turn));
    let bounds = turned.aabb().unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
    // Translation from the turned model's frame to W.
    let lift = -bounds.center().with_z(bounds.min.z);
    let mass = mass_of(&turned, &bounds, density);
    let com = mass.com();
    let texture = Texture::drawn(rng, Pattern::Plain, (model.color, model.color), 0.02, 0.3);
    let mesh = turned.transformed(&DPose3::from_translation(-com));
    let skin = model.texture.as_ref().and_then(|t| Skin::new(&mesh, t));
    let x_wb = DPose3::from_translation(lift + com);
    let object = TruthObject {
        name: name.to_owned(),
        class: name.replace('_', " "),
        material,
        sphere_radius: None,
        mesh,
        parts: Vec::new(),
        x_wb,
        texture,
        x_ab: x_wb,
        hollow: Hollow::Solid,
        mass: MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap_or(mass),
    };
    (object, skin)
}

fn mass_of(mesh: &Mesh, bounds: &Aabb, density: f64) -> MassProperties {
    polyhedron_mass_properties(mesh, density)
        .or_else(|_| {
            let solid = box_mass_properties((0.5 * bounds.extents()).max(DVec3::splat(1e-3)), density)?;
            MassProperties::new(solid.mass(), bounds.center(), solid.inertia())
        })
        .expect("a box of positive size has mass")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floor::draw_floor;
    use crate::materials::draw_material;
    use crate::{CameraModel, Renderer};
    use sms_core::{Camera, Intrinsics, Seed};

    fn write(dir: &Path, name: &str, text: &str) {
        std::fs::write(dir.join(name), text).unwrap();
    }

    #[test]
    fn an_obj_with_a_picture_is_joined_and_rendered_with_it() {
        let dir = tempfile::tempdir().unwrap();
        // A cube of 0.1 m with separate corners for every face. The top shows the upper left quarter of the image, the other
        // faces the whole image.
        let mut text = String::from("mtllib cube.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n");
        text += "vt 0 0.5\nvt 0.5 0.5\nvt 0.5 1\nvt 0 1\n";
        let cube = Mesh::cuboid(DVec3::splat(0.05));
        let mut count = 0;
        for quad in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            for v in quad.map(|i: usize| cube.vertices[i]) {
                text += &format!("v {:.3} {:.3} {:.3}\n", v.x, v.y, v.z + 0.3);
            }
            let uv = if quad == [4, 5, 7, 6] { 4 } else { 0 };
            let corner = |k: usize| format!("{}/{}", count + k, uv + k);
            text += &format!("f {} {} {} {}\n", corner(1), corner(2), corner(3), corner(4));
            count += 4;
        }
        write(dir.path(), "cube.obj", &text);
        write(dir.path(), "cube.mtl", "newmtl a\nKd 0.5 0.5 1\nmap_Kd p.png\n");
        let pixel = |i: usize| if i % 8 < 4 && i / 8 < 4 { [230, 20, 20] } else { [20, 20, 230] };
        let picture = ColorImage::from_vec(8, 8, (0..64).map(pixel).collect());
        sms_core::write_png_color(&dir.path().join("p.png"), &picture).unwrap();

        let model = read_model(&dir.path().join("cube.obj")).unwrap();
        assert_eq!((model.mesh.vertices.len(), model.mesh.triangles.len()), (8, 12));
        assert!(model.mesh.is_closed_oriented() && (model.mesh.volume() - 1e-3).abs() < 1e-12);
        assert_eq!(model.color, [128, 128, 255]);

        let mut rng = Seed(1).rng();
        let material = draw_material("wood", &mut rng);
        let (object, skin) = standing("cube", &model, DQuat::from_rotation_z(0.3), material, 600.0, &mut rng);
        let bounds = object.aabb_w();
        assert!(bounds.min.z.abs() < 1e-12 && bounds.center().truncate().length() < 1e-12);
        assert!((object.mass.com()).length() < 1e-12);
        let (scene, skins) = (
            TruthScene::of_objects("cube".into(), Seed(1), vec![object], draw_floor(Seed(1), Seed(1))),
            [skin],
        );
        let eye = bounds.center() + DVec3::new(0.06, 0.07, 0.23);
        let camera = Camera::look_at(Intrinsics::from_fov(160, 100, 1.2), eye, bounds.center(), DVec3::Z);
        let sensor = CameraModel::perfect();
        let frame = Renderer::with_skins(&scene, &skins).render(&camera, &sensor);
        // Seen from above: on the top the picture is red, on the sides mostly blue.
        let mut red = [0usize; 2];
        for (at, (color, label)) in frame.color.data.iter().zip(&frame.label.data).enumerate() {
            if *label == 1 {
                let p = camera.unproject_pixel(at % 160, at / 160, f64::from(frame.depth.data[at]));
                let top = p.z > 0.0999;
                let is_red = color[0] > color[2];
                if top && p.xy_inside(&bounds, 0.004) {
                    assert!(is_red, "{p} {color:?}");
                    red[0] += 1;
                }
                red[1] += usize::from(!top && !is_red);
            }
        }
        assert!(red[0] > 500 && red[1] > 50, "{red:?}");
    }

    trait Inside {
        fn xy_inside(&self, bounds: &Aabb, margin: f64) -> bool;
    }

    impl Inside for DVec3 {
        /// Whether a point of the cube's turned top is so far from its edges.
        fn xy_inside(&self, bounds: &Aabb, margin: f64) -> bool {
            (*self - bounds.center()).truncate().length() < 0.05 - margin
        }
    }

    #[test]
    fn damaged_files_are_refused_with_their_line() {
        let dir = tempfile::tempdir().unwrap();
        for (text, word) in
            [("v 0 0\n", "line 1"), ("v 0 0 0\nf 1 2 3\n", "line 2"), ("v 0 0 0\n", "no faces")]
        {
            write(dir.path(), "a.obj", text);
            let error = read_model(&dir.path().join("a.obj")).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        write(dir.path(), "a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        write(dir.path(), "a.mtl", "map_Kd a.png\n");
        write(dir.path(), "a.png", "no picture");
        assert!(read_model(&dir.path().join("a.obj")).is_err());
    }
}
