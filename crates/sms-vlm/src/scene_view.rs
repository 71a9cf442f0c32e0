//! Questions about objects of a scanned scene, with the best view of each.

use crate::{Question, VlmConfig, annotated, best_view, jpeg, picture, score_view};
use sms_core::glamx::DVec3;
use sms_core::{BACKGROUND, Entity, EntityKind, Image, LabelInfo, LabelMap, Labels};
use sms_frames::{Frame, Sequence};
use sms_materials::ObjectQuery;

/// Greatest distance of the floor's background from the support plane, metres.
const FLOOR_BAND_M: f64 = 0.01;

/// Returns the question about one object with its best view, or `None` if it is hardly visible. Without an `entity`
/// it is about the floor, at `support_height` (metres, world).
pub fn question_about(
    query: &ObjectQuery,
    entity: Option<&Entity>,
    support_height: Option<f64>,
    sequence: &Sequence,
    labels: &Labels,
    config: &VlmConfig,
) -> Option<Question> {
    let mask_of = |frame: &Frame, map: &LabelMap| mask(frame, map, entity, support_height);
    Some(Question {
        name: query.name.clone(),
        annotation: query.description.clone(),
        is_surface: entity.is_none_or(|e| e.kind == EntityKind::Static),
        jpeg: best_picture(mask_of, sequence, labels, config)?,
    })
}

/// Returns the question about one object of the masks with its best view, or `None` if it is hardly visible.
pub fn question_about_label(
    object: &LabelInfo,
    sequence: &Sequence,
    labels: &Labels,
    config: &VlmConfig,
) -> Option<Question> {
    let mask_of = |_: &Frame, map: &LabelMap| map.map(|label| *label == object.id);
    Some(Question {
        name: object.name.clone(),
        annotation: object.description.clone(),
        is_surface: false,
        jpeg: best_picture(mask_of, sequence, labels, config)?,
    })
}

/// Returns the best view of a mask with its box, JPEG.
fn best_picture(
    mask_of: impl Fn(&Frame, &LabelMap) -> Image<bool>,
    sequence: &Sequence,
    labels: &Labels,
    config: &VlmConfig,
) -> Option<Vec<u8>> {
    let frames = || sequence.frames.iter().zip(&labels.maps);
    let views = frames().map(|(frame, map)| score_view(&mask_of(frame, map), Some(&frame.depth)));
    let (index, view) = best_view(views)?;
    let frame = &sequence.frames[index];
    let size = frame.color.size();
    let own = picture(&frame.color_path, size);
    let color = own.as_ref().unwrap_or(&frame.color);
    Some(jpeg(&annotated(color, view.bounds, size, config.context, config.max_image_side)))
}

