//! The baseline by visual prompting.

use crate::annotate::{paths_picture, resized, sites_picture};
use crate::prompt::{SYSTEM, approach_question, site_question};
use crate::{ApproachSettings, Choice, Chooser, Sites, approaches};
use glamx::DVec3;
use sms_core::{Camera, ColorImage, StageContext};
use sms_vlm::{Cache, ChoiceQuestion, ChooseError, Client, choose, jpeg};

/// A camera image of the quadrotor.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// The picture.
    pub image: ColorImage,
    /// Its camera.
    pub camera: Camera,
    /// The landing target in words ("cardboard box"); may be empty.
    pub target: String,
}

/// Inputs of [`visual_prompting`].
#[derive(Debug, Clone, Copy)]
pub struct PromptingInputs<'a> {
    /// The image that the candidates are drawn on.
    pub observation: &'a Observation,
    /// The candidate sites.
    pub sites: &'a Sites,
    /// Start of the flight, metres.
    pub start_w: DVec3,
    /// Settings of the candidate approaches.
    pub approaches: &'a ApproachSettings,
}

/// The model's choice with its pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct PromptedChoice {
    /// The choice, with the model's reasons.
    pub choice: Choice,
    /// The pictures sent to the model: sites, approaches.
    pub sent: [ColorImage; 2],
    /// The same pictures with the choice highlighted.
    pub chosen: [ColorImage; 2],
}

/// Asks a model for a landing site, then for an approach to it, each among those drawn on the picture.
///
/// # Errors
/// [`ChooseError`] if the server cannot be used, or the model names none of the candidates. No other chooser takes its place.
pub fn visual_prompting(
    inputs: &PromptingInputs<'_>,
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<PromptedChoice, ChooseError> {
    let PromptingInputs { observation, sites, start_w, approaches: settings } = *inputs;
    let (image, camera) = resized(&observation.image, &observation.camera, client.config().max_image_side);
    let ask = |name: &str, text: String, picture: &ColorImage, ids: Vec<u32>| {
        let (name, system) = (name.to_owned(), SYSTEM.to_owned());
        let question = ChoiceQuestion { name, system, text, jpeg: jpeg(picture), ids };
        choose(&question, client, cache, context)
    };
    let ids = |labels: &[(u32, [f64; 2])]| labels.iter().map(|l| l.0).collect::<Vec<u32>>();
    let not_visible = |name: &str| ChooseError::NoAnswer {
        name: name.to_owned(),
        what: "none of the candidates is in the picture".to_owned(),
        cure: "use a view of the platform from above".to_owned(),
    };

    let drawn = sites_picture(&image, &camera, sites, None);
    if drawn.labels.is_empty() {
        return Err(not_visible("landing site"));
    }
    let site = ask("landing site", site_question(&observation.target), &drawn.image, ids(&drawn.labels))?;
    let chosen_sites = sites_picture(&image, &camera, sites, Some(site.id)).image;
    let landing =
        sites.sites.iter().find(|s| s.id == site.id).ok_or_else(|| not_visible("landing site"))?.clone();

    let all = approaches(start_w, landing.p_w, settings);
    let ways = paths_picture(&image, &camera, &landing, &all, None);
    if ways.labels.is_empty() {
        return Err(not_visible("approach"));
    }
    let way = ask("approach", approach_question(&observation.target), &ways.image, ids(&ways.labels))?;
    let chosen_ways = paths_picture(&image, &camera, &landing, &all, Some(way.id)).image;
    let approach = all.into_iter().find(|a| a.id == way.id).ok_or_else(|| not_visible("approach"))?;
    let reasons = [site.reasoning, way.reasoning];
    let choice = Choice { chooser: Chooser::VisualPrompting, site: landing, approach, reasons };
    Ok(PromptedChoice { choice, sent: [drawn.image, ways.image], chosen: [chosen_sites, chosen_ways] })
}
