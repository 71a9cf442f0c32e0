//! The scenes that are measured.

use crate::models::model_scene;
use crate::stacked::{Structure, generate_stacked};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Seed};
use sms_synth::{
    BilliardsSettings, FIXED_SCENES, LandingStructure, ModelScene, TruthScene, billiards_scene,
    generate_billiards, landing_scene, landing_scene_among, read_model, read_models,
};
use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

/// The ten fixed seeds of the billiards family. The demo's are 1 to 5. The scan was tuned on 1001, 1003 and
/// 1005, and 1002, 1009 and 1010 were inspected; 1004, 1006, 1007 and 1008 were only measured.
pub const SEEDS: [u64; 10] = [1001, 1002, 1003, 1004, 1005, 1006, 1007, 1008, 1009, 1010];

/// Frames of a recording (paper: 60).
pub const FRAMES: usize = 60;

/// One of this number of frames is held out.
pub const HOLDOUT: usize = 8;

/// The real recordings, by folder name.
pub const REAL: [&str; 2] = ["seq_tabletop_bin", "seq_shelf_tissue"];

/// The scanned models of `sms-experiments materialize`, by folder name.
pub const MODELS: [&str; 18] = [
    "ycb_025_mug",
    "ycb_024_bowl",
    "ycb_005_tomato_soup_can",
    "ycb_003_cracker_box",
    "ycb_006_mustard_bottle",
    "ycb_010_potted_meat_can",
    "ycb_011_banana",
    "ycb_019_pitcher_base",
    "ycb_036_wood_block",
    "gso_porcelain_ramekin",
    "osim_piggybank",
    "osim_duck",
    "gz_coke_can",
    "gz_soccer_ball_small",
    "gz_cardboard_box",
    "gz_grey_tote",
    "aws_waste_bin",
    "aws_low_table",
];

/// The numbers of the fixed structures, as `sms synth --family landing` numbers them ([`sms_synth::landing_structure`]).
pub const LANDING_SCENES: RangeInclusive<usize> = 1..=LandingStructure::ALL.len();

/// One scene of the benchmark; its text is the `{scene}` of the metrics' keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum BenchScene {
    /// A generated billiards scene of this seed (`billiards_1001`).
    Billiards(u64),
    /// A real recording's folder name (`seq_tabletop_bin`).
    Real(String),
    /// Two balls and eight obstacles of this seed (`scene_1001`): ten objects instead of seven.
    Ten(u64),
    /// A scanned model on a floor, filmed from an orbit; its folder name (`ycb_025_mug`).
    Model(String),
    /// One of the eighteen fixed billiards scenes (`fixed_08`), or a drawn one (`fixed_1003`), by its number.
    Fixed(usize),
    /// Stacked or touching objects (`stacked_box_on_stool`), filmed from an orbit.
    Stacked(Structure),
    /// The same structure with the sizes, colours and overhangs of another seed (`stacked_box_on_stool_2001`).
    DrawnStacked(Structure, u64),
    /// One of the four fixed landing structures, by its number from 1 (`landing_1`), filmed from a helix; other numbers are seeds
    /// of drawn ones (`landing_1001`).
    Landing(usize),
    /// The same with scanned models, if they are present (`landing_scanned_1`).
    ScannedLanding(usize),
}

/// Seed of the stacked structures that are measured; masks are tuned on seeds from 1001 on.
pub const STACKED_SEED: u64 = 1;

impl fmt::Display for BenchScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Billiards(seed) => write!(f, "billiards_{seed}"),
            Self::Ten(seed) => write!(f, "scene_{seed}"),
            Self::Real(name) | Self::Model(name) => f.write_str(name),
            Self::Fixed(number) => write!(f, "fixed_{number:02}"),
            Self::Stacked(structure) => write!(f, "stacked_{}", structure.as_str()),
            Self::DrawnStacked(structure, seed) => write!(f, "stacked_{}_{seed}", structure.as_str()),
            Self::Landing(number) => write!(f, "landing_{number}"),
            Self::ScannedLanding(number) => write!(f, "landing_scanned_{number}"),
        }
    }
}

impl FromStr for BenchScene {
    type Err = InputError;

