//! `sms materialize`: Gaussians → entities → materials → scene.

use super::scan::{RunSettings, SETTINGS, regions_hash};
use super::{inputs_hash, length_text, materials, run_stage, shown, timed, vlm};
use crate::cli::Materialize;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{
    BACKGROUND, CoreError, EntityKind, EntityShape, Hash, InputError, Labels, MaskSource, RunFolder, Seed,
    StageContext, Warnings, atomic,
};
use sms_entities::{
    EntitiesConfig, EntitySet, bake_textures, build_entities, load_entities, material_queries,
    object_gaussians, save_entities,
};
use sms_export::mjcf_text;
use sms_frames::{ReadOptions, Sequence, recorded_colors};
use sms_gaussians::{read_ply, write_ply};
use sms_masks::load_labels;
use sms_materials::{MaterialTable, Overrides, assign, save_queries};
use sms_scene::{Scene, build_scene, save_scene};
use sms_sim::{RapierFactory, RestLimits, RestingDrift, fix_restless};

/// An entity's own Gaussians, in its folder.
const GAUSSIANS: &str = "gaussians.ply";

pub(crate) fn run(console: &Console, a: &Materialize) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let gaussians_dir = run.stage_dir("gaussians", "scan DIR --out")?;
    let frames_dir = run.stage_dir("frames", "scan DIR --out")?;
    let masks_dir = run.stage_dir("masks", "scan DIR --out")?;
    let settings = run_settings(&run)?;
    let mut config = console.context.settings.section("entities", EntitiesConfig::default())?;
    let seed = Seed(settings.seed);
    run.record_settings("entities", &config)?;

    // Unfinished stages are redone from the start: what they decomposed is not.
    config.parts_cache = Some(run.root().join("cache").join("parts"));
    let before = run.stage_hash("gaussians").unwrap_or(Hash(String::new()));
    let read = console.context.settings.section("read", ReadOptions::default())?;
    let labels = load_labels(&masks_dir)?;
    if settings.regions.as_ref().is_some_and(|trained| *trained != regions_hash(&labels).0) {
        let cure =
            "scan again into this run: objects that were merged there, or taken apart, are trained anew";
        let what = "these are not the objects that the scan was made with";
        return Err(InputError::new(what, masks_dir.join("labels.json"), cure).into());
    }
    // Names and descriptions may be edited without another scan.
    let hash = inputs_hash(&[&before], &(&config, seed, &read, names_of(&labels)))?;
    let (sequence, mut labels) = trained_on(Sequence::load(&frames_dir)?, labels, settings.holdout);
    let entities_dir = run_stage(
        console,
        &run,
        "entities",
        &["entities.", "materialize."],
        &hash,
        |stage, warnings| {
            timed("materialize.seconds", || {
                let mut model = read_ply(&gaussians_dir.join("scene.ply"))?;
                let mut set = build_entities(
                    &model,
                    &sequence,
                    &labels,
                    &config,
                    StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings)
                        .with_seed(seed),
                )?;
                set.relabel_model(&mut model);
                let mut labels = labels.clone();
                set.relabel(&mut labels);
                let colors =
                    recorded_colors(&sequence, &read, config.texture.image_side, &console.context.cancel)?;
                let missing = colors.iter().filter(|c| c.is_none()).count();
                if config.texture.enabled && missing > 0 {
                    warnings.add(
                        "materialize",
                        "recorded_colour_missing",
                        format!("{missing} of {} recorded colour images are gone", colors.len()),
                        "put the recording back where it was scanned from; pictures are baked from the smaller frames",
                    );
                }
                bake_textures(&mut set, &sequence, &labels, &colors, &config.texture);
                save_entities(stage.dir(), &set)?;
                for entity in set.entities.iter().filter(|e| e.label != BACKGROUND) {
                    let gaussians = object_gaussians(&model, entity, &config);
                    write_ply(&gaussians, &stage.dir().join(&entity.name).join(GAUSSIANS))?;
                }
                Ok(entity_metrics(&set))
            })
        },
    )?;
    let set = load_entities(&entities_dir)?;

    set.relabel(&mut labels);
    let x_world_recording = sequence.x_world_recording;
    let mut queries = material_queries(&set);
    let estimates = vlm::estimates(console, &run, a.vlm, &set, &queries, &sequence, &labels, seed)?;
    for (query, estimate) in queries.iter_mut().zip(estimates) {
        query.estimate = estimate;
    }
    let table = MaterialTable::builtin();
    let edits = Overrides::read_optional(&run.root().join(materials::EDITS))?;
    let overrides = match a.materials.as_deref() {
        Some(path) => {
            // Each file answers for its own mistakes.
            edits.check(&queries, &table)?;
            edits.under(Overrides::read(path)?)
        }
        None => edits,
    };
    let scene_hash = inputs_hash(&[&hash], &("scene 4", &queries, &overrides, &table))?;
    let scene_dir = run_stage(console, &run, "scene", &["scene."], &scene_hash, |stage, warnings| {
        save_queries(&stage.dir().join(materials::QUERIES), &queries)?;
        let mut materials = assign(&queries, &table, Some(&overrides), warnings)?;
        let floor = materials.pop();
        let support = set.support_height.zip(floor);
        let mut scene =
            build_scene(&settings.recording_name(), &set.entities, &materials, support, x_world_recording)?;
        if labels.source == MaskSource::Geometry {
            fix_pieces(&mut scene, warnings)?;
        }
        save_scene(stage.dir(), &scene)?;
        for body in &scene.bodies {
            let of_entity = entities_dir.join(&body.name).join(GAUSSIANS);
            if of_entity.exists() {
                let in_body = read_ply(&of_entity)?.transformed(&body.x_wb.inverse());
                let file = stage.dir().join("gaussians").join(format!("{}.ply", body.name));
                write_ply(&in_body, &file)?;
            }
        }
        atomic::write_bytes(&stage.dir().join("scene.xml"), mjcf_text(&scene).as_bytes())?;
        Ok(Metrics::new())
    })?;
    summary(console, &set);
    console.say(format!("  in {}", shown(&scene_dir.join("scene.json"))));
    console.print_metrics(&run)
}