/// Returns the object's mask in one frame: its label; for background, the floor is everything at the support's
/// height, and the environment everything above it within its mesh's box.
fn mask(frame: &Frame, map: &LabelMap, entity: Option<&Entity>, support_height: Option<f64>) -> Image<bool> {
    if let Some(entity) = entity.filter(|e| e.label != BACKGROUND) {
        return map.map(|label| *label == entity.label);
    }
    let floor = support_height.unwrap_or(f64::NEG_INFINITY);
    let within = entity.and_then(|e| e.mesh.aabb());
    let is_shown = |p_w: DVec3| match (entity, &within) {
        (None, _) => (p_w.z - floor).abs() < FLOOR_BAND_M,
        (Some(_), Some(b)) => {
            let room = DVec3::splat(FLOOR_BAND_M);
            p_w.z > floor + FLOOR_BAND_M && (b.min - room).cmple(p_w).all() && p_w.cmple(b.max + room).all()
        }
        (Some(_), None) => false,
    };
    let (width, height) = map.size();
    let mut out = Image::filled(width, height, false);
    for y in 0..height {
        for x in 0..width {
            let depth = frame.depth.get(x as i64, y as i64).copied().unwrap_or(0.0);
            if map[(x, y)] == BACKGROUND && depth > 0.0 {
                out[(x, y)] = is_shown(frame.camera.unproject_pixel(x, y, f64::from(depth)));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::glamx::DPose3;
    use sms_core::{Camera, EntityShape, Intrinsics, Mesh, PointCloud};

    fn entity(label: u16, kind: EntityKind, mesh: Mesh) -> Entity {
        Entity {
            label,
            name: format!("object_{label:02}"),
            description: String::new(),
            kind,
            shape: EntityShape::TriMesh,
            cloud: PointCloud::default(),
            mesh,
            texture: None,
            parts: Vec::new(),
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [0; 3],
        }
    }

    /// A camera one metre above the floor looks down at a wall's top (left), an object (middle) and the floor (right).
    fn view() -> (Frame, LabelMap) {
        let intrinsics = Intrinsics { width: 90, height: 60, fx: 90.0, fy: 90.0, cx: 45.0, cy: 30.0 };
        let camera = Camera::look_at(intrinsics, DVec3::new(0.0, 0.0, 1.0), DVec3::ZERO, DVec3::Y);
        let at = |x: usize| match x / 30 {
            0 => (0.8, BACKGROUND),
            1 => (0.9, 7),
            _ => (1.0, BACKGROUND),
        };
        let pixels = || (0..90 * 60).map(|i| at(i % 90));
        let frame = Frame::new(
            camera,
            Image::filled(90, 60, [90, 120, 150]),
            Image::from_vec(90, 60, pixels().map(|p| p.0 as f32).collect()),
            Image::filled(90, 60, [0.0; 3]),
        );
        (frame, Image::from_vec(90, 60, pixels().map(|p| p.1).collect()))
    }

    #[test]
    fn floor_environment_and_objects_are_told_apart() {
        let (frame, map) = view();
        // The camera's x is the world's x here: the wall is at negative x.
        let wall = Mesh::cuboid(DVec3::new(0.25, 0.4, 0.1)).transformed(&DPose3::translation(-0.3, 0.0, 0.1));
        let wall = entity(BACKGROUND, EntityKind::Static, wall);
        let object = entity(7, EntityKind::Dynamic, Mesh::default());
        for (entity, third) in [(Some(&wall), 0), (Some(&object), 1), (None, 2)] {
            let mask = mask(&frame, &map, entity, Some(0.0));
            for (i, is_shown) in mask.data.iter().enumerate() {
                assert_eq!(*is_shown, i % 90 / 30 == third, "pixel {i} of {third}");
            }
        }
        let elsewhere = Mesh::cuboid(DVec3::splat(0.1)).transformed(&DPose3::translation(3.0, 0.0, 0.1));
        let elsewhere = entity(BACKGROUND, EntityKind::Static, elsewhere);
        assert!(!mask(&frame, &map, Some(&elsewhere), Some(0.0)).data.contains(&true));
    }

    #[test]
    fn an_object_that_no_view_shows_is_not_asked_about() {
        let (frame, map) = view();
        let sequence =
            Sequence { frames: vec![frame], x_world_recording: DPose3::identity(), source: "nowhere".into() };
        let labels = Labels { maps: vec![map], objects: Vec::new(), source: sms_core::MaskSource::Truth };
        let ask_about = |entity: Option<&Entity>| {
            let query =
                ObjectQuery { name: "it".into(), description: "a thing".into(), ..Default::default() };
            question_about(&query, entity, Some(0.0), &sequence, &labels, &VlmConfig::default())
        };
        let seen = ask_about(Some(&entity(7, EntityKind::Dynamic, Mesh::default()))).unwrap();
        assert_eq!((seen.name.as_str(), seen.annotation.as_str(), seen.is_surface), ("it", "a thing", false));
        assert_eq!(seen.jpeg[..2], [0xFF, 0xD8]);
        assert!(ask_about(None).unwrap().is_surface, "the floor");
        assert_eq!(ask_about(Some(&entity(8, EntityKind::Dynamic, Mesh::default()))), None);
        let of_label = |id| {
            let object = LabelInfo { id, name: "it".into(), description: "a thing".into() };
            question_about_label(&object, &sequence, &labels, &VlmConfig::default())
        };
        assert_eq!(of_label(7), Some(seen), "an object of the masks is seen as its entity is");
        assert_eq!(of_label(8), None);
    }
}
