//! The planner's view of a scene.

use super::vlm_materials::{apply_vlm_materials, keep_questions};
use super::{BilliardsBench, BilliardsGeometry, Row};
use crate::material_prior::set_material;
use crate::materialize::scan_key;
use crate::scenes::no_scene;
use crate::{
    BenchError, BenchOptions, BenchScene, MaskChoice, MaterialPrior, MaterializeOptions, generated, train,
};
use glamx::DMat3;
use sms_core::{
    Cancel, MaskSource, MassProperties, Progress, Seed, StageContext, Warnings, hash_serializable,
};
use sms_entities::{EntitiesConfig, material_queries};
use sms_materials::{MaterialTable, ObjectQuery};
use sms_pipeline::stages::{self, SceneRequest};
use sms_scene::{Body, BodyShape, Scene, load_scene, loose_mass, save_scene};
use sms_synth::{FixedScene, TruthScene};
use sms_target::{match_bodies, scene_from_truth};
use sms_task::{Billiards, Selector, Task};
use std::path::PathBuf;

/// Seed of the entities stage; `sms materialize` has the same default.
const SEED: Seed = Seed(0);

/// A scene as the planner knows it, with its task.
#[derive(Debug, Clone)]
pub(super) struct PlannerView {
    pub(super) scene: Scene,
    /// The same scan made into bodies the paper's way, where row `paper` is planned.
    pub(super) paper: Option<Scene>,
    pub(super) task: Task,
    /// Seed of the material prior.
    pub(super) prior_seed: Seed,
    /// Number of true objects that have a body in their place.
    pub(super) matched: usize,
    /// Number of bodies that match no object.
    pub(super) strays: usize,
}

impl PlannerView {
    /// The scene that a row plans in.
    pub(super) fn scene_of(&self, row: Row) -> &Scene {
        self.paper.as_ref().filter(|_| row == Row::Paper).unwrap_or(&self.scene)
    }
}