/// Masks from geometry cut things into pieces that no longer stand by themselves; those are kept where they were seen.
/// Masks of people and networks mean what they say: what does not rest there is left to `sms simulate` to tell.
fn fix_pieces(scene: &mut Scene, warnings: &Warnings) -> anyhow::Result<()> {
    for drift in fix_restless(&RapierFactory, scene, &RestLimits::default())? {
        let message = format!("{}: it is kept as a fixed collider", drift_text(&drift));
        warnings.add("materialize", "kept_fixed", message, "correct the masks, or scan it from more sides");
    }
    Ok(())
}

/// How far a body came by itself, in words.
pub(crate) fn drift_text(drift: &RestingDrift) -> String {
    let (moved, degrees) = (length_text(drift.moved_m), drift.turned_rad.to_degrees());
    format!("`{}` moved {moved} and turned {degrees:.1}° when left alone", drift.body)
}

/// What the objects are called and described as, by their ids.
fn names_of(labels: &Labels) -> Vec<(u16, &str, &str)> {
    labels.objects.iter().map(|o| (o.id, o.name.as_str(), o.description.as_str())).collect()
}

/// The frames that were trained on, with their label maps: objects must not see what was kept out either.
fn trained_on(sequence: Sequence, labels: Labels, holdout: usize) -> (Sequence, Labels) {
    let kept = |index: usize| !Sequence::is_held_out(index, holdout);
    let maps = labels.maps.into_iter().enumerate().filter(|(i, _)| kept(*i)).map(|(_, m)| m).collect();
    let frames = sequence.frames.into_iter().enumerate().filter(|(i, _)| kept(*i)).map(|(_, f)| f).collect();
    (Sequence { frames, ..sequence }, Labels { maps, ..labels })
}

/// The settings that the run's Gaussians were made with.
pub(crate) fn run_settings(run: &RunFolder) -> anyhow::Result<RunSettings> {
    let dir = run.stage_dir("gaussians", "scan DIR --out")?;
    let path = dir.join(SETTINGS);
    if !path.exists() {
        let cure = "scan the recording again into this run";
        return Err(InputError::new("this run does not say how it was scanned", &path, cure).into());
    }
    Ok(atomic::read_json(&path)?)
}

impl RunSettings {
    /// The recording's folder name.
    pub(crate) fn recording_name(&self) -> String {
        let path = std::path::Path::new(&self.recording);
        path.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
    }
}

fn entity_metrics(set: &EntitySet) -> Metrics {
    let dynamic: Vec<_> = set.entities.iter().filter(|e| e.kind == EntityKind::Dynamic).collect();
    let spheres = dynamic.iter().filter(|e| matches!(e.shape, EntityShape::Sphere { .. })).count();
    let boxes = dynamic.iter().filter(|e| matches!(e.shape, EntityShape::Box { .. })).count();
    let cylinders = dynamic.iter().filter(|e| matches!(e.shape, EntityShape::Cylinder { .. })).count();
    let closed = dynamic.iter().filter(|e| e.mesh.is_closed_oriented()).count();
    let mut m = Metrics::new();
    m.set("entities.count", dynamic.len()).set("entities.spheres", spheres).set("entities.closed", closed);
    m.set("entities.boxes", boxes).set("entities.cylinders", cylinders);
    m.set("entities.static", set.entities.len() - dynamic.len());
    m
}

fn summary(console: &Console, set: &EntitySet) {
    for e in &set.entities {
        let what = match (&e.kind, &e.shape) {
            (EntityKind::Static, _) => format!("static, {} triangles", e.mesh.triangles.len()),
            (_, EntityShape::Sphere { radius, .. }) => format!("sphere, radius {:.2} mm", radius * 1e3),
            (_, EntityShape::Box { half_extents, .. }) => {
                let [x, y, z] = (2e3 * *half_extents).to_array();
                format!("box, {x:.1} × {y:.1} × {z:.1} mm")
            }
            (_, EntityShape::Cylinder { radius, half_length, .. }) => {
                format!("cylinder, radius {:.2} mm, {:.1} mm long", radius * 1e3, half_length * 2e3)
            }
            _ => format!("{} convex parts, {:.0} cm³", e.parts.len(), e.mesh.volume() * 1e6),
        };
        console.say(format!("{:>16}: {what}, {:.0} % observed", e.name, 100.0 * e.observed_share));
    }
}

/// Reads JSON that may be absent; what is there and damaged is not passed over.
pub(crate) fn read_optional<T: serde::de::DeserializeOwned>(
    path: &std::path::Path,
) -> anyhow::Result<Option<T>> {
    if !path.exists() {
        return Ok(None);
    }
    atomic::read_json(path).map(Some).map_err(|e| match e {
        CoreError::Input(e) => {
            InputError { cure: "restore it; or delete it, and the report is written without it".into(), ..e }
                .into()
        }
        other => other.into(),
    })
}
