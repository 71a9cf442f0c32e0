//! Gaussians → entities → materials → scene.

use super::Run;
use super::poses::pose_report;
use super::settings::{RunSettings, regions_hash};
use crate::Error;
use crate::cache::{inputs_hash, run_stage};
use crate::command_options::record_options;
use crate::material_edits::QUERIES;
use crate::object_names::{EDITS, ObjectNames, differ, follow, write_names};
use crate::origin::{current_dir, stage_state};
use crate::stages::{SceneRequest, entities, entity_metrics, scene, trained_only};
use crate::vlm::{VlmMode, cached_estimates};
use sms_core::metrics::Metrics;
use sms_core::{
    BACKGROUND, Hash, InputError, Labels, MaskSource, RunFolder, Seed, Warnings, atomic, shell_argument,
};
use sms_entities::{EntitiesConfig, EntitySet, load_entities, material_queries, save_entities};
use sms_export::mjcf_text;
use sms_frames::{ReadOptions, Sequence};
use sms_gaussians::{read_ply, write_ply};
use sms_masks::load_labels;
use sms_materials::{ClassChoice, MaterialTable, ObjectQuery, Overrides, class_choices};
use sms_scene::{MOST_SIZE_SIGMA, Scene, save_scene};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// File of an entity's own Gaussians, in its folder.
const GAUSSIANS: &str = "gaussians.ply";

/// Options of [`Run::materialize`].
#[derive(Debug, Clone, Default)]
pub struct MaterializeRequest {
    /// A TOML file with material values of the user (`[object.NAME] class = "ceramic"`).
    pub materials: Option<PathBuf>,
    /// Use of a vision-language model for materials.
    pub vlm: VlmMode,
}

/// Result of [`Run::materialize`].
#[derive(Debug, Clone)]
pub struct MaterializeOutcome {
    /// The entities.
    pub entities: EntitySet,
    /// The material classes of the objects, with their origins.
    pub materials: Vec<ClassChoice>,
    /// Folder of the scene.
    pub scene_dir: PathBuf,
}

impl Run<'_> {
    /// Turns the scan into a scene: entities with meshes, materials, bodies. An earlier scene stays until the new one is
    /// complete. Plans for another scene stay, too, and are stale then.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no scan, its objects were edited since, or material values name an object that does
    /// not exist: before any work. Otherwise the error of the stage that failed.
    pub fn materialize(&self, request: &MaterializeRequest) -> Result<MaterializeOutcome, Error> {
        let run = self.open()?;
        let gaussians_dir = current_dir(&run, "gaussians", "scan DIR --out")?;
        let frames_dir = run.stage_dir("frames", "scan DIR --out")?;
        let masks_dir = run.stage_dir("masks", "scan DIR --out")?;
        let settings = RunSettings::of(&run)?;
        let mut config = self.context.settings.section("entities", EntitiesConfig::default())?;
        run.record_settings("entities", &config)?;
        // Unfinished stages start again, but keep finished convex decompositions.
        config.parts_cache = Some(run.root().join("cache").join("parts"));
        let read = self.context.settings.section("read", ReadOptions::default())?;
        let labels = load_labels(&masks_dir)?;
        refuse_other_objects(&settings, &labels, &masks_dir)?;
        let seed = Seed(settings.seed);

        let overrides = overrides(&run, request)?;
        record_options(self.context, &run, "materialize")?;
        let before = stage_state(&run, "gaussians").unwrap_or(Hash(String::new()));
        // Names and descriptions may be edited without a new scan.
        let names: Vec<_> = labels.objects.iter().map(|o| (o.id, &o.name, &o.description)).collect();
        let hash = inputs_hash(&[&before], &(&config, seed, &read, names))?;
        let (sequence, mut labels) = trained_only(Sequence::load(&frames_dir)?, labels, settings.holdout);
        let entities_dir = run_stage(self.context, &run, "entities", &hash, |stage, warnings| {
            let began = Instant::now();
            let model = read_ply(&gaussians_dir.join("scene.ply"))?;
            let context = self.context.stage(warnings, seed);
            let made = entities(model, &sequence, &labels, &config, &read, context)?;
            save_entities(stage.dir(), &made.set)?;
            for (name, gaussians) in &made.gaussians {
                write_ply(gaussians, &stage.dir().join(name).join(GAUSSIANS))?;
            }
            let mut metrics = entity_metrics(&made.set);
            metrics.set("materialize.seconds", began.elapsed().as_secs_f64());
            Ok(metrics)
        })?;
        let set = load_entities(&entities_dir)?;
        set.relabel(&mut labels);

        let mut queries = material_queries(&set);
        let estimates =
            cached_estimates(self.context, &run, request.vlm, (&set, &queries), (&sequence, &labels), seed)?;
        for (query, estimate) in queries.iter_mut().zip(estimates) {
            query.estimate = estimate;
        }
        let size_sigma = pose_report(&frames_dir)?.and_then(|report| report.relative_size_sigma());
        let scene_hash = inputs_hash(&[&hash], &("scene 7", &queries, &overrides, MaterialTable::builtin()))?;
        let scene_dir = run_stage(self.context, &run, "scene", &scene_hash, |stage, warnings| {
            atomic::write_json(&stage.dir().join(QUERIES), &queries)?;
            let objects = set.entities.iter().filter(|e| e.label != BACKGROUND);
            write_names(&run, stage.dir(), objects.map(|e| (e.name.as_str(), e.label)))?;
            let overrides = without_unused(&run, overrides.clone(), &queries, warnings);
            let name = settings.recording_name();
            let request = SceneRequest {
                name: &name,
                queries: &queries,
                overrides: Some(&overrides),
                size_sigma: size_sigma.unwrap_or(0.0).min(MOST_SIZE_SIGMA),
                x_world_recording: sequence.x_world_recording,
                fix_restless: labels.source == MaskSource::Geometry,
            };
            let scene = scene(&set, &request, self.context.stage(warnings, seed))?;
            write_scene(&scene, stage.dir(), &entities_dir)?;
            Ok(Metrics::new())
        })?;
        self.tell_stale(&run);
        // The queries are those of the entities, in their order, and of the floor.
        let labelled = set.entities.iter().zip(queries).filter(|(entity, _)| entity.label != BACKGROUND);
        let objects: Vec<ObjectQuery> = labelled.map(|(_, query)| query).collect();
        let materials = class_choices(&objects, &MaterialTable::builtin(), Some(&overrides));
        Ok(MaterializeOutcome { entities: set, materials, scene_dir })
    }
}

