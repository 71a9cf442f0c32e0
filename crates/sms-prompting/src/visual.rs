//! The baseline by visual prompting.

use crate::annotate::{paths_picture, resized, sites_picture};
use crate::prompt::{SYSTEM, approach_question, site_question};
use crate::{ApproachSettings, Choice, Chooser, Sites, approaches};
use glamx::DVec3;
use sms_core::{Camera, Cancel, ColorImage, Warnings};
use sms_vlm::{Cache, ChoiceQuestion, ChooseError, Client, choose, jpeg};

/// What the quadrotor sees.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// The picture.
    pub image: ColorImage,
    /// Its camera.
    pub camera: Camera,
    /// What is to be landed on, in words ("cardboard box"); may be empty.
    pub target: String,
}

/// What was asked and chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Prompted {
    /// The choice, with the model's reasons.
    pub choice: Choice,
    /// The pictures that were sent: sites, approaches.
    pub asked: [ColorImage; 2],
    /// The same with what was chosen.
    pub chosen: [ColorImage; 2],
}

/// Asks a model for a landing site, then for an approach to it, each among those drawn on the picture.
///
/// # Errors
/// [`ChooseError`]: the server cannot be used, or the model names none of the candidates. There is no other chooser in its place.
pub fn visual_prompting(
    seen: &Observation,
    sites: &Sites,
    start_w: DVec3,
    settings: &ApproachSettings,
    client: &Client,
    cache: &Cache,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<Prompted, ChooseError> {
    let (image, camera) = resized(&seen.image, &seen.camera, client.config().max_image_side);
    let ask = |name: &str, text: String, picture: &ColorImage, ids: Vec<u32>| {
        let (name, system) = (name.to_owned(), SYSTEM.to_owned());
        let question = ChoiceQuestion { name, system, text, jpeg: jpeg(picture), ids };
        choose(&question, client, cache, cancel, warnings)
    };
    let ids = |labels: &[(u32, [f64; 2])]| labels.iter().map(|l| l.0).collect::<Vec<u32>>();
    let not_seen = |name: &str| ChooseError::NoAnswer {
        name: name.to_owned(),
        what: "none of the candidates is in the picture".to_owned(),
        cure: "use a view of the platform from above".to_owned(),
    };

    let drawn = sites_picture(&image, &camera, sites, None);
    if drawn.labels.is_empty() {
        return Err(not_seen("landing site"));
    }
    let site = ask("landing site", site_question(&seen.target), &drawn.image, ids(&drawn.labels))?;
    let chosen_sites = sites_picture(&image, &camera, sites, Some(site.id)).image;
    let landing =
        sites.sites.iter().find(|s| s.id == site.id).ok_or_else(|| not_seen("landing site"))?.clone();

    let all = approaches(start_w, landing.p_w, settings);
    let ways = paths_picture(&image, &camera, &landing, &all, None);
    if ways.labels.is_empty() {
        return Err(not_seen("approach"));
    }
    let way = ask("approach", approach_question(&seen.target), &ways.image, ids(&ways.labels))?;
    let chosen_ways = paths_picture(&image, &camera, &landing, &all, Some(way.id)).image;
    let approach = all.into_iter().find(|a| a.id == way.id).ok_or_else(|| not_seen("approach"))?;
    let reasons = [site.reasoning, way.reasoning];
    let choice = Choice { chooser: Chooser::VisualPrompting, site: landing, approach, reasons };
    Ok(Prompted { choice, asked: [drawn.image, ways.image], chosen: [chosen_sites, chosen_ways] })
}
