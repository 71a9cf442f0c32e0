//! `sms synth`: writes a generated recording of any scene.

use crate::cli::{FamilyName, SynthArguments};
use sms_cli::front::Console;
use sms_core::{InputError, Seed, counted};
use sms_pipeline::write_task_files;
use sms_synth::{
    BilliardsSettings, FIXED_SCENES, HelicalPath, Layout, ModelScene, RecordingSettings, SceneViews,
    generate_billiards, generate_billiards_among, generate_challenge, landing_scene_among, read_models,
    record_views,
};

pub(crate) fn run(console: &Console, a: &SynthArguments) -> anyhow::Result<()> {
    let made = scene(console, a)?;
    let truth = &made.scene;
    let settings = recording(console, a)?;
    let poses = match &truth.landing {
        Some(_) => HelicalPath::default().poses(truth, settings.frames),
        None => settings.path.poses(truth, settings.frames),
    };
    let source = made.skins.iter().filter(|s| s.is_some()).count().to_string();
    record_views(
        &SceneViews { scene: truth, skins: &made.skins, poses: &poses, source: &source },
        &settings,
        &a.folder,
        console.context.progress.as_ref(),
        &console.context.cancel,
    )?;
    write_task_files(truth, &a.folder)?;
    console.say(format!(
        "{}: {} in {}",
        truth.name,
        counted(truth.objects.len(), "object", "objects"),
        a.folder.display()
    ));
    Ok(())
}

/// The sensor's settings, then those of the user, then the arguments.
fn recording(console: &Console, a: &SynthArguments) -> anyhow::Result<RecordingSettings> {
    let sensor = a.sensor.sensor();
    let base = a.width.map_or_else(|| sensor.recording(), |width| sensor.recording_at(width));
    let base = RecordingSettings { path: a.path.path(), ..base };
    let mut settings = console.context.settings.section("recording", base)?;
    settings.seed = Seed(a.seed);
    settings.frames = a.frames.unwrap_or(settings.frames);
    let poses = &mut settings.sensor.poses;
    if a.pose_noise_mm != 0.0 {
        poses.jitter_m = a.pose_noise_mm * 1e-3;
    }
    if a.pose_noise_deg != 0.0 {
        poses.jitter_rad = a.pose_noise_deg.to_radians();
    }
    Ok(settings)
}

fn scene(console: &Console, a: &SynthArguments) -> anyhow::Result<ModelScene> {
    let plain = |scene| ModelScene { scene, skins: Vec::new() };
    if a.meshes.is_some() && !matches!(a.family, FamilyName::Billiards | FamilyName::Landing) {
        let what = "only the families billiards and landing use scanned models";
        let cure = "add --family billiards or --family landing, or leave it out";
        return Err(InputError::new(what, "--meshes", cure).into());
    }
    let models = match &a.meshes {
        Some(dir) if dir.is_dir() => read_models(dir)?,
        Some(dir) => {
            console.say(format!("the folder {} does not exist: all objects are generated", dir.display()));
            Vec::new()
        }
        None => Vec::new(),
    };
    match a.family {
        FamilyName::Billiards => {
            let defaults = BilliardsSettings::default();
            let settings = BilliardsSettings { objects: a.objects.unwrap_or(defaults.objects), ..defaults };
            if models.is_empty() {
                return Ok(plain(generate_billiards(Seed(a.seed), &settings)));
            }
            Ok(generate_billiards_among(Seed(a.seed), &settings, &models))
        }
        FamilyName::Challenge => {
            let layout = Layout::ALL[(a.seed % Layout::ALL.len() as u64) as usize];
            let drawn = generate_challenge(layout, Seed(a.seed), a.objects.unwrap_or(4));
            drawn.map(plain).ok_or_else(|| {
                let what =
                    format!("the layout `{}` of this seed does not fit into the workspace", layout.as_str());
                InputError::new(what, "--seed", "try the next seed, or fewer objects").into()
            })
        }
        FamilyName::Fixed => {
            let fixed = FIXED_SCENES.iter().find(|s| s.number as u64 == a.seed).ok_or_else(|| {
                InputError::new("this fixed scene does not exist", "--seed", "use a number from 1 to 18")
            })?;
            Ok(plain(fixed.generate()))
        }
        FamilyName::Landing => Ok(landing_scene_among(a.seed, &models)?),
    }
}