    fn from_str(text: &str) -> Result<Self, InputError> {
        if let Some(real) = REAL.iter().find(|r| **r == text) {
            return Ok(Self::Real((*real).to_owned()));
        }
        text.strip_prefix("billiards_").unwrap_or(text).parse().map(Self::Billiards).map_err(|_| {
            InputError::new(
                format!("no scene is called `{text}`"),
                "--scenes",
                format!("give a number of scenes, seeds such as 1001, or {}", REAL.join(", ")),
            )
        })
    }
}

/// The scenes of a list: `all` (the ten seeds and the real recordings), `real`, a number n up to ten (the first n seeds),
/// or ids separated by commas.
///
/// # Errors
/// [`InputError`] naming the part that does not name a scene.
pub fn select_scenes(list: &str) -> Result<Vec<BenchScene>, InputError> {
    let real = || REAL.iter().map(|r| BenchScene::Real((*r).to_owned()));
    let seeds = || SEEDS.into_iter().map(BenchScene::Billiards);
    match list {
        "all" => return Ok(seeds().chain(real()).collect()),
        "real" => return Ok(real().collect()),
        _ => {}
    }
    if let Ok(count @ 1..=10) = list.parse::<usize>() {
        return Ok(seeds().take(count).collect());
    }
    list.split(',').map(|id| id.trim().parse()).collect()
}

/// The scenes of `sms-experiments masks` that a list names: `all` (the fixed billiards scenes, the stacked structures, the real
/// shelf), `fixed`, `stacked`, `landing` (the four fixed structures), `real`, or ids separated by commas.
///
/// # Errors
/// [`InputError`] naming the part that does not name a scene.
pub fn select_mask_scenes(list: &str) -> Result<Vec<BenchScene>, InputError> {
    let fixed = || FIXED_SCENES.iter().map(|s| BenchScene::Fixed(s.number));
    let stacked = || Structure::ALL.into_iter().map(BenchScene::Stacked);
    // The other real recording marks one object only.
    let shelf = || std::iter::once(BenchScene::Real(REAL[1].to_owned()));
    match list {
        "all" => return Ok(fixed().chain(stacked()).chain(shelf()).collect()),
        "fixed" => return Ok(fixed().collect()),
        "stacked" => return Ok(stacked().collect()),
        "landing" => return Ok(LANDING_SCENES.map(BenchScene::Landing).collect()),
        "real" => return Ok(REAL.iter().map(|r| BenchScene::Real((*r).to_owned())).collect()),
        _ => {}
    }
    let known: Vec<BenchScene> = fixed().chain(stacked()).collect();
    list.split(',')
        .map(str::trim)
        .map(|id| match known.iter().find(|s| s.to_string() == id) {
            Some(scene) => Ok(scene.clone()),
            None => {
                let numbered = |prefix: &str| id.strip_prefix(prefix)?.parse().ok();
                let scanned = numbered("landing_scanned_").map(BenchScene::ScannedLanding);
                scanned.or(numbered("landing_").map(BenchScene::Landing)).map_or_else(|| id.parse(), Ok)
            }
        })
        .collect()
}

/// The true scene of a seed.
pub fn truth_scene(seed: u64) -> TruthScene {
    generate_billiards(Seed(seed), &BilliardsSettings::default())
}

/// The truth of a generated scene, and the textures of its objects. `None` for real recordings, and for a
/// model that is not there.
///
/// # Errors
/// [`CoreError`] of a model that cannot be read.
pub fn generated(scene: &BenchScene) -> Result<Option<ModelScene>, CoreError> {
    let plain = |scene| Ok(Some(ModelScene { scene, skins: Vec::new() }));
    match scene {
        BenchScene::Billiards(seed) => plain(truth_scene(*seed)),
        BenchScene::Ten(seed) => {
            let settings = BilliardsSettings { objects: 8, ..BilliardsSettings::default() };
            plain(generate_billiards(Seed(*seed), &settings))
        }
        BenchScene::Model(name) => {
            let path = model_path(name);
            if !path.is_file() {
                return Ok(None);
            }
            Ok(Some(model_scene(name, &read_model(&path)?, Seed(0))))
        }
        BenchScene::Fixed(number) => match billiards_scene(*number) {
            Some(fixed) => plain(fixed.generate()),
            None => Ok(None),
        },
        BenchScene::Stacked(structure) => plain(generate_stacked(*structure, Seed(STACKED_SEED))),
        BenchScene::DrawnStacked(structure, seed) => plain(generate_stacked(*structure, Seed(*seed))),
        BenchScene::Landing(number) => plain(landing_scene(*number as u64)),
        BenchScene::ScannedLanding(number) => {
            let dir = models_dir();
            if !dir.is_dir() {
                return Ok(None);
            }
            Ok(Some(landing_scene_among(*number as u64, &read_models(&dir)?)?))
        }
        BenchScene::Real(_) => Ok(None),
    }
}