/// Builds the view, or reads the kept geometry; then applies the material prior.
pub(super) fn planner_view(
    bench: &BilliardsBench,
    fixed: &FixedScene,
    truth: &TruthScene,
    material_prior: MaterialPrior,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<PlannerView, BenchError> {
    let is_asked = material_prior == MaterialPrior::Vlm;
    let has_paper = bench.rows.contains(&Row::Paper);
    let (mut scene, mut paper) = match bench.geometry {
        BilliardsGeometry::Truth if is_asked => {
            let cure = "take --geometry scan, or leave `vlm` out of --materials";
            let what = "a vision-language model needs pictures, and true geometry has none";
            return Err(sms_core::InputError::new(what, "--geometry", cure).into());
        }
        BilliardsGeometry::Truth => {
            let mut scene = scene_from_truth(truth).map_err(sms_target::TargetError::from)?;
            scene.bodies.iter_mut().for_each(forget_material);
            (scene.clone(), has_paper.then_some(scene))
        }
        BilliardsGeometry::Scan => {
            let which = BenchScene::Fixed(fixed.number);
            let known = |entities: &EntitiesConfig| {
                let mut scene = scanned(&bench.scan, &which, entities, progress, cancel)?;
                if is_asked {
                    let client = bench.vlm.as_deref().ok_or_else(no_model)?;
                    let dir = scan_dir(&bench.scan, &which, entities)?;
                    apply_vlm_materials(
                        &mut scene,
                        &dir,
                        client,
                        &bench.scan.keep.join("vlm"),
                        progress,
                        cancel,
                    )?;
                }
                Ok::<_, BenchError>(scene)
            };
            let papers = has_paper.then_some(&bench.paper_entities);
            (known(&bench.scan.bench.entities)?, papers.map(known).transpose()?)
        }
    };
    let prior_seed = Seed(fixed.seed);
    let pairs = apply_to_matched(&mut scene, truth, material_prior, prior_seed)?;
    if let Some(paper) = &mut paper {
        apply_to_matched(paper, truth, material_prior, prior_seed)?;
    }
    let goal = truth.goal_w;
    let goal_w = scene
        .x_world_recording
        .transform_point(glamx::DVec3::new(goal[0], goal[1], 0.0))
        .truncate()
        .to_array();
    let task = match bench.geometry {
        BilliardsGeometry::Truth => {
            Billiards::new(Selector::by_name(&truth.cue), Selector::by_name(&truth.target), goal_w)
        }
        // The balls as a user would describe them.
        BilliardsGeometry::Scan => {
            Billiards::new(Selector::sphere_of_color("white"), Selector::sphere_of_color("blue"), goal_w)
        }
    };
    let bodies = scene.bodies.iter().filter(|b| is_object(b)).count();
    let task = Task::Billiards(task);
    Ok(PlannerView { task, prior_seed, matched: pairs, strays: bodies - pairs, scene, paper })
}

fn no_model() -> sms_core::InputError {
    sms_core::InputError::new(
        "no vision-language model is named to ask about materials",
        "--materials vlm",
        "name a server and a model with SMS_VLM_URL and SMS_VLM_MODEL, or leave `vlm` out",
    )
}

/// Replaces a true material by the prior, and scales the mass to it for the same distribution of mass. The result
/// is rounded, because the last bits of a quotient depend on the divisor.
pub(crate) fn forget_material(body: &mut Body) {
    let is_sphere = matches!(body.shape, BodyShape::Sphere { .. });
    let prior = MaterialTable::builtin().prior(is_sphere);
    let density = body.material.effective_density();
    if let Some(was) = body.mass.filter(|_| density > 0.0) {
        let rounded = |v: f64| f64::from((v / density) as f32) * prior.effective_density();
        let inertia = DMat3::from_cols_array(&was.inertia().to_cols_array().map(rounded));
        // The scaled inertia is as valid as the previous one, up to rounding.
        body.mass = MassProperties::new(rounded(was.mass()), was.com(), inertia).ok();
    }
    body.material = prior;
}

/// The scene that scan and materialize make of a generated scene's recording. Materials are the prior's.
pub(crate) fn scanned(
    scan: &MaterializeOptions,
    which: &BenchScene,
    entities: &EntitiesConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Scene, BenchError> {
    let dir = scan_dir(scan, which, entities)?;
    if !scan.rescan && dir.join("scene.json").is_file() {
        return Ok(load_scene(&dir)?);
    }
    let warnings = Warnings::new();
    let trained =
        train(which, scan, StageContext::new(progress, cancel, &warnings))?.ok_or_else(|| no_scene(which))?;
    let context = StageContext::new(progress, cancel, &warnings).with_seed(SEED);
    let set = stages::entities(
        trained.model,
        &trained.sequence,
        &trained.labels,
        entities,
        &scan.bench.read,
        context,
    )?
    .set;
    // The experiment applies its own material prior, so names must not choose a material here.
    let nameless = |query| ObjectQuery { name: String::new(), description: String::new(), ..query };
    let queries: Vec<ObjectQuery> = material_queries(&set).into_iter().map(nameless).collect();
    let request = SceneRequest {
        name: &which.to_string(),
        queries: &queries,
        overrides: None,
        size_sigma: 0.0,
        x_world_recording: trained.sequence.x_world_recording,
        fix_restless: trained.labels.source == MaskSource::Geometry,
    };
    let scene = stages::scene(&set, &request, context)?;
    keep_questions(&dir, &set, &trained.sequence, &trained.labels)?;
    save_scene(&dir, &scene)?;
    Ok(scene)
}

/// Folder of a kept scanned scene, named by a hash of its inputs.
pub(super) fn scan_dir(
    scan: &MaterializeOptions,
    which: &BenchScene,
    entities: &EntitiesConfig,
) -> Result<PathBuf, BenchError> {
    let truth = generated(which)?.ok_or_else(|| no_scene(which))?.scene;
    let true_masks = scan.masks == MaskChoice::Truth;
    let options = BenchOptions { true_masks, ..scan.bench.clone() };
    let key = hash_serializable(&(scan_key(which, &options)?, truth, entities, SEED)).0;
    Ok(scan.keep.join("scenes").join(format!("{which}-{}", &key[..12])))
}

/// Whether the body is a finite object, fixed or not: neither the floor nor the background.
pub(super) fn is_object(body: &Body) -> bool {
    !matches!(body.shape, BodyShape::HalfSpace) && (body.mass.is_some() || loose_mass(body).is_some())
}

/// Applies the material prior to the bodies that lie where true objects lie; the others keep the handbook's prior. Returns the number
/// of matched bodies. Names of the two scenes are unrelated.
pub(crate) fn apply_to_matched(
    scene: &mut Scene,
    truth: &TruthScene,
    material_prior: MaterialPrior,
    seed: Seed,
) -> Result<usize, BenchError> {
    let mut true_scene = scene_from_truth(truth).map_err(sms_target::TargetError::from)?;
    for body in &mut true_scene.bodies {
        body.x_wb = scene.x_world_recording * body.x_wb;
    }
    // Bodies that did not rest were fixed; they still have a material.
    let own = scene.loosened();
    let pairs = match_bodies(&own, &true_scene);
    if material_prior == MaterialPrior::Vlm {
        // The model's estimates are already applied.
        return Ok(pairs.len());
    }
    for (body, own) in scene.bodies.iter_mut().zip(&own.bodies) {
        if matches!(body.shape, BodyShape::HalfSpace) {
            set_material(body, material_prior.of_floor(&truth.floor.material, seed));
        } else if let Some(object) = pairs.iter().find(|p| p.0 == body.name).and_then(|p| truth.object(&p.1))
        {
            let material = material_prior.of_object(object, own, seed);
            set_material(body, material);
        }
    }
    Ok(pairs.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::redrawn::redraw_materials;
    use sms_core::NoProgress;
    use sms_scene::BodyKind;
    use sms_synth::FIXED_SCENES;

    fn known(truth: &TruthScene, material_prior: MaterialPrior) -> PlannerView {
        let mut bench = BilliardsBench::new(vec![], std::path::Path::new("keep"), "out");
        bench.geometry = BilliardsGeometry::Truth;
        planner_view(&bench, &FIXED_SCENES[7], truth, material_prior, &NoProgress, &Cancel::new()).unwrap()
    }

    #[test]
    fn true_materials_are_seen_only_where_they_are_told() {
        let truth = FIXED_SCENES[7].generate();
        let other = redraw_materials(&truth, Seed(5));
        assert!(truth.objects.iter().zip(&other.objects).all(|(a, b)| a.mass.mass() != b.mass.mass()));
        for material_prior in [MaterialPrior::Class, MaterialPrior::Prior] {
            let (a, b) = (known(&truth, material_prior), known(&other, material_prior));
            assert_eq!(a.scene.bodies, b.scene.bodies);
            assert_eq!(format!("{:?}", a.task), format!("{:?}", b.task));
        }
        for material_prior in [MaterialPrior::Noisy, MaterialPrior::Truth] {
            assert_ne!(
                known(&truth, material_prior).scene.bodies,
                known(&other, material_prior).scene.bodies
            );
        }
    }

    #[test]
    fn the_truth_told_is_the_truth() {
        let truth = FIXED_SCENES[7].generate();
        let material_prior = known(&truth, MaterialPrior::Truth);
        assert_eq!((material_prior.matched, material_prior.strays), (truth.objects.len(), 0));
        for object in &truth.objects {
            let body = material_prior.scene.bodies.iter().find(|b| b.name == object.name).unwrap();
            assert_eq!(body.material, object.material);
            assert!((body.mass.unwrap().mass() / object.mass.mass() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_was_fixed_is_made_of_what_the_truth_is() {
        let truth = FIXED_SCENES[7].generate();
        let mut scene = scene_from_truth(&truth).unwrap();
        scene.bodies.iter_mut().for_each(forget_material);
        let loose = scene.bodies.iter().position(|b| b.mass.is_some() && loose_mass(b).is_some()).unwrap();
        let fixed = &mut scene.bodies[loose];
        (fixed.kind, fixed.mass) = (BodyKind::Static, None);
        let pairs = apply_to_matched(&mut scene, &truth, MaterialPrior::Truth, Seed(0)).unwrap();
        assert_eq!(pairs, truth.objects.len());
        let fixed = &scene.bodies[loose];
        assert_eq!((fixed.kind, fixed.mass), (BodyKind::Static, None));
        assert_eq!(fixed.material, truth.object(&fixed.name).unwrap().material);
    }

    #[test]
    fn what_lies_elsewhere_or_is_called_otherwise_is_told_by_its_place() {
        let truth = FIXED_SCENES[7].generate();
        let mut scene = scene_from_truth(&truth).unwrap();
        scene.bodies.iter_mut().for_each(forget_material);
        let names: Vec<String> = scene.bodies.iter().map(|b| b.name.clone()).collect();
        for (i, body) in scene.bodies.iter_mut().enumerate() {
            body.name = format!("object_{i:02}");
        }
        // The last one is not where any object is.
        let last = scene.bodies.len() - 1;
        scene.bodies[last].x_wb.translation.x += 3.0;
        let prior = scene.bodies[last].material.clone();
        let pairs = apply_to_matched(&mut scene, &truth, MaterialPrior::Truth, Seed(0)).unwrap();
        assert_eq!(pairs, truth.objects.len() - 1);
        assert_eq!(scene.bodies[last].material, prior);
        for (body, name) in scene.bodies[1..last].iter().zip(&names[1..]) {
            assert_eq!(body.material, truth.object(name).unwrap().material);
        }
    }
}
