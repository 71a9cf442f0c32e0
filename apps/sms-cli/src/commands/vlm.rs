//! Asks a vision-language model about the objects of a scene, as `sms materialize` does.

use crate::cli::VlmMode;
use crate::context::Context;
use sms_core::glamx::DVec3;
use sms_core::metrics::Metrics;
use sms_core::{
    BACKGROUND, Entity, EntityKind, Image, InputError, LabelMap, Labels, RunFolder, Seed, Warnings,
};
use sms_entities::EntitySet;
use sms_frames::{Frame, Sequence};
use sms_materials::{Estimate, ObjectQuery};
use sms_vlm::{
    ApiKey, Asked, Cache, Client, Question, VlmConfig, annotated, ask, best_view, jpeg, picture, score_view,
};
use std::time::Instant;

/// Folder of the stored replies in a run. It is no stage: replies stay when the scene is made again.
pub(crate) const REPLIES: &str = "vlm";
/// Background so near to the support plane is the floor, metres.
const FLOOR_BAND_M: f64 = 0.01;

/// The settings before `--settings` and `--set`: server and model of the environment.
pub(crate) fn defaults() -> VlmConfig {
    let named = |key: &str| std::env::var(key).map(|v| v.trim().to_owned()).unwrap_or_default();
    VlmConfig { url: named("SMS_VLM_URL"), model: named("SMS_VLM_MODEL"), ..VlmConfig::default() }
}

/// What the model says of each of `queries` (the entities of `set`, then the floor); `None` for those that it was not asked
/// about or did not answer.
pub(crate) fn estimates(
    context: &Context,
    run: &RunFolder,
    mode: VlmMode,
    set: &EntitySet,
    queries: &[ObjectQuery],
    sequence: &Sequence,
    labels: &Labels,
    seed: Seed,
) -> anyhow::Result<Vec<Option<Estimate>>> {
    let mut estimates = vec![None; queries.len()];
    let mut config = context.settings.section("vlm", defaults())?;
    let is_wanted = match mode {
        VlmMode::Off => false,
        VlmMode::Auto => !config.url.trim().is_empty(),
        VlmMode::On | VlmMode::CacheOnly => true,
    };
    let warnings = Warnings::new();
    if !is_wanted {
        // What an earlier run of the command said of the model is no longer so.
        context.finish(run, "vlm", &["vlm."], Metrics::new(), &warnings)?;
        return Ok(estimates);
    }
    config.cache_only |= mode == VlmMode::CacheOnly;
    run.record_settings("vlm", &config)?;
    let began = Instant::now();
    let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
    let client = Client::new(&config, key, seed.derive("vlm"))?;

    let mut asked_about = Vec::new();
    let mut questions = Vec::new();
    for (i, query) in queries.iter().enumerate() {
        let entity = set.entities.get(i);
        match question(query, entity, set.support_height, sequence, labels, &config) {
            Some(question) => {
                asked_about.push(i);
                questions.push(question);
            }
            // Nobody asked for the environment's own material where no camera shows it.
            None => warnings.add(
                "vlm",
                "vlm_not_seen",
                format!(
                    "no view shows enough of {} to ask about it; the table or a prior stands in",
                    query.name
                ),
                "set its values with `sms materials RUN --set`",
            ),
        }
    }
    let cache = Cache::new(&run.root().join(REPLIES));
    let asked = ask(&questions, &client, &cache, context.progress.as_ref(), &context.cancel, &warnings)?;
    let mut metrics = Metrics::new();
    count(&asked, queries.len(), &config, &mut metrics);
    metrics.set("vlm.seconds", began.elapsed().as_secs_f64());
    context.finish(run, "vlm", &["vlm."], metrics, &warnings)?;
    context.say(summary(&asked, queries.len(), &config));
    if let (VlmMode::On, Some(given_up)) = (mode, &asked.given_up) {
        return Err(InputError::new(given_up.what.clone(), config.url, given_up.cure.clone()).into());
    }
    let is_silent = !questions.is_empty() && asked.outcomes.iter().all(|o| o.estimate().is_none());
    if mode == VlmMode::On && is_silent {
        return Err(InputError::new(
            "not one object could be answered by the vision-language model",
            config.url,
            "see the warnings above; or use --vlm auto, and the table or a prior stands in",
        )
        .into());
    }
    for (i, outcome) in asked_about.into_iter().zip(&asked.outcomes) {
        estimates[i] = outcome.estimate().cloned();
    }
    Ok(estimates)
}

