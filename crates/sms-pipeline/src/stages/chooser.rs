//! Baselines of the landing planner: the choice of a site and an approach from geometric candidates.

use super::LandingProblem;
use crate::Error;
use serde::{Deserialize, Serialize};
use sms_core::{ColorImage, InputError, StageContext};
use sms_frames::Frame;
use sms_landing::{
    LandingAction, LandingEvaluations, LandingPlan, LandingPlanOutcome, LandingRecording, LandingSettings,
    PlannedBody, RolloutOptions, rollout_landing,
};
use sms_prompting::{
    ApproachSettings, Choice, Observation, PromptingInputs, SiteSettings, Sites, approaches, best_view,
    geometric, landing_sites, paths_picture, random, resized, sites_picture, surfaces_of, visual_prompting,
};
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_vlm::{Cache, Client, picture};
use sms_wash::{WashModel, WashSettings};

/// Time between recorded states, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 60.0;

/// Chooser of a landing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LandingChooser {
    /// The search in simulation.
    #[default]
    Search,
    /// The centre of the top face with a straight approach.
    Geometric,
    /// A random choice of site and approach.
    Random,
    /// A vision-language model that chooses from sites and approaches drawn on a frame.
    Visual,
}

impl LandingChooser {
    /// Returns the name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Search => "ours",
            Self::Geometric => "geometric",
            Self::Random => "random",
            Self::Visual => "visual prompting",
        }
    }
}

/// A baseline's choice and its reason.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ChoiceRecord {
    /// Name of the chooser in tables.
    pub chooser: String,
    /// Number of the site.
    pub site: u32,
    /// Number of the approach.
    pub approach: u32,
    /// Reason for this site and approach.
    pub reasons: [String; 2],
}

/// A plan of a baseline.
#[derive(Debug)]
pub struct ChosenLanding {
    /// The plan, flown once with particles in the scanned world.
    pub outcome: LandingPlanOutcome,
    /// The choice.
    pub record: ChoiceRecord,
    /// Pictures of the sites and of the approaches; empty if no frame shows them.
    pub pictures: Vec<ColorImage>,
    /// Number of candidate sites and of approaches to each.
    pub candidates: (usize, usize),
}

/// Chooses a landing by a baseline. `frames` are the recording's; `model` is needed for [`LandingChooser::Visual`].
///
/// # Errors
/// [`Error::Input`] if there is no site, no frame shows it, or the model does not answer.
pub fn choose_landing(
    landing: &LandingProblem,
    chooser: LandingChooser,
    frames: &[Frame],
    settings: &LandingSettings,
    model: Option<(&Client, &Cache)>,
    context: StageContext<'_>,
) -> Result<ChosenLanding, Error> {
    let LandingProblem { scene, task, .. } = landing;
    task.check_rest(&RapierFactory, scene)?;
    let limits = task.task().surface;
    let wanted =
        SiteSettings { min_height: limits.height_m, max_tilt: limits.slope_rad, ..SiteSettings::default() };
    let sites = landing_sites(&surfaces_of(scene), task.vehicle(), &wanted).map_err(|e| {
        let cure = "lower `surface.height_m` in the task, or use a smaller vehicle";
        InputError::new(e.to_string(), task.task().path(), cure)
    })?;
    let ways = ApproachSettings::default();
    let start_w = task.start_w();
    let view = observation(frames, scene, &sites);
    let (choice, pictures) = match (chooser, model) {
        (LandingChooser::Visual, Some((client, cache))) => {
            let view = view.ok_or_else(not_in_view)?;
            let inputs = PromptingInputs { observation: &view, sites: &sites, start_w, approaches: &ways };
            let prompted = visual_prompting(&inputs, client, cache, context).map_err(|e| {
                match e.input(&client.config().url) {
                    Ok(refused) => Error::from(refused),
                    Err(e) => e.into(),
                }
            })?;
            (prompted.choice, prompted.chosen.into())
        }
        (LandingChooser::Visual, None) => {
            let cure = "set the server with SMS_VLM_URL, or use another chooser";
            return Err(InputError::new("no vision-language model is set", "--chooser visual", cure).into());
        }
        (LandingChooser::Random, _) => {
            drawn(view, &sites, random(&sites, start_w, &ways, context.seed), landing, &ways)
        }
        (LandingChooser::Search | LandingChooser::Geometric, _) => {
            drawn(view, &sites, geometric(&sites, start_w, &ways), landing, &ways)
        }
    };
    let record = ChoiceRecord {
        chooser: choice.chooser.name().to_owned(),
        site: choice.site.id,
        approach: choice.approach.id,
        reasons: choice.reasons.clone(),
    };
    let plan = flown(landing, action_of(&choice), settings)?;
    let candidates = (sites.sites.len(), ways.count);
    let outcome = LandingPlanOutcome { plan, trials: Vec::new() };
    Ok(ChosenLanding { outcome, record, pictures, candidates })
}