/// Refuses labels that the Gaussians were not trained with.
fn refuse_other_objects(settings: &RunSettings, labels: &Labels, masks_dir: &Path) -> Result<(), Error> {
    let Some(trained) = &settings.regions else { return Ok(()) };
    if *trained == regions_hash(labels)?.0 {
        return Ok(());
    }
    let what = "the scan was trained with other objects";
    let cure = "scan again into this run, which trains objects that were merged or separated";
    Err(InputError::new(what, masks_dir.join("labels.json"), cure).into())
}

/// Returns the material values of the user: the edits of the run under those of the file, both checked against the
/// masks. Edits move to the present names of their objects; the file is rewritten only then, because its comments are lost.
fn overrides(run: &RunFolder, request: &MaterializeRequest) -> Result<Overrides, Error> {
    let names = ObjectNames::of(run)?;
    let path = run.root().join(EDITS);
    let read = Overrides::read_optional(&path)?;
    let followed = follow(read.clone(), &names);
    let known = names.known().unwrap_or_default();
    if !followed.lost.is_empty() {
        let (lost, first) = (followed.lost.join("`, `"), followed.lost.join(" --unset "));
        let what = format!("this run has no object `{lost}`, for which material values are set");
        let root = shell_argument(run.root());
        let cure =
            format!("`sms materials {root} --unset {first}` removes them; objects: {}", known.join(", "));
        return Err(InputError::new(what, path, cure).into());
    }
    let mut edits = followed.overrides;
    if differ(&edits, &read) {
        edits.save(&path)?;
    }
    // Labels identify objects in the file only.
    edits.object.values_mut().for_each(|o| o.label = None);
    let Some(file) = request.materials.as_deref() else { return Ok(edits) };
    let given = Overrides::read(file)?;
    if let Some(name) = given.object.keys().find(|name| !known.contains(&name.as_str())) {
        let what = format!("there is no object `{name}` in this run");
        return Err(InputError::new(what, file, format!("name one of: {}", known.join(", "))).into());
    }
    Ok(edits.under(given))
}

/// Removes the values of objects that the masks have but the scene has not, such as pieces that were joined to others,
/// and adds a warning for each.
fn without_unused(
    run: &RunFolder,
    mut overrides: Overrides,
    queries: &[ObjectQuery],
    warnings: &Warnings,
) -> Overrides {
    overrides.object.retain(|name, _| {
        let is_used = queries.iter().any(|q| q.name == *name);
        if !is_used {
            let what = format!("the material values of `{name}` are not used: the scene has no such body");
            let root = shell_argument(run.root());
            let cure =
                format!("remove them: `sms materials {root} --unset {name}`, or in the file of --materials");
            warnings.add("scene", "material_unused", what, cure);
        }
        is_used
    });
    overrides
}

/// Writes the scene, its MJCF and the Gaussians of its bodies.
fn write_scene(scene: &Scene, dir: &Path, entities_dir: &Path) -> Result<(), Error> {
    save_scene(dir, scene)?;
    for body in &scene.bodies {
        let of_entity = entities_dir.join(&body.name).join(GAUSSIANS);
        if of_entity.exists() {
            let in_body = read_ply(&of_entity)?.transformed(&body.x_wb.inverse());
            write_ply(&in_body, &dir.join("gaussians").join(format!("{}.ply", body.name)))?;
        }
    }
    Ok(atomic::write_bytes(&dir.join("scene.xml"), mjcf_text(scene).as_bytes())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_names::fixture::run_with_masks;

    #[test]
    fn a_file_by_hand_is_rewritten_only_if_its_values_move() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_with_masks(dir.path(), &["mug", "duck"]);
        let path = dir.path().join(EDITS);
        let by_hand = "# weighed on Monday\n[object.mug]\nmass_kg = 0.31\n";
        std::fs::write(&path, by_hand).unwrap();
        let request = MaterializeRequest::default();
        let used = overrides(&run, &request).unwrap();
        assert_eq!(used.object, Overrides::read(&path).unwrap().object);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), by_hand);

        // The table has the name of the mug in the scene.
        write_names(&run, &dir.path().join("scene"), [("object_01", 1)].into_iter()).unwrap();
        std::fs::write(&path, "[object.object_01]\nmass_kg = 0.31\n").unwrap();
        assert_eq!(overrides(&run, &request).unwrap().object, used.object);
        let moved = Overrides::read(&path).unwrap();
        assert_eq!(moved.object.keys().collect::<Vec<_>>(), ["mug"]);
        assert_eq!(moved.object["mug"].label, Some(1));
    }
}