fn count(asked: &Asked, objects: usize, config: &VlmConfig, metrics: &mut Metrics) {
    let usage = asked.usage;
    metrics
        .set("vlm.objects", objects)
        .set("vlm.answered", asked.answered())
        .set("vlm.cached", asked.cached());
    metrics.set("vlm.fallbacks", objects - asked.answered());
    metrics.set("vlm.requests", usage.requests);
    metrics
        .set("vlm.prompt_tokens", usage.prompt_tokens)
        .set("vlm.completion_tokens", usage.completion_tokens);
    if let Some(cost) = config.cost(usage.prompt_tokens, usage.completion_tokens) {
        metrics.set("vlm.cost", cost);
    }
}

fn summary(asked: &Asked, objects: usize, config: &VlmConfig) -> String {
    let usage = asked.usage;
    if usage.requests == 0 {
        let all = asked.cached();
        return format!(
            "{:>16}: {all} of {objects} answered by {}, all stored before; no requests",
            "vlm", config.model
        );
    }
    let cost = match config.cost(usage.prompt_tokens, usage.completion_tokens) {
        Some(cost) => format!("cost {cost:.4}"),
        None => {
            "cost unknown (set vlm.price_prompt_per_million and vlm.price_completion_per_million)".to_owned()
        }
    };
    format!(
        "{:>16}: {} of {objects} answered by {}, {} of these stored before; {} requests, {} + {} tokens, {cost}",
        "vlm",
        asked.answered(),
        config.model,
        asked.cached(),
        usage.requests,
        usage.prompt_tokens,
        usage.completion_tokens,
    )
}

/// The question about one object with its best view, or `None` where it is hardly seen.
fn question(
    query: &ObjectQuery,
    entity: Option<&Entity>,
    support_height: Option<f64>,
    sequence: &Sequence,
    labels: &Labels,
    config: &VlmConfig,
) -> Option<Question> {
    let mask_of = |frame: &Frame, map: &LabelMap| mask(frame, map, entity, support_height);
    let frames = || sequence.frames.iter().zip(&labels.maps);
    let views = frames().map(|(frame, map)| score_view(&mask_of(frame, map), Some(&frame.depth)));
    let (index, view) = best_view(views)?;
    let frame = &sequence.frames[index];
    let size = frame.color.size();
    let own = picture(&frame.color_path, size);
    let color = own.as_ref().unwrap_or(&frame.color);
    let image = annotated(color, view.bounds, size, config.context, config.max_image_side);
    Some(Question {
        name: query.name.clone(),
        annotation: query.description.clone(),
        is_surface: entity.is_none_or(|e| e.kind == EntityKind::Static),
        jpeg: jpeg(&image),
    })
}

/// Where one frame shows the object: its label; of what no label explains, the floor is what lies at the support's height
/// and the environment what lies within its mesh's box above that.
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
        let frame = Frame {
            index: 0,
            time_s: None,
            camera,
            color: Image::filled(90, 60, [90, 120, 150]),
            depth: Image::from_vec(90, 60, pixels().map(|p| p.0 as f32).collect()),
            normal_c: Image::filled(90, 60, [0.0; 3]),
            color_path: "nowhere.png".into(),
            mask_path: None,
        };
        (frame, Image::from_vec(90, 60, pixels().map(|p| p.1).collect()))
    }

    #[test]
    fn floor_environment_and_objects_are_told_apart() {
        let (frame, map) = view();
        // The camera's x is the world's x here: the wall is where x is negative.
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
            question(&query, entity, Some(0.0), &sequence, &labels, &VlmConfig::default())
        };
        let seen = ask_about(Some(&entity(7, EntityKind::Dynamic, Mesh::default()))).unwrap();
        assert_eq!((seen.name.as_str(), seen.annotation.as_str(), seen.is_surface), ("it", "a thing", false));
        assert_eq!(seen.jpeg[..2], [0xFF, 0xD8]);
        assert!(ask_about(None).unwrap().is_surface, "the floor");
        assert_eq!(ask_about(Some(&entity(8, EntityKind::Dynamic, Mesh::default()))), None);
    }
}