/// The error for a missing scene, or one built from scanned models that are missing.
pub(crate) fn no_scene(which: &BenchScene) -> InputError {
    InputError::new(
        format!("there is no generated scene {which}"),
        "--scenes",
        "give numbers of existing scenes; scanned models are looked for in meshes/ of SMS_TEST_DATA",
    )
}

/// The folder of the scanned models.
pub fn models_dir() -> PathBuf {
    real_data_dir().join("meshes")
}

/// Returns the path of a scanned model.
pub fn model_path(name: &str) -> PathBuf {
    models_dir().join(name).join("model.obj")
}

/// The models whose names contain one of these words (`mug`, `ycb_025_mug`).
///
/// # Errors
/// [`InputError`] naming the word that no name contains.
pub fn select_models(words: &[String]) -> Result<Vec<BenchScene>, InputError> {
    for word in words {
        if !MODELS.iter().any(|m| m.contains(word.as_str())) {
            let cure = format!("the objects are {}", MODELS.join(", "));
            return Err(InputError::new(format!("no object is called `{word}`"), "--objects", cure));
        }
    }
    let chosen = MODELS.iter().filter(|m| words.iter().any(|w| m.contains(w.as_str())));
    Ok(chosen.map(|m| BenchScene::Model((*m).to_owned())).collect())
}

/// The folder of the real recordings: `SMS_TEST_DATA`, else `../shared/data`.
pub fn real_data_dir() -> PathBuf {
    std::env::var_os("SMS_TEST_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_objects_are_ten() {
        for seed in SEEDS {
            let made = generated(&BenchScene::Ten(seed)).unwrap().unwrap();
            assert_eq!(made.scene.objects.len(), 10, "seed {seed}");
        }
    }

    #[test]
    fn lists_name_scenes_for_masks() {
        assert_eq!(select_mask_scenes("all").unwrap().len(), 23);
        let mixed = select_mask_scenes("fixed_08, stacked_tote_on_table,billiards_1001").unwrap();
        let text: Vec<String> = mixed.iter().map(ToString::to_string).collect();
        assert_eq!(text, ["fixed_08", "stacked_tote_on_table", "billiards_1001"]);
        let landing = select_mask_scenes("landing").unwrap();
        let scanned = &select_mask_scenes("landing_scanned_3").unwrap()[0];
        assert_eq!(
            (scanned, scanned.to_string().as_str()),
            (&BenchScene::ScannedLanding(3), "landing_scanned_3")
        );
        assert_eq!((landing.len(), &landing[1]), (4, &select_mask_scenes("landing_2").unwrap()[0]));
        assert!(select_mask_scenes("fixed_19").unwrap_err().to_string().contains("fixed_19"));
    }

    #[test]
    fn lists_name_scenes() {
        assert_eq!(select_scenes("2").unwrap(), [BenchScene::Billiards(1001), BenchScene::Billiards(1002)]);
        assert_eq!(select_scenes("all").unwrap().len(), 12);
        let mixed = select_scenes("1003, billiards_7,seq_shelf_tissue").unwrap();
        let text: Vec<String> = mixed.iter().map(ToString::to_string).collect();
        assert_eq!(text, ["billiards_1003", "billiards_7", "seq_shelf_tissue"]);
        let models = select_models(&["box".into(), "ycb_025_mug".into()]).unwrap();
        let text: Vec<String> = models.iter().map(ToString::to_string).collect();
        assert_eq!(text, ["ycb_025_mug", "ycb_003_cracker_box", "gz_cardboard_box"]);
        assert!(select_models(&["spoon".into()]).unwrap_err().to_string().contains("spoon"));
        assert!(select_scenes("snooker").unwrap_err().to_string().contains("snooker"));
    }
}