/// Plans an action: flies it once with particles in the scanned world.
fn flown(
    landing: &LandingProblem,
    action: LandingAction,
    settings: &LandingSettings,
) -> Result<LandingPlan, Error> {
    let LandingProblem { scene, task, .. } = landing;
    let wash = WashSettings { model: WashModel::Sph, stream: settings.jet, sph: settings.sph };
    let options = RolloutOptions { recording: Some(recording(false)), ..RolloutOptions::default() };
    let nominal = rollout_landing(&RapierFactory, &wash, scene, task, &action, &options)?;
    let invalid = usize::from(nominal.objective.is_none());
    Ok(LandingPlan {
        task: task.task().clone(),
        engine: nominal.engine.clone(),
        vehicle: task.vehicle().clone(),
        surface: task.surface().clone(),
        structure: task.structure().to_vec(),
        parameters: task.parameters(),
        action,
        bodies: PlannedBody::all_of(scene),
        nominal,
        wash,
        predicted: None,
        alternatives: Vec::new(),
        evaluations: LandingEvaluations { jet: 0, sph: 1, invalid },
    })
}

/// Returns the landing action of a choice.
pub fn action_of(choice: &Choice) -> LandingAction {
    LandingAction {
        landing_w: choice.site.p_w.truncate().to_array(),
        approach_radius: choice.approach.radius,
        approach_angle: choice.approach.angle.rem_euclid(std::f64::consts::TAU),
    }
}

pub(crate) fn recording(particles: bool) -> LandingRecording {
    LandingRecording { every_s: RECORD_EVERY_S, particles }
}

/// Returns the frame that shows the sites best; `None` if none does.
pub fn observation(frames: &[Frame], scene: &Scene, sites: &Sites) -> Option<Observation> {
    let frame = &frames[best_view(frames.iter().map(|f| &f.camera), &sites.sites)?];
    let image = picture(&frame.color_path, frame.color.size()).unwrap_or_else(|| frame.color.clone());
    let called = scene.body(&sites.platform).map(|b| b.description.clone()).filter(|d| !d.trim().is_empty());
    let target = called.unwrap_or_else(|| sites.platform.replace('_', " "));
    Some(Observation { image, camera: frame.camera, target })
}

fn not_in_view() -> InputError {
    InputError::new(
        "no frame of the recording shows the landing sites from above",
        "--chooser visual",
        "record the structure from higher up, or use another chooser",
    )
}

/// Returns the choice with its pictures.
fn drawn(
    view: Option<Observation>,
    sites: &Sites,
    choice: Choice,
    landing: &LandingProblem,
    ways: &ApproachSettings,
) -> (Choice, Vec<ColorImage>) {
    let Some(view) = view else { return (choice, Vec::new()) };
    let (image, camera) = resized(&view.image, &view.camera, crate::settings::vlm_defaults().max_image_side);
    let all = approaches(landing.task.start_w(), choice.site.p_w, ways);
    let pictures = vec![
        sites_picture(&image, &camera, sites, Some(choice.site.id)).image,
        paths_picture(&image, &camera, &choice.site, &all, Some(choice.approach.id)).image,
    ];
    (choice, pictures)
}
